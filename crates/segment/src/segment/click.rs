//! Finds the Gaussian visible at a clicked pixel.

use crate::config::types::segment::ClickConfig;
use crate::model::HostGaussians;
use burn::tensor::Device;
use volseggs_kernels::splat::SplatSettings;
use volseggs_kernels::splat::contributors::{Contributors, ContributorsError, contributors};

/// Returns the Gaussians under a click on column `x` and row `y`, as indices and weights, nearest first. They are those
/// that contribute to that pixel or, where it shows nothing, to the nearest pixel within reach that shows something.
///
/// # Errors
/// If the camera has no such pixel.
pub fn under(
    gaussians: &HostGaussians,
    settings: SplatSettings,
    [x, y]: [u32; 2],
    config: &ClickConfig,
    device: &Device,
) -> Result<Vec<(u32, f32)>, ContributorsError> {
    let camera = settings.camera;
    let pixel = y.saturating_mul(camera.width as u32).saturating_add(x);
    // a column beyond the right edge must not become a pixel of the next row
    let pixel = if x as usize >= camera.width { u32::MAX } else { pixel };
    let clicked = seen(gaussians, settings, &[pixel], device)?;
    let shows = |found: &Contributors, row: usize| found.row(row).1.iter().sum::<f32>() >= config.faint;
    if !config.nearby || shows(&clicked, 0) {
        return Ok(clicked.pairs(0).collect());
    }
    let reach = (config.reach * camera.width as f32).max(config.min_reach);
    let around = around([x, y], [camera.width, camera.height], reach);
    let found = seen(gaussians, settings, &around, device)?;
    let nearest = (0..around.len()).find(|&row| shows(&found, row));
    Ok(nearest.map_or_else(|| clicked.pairs(0).collect(), |row| found.pairs(row).collect()))
}

/// The pixels within `reach` pixels of a pixel, without itself, nearest first.
fn around([x, y]: [u32; 2], [width, height]: [usize; 2], reach: f32) -> Vec<u32> {
    let (x, y, steps) = (i64::from(x), i64::from(y), reach as i64);
    let mut found: Vec<(i64, u32)> = Vec::new();
    for (dy, dx) in (-steps..=steps).flat_map(|dy| (-steps..=steps).map(move |dx| (dy, dx))) {
        let (distance, column, row) = (dx * dx + dy * dy, x + dx, y + dy);
        let inside = (0..width as i64).contains(&column) && (0..height as i64).contains(&row);
        if inside && distance > 0 && distance as f32 <= reach * reach {
            found.push((distance, (row * width as i64 + column) as u32));
        }
    }
    found.sort_unstable();
    found.into_iter().map(|(_, pixel)| pixel).collect()
}

/// Lists the Gaussians that contribute to each of `pixels` (`y * width + x`).
///
/// # Errors
/// If the camera has no such pixel.
pub fn seen(
    gaussians: &HostGaussians,
    settings: SplatSettings,
    pixels: &[u32],
    device: &Device,
) -> Result<Contributors, ContributorsError> {
    // colours do not affect the weights, and are most of the data to copy
    let settings = settings.rendering.flat().seen_by(settings.camera);
    contributors(&gaussians.without_colours().into_splat(device), &settings, pixels)
}

/// Returns the heaviest Gaussian `under` a click for which `wanted` holds, the nearest of equals.
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
    use crate::model::ToKernel;
    use crate::segment::test_support::rendering;
    use glam::DVec3;

    /// A faint Gaussian in front of a solid one, seen along the y axis, and a third far to the side.
    fn three() -> (HostGaussians, SplatSettings) {
        let at = HostGaussians {
            means: vec![0.0, -0.5, 0.0, 0.0, 0.5, 0.0, 9.0, 0.0, 0.0],
            rotations: [1.0, 0.0, 0.0, 0.0].repeat(3),
            log_scales: vec![-2.0; 9],
            opacity_logits: vec![-2.0, 4.0, 4.0],
            sh: vec![0.3; 9],
            sh_stride: 1,
            ..HostGaussians::default()
        };
        let camera = Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, 0.5, 64, 48);
        (at, rendering().seen_by(camera.to_kernel()))
    }

    #[test]
    fn a_click_finds_the_heaviest_gaussian_that_is_wanted() {
        let device = crate::device::DeviceName::Flex.open().unwrap();
        let (at, settings) = three();
        let under = under(&at, settings, [32, 24], &ClickConfig::default(), &device).unwrap();
        assert_eq!(under.iter().map(|u| u.0).collect::<Vec<_>>(), [0, 1], "nearest first");
        assert_eq!(heaviest(&under, |_| true), Some(1), "the faint one in front does not count more");
        assert_eq!(heaviest(&under, |i| i == 0), Some(0));
        assert_eq!(heaviest(&under, |i| i == 2), None);
    }

    #[test]
    fn a_click_beside_a_thin_object_selects_it() {
        let device = crate::device::DeviceName::Flex.open().unwrap();
        let (mut at, settings) = three();
        // a thread along the vertical, a fraction of a pixel wide, in column 32
        at.log_scales[..3].copy_from_slice(&[-9.0, -9.0, 0.0]);
        at.opacity_logits[..2].copy_from_slice(&[4.0, -20.0]);
        let on =
            |column| under(&at, settings, [column, 20], &ClickConfig::default(), &device).unwrap().first().map(|u| u.0);
        let columns: Vec<u32> = (20..45).filter(|&c| on(c) == Some(0)).collect();
        let (first, last) = (columns[0], columns[columns.len() - 1]);
        assert!((5..=6).contains(&(last - first + 1)), "two pixels on either side: {columns:?}");
        assert!(columns.iter().any(|&c| (31..=32).contains(&c)) && on(first - 1).is_none(), "{columns:?}");
    }

    #[test]
    fn a_pixel_beside_the_picture_is_an_error() {
        let device = crate::device::DeviceName::Flex.open().unwrap();
        let (at, settings) = three();
        for pixel in [[64, 0], [0, 48], [u32::MAX, 1], [3, u32::MAX]] {
            under(&at, settings, pixel, &ClickConfig::default(), &device).unwrap_err();
        }
        assert_eq!(under(&at, settings, [0, 0], &ClickConfig::default(), &device).unwrap(), [], "nothing there");
    }
}
