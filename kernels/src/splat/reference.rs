//! The splat op in plain f64 loops: no tiles, no vectors, no threads. The oracle of the tests.

use super::{ALPHA_MAX, ALPHA_MIN, DILATION, NEAR, SplatSettings, TRANSMITTANCE_MIN};

/// Gaussians in f64, row-major, shapes as in [`super::SplatInputs`].
#[derive(Clone, Debug)]
pub struct Scene {
    /// `[N, 3]`
    pub means: Vec<f64>,
    /// `[N, 4]`, wxyz
    pub rotations: Vec<f64>,
    /// `[N, 3]`
    pub log_scales: Vec<f64>,
    /// `[N]`
    pub opacity_logits: Vec<f64>,
    /// `[N, K, 3]`
    pub sh: Vec<f64>,
    /// Coefficients a Gaussian, K.
    pub sh_stride: usize,
}

/// A Gaussian on screen.
pub(crate) struct Projected {
    pub(crate) depth: f64,
    pub(crate) mean: [f64; 2],
    pub(crate) conic: [f64; 3],
    pub(crate) opacity: f64,
    colour: [f64; 3],
}

/// Renders `[H, W, 4]`: colour over the background, and alpha.
pub fn render(scene: &Scene, settings: &SplatSettings) -> Vec<f64> {
    let n = scene.opacity_logits.len();
    let mut drawn: Vec<Projected> = (0..n).filter_map(|i| project(scene, i, settings)).collect();
    drawn.sort_by(|a, b| a.depth.total_cmp(&b.depth)); // stable: ties by index
    let camera = &settings.camera;
    let mut image = Vec::with_capacity(camera.width * camera.height * 4);
    for row in 0..camera.height {
        for column in 0..camera.width {
            let (px, py) = (column as f64 + 0.5, row as f64 + 0.5);
            let mut colour = [0.0; 3];
            let mut t = 1.0;
            for g in &drawn {
                let (dx, dy) = (px - g.mean[0], py - g.mean[1]);
                let power = -0.5 * (g.conic[0] * dx * dx + g.conic[2] * dy * dy) - g.conic[1] * dx * dy;
                let alpha = (g.opacity * power.exp()).min(f64::from(ALPHA_MAX));
                if alpha < f64::from(ALPHA_MIN) {
                    continue;
                }
                if t * (1.0 - alpha) <= f64::from(TRANSMITTANCE_MIN) {
                    break;
                }
                for c in 0..3 {
                    colour[c] += g.colour[c] * alpha * t;
                }
                t *= 1.0 - alpha;
            }
            image.extend((0..3).map(|c| colour[c] + t * f64::from(settings.background[c])));
            image.push(1.0 - t);
        }
    }
    image
}

