//! Projection of each Gaussian to the screen. The same arithmetic as on the CPU, in the same order.

use super::covariance::on_screen;
use super::sh::{basis, count};
use crate::cube::is_finite;
use crate::cube::prelude::*;
use crate::cube::vector::{Vec3, dot, scaled, sum_of_two, vec3_at};
use crate::splat::{ALPHA_MIN, NEAR, SplatSettings};

/// Words per projected Gaussian: x, y, qa, qb, qc, ln(opacity), red, green, blue, extent x, extent y, unused.
///
/// `ln(opacity * exp(power)) = qa dx^2 + qb dx dy + qc dy^2 + ln(opacity)`.
pub(super) const SCREEN: usize = 12;

/// The depth key of a Gaussian that is not drawn: after all others.
pub(super) const CULLED: u32 = u32::MAX;

/// The camera as the kernels read it: fx, fy, cx, cy, rotation (9), translation (3), eye (3), limits of the slopes (4),
/// width, height, dilation.
pub(super) fn camera_words(settings: &SplatSettings) -> Vec<f32> {
    let camera = &settings.camera;
    let mut words = vec![camera.fx, camera.fy, camera.cx, camera.cy];
    words.extend(camera.rotation.iter().flatten());
    words.extend(camera.translation);
    words.extend(camera.position());
    words.extend(camera.jacobian_limits().as_flattened());
    words.extend([camera.width as f32, camera.height as f32, settings.rendering.dilation]);
    words
}

/// The part of a Gaussian's projection that does not depend on its covariance.
#[derive(CubeType)]
pub(super) struct ProjectedMean {
    /// Position in camera space.
    pub at: Vec3,
    pub slope_x: f32,
    pub slope_y: f32,
    pub clamped_x: bool,
    pub clamped_y: bool,
    /// `J W`, two rows.
    pub u: Vec3,
    pub v: Vec3,
}

#[cube]
pub(super) fn view(means: &[f32], camera: &[f32], i: usize) -> ProjectedMean {
    let mean = vec3_at(means, 3 * i);
    let (wx, wy, wz) = (vec3_at(camera, 4), vec3_at(camera, 7), vec3_at(camera, 10));
    let (fx, fy) = (camera[0], camera[1]);
    let at = Vec3 { x: dot(&wx, &mean) + camera[13], y: dot(&wy, &mean) + camera[14], z: dot(&wz, &mean) + camera[15] };
    let iz = 1.0f32 / at.z;
    let (left, right, top, bottom) = (camera[19], camera[20], camera[21], camera[22]);
    let (raw_x, raw_y) = (at.x * iz, at.y * iz);
    let clamped_x = raw_x < left || raw_x > right;
    let clamped_y = raw_y < top || raw_y > bottom;
    let slope_x = clamp(raw_x, left, right);
    let slope_y = clamp(raw_y, top, bottom);
    let u = sum_of_two(fx * iz, &wx, -fx * slope_x * iz, &wz);
    let v = sum_of_two(fy * iz, &wy, -fy * slope_y * iz, &wz);
    ProjectedMean { at, slope_x, slope_y, clamped_x, clamped_y, u, v }
}

/// Unit direction from the camera to the mean, and the inverse of the distance.
#[derive(CubeType)]
pub(super) struct Direction {
    pub unit: Vec3,
    pub inverse: f32,
}

#[cube]
pub(super) fn view_direction(means: &[f32], camera: &[f32], i: usize) -> Direction {
    let d = Vec3 { x: means[3 * i] - camera[16], y: means[3 * i + 1] - camera[17], z: means[3 * i + 2] - camera[18] };
    let inverse = 1.0f32 / max(f32::sqrt(dot(&d, &d)), 1e-20f32);
    Direction { unit: scaled(&d, inverse), inverse }
}

