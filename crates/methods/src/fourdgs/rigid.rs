//! The regulariser that makes neighbours move alike, as in the published code (`lambda_rigid`).

use burn::tensor::{Device, Int, Tensor, TensorData};
use rayon::prelude::*;
use std::collections::BTreeMap;
use volseggs_base::points::neighbours::NeighbourGrid;
use volseggs_core::model::params::HostTensor;

/// Decay of a neighbour's weight with its distance, 1 / scene units (published code).
const WEIGHT_DECAY: f32 = 100.0;
/// The duration over which motions are compared; the whole time range is 1 (published code).
const INTERVAL: f32 = 0.1;
/// Minimum squared difference, as the square root has no gradient at 0.
const MIN_SQUARE: f32 = 1e-12;
/// The names in a checkpoint.
const NEIGHBOURS: &str = "rigid.neighbours";
const WEIGHTS: &str = "rigid.weights";

/// The neighbours of N Gaussians.
#[derive(Debug)]
pub(super) struct Neighbours {
    /// Number of neighbours of each, itself included: K.
    count: usize,
    /// Their indices `[N K]`.
    indices: Tensor<1, Int>,
    /// Their weights `[N, K]`.
    weights: Tensor<2>,
}

impl Neighbours {
    /// The `count` (K) Gaussians nearest to each of the `means` `[N, 3]`, itself included.
    pub(super) fn of(means: &[f32], count: usize, device: &Device) -> Self {
        let n = means.len() / 3;
        let Ok(grid) = NeighbourGrid::adaptive(means) else { unreachable!("means are [N, 3]") };
        let found: Vec<Vec<(u32, f32)>> = (0..n)
            .into_par_iter()
            .map(|i| {
                let at = [means[3 * i], means[3 * i + 1], means[3 * i + 2]];
                let mut near = grid.nearest(at, count - 1, Some(i as u32));
                // itself, repeated if there are too few; this adds nothing to the loss, as it moves like itself
                near.resize(count, (i as u32, f32::INFINITY));
                near
            })
            .collect();
        let indices = found.iter().flatten().map(|(i, _)| *i).collect();
        let weights = found.iter().flatten().map(|(_, square)| (-WEIGHT_DECAY * square.sqrt()).exp()).collect();
        Self::put(indices, weights, count, device)
    }

    fn put(indices: Vec<u32>, weights: Vec<f32>, count: usize, device: &Device) -> Self {
        let n = weights.len() / count;
        let indices: Vec<i32> = indices.into_iter().map(|i| i as i32).collect();
        Self {
            count,
            indices: Tensor::from_data(TensorData::new(indices, [n * count]), device),
            weights: Tensor::from_data(TensorData::new(weights, [n, count]), device),
        }
    }

    /// The mean over all Gaussians i and their K neighbours j of `exp(-100 d_ij) |v_i - v_j|`, where v is the
    /// displacement of a mean in a tenth of the time range, from `velocities` `[N, 3]`; `[1]`.
    pub(super) fn loss(&self, velocities: Tensor<2>) -> Tensor<1> {
        let [n, _] = velocities.dims();
        let ways = velocities.mul_scalar(INTERVAL);
        let theirs = ways.clone().select(0, self.indices.clone()).reshape([n, self.count, 3]);
        let apart = theirs - ways.reshape([n, 1, 3]);
        let square = (apart.clone() * apart).sum_dim(2).reshape([n, self.count]);
        (square.clamp_min(MIN_SQUARE).sqrt() * self.weights.clone()).mean()
    }

    /// The neighbours as tensors for a checkpoint; indices are exact in f32 below 2^24.
    pub(super) fn to_tensors(&self) -> BTreeMap<String, HostTensor> {
        let indices = self.indices.clone().into_data().convert::<i32>().try_into_vec::<i32>().unwrap_or_default();
        let shape = self.weights.dims().to_vec();
        let weights = self.weights.clone().into_data().try_into_vec::<f32>().unwrap_or_default();
        let indices = indices.into_iter().map(|i| i as f32).collect();
        BTreeMap::from([
            (NEIGHBOURS.to_owned(), HostTensor { shape: shape.clone(), values: indices }),
            (WEIGHTS.to_owned(), HostTensor { shape, values: weights }),
        ])
    }

