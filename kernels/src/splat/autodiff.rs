//! Gradient registration for [`super::splat`] and [`super::splat_covariances`], which differ in the number of inputs.

use super::{CovarianceTensors, SplatBackwardOps, SplatForward, SplatOps, SplatSaved, SplatSettings, SplatTensors};
use crate::tensors::Pullback;
use burn::backend::Autodiff;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::ops::{Backward, NodeGuard, OpsKind};

impl<B: SplatOps + SplatBackwardOps, C: CheckpointStrategy> SplatOps for Autodiff<B, C> {
    fn splat_forward(inputs: SplatTensors<Self>, settings: SplatSettings, _: bool) -> SplatForward<Self> {
        let SplatTensors { means, covariances, opacity_logits, sh, screen_offsets } = inputs;
        let (means, of_means) = means.into_parts();
        let (opacity_logits, of_opacities) = opacity_logits.into_parts();
        let (sh, of_sh) = sh.into_parts();
        let (screen_offsets, of_offsets) = screen_offsets.into_parts();
        let with = |covariances| SplatTensors { means, covariances, opacity_logits, sh, screen_offsets };
        match covariances {
            CovarianceTensors::Factored { rotations, log_scales } => {
                let (rotations, of_rotations) = rotations.into_parts();
                let (log_scales, of_scales) = log_scales.into_parts();
                let inputs = with(CovarianceTensors::Factored { rotations, log_scales });
                recorded(inputs, [of_means, of_rotations, of_scales, of_opacities, of_sh, of_offsets], settings)
            }
            CovarianceTensors::Entries(entries) => {
                let (entries, of_entries) = entries.into_parts();
                let inputs = with(CovarianceTensors::Entries(entries));
                recorded(inputs, [of_means, of_entries, of_opacities, of_sh, of_offsets], settings)
            }
        }
    }
}

/// Renders, and records what the backward pass needs; `nodes` are in the order of [`SplatTensors::into_vec`].
fn recorded<B: SplatOps + SplatBackwardOps, C: CheckpointStrategy, const N: usize>(
    inputs: SplatTensors<B>,
    nodes: [NodeGuard; N],
    settings: SplatSettings,
) -> SplatForward<Autodiff<B, C>> {
    let backward = |(inputs, settings, saved): (SplatTensors<B>, SplatSettings, SplatSaved), grad| {
        let mut grads = B::splat_backward(inputs, grad, settings, saved).into_vec().into_iter();
        std::array::from_fn(|_| grads.next().expect("one gradient for each input"))
    };
    match Pullback::<B, _, N>(backward).prepare::<C>(nodes).compute_bound().stateful() {
        OpsKind::Tracked(prep) => {
            let out = B::splat_forward(inputs.clone(), settings, true);
            let kept = (inputs, settings, out.saved.clone());
            SplatForward { image: prep.finish(kept, out.image), radii: out.radii, saved: out.saved }
        }
        OpsKind::UnTracked(prep) => {
            let out = B::splat_forward(inputs, settings, false);
            SplatForward { image: prep.finish(out.image), radii: out.radii, saved: out.saved }
        }
    }
}