pub(crate) fn project(scene: &Scene, i: usize, settings: &SplatSettings) -> Option<Projected> {
    let camera = &settings.camera;
    let w = camera.rotation.map(|row| row.map(f64::from));
    let mean: [f64; 3] = std::array::from_fn(|k| scene.means[3 * i + k]);
    let t: [f64; 3] =
        std::array::from_fn(|r| (0..3).map(|k| w[r][k] * mean[k]).sum::<f64>() + f64::from(camera.translation[r]));
    let q: [f64; 4] = std::array::from_fn(|k| scene.rotations[4 * i + k]);
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    let [qw, qx, qy, qz] = if norm <= 1e-12 { [1.0, 0.0, 0.0, 0.0] } else { q.map(|v| v / norm) };
    let r = [
        [1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy - qw * qz), 2.0 * (qx * qz + qw * qy)],
        [2.0 * (qx * qy + qw * qz), 1.0 - 2.0 * (qx * qx + qz * qz), 2.0 * (qy * qz - qw * qx)],
        [2.0 * (qx * qz - qw * qy), 2.0 * (qy * qz + qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)],
    ];
    let scale: [f64; 3] = std::array::from_fn(|k| scene.log_scales[3 * i + k].exp());
    let sigma: [[f64; 3]; 3] =
        std::array::from_fn(|a| std::array::from_fn(|b| (0..3).map(|k| r[a][k] * scale[k] * scale[k] * r[b][k]).sum()));
    let (fx, fy) = (f64::from(camera.fx), f64::from(camera.fy));
    let limit = [1.3 * camera.width as f64 / (2.0 * fx), 1.3 * camera.height as f64 / (2.0 * fy)];
    let (sx, sy) = ((t[0] / t[2]).clamp(-limit[0], limit[0]), (t[1] / t[2]).clamp(-limit[1], limit[1]));
    let j = [[fx / t[2], 0.0, -fx * sx / t[2]], [0.0, fy / t[2], -fy * sy / t[2]]];
    let jw: [[f64; 3]; 2] = std::array::from_fn(|a| std::array::from_fn(|b| (0..3).map(|k| j[a][k] * w[k][b]).sum()));
    let cov: [[f64; 2]; 2] = std::array::from_fn(|a| {
        std::array::from_fn(|b| {
            let v: f64 = (0..3).map(|k| (0..3).map(|l| jw[a][k] * sigma[k][l] * jw[b][l]).sum::<f64>()).sum();
            v + if a == b { f64::from(DILATION) } else { 0.0 }
        })
    });
    let det = cov[0][0] * cov[1][1] - cov[0][1] * cov[0][1];
    let eye: [f64; 3] =
        std::array::from_fn(|k| -(0..3).map(|r| w[r][k] * f64::from(camera.translation[r])).sum::<f64>());
    let d: [f64; 3] = std::array::from_fn(|k| mean[k] - eye[k]);
    let length = d.iter().map(|v| v * v).sum::<f64>().sqrt();
    let basis = sh_basis(d.map(|v| v / length), settings.sh_degree);
    let colour: [f64; 3] = std::array::from_fn(|c| {
        let sum: f64 = basis.iter().enumerate().map(|(k, b)| b * scene.sh[(scene.sh_stride * i + k) * 3 + c]).sum();
        // not `f64::max`, which would turn NaN into 0: the kernels cull such a Gaussian
        if sum + 0.5 < 0.0 { 0.0 } else { sum + 0.5 }
    });
    let opacity = 1.0 / (1.0 + (-scene.opacity_logits[i]).exp());
    let finite = det.is_finite() && det > 0.0 && colour.iter().all(|c| c.is_finite()) && opacity.is_finite();
    (t[2] > f64::from(NEAR) && finite).then(|| Projected {
        depth: t[2],
        mean: [fx * t[0] / t[2] + f64::from(camera.cx), fy * t[1] / t[2] + f64::from(camera.cy)],
        conic: [cov[1][1] / det, -cov[0][1] / det, cov[0][0] / det],
        opacity,
        colour,
    })
}

/// Spherical harmonics from their definition, `(degree + 1)^2` values, in the order and signs of 3DGS.
fn sh_basis([x, y, z]: [f64; 3], degree: usize) -> Vec<f64> {
    use std::f64::consts::PI;
    let mut b = vec![0.5 * (1.0 / PI).sqrt()];
    if degree >= 1 {
        let c = (3.0 / (4.0 * PI)).sqrt();
        b.extend([-c * y, c * z, -c * x]);
    }
    if degree >= 2 {
        let c = 0.5 * (15.0 / PI).sqrt();
        let c20 = 0.25 * (5.0 / PI).sqrt();
        b.extend([c * x * y, -c * y * z, c20 * (2.0 * z * z - x * x - y * y), -c * x * z, 0.5 * c * (x * x - y * y)]);
    }
    if degree >= 3 {
        let c3 = 0.25 * (35.0 / (2.0 * PI)).sqrt();
        let c2 = 0.5 * (105.0 / PI).sqrt();
        let c1 = 0.25 * (21.0 / (2.0 * PI)).sqrt();
        let c0 = 0.25 * (7.0 / PI).sqrt();
        b.extend([
            -c3 * y * (3.0 * x * x - y * y),
            c2 * x * y * z,
            -c1 * y * (4.0 * z * z - x * x - y * y),
            c0 * z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y),
            -c1 * x * (4.0 * z * z - x * x - y * y),
            0.5 * c2 * z * (x * x - y * y),
            -c3 * x * (x * x - 3.0 * y * y),
        ]);
    }
    b
}
