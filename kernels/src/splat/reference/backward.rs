//! Gradients of the reference image, in f64, by the chain rule over plain matrices. Nothing is shared with the kernels,
//! and blending is differentiated in another form: by the light from behind a Gaussian, accumulated from the back.

use super::{Cutoffs, Geometry, Projected, ReferenceScene, basis_of, conic, drawn, geometry, pixel_centres, unit};
use crate::splat::SplatSettings;

/// The gradient of a loss with respect to a Gaussian on screen.
#[derive(Clone, Copy, Default)]
struct ByScreen {
    mean: [f64; 2],
    /// With respect to the three entries of the conic.
    conic: [f64; 3],
    opacity_logit: f64,
    colour: [f64; 3],
}

/// Returns the gradient, laid out like the scene, of a loss whose gradient with respect to the image is `by_image`
/// `[H, W, 4]`. At a clamp it is that of the side on which the value lies; the depth order and skipped contributions
/// count as fixed.
///
/// # Panics
/// If `by_image` is not of the camera's size.
pub fn backward(
    scene: &ReferenceScene,
    settings: &SplatSettings,
    cutoffs: Cutoffs,
    by_image: &[f64],
) -> ReferenceScene {
    let camera = &settings.camera;
    assert_eq!(by_image.len(), camera.width * camera.height * 4, "the gradient of the image is [H, W, 4]");
    let drawn = drawn(scene, settings);
    let mut by_screen = vec![ByScreen::default(); drawn.len()];
    for (pixel, v) in pixel_centres(settings).zip(by_image.chunks_exact(4)) {
        pixel_backward(&drawn, pixel, v, settings, cutoffs, &mut by_screen);
    }
    let mut out = scene.zeros();
    for ((i, projected), by_screen) in drawn.iter().zip(&by_screen) {
        attributes_backward(scene, *i, settings, projected, by_screen, &mut out);
    }
    out
}

fn pixel_backward(
    drawn: &[(usize, Projected)],
    pixel: [f64; 2],
    v: &[f64],
    settings: &SplatSettings,
    cutoffs: Cutoffs,
    out: &mut [ByScreen],
) {
    // blended Gaussians: position in the list, offset from the mean, alpha before and after its clamp, light left
    // before it
    let mut blended = Vec::new();
    let mut t = 1.0;
    for (at, (_, g)) in drawn.iter().enumerate() {
        let offset = [pixel[0] - g.mean[0], pixel[1] - g.mean[1]];
        let free = g.alpha(offset);
        let alpha = free.min(cutoffs.alpha_max);
        if alpha < cutoffs.alpha_min {
            continue;
        }
        if t * (1.0 - alpha) <= cutoffs.transmittance_min {
            break;
        }
        blended.push((at, offset, free, alpha, t));
        t *= 1.0 - alpha;
    }
    // the loss per unit of light from behind
    let mut behind: f64 = (0..3).map(|c| v[c] * f64::from(settings.rendering.background[c])).sum();
    for (at, [dx, dy], free, alpha, t) in blended.into_iter().rev() {
        let (g, out) = (&drawn[at].1, &mut out[at]);
        // the fourth channel is alpha, to which every Gaussian contributes its full weight
        let own = v[3] + (0..3).map(|c| v[c] * g.colour[c]).sum::<f64>();
        (0..3).for_each(|c| out.colour[c] += v[c] * alpha * t);
        if free <= cutoffs.alpha_max {
            let by_power = alpha * t * (own - behind);
            let [a, b, c] = g.conic;
            out.mean[0] += by_power * (a * dx + b * dy);
            out.mean[1] += by_power * (b * dx + c * dy);
            out.conic[0] -= by_power * 0.5 * dx * dx;
            out.conic[1] -= by_power * dx * dy;
            out.conic[2] -= by_power * 0.5 * dy * dy;
            out.opacity_logit += by_power * (1.0 - g.opacity);
        }
        behind = alpha * own + (1.0 - alpha) * behind;
    }
}

