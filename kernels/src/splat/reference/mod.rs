//! The splat op as plain f64 loops: no tiles, no vectors, no threads. The oracle of the tests.
//!
//! The op's [`Cutoffs`] make its image jump where a Gaussian crosses one of them, so difference quotients of that image
//! say nothing about its gradient there. Without them ([`Cutoffs::NONE`]) the image is smooth wherever no two depths
//! are equal, no colour is zero and no slope is at its limit, and [`backward`], which takes any cutoffs, can be
//! compared with difference quotients entry by entry. With them ([`Cutoffs::OP`]) it is the oracle of the kernels'
//! gradients.

mod backward;

use super::{ALPHA_MAX, ALPHA_MIN, MINOR_SLACK, NEAR, SplatSettings, TRANSMITTANCE_MIN};
use crate::sh::exact_basis;

pub use backward::backward;

/// The thresholds of blending.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cutoffs {
    /// Alpha is clamped to this value.
    pub alpha_max: f64,
    /// Contributions below this alpha are skipped.
    pub alpha_min: f64,
    /// A pixel is finished when its transmittance would fall to this value.
    pub transmittance_min: f64,
}

impl Cutoffs {
    /// The thresholds of the op.
    pub const OP: Self =
        Self { alpha_max: ALPHA_MAX as f64, alpha_min: ALPHA_MIN as f64, transmittance_min: TRANSMITTANCE_MIN as f64 };
    /// No thresholds: every Gaussian reaches every pixel.
    pub const NONE: Self =
        Self { alpha_max: f64::INFINITY, alpha_min: f64::NEG_INFINITY, transmittance_min: f64::NEG_INFINITY };
}

/// Gaussians in f64, row-major, shapes as in [`super::SplatInputs`] and [`super::CovarianceInputs`].
#[derive(Clone, Debug, Default)]
pub struct ReferenceScene {
    /// `[N, 3]`
    pub means: Vec<f64>,
    /// `[N, 4]`, wxyz
    pub rotations: Vec<f64>,
    /// `[N, 3]`
    pub log_scales: Vec<f64>,
    /// Entries xx, xy, xz, yy, yz, zz `[N, 6]`, in place of rotations and scales, which then have no effect; empty if
    /// those are used.
    pub covariances: Vec<f64>,
    /// `[N]`
    pub opacity_logits: Vec<f64>,
    /// `[N, K, 3]`
    pub sh: Vec<f64>,
    /// Coefficients per Gaussian, K.
    pub sh_stride: usize,
    /// `[N, 2]`
    pub screen_offsets: Vec<f64>,
}

impl ReferenceScene {
    /// Returns the same number of Gaussians, with all values zero.
    fn zeros(&self) -> Self {
        let like = |values: &[f64]| vec![0.0; values.len()];
        Self {
            means: like(&self.means),
            rotations: like(&self.rotations),
            log_scales: like(&self.log_scales),
            covariances: like(&self.covariances),
            opacity_logits: like(&self.opacity_logits),
            sh: like(&self.sh),
            sh_stride: self.sh_stride,
            screen_offsets: like(&self.screen_offsets),
        }
    }
}

/// A Gaussian on screen.
pub(crate) struct Projected {
    pub(crate) depth: f64,
    pub(crate) mean: [f64; 2],
    pub(crate) conic: [f64; 3],
    pub(crate) opacity: f64,
    colour: [f64; 3],
}

impl Projected {
    /// Returns alpha before its clamp at an offset (dx, dy) from the mean.
    pub(crate) fn alpha(&self, [dx, dy]: [f64; 2]) -> f64 {
        let [a, b, c] = self.conic;
        self.opacity * (-0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy).exp()
    }
}

/// Renders `[H, W, 4]`: colour over the background, and alpha.
pub fn render(scene: &ReferenceScene, settings: &SplatSettings, cutoffs: Cutoffs) -> Vec<f64> {
    let drawn = drawn(scene, settings);
    let camera = &settings.camera;
    let mut image = Vec::with_capacity(camera.width * camera.height * 4);
    for pixel in pixel_centres(settings) {
        let mut colour = [0.0; 3];
        let mut t = 1.0;
        for (_, g) in &drawn {
            let alpha = g.alpha([pixel[0] - g.mean[0], pixel[1] - g.mean[1]]).min(cutoffs.alpha_max);
            if alpha < cutoffs.alpha_min {
                continue;
            }
            if t * (1.0 - alpha) <= cutoffs.transmittance_min {
                break;
            }
            for c in 0..3 {
                colour[c] += g.colour[c] * alpha * t;
            }
            t *= 1.0 - alpha;
        }
        image.extend((0..3).map(|c| colour[c] + t * f64::from(settings.rendering.background[c])));
        image.push(1.0 - t);
    }
    image
}