    /// The neighbours of `n` Gaussians from [`Neighbours::to_tensors`]; `None` if there were none.
    ///
    /// # Errors
    /// A description of what does not fit.
    pub(super) fn from_tensors(
        tensors: &BTreeMap<String, HostTensor>,
        n: usize,
        count: usize,
        device: &Device,
    ) -> Result<Option<Self>, String> {
        let (Some(indices), Some(weights)) = (tensors.get(NEIGHBOURS), tensors.get(WEIGHTS)) else {
            return Ok(None);
        };
        let fits = |t: &HostTensor| t.values.len() == n * count;
        if !fits(indices) || !fits(weights) || indices.values.iter().any(|i| !(0.0..n as f32).contains(i)) {
            return Err(format!("{NEIGHBOURS} and {WEIGHTS} do not hold {count} neighbours for each of {n} Gaussians"));
        }
        let indices = indices.values.iter().map(|&i| i as u32).collect();
        Ok(Some(Self::put(indices, weights.values.clone(), count, device)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POINTS: [[f64; 3]; 5] =
        [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 0.05], [0.03, 0.03, 0.03]];
    const VELOCITIES: [[f64; 3]; 5] =
        [[0.1, 0.2, -0.3], [0.4, -0.1, 0.2], [0.0, 0.3, 0.1], [-0.2, 0.1, 0.5], [0.3, 0.3, 0.0]];

    /// The published formula in f64.
    fn exact(velocities: &[[f64; 3]; 5], count: usize) -> f64 {
        let distance = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
        let of = |i: usize| -> f64 {
            let mut all: Vec<(f64, usize)> = (0..5).map(|j| (distance(POINTS[i], POINTS[j]), j)).collect();
            all.sort_by(|a, b| a.partial_cmp(b).unwrap());
            let term = |(d, j): &(f64, usize)| (-100.0 * d).exp() * 0.1 * distance(velocities[i], velocities[*j]);
            all[..count].iter().map(term).sum()
        };
        (0..5).map(of).sum::<f64>() / (5 * count) as f64
    }

    fn the_loss_and_its_gradient_are_those_of_the_formula(device: Device) {
        let device = device.autodiff();
        let flat = |values: &[[f64; 3]; 5]| values.as_flattened().iter().map(|v| *v as f32).collect::<Vec<_>>();
        let neighbours = Neighbours::of(&flat(&POINTS), 3, &device);
        let velocities = Tensor::<2>::from_data(TensorData::new(flat(&VELOCITIES), [5, 3]), &device).require_grad();
        let loss = neighbours.loss(velocities.clone());
        let value = f64::from(loss.clone().into_scalar::<f32>());
        assert!((value - exact(&VELOCITIES, 3)).abs() < 1e-6 * value, "{value} {}", exact(&VELOCITIES, 3));
        let gradient = volseggs_core::model::params::to_vec(velocities.grad(&loss.backward()).unwrap());
        for i in 0..15 {
            let moved = |step: f64| {
                let mut all = VELOCITIES;
                all[i / 3][i % 3] += step;
                exact(&all, 3)
            };
            let quotient = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            assert!((f64::from(gradient[i]) - quotient).abs() < 1e-6, "{i}: {} {quotient}", gradient[i]);
        }
    }

    fn equal_velocities_and_lone_points_leave_finite_gradients(device: Device) {
        let device = device.autodiff();
        for points in [vec![0.0; 6], vec![0.0, 0.0, 0.0, f32::NAN, 0.0, 0.0], vec![0.5; 3]] {
            let n = points.len() / 3;
            let neighbours = Neighbours::of(&points, 4, &device);
            let velocities = Tensor::<2>::ones([n, 3], &device).require_grad();
            let loss = neighbours.loss(velocities.clone());
            assert!(loss.clone().into_scalar::<f32>() < 1e-5);
            let gradient = volseggs_core::model::params::to_vec(velocities.grad(&loss.backward()).unwrap());
            assert!(gradient.iter().all(|v| *v == 0.0), "{gradient:?}");
        }
    }

    volseggs_testing::on_every_device!(
        crate::test_support::open_to_test =>
        the_loss_and_its_gradient_are_those_of_the_formula,
        equal_velocities_and_lone_points_leave_finite_gradients,
    );

    #[test]
    fn neighbours_survive_a_checkpoint() {
        let device = volseggs_core::device::DeviceName::all()[0].open().unwrap();
        let points: Vec<f32> = POINTS.as_flattened().iter().map(|v| *v as f32).collect();
        let tensors = Neighbours::of(&points, 3, &device).to_tensors();
        let read = Neighbours::from_tensors(&tensors, 5, 3, &device).unwrap().unwrap();
        assert_eq!(read.to_tensors(), tensors);
        assert!(Neighbours::from_tensors(&tensors, 4, 3, &device).unwrap_err().contains("3 neighbours"));
        assert!(Neighbours::from_tensors(&BTreeMap::new(), 5, 3, &device).unwrap().is_none());
    }
}
