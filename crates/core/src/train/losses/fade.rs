//! The fading penalty of the joint stage, `loss.fade`.

use super::{LossInput, LossTerm};
use crate::config::types::Config;
use crate::train::schedule::Stage;
use burn::tensor::Tensor;
use burn::tensor::activation::sigmoid;

/// How much the Gaussians fade.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fade;

impl LossTerm for Fade {
    fn loss(&self, seen: &LossInput<'_>) -> Tensor<1> {
        fading(seen.gaussians.opacity_logits.clone(), seen.scene.gaussians.opacity_logits.val())
    }

    fn weight(&self, config: &Config, stage: Stage) -> Option<f64> {
        Some(if stage.is_joint() { config.loss.fade } else { 0.0 })
    }

    fn check(&self, config: &Config) -> Result<(), String> {
        let (fade, visits) = (config.loss.fade, config.speed.cull_visits);
        if fade > 0.0 && visits > 1 {
            return Err(format!(
                "speed.cull_visits = {visits} skips faded Gaussians, on which loss.fade = {fade} acts: use only one of \
                 them"
            ));
        }
        if fade > 0.0 && !config.model.deform_opacity {
            return Err(format!("loss.fade = {fade}: nothing fades with model.deform_opacity = false"));
        }
        Ok(())
    }
}

/// Returns how much the Gaussians fade: the mean absolute difference between their opacity at a time and the canonical
/// one, in [0, 1]. Both are logits `[N]`; the result is `[1]`. This term is this project's own: images alone do not
/// distinguish an object that moves from one that fades out while another appears.
pub fn fading(at: Tensor<1>, canonical: Tensor<1>) -> Tensor<1> {
    (sigmoid(at) - sigmoid(canonical)).abs().mean()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::params::to_vec;

    #[test]
    fn fading_is_the_mean_change_of_opacity_and_goes_down_by_either() {
        let device = crate::device::DeviceName::all()[0].open().unwrap().autodiff();
        let logits = |v: [f32; 3]| Tensor::<1>::from_floats(v, &device).require_grad();
        let (at, canonical) = (logits([0.0, 2.0, -8.0]), logits([1.0, 2.0, 3.0]));
        let loss = fading(at.clone(), canonical.clone());
        let sigmoid = |x: f32| 1.0 / (1.0 + (-x).exp());
        let expected = ((sigmoid(1.0) - 0.5) + (sigmoid(3.0) - sigmoid(-8.0))) / 3.0;
        assert!((to_vec(loss.clone().inner())[0] - expected).abs() < 1e-6);
        let gradients = loss.backward();
        let of = |t: &Tensor<1>| to_vec(t.grad(&gradients).unwrap());
        let slope = |x: f32| sigmoid(x) * (1.0 - sigmoid(x)) / 3.0;
        for (found, expected) in
            [(of(&at), [-slope(0.0), 0.0, -slope(-8.0)]), (of(&canonical), [slope(1.0), 0.0, slope(3.0)])]
        {
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?}, not {expected:?}");
        }
    }
}