fn attributes_backward(
    scene: &ReferenceScene,
    i: usize,
    settings: &SplatSettings,
    projected: &Projected,
    by: &ByScreen,
    out: &mut ReferenceScene,
) {
    let g = geometry(scene, i, settings);
    // the conic K is the inverse of the covariance: dL/dCov = -K (dL/dK) K
    let ([a, b, c], _) = conic(g.covariance);
    let inverse = [[a, b], [b, c]];
    let by_inverse = [[by.conic[0], 0.5 * by.conic[1]], [0.5 * by.conic[1], by.conic[2]]];
    let by_covariance = product(product(inverse, by_inverse), inverse).map(|row| row.map(|v| -v));
    // Cov = (J W) Sigma (J W)^T, all symmetric except J W
    let jw = product(g.j, g.w);
    let by_jw = product(product(by_covariance, jw), g.sigma).map(|row| row.map(|v| 2.0 * v));
    let by_sigma = product(product(transposed(jw), by_covariance), jw);
    if scene.covariances.is_empty() {
        factors_backward(i, &g, &by_sigma, out);
    } else {
        // an off-diagonal entry occurs at two places
        let twice = |a: usize, b: usize| by_sigma[a][b] + by_sigma[b][a];
        let by_entries = [by_sigma[0][0], twice(0, 1), twice(0, 2), by_sigma[1][1], twice(1, 2), by_sigma[2][2]];
        out.covariances[6 * i..][..6].copy_from_slice(&by_entries);
    }

    let by_t = by_camera_position(&g, settings, by, &product(by_jw, transposed(g.w)));
    let by_direction = colour_backward(scene, i, settings, &g, projected, by, out);
    for k in 0..3 {
        out.means[3 * i + k] = by_direction[k] + (0..3).map(|r| g.w[r][k] * by_t[r]).sum::<f64>();
    }
    out.opacity_logits[i] = by.opacity_logit;
    out.screen_offsets[2 * i..][..2].copy_from_slice(&by.mean);
}

/// Propagates the gradient to the rotation and the scales of the covariance `R S S^T R^T`.
fn factors_backward(i: usize, g: &Geometry, by_sigma: &[[f64; 3]; 3], out: &mut ReferenceScene) {
    let by_rotated = product(*by_sigma, g.rotation);
    for k in 0..3 {
        let by_square: f64 = (0..3).map(|r| g.rotation[r][k] * by_rotated[r][k]).sum();
        out.log_scales[3 * i + k] = 2.0 * g.scale[k] * g.scale[k] * by_square;
    }
    let by_rotation: [[f64; 3]; 3] =
        std::array::from_fn(|r| std::array::from_fn(|k| 2.0 * by_rotated[r][k] * g.scale[k] * g.scale[k]));
    out.rotations[4 * i..][..4].copy_from_slice(&by_quaternion(g, &by_rotation));
}

/// Propagates the gradient through the rotation matrix, and through the division by the quaternion's length, which
/// removes the component along it.
fn by_quaternion(g: &Geometry, by_rotation: &[[f64; 3]; 3]) -> [f64; 4] {
    if g.norm == 0.0 {
        return [0.0; 4];
    }
    let [w, x, y, z] = g.quaternion;
    // the derivatives of the matrix with respect to w, x, y and z, halved
    let derivatives = [
        [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]],
        [[0.0, y, z], [y, -2.0 * x, -w], [z, w, -2.0 * x]],
        [[-2.0 * y, x, w], [x, 0.0, z], [-w, z, -2.0 * y]],
        [[-2.0 * z, -w, x], [w, -2.0 * z, y], [x, y, 0.0]],
    ];
    let by_unit = derivatives.map(|d| {
        2.0 * d.iter().flatten().zip(by_rotation.iter().flatten()).map(|(d, by): (&f64, &f64)| d * by).sum::<f64>()
    });
    let along: f64 = by_unit.iter().zip(&g.quaternion).map(|(a, b)| a * b).sum();
    std::array::from_fn(|k| (by_unit[k] - along * g.quaternion[k]) / g.norm)
}

