//! The initial 4D Gaussians: those of 3DGS, spread over time and not rotated in it.

use super::model::{Scene4d, Spec};
use crate::fourdgs::FourDgsConfig;
use burn::tensor::Device;
use std::collections::BTreeMap;
use volseggs_base::rng::{Purpose, Rng};
use volseggs_core::config::types::Config;
use volseggs_core::model::HostGaussians;
use volseggs_core::model::params::HostTensor;
use volseggs_core::train::{TrainError, init};
use volseggs_volume::data::Split;

/// The initial Gaussians: placed in space according to `[init]`, with random peak times and constant colours.
///
/// # Errors
/// As [`init::initialise`].
pub(super) fn first(
    split: &Split,
    config: &Config,
    settings: &FourDgsConfig,
    background: [f32; 3],
    device: &Device,
) -> Result<Scene4d, TrainError> {
    let (host, scene) = init::initialise(split, config, background)?;
    let orders = settings.time_orders + 1;
    let (centre, half_size) = (scene.centre, scene.half_size);
    let spec = Spec {
        sh_stride: host.sh_stride,
        orders,
        sh_degree: 0,
        time_degree: 0,
        background,
        dilation: config.model.dilation as f32,
        centre,
        half_size,
    };
    let tensors = in_time(host, config.seed, settings);
    match Scene4d::of(spec, &tensors, device) {
        Ok(scene) => Ok(scene),
        Err(error) => unreachable!("the tensors are those of the spec: {error}"),
    }
}

fn in_time(host: HostGaussians, seed: u64, settings: &FourDgsConfig) -> BTreeMap<String, HostTensor> {
    let (n, orders) = (host.len(), settings.time_orders + 1);
    let mut rng = Rng::new(seed, 0, Purpose::PeakTimes);
    let margin = settings.time_margin as f32;
    let times = (0..n).map(|_| rng.uniform() * (1.0 + 2.0 * margin) - margin).collect();
    let along = settings.time_scale.ln() as f32;
    let log_scales = host.log_scales.chunks_exact(3).flat_map(|s| [s[0], s[1], s[2], along]).collect();
    let width = 3 * host.sh_stride;
    let mut sh = vec![0.0; n * orders * width];
    for (row, constant) in sh.chunks_exact_mut(orders * width).zip(host.sh.chunks_exact(width)) {
        row[..width].copy_from_slice(constant);
    }
    let identity = [1.0, 0.0, 0.0, 0.0].repeat(n);
    let tensor = |name: &str, shape: &[usize], values: Vec<f32>| {
        (format!("gaussians.{name}"), HostTensor { shape: shape.to_vec(), values })
    };
    BTreeMap::from([
        tensor("means", &[n, 3], host.means),
        tensor("times", &[n], times),
        tensor("log_scales", &[n, 4], log_scales),
        tensor("left", &[n, 4], identity.clone()),
        tensor("right", &[n, 4], identity),
        tensor("opacity_logits", &[n], host.opacity_logits),
        tensor("sh", &[n, orders * host.sh_stride, 3], sh),
    ])
}