/// Projects one Gaussian per unit: `screen` `[N, 12]`, depth keys, indices to sort with them, radii. For `source`, see
/// [`on_screen`].
#[cube(launch)]
pub(super) fn project(
    means: &[f32],
    source: &[f32],
    log_scales: &[f32],
    opacity_logits: &[f32],
    sh: &[f32],
    offsets: &[f32],
    camera: &[f32],
    screen: &mut [f32],
    keys: &mut [u32],
    indices: &mut [u32],
    radii: &mut [i32],
    n: u32,
    sh_stride: u32,
    #[comptime] degree: u32,
    #[comptime] even: bool,
    #[comptime] entries: bool,
) {
    if ABSOLUTE_POS < n as usize {
        let i = ABSOLUTE_POS;
        let at_camera = view(means, camera, i);
        let s = on_screen(source, log_scales, &at_camera, i, entries);
        let dilation = camera[25];
        let (ca, cb, cc) = (s.xx + dilation, s.xy, s.yy + dilation);
        let determinant = s.determinant + dilation * (s.xx + s.yy) + dilation * dilation;
        let (width, height) = (camera[23], camera[24]);
        let opacity = 1.0f32 / (1.0f32 + f32::exp(-opacity_logits[i]));
        let inverse = 1.0f32 / determinant;
        let iz = 1.0f32 / at_camera.at.z;
        let x = camera[0] * at_camera.at.x * iz + camera[2] + offsets[2 * i];
        let y = camera[1] * at_camera.at.y * iz + camera[3] + offsets[2 * i + 1];
        // alpha >= 1/255 inside the ellipse d^T conic d <= reach
        let reach = 2.0f32 * f32::ln(opacity / comptime!(ALPHA_MIN));
        let extent_x = f32::sqrt(max(reach * ca, 0.0f32));
        let extent_y = f32::sqrt(max(reach * cc, 0.0f32));
        let (qa, qb, qc) = (-0.5f32 * cc * inverse, cb * inverse, -0.5f32 * ca * inverse);

        let d = view_direction(means, camera, i);
        let base = i * 3 * sh_stride as usize;
        let mut b = Array::<f32>::new(16usize);
        basis(&mut b, &d.unit, degree, even);
        let mut red = 0.5f32;
        let mut green = 0.5f32;
        let mut blue = 0.5f32;
        #[unroll]
        for k in 0..comptime!(count(degree, even)) {
            red += b[k] * sh[base + 3 * k];
            green += b[k] * sh[base + 3 * k + 1];
            blue += b[k] * sh[base + 3 * k + 2];
        }
        let finite = is_finite(opacity)
            && s.valid
            && is_finite(at_camera.at.z)
            && is_finite(qa + qb + qc)
            && is_finite(determinant)
            && is_finite(x + y + extent_x + extent_y)
            && is_finite(red)
            && is_finite(green)
            && is_finite(blue);
        let drawn = finite
            && opacity >= comptime!(ALPHA_MIN)
            && at_camera.at.z > comptime!(NEAR)
            && inverse > 0.0f32
            && x + extent_x >= 0.0f32
            && x - extent_x <= width
            && y + extent_y >= 0.0f32
            && y - extent_y <= height;
        let at = i * 12;
        indices[i] = i as u32;
        if drawn {
            screen[at] = x;
            screen[at + 1] = y;
            screen[at + 2] = qa;
            screen[at + 3] = qb;
            screen[at + 4] = qc;
            screen[at + 5] = f32::ln(opacity);
            screen[at + 6] = max(red, 0.0f32);
            screen[at + 7] = max(green, 0.0f32);
            screen[at + 8] = max(blue, 0.0f32);
            screen[at + 9] = extent_x;
            screen[at + 10] = extent_y;
            // depths are positive, so their bits sort as integers
            keys[i] = u32::reinterpret(at_camera.at.z);
            let mid = 0.5f32 * (ca + cc);
            let lambda = mid + f32::sqrt(max(mid * mid - determinant, 0.1f32));
            radii[i] = i32::cast_from(min(f32::ceil(3.0f32 * f32::sqrt(lambda)), 1e9f32));
        } else {
            keys[i] = comptime!(CULLED);
            radii[i] = 0i32;
        }
    }
}