/// Propagates the gradient through the projected mean and the Jacobian, whose slopes are constant where they are
/// clamped.
fn by_camera_position(g: &Geometry, settings: &SplatSettings, by: &ByScreen, by_j: &[[f64; 3]; 2]) -> [f64; 3] {
    let focal = [f64::from(settings.camera.fx), f64::from(settings.camera.fy)];
    let z = g.t[2];
    let mut out = [0.0; 3];
    for k in 0..2 {
        // mean = f x / z, J = (f / z, -f slope / z)
        out[k] += by.mean[k] * focal[k] / z;
        out[2] -= by.mean[k] * focal[k] * g.t[k] / (z * z);
        out[2] += focal[k] * (g.slope[k] * by_j[k][2] - by_j[k][k]) / (z * z);
        if !g.clamped[k] {
            let by_slope = -focal[k] / z * by_j[k][2];
            out[k] += by_slope / z;
            out[2] -= by_slope * g.t[k] / (z * z);
        }
    }
    out
}

/// Writes the gradient with respect to the coefficients to `out`; returns that with respect to the view direction
/// before normalisation.
fn colour_backward(
    scene: &ReferenceScene,
    i: usize,
    settings: &SplatSettings,
    g: &Geometry,
    projected: &Projected,
    by: &ByScreen,
    out: &mut ReferenceScene,
) -> [f64; 3] {
    let degree = settings.rendering.sh_degree;
    let (direction, length) = unit(g.direction);
    let by_colour: [f64; 3] = std::array::from_fn(|c| if projected.colour[c] > 0.0 { by.colour[c] } else { 0.0 });
    let mut by_basis = Vec::new();
    for (k, basis) in basis_of(scene, direction, degree).into_iter().enumerate() {
        let row = (scene.sh_stride * i + k) * 3;
        (0..3).for_each(|c| out.sh[row + c] = basis * by_colour[c]);
        by_basis.push((0..3).map(|c| scene.sh[row + c] * by_colour[c]).sum::<f64>());
    }
    let by_unit: [f64; 3] = std::array::from_fn(|axis| {
        basis_derivative(scene, direction, axis, degree).iter().zip(&by_basis).map(|(d, by)| d * by).sum()
    });
    let along: f64 = by_unit.iter().zip(&direction).map(|(a, b)| a * b).sum();
    std::array::from_fn(|k| (by_unit[k] - along * direction[k]) / length)
}

/// Returns the derivative of the basis with respect to one coordinate of the direction. The basis consists of
/// polynomials of degree 4 at most, for which this difference quotient is the exact derivative.
fn basis_derivative(scene: &ReferenceScene, direction: [f64; 3], axis: usize, degree: usize) -> Vec<f64> {
    let at = |step: f64| {
        let mut moved = direction;
        moved[axis] += step;
        basis_of(scene, moved, degree)
    };
    let (near, far) = ([at(1.0), at(-1.0)], [at(2.0), at(-2.0)]);
    (0..near[0].len()).map(|k| (8.0 * (near[0][k] - near[1][k]) - (far[0][k] - far[1][k])) / 12.0).collect()
}

fn product<const A: usize, const B: usize, const C: usize>(a: [[f64; B]; A], b: [[f64; C]; B]) -> [[f64; C]; A] {
    std::array::from_fn(|r| std::array::from_fn(|c| (0..B).map(|k| a[r][k] * b[k][c]).sum()))
}

fn transposed<const A: usize, const B: usize>(a: [[f64; B]; A]) -> [[f64; A]; B] {
    std::array::from_fn(|r| std::array::from_fn(|c| a[c][r]))
}
