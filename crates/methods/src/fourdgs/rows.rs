//! Adding and removing Gaussians: planned as in 3DGS, with halves drawn from their parent in space and time.

use super::rotation_matrices;
use burn::tensor::{Device, Tensor, TensorData};
use std::collections::BTreeMap;
use volseggs_base::rng::Rng;
use volseggs_core::model::params::{HostTensor, to_vec};
use volseggs_core::train::densify::{RowSource, gather};

/// Factor by which halves are smaller, as in 3DGS.
const SMALLER: f32 = 1.6;

/// Number of values per row of a tensor.
pub(super) fn width(tensor: &HostTensor) -> usize {
    tensor.shape.iter().skip(1).product()
}

/// The new parameters by name, made from the `old` ones. Halves are drawn from their parent's distribution in space and
/// time and are smaller in all four directions.
pub(super) fn apply(
    rows: &[RowSource],
    old: &BTreeMap<String, HostTensor>,
    mut rng: Rng,
    device: &Device,
) -> BTreeMap<String, HostTensor> {
    let gathered = |(name, tensor): (&String, &HostTensor)| {
        let mut shape = tensor.shape.clone();
        shape[0] = rows.len();
        (name.clone(), HostTensor { shape, values: gather(&tensor.values, rows, width(tensor)) })
    };
    let mut new: BTreeMap<String, HostTensor> = old.iter().map(gathered).collect();
    let halves: Vec<usize> = (0..rows.len()).filter(|&j| matches!(rows[j], RowSource::Half(_))).collect();
    if halves.is_empty() {
        return new;
    }
    let fours = |name: &str| -> Vec<f32> {
        let values = new.get(name).map_or(&[][..], |tensor| &tensor.values);
        halves.iter().flat_map(|&j| &values[4 * j..][..4]).copied().collect()
    };
    let quaternions = |name: &str| Tensor::from_data(TensorData::new(fours(name), [halves.len(), 4]), device);
    let rotations = to_vec(rotation_matrices(quaternions("gaussians.left"), quaternions("gaussians.right")));
    let offsets: Vec<[f32; 4]> = fours("gaussians.log_scales")
        .chunks_exact(4)
        .zip(rotations.chunks_exact(16))
        .map(|(log_scales, rotation)| {
            let local: [f32; 4] = std::array::from_fn(|k| log_scales[k].exp() * rng.normal());
            std::array::from_fn(|r| (0..4).map(|k| rotation[4 * r + k] * local[k]).sum())
        })
        .collect();
    let mut of = |name: &str, width: usize, change: fn(&mut [f32], &[f32; 4])| {
        if let Some(tensor) = new.get_mut(name) {
            let rows = halves.iter().zip(&offsets);
            rows.for_each(|(&j, offset)| change(&mut tensor.values[width * j..][..width], offset));
        }
    };
    of("gaussians.means", 3, |mean, offset| mean.iter_mut().zip(offset).for_each(|(v, d)| *v += d));
    of("gaussians.times", 1, |time, offset| time[0] += offset[3]);
    of("gaussians.log_scales", 4, |scales, _| scales.iter_mut().for_each(|s| *s -= SMALLER.ln()));
    new
}
