//! From a clicked pixel to the Gaussian seen there.

use crate::model::HostGaussians;
use burn::tensor::Device;
use volseggs_kernels::splat::SplatSettings;
use volseggs_kernels::splat::contributors::{Contributors, ContributorsError, contributors};

/// What the pixel at column `x` and row `y` is made of: indices of Gaussians and their weights, nearest first.
///
/// # Errors
/// If the camera has no such pixel.
pub fn under(
    gaussians: &HostGaussians,
    settings: SplatSettings,
    [x, y]: [u32; 2],
    device: &Device,
) -> Result<Vec<(u32, f32)>, ContributorsError> {
    let camera = settings.camera;
    let pixel = y.saturating_mul(camera.width as u32).saturating_add(x);
    // a column beyond the right edge must not become a pixel of the next row
    let pixel = if x as usize >= camera.width { u32::MAX } else { pixel };
    let found = seen(gaussians, settings, &[pixel], device)?;
    let (indices, weights) = found.row(0);
    Ok(indices.iter().copied().zip(weights.iter().copied()).collect())
}

/// What some pixels (`y * width + x`) are made of.
///
/// # Errors
/// If the camera has no such pixel.
pub fn seen(
    gaussians: &HostGaussians,
    settings: SplatSettings,
    pixels: &[u32],
    device: &Device,
) -> Result<Contributors, ContributorsError> {
    // colours do not change what a pixel is made of, and are most of what there is to copy
    let settings = SplatSettings { sh_degree: 0, ..settings };
    contributors(&gaussians.without_colours().into_splat(device), &settings, pixels)
}

/// The heaviest of them for which `wanted` holds, the nearest of equals.
#[must_use]
pub fn heaviest(under: &[(u32, f32)], wanted: impl Fn(u32) -> bool) -> Option<u32> {
    let mut best: Option<(u32, f32)> = None;
    for &(index, weight) in under.iter().filter(|(index, _)| wanted(*index)) {
        if best.is_none_or(|(_, most)| weight > most) {
            best = Some((index, weight));
        }
    }
    best.map(|(index, _)| index)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Camera;
    use crate::segment::balls::rendering;
    use glam::DVec3;

    /// A faint red ball before a solid one, seen along the y axis; a third far to the side.
    fn three() -> (HostGaussians, SplatSettings) {
        let at = HostGaussians {
            means: vec![0.0, -0.5, 0.0, 0.0, 0.5, 0.0, 9.0, 0.0, 0.0],
            rotations: [1.0, 0.0, 0.0, 0.0].repeat(3),
            log_scales: vec![-2.0; 9],
            opacity_logits: vec![-2.0, 4.0, 4.0],
            sh: vec![0.3; 9],
            sh_stride: 1,
            shading: None,
            embedding: None,
        };
        let camera = Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, 0.5, 64, 48);
        (at, rendering().seen_by(camera.to_kernel()))
    }

    #[test]
    fn a_click_finds_the_heaviest_and_what_is_wanted_of_it() {
        let device = crate::device::DeviceName::Flex.open().unwrap();
        let (at, settings) = three();
        let under = under(&at, settings, [32, 24], &device).unwrap();
        assert_eq!(under.iter().map(|u| u.0).collect::<Vec<_>>(), [0, 1], "nearest first");
        assert_eq!(heaviest(&under, |_| true), Some(1), "the faint one in front does not count more");
        assert_eq!(heaviest(&under, |i| i == 0), Some(0));
        assert_eq!(heaviest(&under, |i| i == 2), None);
    }

    #[test]
    fn a_pixel_beside_the_picture_is_an_error() {
        let device = crate::device::DeviceName::Flex.open().unwrap();
        let (at, settings) = three();
        for pixel in [[64, 0], [0, 48], [u32::MAX, 1], [3, u32::MAX]] {
            under(&at, settings, pixel, &device).unwrap_err();
        }
        assert_eq!(under(&at, settings, [0, 0], &device).unwrap(), [], "nothing there");
    }
}
