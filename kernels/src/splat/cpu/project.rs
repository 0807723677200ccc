//! Projection of each Gaussian to the screen: position, inverse covariance, opacity, colour, extent, depth.

use super::Attributes;
use super::covariance::{Covariance, Covariances};
use super::lanes::{LOG2_E, wide};
use crate::activation::sigmoid;
use crate::backend::filled;
use crate::sh::{self, Bands};
use crate::splat::{ALPHA_MIN, NEAR, Rendering, SplatSettings};
use crate::turn::dot;
use rayon::prelude::*;

/// A projected Gaussian, as blending reads it.
///
/// `log2(opacity * exp(power)) = qa dx^2 + qb dx dy + qc dy^2 + log2_opacity`. Within one line of the cache, as they are
/// read from scattered memory.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(64))]
pub(crate) struct Splat2d {
    pub x: f32,
    pub y: f32,
    pub qa: f32,
    pub qb: f32,
    pub qc: f32,
    pub log2_opacity: f32,
    pub colour: [f32; 3],
    /// Half extents in pixels of the region where alpha reaches 1/255.
    pub extent: [f32; 2],
    pub depth: f32,
    /// Radius in pixels, three standard deviations; 0 for a Gaussian that is not drawn.
    pub radius: i32,
}

/// Intermediate results of one projection that the backward pass needs again.
pub(crate) struct Projection {
    /// Position in camera space.
    pub camera_mean: [f32; 3],
    /// `x/z`, `y/z`, clamped, and whether the clamp took effect.
    pub slope: [f32; 2],
    pub clamped: [bool; 2],
    /// `J W`, `[2, 3]`.
    pub jw: [[f32; 3]; 2],
    /// The covariance before the projection.
    pub source: Covariance,
    /// Projected covariance (a, b, c) with the dilation, and its determinant.
    pub covariance: [f32; 3],
    pub determinant: f32,
}

impl Projection {
    /// Projects Gaussian `i` at `mean`.
    #[inline(always)]
    pub(crate) fn new(mean: [f32; 3], covariances: Covariances<&[f32]>, i: usize, settings: &SplatSettings) -> Self {
        let SplatSettings { camera, rendering: Rendering { dilation, .. } } = settings;
        let w = &camera.rotation;
        let camera_mean: [f32; 3] =
            std::array::from_fn(|i| w[i][0] * mean[0] + w[i][1] * mean[1] + w[i][2] * mean[2] + camera.translation[i]);
        let iz = 1.0 / camera_mean[2];
        let raw = [camera_mean[0] * iz, camera_mean[1] * iz];
        let [[left, right], [top, bottom]] = camera.jacobian_limits();
        let clamped = [raw[0] < left || raw[0] > right, raw[1] < top || raw[1] > bottom];
        let slope = [raw[0].clamp(left, right), raw[1].clamp(top, bottom)];
        let (j00, j02) = (camera.fx * iz, -camera.fx * slope[0] * iz);
        let (j11, j12) = (camera.fy * iz, -camera.fy * slope[1] * iz);
        let jw = [
            std::array::from_fn(|k| j00 * w[0][k] + j02 * w[2][k]),
            std::array::from_fn(|k| j11 * w[1][k] + j12 * w[2][k]),
        ];
        let (source, on_screen) = Covariance::project(covariances, i, &jw);
        let [aa, ab, cc] = on_screen.entries;
        let determinant = on_screen.determinant + dilation * (aa + cc) + dilation * dilation;
        let covariance = [aa + dilation, ab, cc + dilation];
        Self { camera_mean, slope, clamped, jw, source, covariance, determinant }
    }
}

/// Reads row `i` of a row-major array with `D` columns.
#[inline(always)]
pub(crate) fn row<const D: usize>(values: &[f32], i: usize) -> [f32; D] {
    std::array::from_fn(|k| values[D * i + k])
}

