//! Renders some Gaussians alone: colour, alpha and depth, as mask sources see them.

use super::paint::flat;
pub use crate::model::pictures::{draw, draw_each};
use crate::model::{HostGaussians, Rendering};
use burn::tensor::Device;
use volseggs_kernels::splat::SplatSettings;

/// A picture of Gaussians alone.
#[derive(Clone, Debug, PartialEq)]
pub struct GaussianPicture {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Colour over the background, and alpha, `[H, W, 4]`.
    pub rgba: Vec<f32>,
    /// Mean depth of what is visible, scene units, `[H, W]`; 0 where nothing is.
    pub depth: Vec<f32>,
}

/// The fraction of the blended colour of all `gaussians` that comes from `members`, `[H, W]` in [0, 1]; 0 where nothing
/// is.
///
/// # Panics
/// If a member is not below N.
pub fn share(gaussians: &HostGaussians, members: &[u32], settings: SplatSettings, device: &Device) -> Vec<f32> {
    let mut member = vec![false; gaussians.len()];
    members.iter().for_each(|&m| member[m as usize] = true);
    // members white, others black
    let shades = member.into_iter().map(|m| if m { [1.0; 3] } else { [0.0; 3] });
    let flat = flat(gaussians.clone(), shades);
    let drawn = draw(&flat, over_nothing(settings), device);
    drawn.chunks_exact(4).map(|p| if p[3] > 1.0 / 255.0 { (p[0] / p[3]).clamp(0.0, 1.0) } else { 0.0 }).collect()
}

/// Draws `gaussians`.
pub fn picture(gaussians: &HostGaussians, settings: SplatSettings, device: &Device) -> GaussianPicture {
    let rgba = draw(gaussians, settings, device);
    // depth in place of colour, over nothing
    let camera = settings.camera;
    let row = camera.rotation[2];
    let depth_of = |m: &[f32]| row[0] * m[0] + row[1] * m[1] + row[2] * m[2] + camera.translation[2];
    let far = gaussians.means.chunks_exact(3).map(depth_of).filter(|d| d.is_finite()).fold(1e-6, f32::max);
    let shares = gaussians.means.chunks_exact(3).map(|m| [depth_of(m).max(0.0) / far; 3]);
    let depths = draw(&flat(gaussians.clone(), shares), over_nothing(settings), device);
    let depth = depths.chunks_exact(4).map(|p| if p[3] > 1.0 / 255.0 { far * p[0] / p[3] } else { 0.0 }).collect();
    GaussianPicture { width: camera.width, height: camera.height, rgba, depth }
}

/// The means of `values` `[N, 3]` over what each pixel shows, weighted like colours, `[H, W, 3]`; NaN where nothing is
/// visible. Values that are not finite count as 0.
pub fn mean_values(gaussians: &HostGaussians, values: &[f32], settings: SplatSettings, device: &Device) -> Vec<f32> {
    let finite = |v: f32| if v.is_finite() { v } else { 0.0 };
    let full = values.iter().map(|v| finite(*v).abs()).fold(f32::MIN_POSITIVE, f32::max);
    // as colours they must not be negative
    let shades = values.chunks_exact(3).map(|v| [0, 1, 2].map(|c| 0.5 + 0.5 * (finite(v[c]) / full)));
    let drawn = draw(&flat(gaussians.clone(), shades), over_nothing(settings), device);
    let mean = |p: &[f32], c: usize| if p[3] > 1.0 / 255.0 { full * (2.0 * p[c] / p[3] - 1.0) } else { f32::NAN };
    drawn.chunks_exact(4).flat_map(|p| [0, 1, 2].map(|c| mean(p, c))).collect()
}

/// The same for painted Gaussians, which look alike from every side, over black.
fn over_nothing(settings: SplatSettings) -> SplatSettings {
    Rendering { background: [0.0; 3], ..settings.rendering.flat() }.seen_by(settings.camera)
}
