//! Pictures of Gaussians on the host, such as those of one time or of one segment.

use super::params::to_vec;
use super::{HostGaussians, Rendering};
use burn::tensor::Device;
use volseggs_kernels::splat::{SplatSettings, splat};

/// Colour over the background and alpha, `[H, W, 4]`.
pub fn draw(gaussians: &HostGaussians, settings: SplatSettings, device: &Device) -> Vec<f32> {
    draw_each(gaussians.clone(), [settings], device).next().unwrap_or_default()
}

/// The same with each of several settings, one image at a time; the Gaussians are moved to the device once.
pub fn draw_each(
    gaussians: HostGaussians,
    settings: impl IntoIterator<Item = SplatSettings>,
    device: &Device,
) -> impl Iterator<Item = Vec<f32>> {
    let inputs = (!gaussians.is_empty()).then(|| gaussians.into_splat(device));
    let one = move |settings: SplatSettings| match &inputs {
        Some(inputs) => to_vec(splat(inputs.clone(), settings).image),
        // not every backend can hold an empty tensor
        None => {
            let SplatSettings { camera, rendering: Rendering { background: [r, g, b], .. } } = settings;
            [r, g, b, 0.0].repeat(camera.width * camera.height)
        }
    };
    settings.into_iter().map(one)
}
