//! Contributors by plain f64 loops: no tiles, no vectors, no threads. The oracle of the tests.

use crate::splat::reference::{Projected, ReferenceScene, drawn};
use crate::splat::{ALPHA_MAX, ALPHA_MIN, SplatSettings, TRANSMITTANCE_MIN};

/// The oracle's result for a pixel.
#[derive(Clone, Debug)]
pub struct ReferencePixel {
    /// Gaussians with their weights `alpha * T`, nearest first.
    pub list: Vec<(u32, f64)>,
    /// How close any decision was to going the other way, as a fraction: the smallest of `|alpha / ALPHA_MIN - 1|` and
    /// `|T / TRANSMITTANCE_MIN - 1|` encountered. Below the rounding of f32 the list is not meaningful.
    pub margin: f64,
    /// The smallest relative difference in depth between two successive Gaussians of the pixel.
    pub depth_gap: f64,
}

/// Returns the contributors of each pixel `y * width + x`, in the order of `pixels`.
pub fn contributors(scene: &ReferenceScene, settings: &SplatSettings, pixels: &[u32]) -> Vec<ReferencePixel> {
    let drawn = drawn(scene, settings);
    let width = settings.camera.width as u32;
    pixels.iter().map(|&p| pixel(&drawn, f64::from(p % width) + 0.5, f64::from(p / width) + 0.5)).collect()
}

fn pixel(drawn: &[(usize, Projected)], px: f64, py: f64) -> ReferencePixel {
    let (alpha_min, t_min) = (f64::from(ALPHA_MIN), f64::from(TRANSMITTANCE_MIN));
    let mut out = ReferencePixel { list: Vec::new(), margin: f64::INFINITY, depth_gap: f64::INFINITY };
    let mut t = 1.0;
    let mut previous = f64::NEG_INFINITY;
    for (index, g) in drawn {
        let alpha = g.alpha([px - g.mean[0], py - g.mean[1]]).min(f64::from(ALPHA_MAX));
        out.margin = out.margin.min((alpha / alpha_min - 1.0).abs());
        if alpha < alpha_min {
            continue;
        }
        out.depth_gap = out.depth_gap.min((g.depth - previous) / g.depth);
        previous = g.depth;
        let after = t * (1.0 - alpha);
        out.margin = out.margin.min((after / t_min - 1.0).abs());
        if after <= t_min {
            break;
        }
        out.list.push((*index as u32, alpha * t));
        t = after;
    }
    out
}