/// Returns the pixel centres, row by row.
fn pixel_centres(settings: &SplatSettings) -> impl Iterator<Item = [f64; 2]> {
    let camera = settings.camera;
    (0..camera.width * camera.height).map(move |p| [(p % camera.width) as f64 + 0.5, (p / camera.width) as f64 + 0.5])
}

/// Returns the Gaussians that are not culled, with their indices, nearest first, ties by index.
pub(crate) fn drawn(scene: &ReferenceScene, settings: &SplatSettings) -> Vec<(usize, Projected)> {
    let n = scene.opacity_logits.len();
    let mut drawn: Vec<_> = (0..n).filter_map(|i| Some((i, project(scene, i, settings)?))).collect();
    drawn.sort_by(|a, b| a.1.depth.total_cmp(&b.1.depth)); // stable
    drawn
}

/// Intermediate results between a Gaussian's attributes and its shape on screen.
struct Geometry {
    /// World to camera.
    w: [[f64; 3]; 3],
    /// Position in camera space.
    t: [f64; 3],
    /// The normalised quaternion, and its original length, 0 for no rotation.
    quaternion: [f64; 4],
    norm: f64,
    rotation: [[f64; 3]; 3],
    scale: [f64; 3],
    /// x/z and y/z, clamped, and whether the clamp took effect.
    slope: [f64; 2],
    clamped: [bool; 2],
    /// Jacobian of the projection.
    j: [[f64; 3]; 2],
    /// Covariance in the world.
    sigma: [[f64; 3]; 3],
    /// Covariance on screen, dilated.
    covariance: [[f64; 2]; 2],
    /// View direction, not of unit length.
    direction: [f64; 3],
}

fn geometry(scene: &ReferenceScene, i: usize, settings: &SplatSettings) -> Geometry {
    let camera = &settings.camera;
    let w = camera.rotation.map(|row| row.map(f64::from));
    let mean: [f64; 3] = std::array::from_fn(|k| scene.means[3 * i + k]);
    let t: [f64; 3] =
        std::array::from_fn(|r| (0..3).map(|k| w[r][k] * mean[k]).sum::<f64>() + f64::from(camera.translation[r]));
    let q: [f64; 4] = std::array::from_fn(|k| scene.rotations[4 * i + k]);
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    let norm = if norm <= 1e-12 { 0.0 } else { norm };
    let quaternion = if norm == 0.0 { [1.0, 0.0, 0.0, 0.0] } else { q.map(|v| v / norm) };
    let rotation = rotation_matrix(quaternion);
    let scale: [f64; 3] = std::array::from_fn(|k| scene.log_scales[3 * i + k].exp());
    let sigma = match scene.covariances.get(6 * i..6 * i + 6) {
        Some(&[xx, xy, xz, yy, yz, zz]) => [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]],
        _ => world_covariance(rotation, scale),
    };
    let (fx, fy) = (f64::from(camera.fx), f64::from(camera.fy));
    let half = [1.3 * camera.width as f64 / (2.0 * fx), 1.3 * camera.height as f64 / (2.0 * fy)];
    let middle = [
        (0.5 * camera.width as f64 - f64::from(camera.cx)) / fx,
        (0.5 * camera.height as f64 - f64::from(camera.cy)) / fy,
    ];
    let free = [t[0] / t[2], t[1] / t[2]];
    let slope: [f64; 2] = std::array::from_fn(|k| free[k].clamp(middle[k] - half[k], middle[k] + half[k]));
    let j = [[fx / t[2], 0.0, -fx * slope[0] / t[2]], [0.0, fy / t[2], -fy * slope[1] / t[2]]];
    let jw: [[f64; 3]; 2] = std::array::from_fn(|a| std::array::from_fn(|b| (0..3).map(|k| j[a][k] * w[k][b]).sum()));
    let covariance: [[f64; 2]; 2] = std::array::from_fn(|a| {
        std::array::from_fn(|b| {
            let v: f64 = (0..3).map(|k| (0..3).map(|l| jw[a][k] * sigma[k][l] * jw[b][l]).sum::<f64>()).sum();
            v + if a == b { f64::from(settings.rendering.dilation) } else { 0.0 }
        })
    });
    let eye: [f64; 3] =
        std::array::from_fn(|k| -(0..3).map(|r| w[r][k] * f64::from(camera.translation[r])).sum::<f64>());
    Geometry {
        w,
        t,
        quaternion,
        norm,
        rotation,
        scale,
        slope,
        clamped: [slope[0] != free[0], slope[1] != free[1]],
        j,
        sigma,
        covariance,
        direction: std::array::from_fn(|k| mean[k] - eye[k]),
    }
}