/// Returns the unit direction from the camera to the mean, and the inverse of the distance.
#[inline(always)]
pub(crate) fn view_direction(mean: [f32; 3], eye: [f32; 3]) -> ([f32; 3], f32) {
    let d = [mean[0] - eye[0], mean[1] - eye[1], mean[2] - eye[2]];
    let inverse = 1.0 / dot(d, d).sqrt().max(1e-20);
    (d.map(|v| v * inverse), inverse)
}

/// Gaussians per task.
const CHUNK: usize = 1024;

/// Projects all Gaussians; those that are culled have radius 0.
pub(crate) fn project(attributes: Attributes<'_>, offsets: &[f32], settings: &SplatSettings) -> Vec<Splat2d> {
    let eye = settings.camera.position();
    let mut splats = filled(Splat2d::default(), attributes.len());
    splats.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, out)| {
        wide!(for (j, splat) in out.iter_mut().enumerate() {
            let i = chunk * CHUNK + j;
            let offset = [offsets[2 * i], offsets[2 * i + 1]];
            *splat = project_one(attributes, i, offset, eye, settings).unwrap_or_default();
        });
    });
    splats
}

/// Projects one Gaussian; `None` if it is not beyond the near plane, too transparent, off screen or not finite.
#[inline(always)]
fn project_one(
    a: Attributes<'_>,
    i: usize,
    offset: [f32; 2],
    eye: [f32; 3],
    settings: &SplatSettings,
) -> Option<Splat2d> {
    let camera = &settings.camera;
    let mean = row::<3>(a.means, i);
    let opacity = sigmoid(a.opacity_logits[i]);
    if opacity.is_nan() || opacity < ALPHA_MIN {
        return None;
    }
    let p = Projection::new(mean, a.covariances, i, settings);
    if p.camera_mean[2].is_nan() || p.camera_mean[2] <= NEAR {
        return None;
    }
    let [ca, cb, cc] = p.covariance;
    let inverse = 1.0 / p.determinant;
    let iz = 1.0 / p.camera_mean[2];
    let x = camera.fx * p.camera_mean[0] * iz + camera.cx + offset[0];
    let y = camera.fy * p.camera_mean[1] * iz + camera.cy + offset[1];
    // alpha >= 1/255 inside the ellipse power >= ln(1/(255 opacity)), i.e. d^T conic d <= reach
    let reach = 2.0 * (opacity / ALPHA_MIN).ln();
    let extent = [(reach * ca).sqrt(), (reach * cc).sqrt()];
    let (qa, qb, qc) = (-0.5 * LOG2_E * cc * inverse, LOG2_E * cb * inverse, -0.5 * LOG2_E * ca * inverse);
    let on_screen = x + extent[0] >= 0.0
        && x - extent[0] <= camera.width as f32
        && y + extent[1] >= 0.0
        && y - extent[1] <= camera.height as f32;
    let finite = (qa + qb + qc).is_finite() && inverse > 0.0 && (x + y + extent[0] + extent[1]).is_finite();
    if !(on_screen && finite) {
        return None;
    }
    let mid = 0.5 * (ca + cc);
    let lambda = mid + (mid * mid - p.determinant).max(0.1).sqrt();
    let radius = (3.0 * lambda.sqrt()).ceil().min(1e9) as i32;

    let (direction, _) = view_direction(mean, eye);
    let bands = Bands::of_any(a.sh_stride);
    let b = sh::basis(direction, settings.rendering.sh_degree, bands);
    let count = bands.count(settings.rendering.sh_degree);
    let coefficients = &a.sh[3 * a.sh_stride * i..][..3 * count];
    let mut colour = [0.5f32; 3];
    for (k, c) in coefficients.chunks_exact(3).enumerate() {
        for channel in 0..3 {
            colour[channel] += b[k] * c[channel];
        }
    }
    if colour.iter().any(|c| !c.is_finite()) {
        return None;
    }
    let colour = colour.map(|c| c.max(0.0));
    Some(Splat2d { x, y, qa, qb, qc, log2_opacity: opacity.log2(), colour, extent, depth: p.camera_mean[2], radius })
}