/// The rotation matrix of a unit quaternion, by rows.
pub(crate) fn rotation_matrix([w, x, y, z]: [f64; 4]) -> [[f64; 3]; 3] {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// `R S S^T R^T`
fn world_covariance(rotation: [[f64; 3]; 3], scale: [f64; 3]) -> [[f64; 3]; 3] {
    std::array::from_fn(|a| {
        std::array::from_fn(|b| (0..3).map(|k| rotation[a][k] * scale[k] * scale[k] * rotation[b][k]).sum())
    })
}

/// Whether no principal minor is negative by more than [`MINOR_SLACK`] of the product of its diagonal.
fn is_semidefinite(m: [[f64; 3]; 3]) -> bool {
    let above = |minor: f64, diagonal: f64| minor >= -f64::from(MINOR_SLACK) * diagonal;
    let pair = |a: usize, b: usize| above(m[a][a] * m[b][b] - m[a][b] * m[b][a], m[a][a] * m[b][b]);
    // expansion along the first row, with cyclic indices
    let determinant: f64 =
        (0..3).map(|k| m[0][k] * (m[1][(k + 1) % 3] * m[2][(k + 2) % 3] - m[1][(k + 2) % 3] * m[2][(k + 1) % 3])).sum();
    (0..3).all(|k| m[k][k] >= 0.0)
        && pair(0, 1)
        && pair(0, 2)
        && pair(1, 2)
        && above(determinant, m[0][0] * m[1][1] * m[2][2])
}

/// Returns the inverse of the covariance on screen (a, b, c), and the determinant of the covariance.
fn conic([[a, b], [_, c]]: [[f64; 2]; 2]) -> ([f64; 3], f64) {
    let det = a * c - b * b;
    ([c / det, -b / det, a / det], det)
}

/// Returns the normalised vector and its original length.
fn unit(v: [f64; 3]) -> ([f64; 3], f64) {
    let length = v.iter().map(|v| v * v).sum::<f64>().sqrt();
    (v.map(|v| v / length), length)
}

fn project(scene: &ReferenceScene, i: usize, settings: &SplatSettings) -> Option<Projected> {
    let camera = &settings.camera;
    let g = geometry(scene, i, settings);
    let (conic, det) = conic(g.covariance);
    let basis = basis_of(scene, unit(g.direction).0, settings.rendering.sh_degree);
    let colour: [f64; 3] = std::array::from_fn(|c| {
        let sum: f64 = basis.iter().enumerate().map(|(k, b)| b * scene.sh[(scene.sh_stride * i + k) * 3 + c]).sum();
        // not `f64::max`, which would turn NaN into 0: the kernels cull such a Gaussian
        if sum + 0.5 < 0.0 { 0.0 } else { sum + 0.5 }
    });
    let opacity = 1.0 / (1.0 + (-scene.opacity_logits[i]).exp());
    let semidefinite = scene.covariances.is_empty() || is_semidefinite(g.sigma);
    let finite =
        semidefinite && det.is_finite() && det > 0.0 && colour.iter().all(|c| c.is_finite()) && opacity.is_finite();
    let (fx, fy) = (f64::from(camera.fx), f64::from(camera.fy));
    (g.t[2] > f64::from(NEAR) && finite).then(|| Projected {
        depth: g.t[2],
        mean: [
            fx * g.t[0] / g.t[2] + f64::from(camera.cx) + scene.screen_offsets[2 * i],
            fy * g.t[1] / g.t[2] + f64::from(camera.cy) + scene.screen_offsets[2 * i + 1],
        ],
        conic,
        opacity,
        colour,
    })
}

/// Returns the basis functions of a scene's coefficients up to `degree`: of even bands alone where their number is that
/// of even ones.
fn basis_of(scene: &ReferenceScene, direction: [f64; 3], degree: usize) -> Vec<f64> {
    let even = [6, 15].contains(&scene.sh_stride);
    let wanted = |(k, _): &(usize, f64)| !even || k.isqrt().is_multiple_of(2);
    let all = exact_basis(direction).into_iter().take((degree + 1).pow(2));
    all.enumerate().filter(wanted).map(|(_, b)| b).collect()
}
