//! Per Gaussian: to the screen. The same arithmetic as on the CPU, in the same order.

use super::sh::basis;
use crate::Camera;
use crate::cube::is_finite;
use crate::splat::{ALPHA_MIN, DILATION, NEAR};
use burn_cubecl::cubecl;
use burn_cubecl::cubecl::prelude::*;

/// Words of a projected Gaussian: x, y, qa, qb, qc, ln(opacity), red, green, blue, extent x, extent y, none.
///
/// `ln(opacity * exp(power)) = qa dx^2 + qb dx dy + qc dy^2 + ln(opacity)`.
pub(super) const SCREEN: usize = 12;

/// The depth key of a Gaussian that is not drawn: behind all others.
pub(super) const CULLED: u32 = u32::MAX;

/// The camera as the kernels read it: fx, fy, cx, cy, rotation (9), translation (3), eye (3), limits of the slope (2),
/// width, height.
pub(super) fn camera_words(camera: &Camera) -> Vec<f32> {
    let mut words = vec![camera.fx, camera.fy, camera.cx, camera.cy];
    words.extend(camera.rotation.iter().flatten());
    words.extend(camera.translation);
    words.extend(camera.position());
    words.extend(camera.jacobian_limits());
    words.extend([camera.width as f32, camera.height as f32]);
    words
}

/// What the backward pass needs again of one projection; as `cpu::project::Projection`.
#[derive(CubeType)]
pub(super) struct Projection {
    pub r00: f32,
    pub r01: f32,
    pub r02: f32,
    pub r10: f32,
    pub r11: f32,
    pub r12: f32,
    pub r20: f32,
    pub r21: f32,
    pub r22: f32,
    pub qw: f32,
    pub qx: f32,
    pub qy: f32,
    pub qz: f32,
    pub inverse_norm: f32,
    pub s0: f32,
    pub s1: f32,
    pub s2: f32,
    pub cx: f32,
    pub cy: f32,
    pub cz: f32,
    pub slope_x: f32,
    pub slope_y: f32,
    pub clamped_x: bool,
    pub clamped_y: bool,
    /// `J W`, two rows.
    pub u0: f32,
    pub u1: f32,
    pub u2: f32,
    pub v0: f32,
    pub v1: f32,
    pub v2: f32,
    /// `J W R S`, two rows.
    pub a0: f32,
    pub a1: f32,
    pub a2: f32,
    pub b0: f32,
    pub b1: f32,
    pub b2: f32,
    /// Covariance with the dilation, and its determinant.
    pub ca: f32,
    pub cb: f32,
    pub cc: f32,
    pub determinant: f32,
}

#[cube]
pub(super) fn project_gaussian(
    means: &[f32],
    rotations: &[f32],
    log_scales: &[f32],
    camera: &[f32],
    i: usize,
) -> Projection {
    let (mx, my, mz) = (means[3 * i], means[3 * i + 1], means[3 * i + 2]);
    let (w, x, y, z) = (rotations[4 * i], rotations[4 * i + 1], rotations[4 * i + 2], rotations[4 * i + 3]);
    let norm2 = w * w + x * x + y * y + z * z;
    let has_length = norm2 > 1e-24f32;
    let inverse_norm = select(has_length, 1.0f32 / f32::sqrt(max(norm2, 1e-24f32)), 0.0f32);
    // a zero quaternion stands for no rotation
    let qw = select(has_length, w * inverse_norm, 1.0f32);
    let qx = x * inverse_norm;
    let qy = y * inverse_norm;
    let qz = z * inverse_norm;
    let r00 = 1.0f32 - 2.0f32 * (qy * qy + qz * qz);
    let r01 = 2.0f32 * (qx * qy - qw * qz);
    let r02 = 2.0f32 * (qx * qz + qw * qy);
    let r10 = 2.0f32 * (qx * qy + qw * qz);
    let r11 = 1.0f32 - 2.0f32 * (qx * qx + qz * qz);
    let r12 = 2.0f32 * (qy * qz - qw * qx);
    let r20 = 2.0f32 * (qx * qz - qw * qy);
    let r21 = 2.0f32 * (qy * qz + qw * qx);
    let r22 = 1.0f32 - 2.0f32 * (qx * qx + qy * qy);
    let s0 = f32::exp(log_scales[3 * i]);
    let s1 = f32::exp(log_scales[3 * i + 1]);
    let s2 = f32::exp(log_scales[3 * i + 2]);
    let (fx, fy) = (camera[0], camera[1]);
    let cx = camera[4] * mx + camera[5] * my + camera[6] * mz + camera[13];
    let cy = camera[7] * mx + camera[8] * my + camera[9] * mz + camera[14];
    let cz = camera[10] * mx + camera[11] * my + camera[12] * mz + camera[15];
    let iz = 1.0f32 / cz;
    let (limit_x, limit_y) = (camera[19], camera[20]);
    let (raw_x, raw_y) = (cx * iz, cy * iz);
    let clamped_x = f32::abs(raw_x) > limit_x;
    let clamped_y = f32::abs(raw_y) > limit_y;
    let slope_x = clamp(raw_x, -limit_x, limit_x);
    let slope_y = clamp(raw_y, -limit_y, limit_y);
    let (j00, j02) = (fx * iz, -fx * slope_x * iz);
    let (j11, j12) = (fy * iz, -fy * slope_y * iz);
    let u0 = j00 * camera[4] + j02 * camera[10];
    let u1 = j00 * camera[5] + j02 * camera[11];
    let u2 = j00 * camera[6] + j02 * camera[12];
    let v0 = j11 * camera[7] + j12 * camera[10];
    let v1 = j11 * camera[8] + j12 * camera[11];
    let v2 = j11 * camera[9] + j12 * camera[12];
    let a0 = s0 * (u0 * r00 + u1 * r10 + u2 * r20);
    let a1 = s1 * (u0 * r01 + u1 * r11 + u2 * r21);
    let a2 = s2 * (u0 * r02 + u1 * r12 + u2 * r22);
    let b0 = s0 * (v0 * r00 + v1 * r10 + v2 * r20);
    let b1 = s1 * (v0 * r01 + v1 * r11 + v2 * r21);
    let b2 = s2 * (v0 * r02 + v1 * r12 + v2 * r22);
    let aa = a0 * a0 + a1 * a1 + a2 * a2;
    let ab = a0 * b0 + a1 * b1 + a2 * b2;
    let bb = b0 * b0 + b1 * b1 + b2 * b2;
    // |a x b|^2 is the determinant without the dilation, free of cancellation (Lagrange's identity)
    let (x0, x1, x2) = (a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0);
    let dilation = comptime!(DILATION);
    let determinant = x0 * x0 + x1 * x1 + x2 * x2 + dilation * (aa + bb) + dilation * dilation;
    Projection {
        r00,
        r01,
        r02,
        r10,
        r11,
        r12,
        r20,
        r21,
        r22,
        qw,
        qx,
        qy,
        qz,
        inverse_norm,
        s0,
        s1,
        s2,
        cx,
        cy,
        cz,
        slope_x,
        slope_y,
        clamped_x,
        clamped_y,
        u0,
        u1,
        u2,
        v0,
        v1,
        v2,
        a0,
        a1,
        a2,
        b0,
        b1,
        b2,
        ca: aa + dilation,
        cb: ab,
        cc: bb + dilation,
        determinant,
    }
}

/// Unit direction from the camera to the mean, and the inverse of the distance.
#[derive(CubeType)]
pub(super) struct Direction {
    pub x: f32,
    pub y: f32,
    pub z: f32,
    pub inverse: f32,
}

#[cube]
pub(super) fn view_direction(means: &[f32], camera: &[f32], i: usize) -> Direction {
    let dx = means[3 * i] - camera[16];
    let dy = means[3 * i + 1] - camera[17];
    let dz = means[3 * i + 2] - camera[18];
    let inverse = 1.0f32 / max(f32::sqrt(dx * dx + dy * dy + dz * dz), 1e-20f32);
    Direction { x: dx * inverse, y: dy * inverse, z: dz * inverse, inverse }
}

/// Projects a Gaussian a unit: `screen` `[N, 12]`, depth keys, indices to sort with them, radii.
#[cube(launch)]
pub(super) fn project(
    means: &[f32],
    rotations: &[f32],
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
) {
    if ABSOLUTE_POS < n as usize {
        let i = ABSOLUTE_POS;
        let p = project_gaussian(means, rotations, log_scales, camera, i);
        let (width, height) = (camera[21], camera[22]);
        let opacity = 1.0f32 / (1.0f32 + f32::exp(-opacity_logits[i]));
        let inverse = 1.0f32 / p.determinant;
        let iz = 1.0f32 / p.cz;
        let x = camera[0] * p.cx * iz + camera[2] + offsets[2 * i];
        let y = camera[1] * p.cy * iz + camera[3] + offsets[2 * i + 1];
        // alpha >= 1/255 inside the ellipse d^T conic d <= reach
        let reach = 2.0f32 * f32::ln(opacity / comptime!(ALPHA_MIN));
        let extent_x = f32::sqrt(max(reach * p.ca, 0.0f32));
        let extent_y = f32::sqrt(max(reach * p.cc, 0.0f32));
        let (qa, qb, qc) = (-0.5f32 * p.cc * inverse, p.cb * inverse, -0.5f32 * p.ca * inverse);

        let d = view_direction(means, camera, i);
        let base = i * 3 * sh_stride as usize;
        let mut b = Array::<f32>::new(16usize);
        basis(&mut b, d.x, d.y, d.z, degree);
        let mut red = 0.5f32;
        let mut green = 0.5f32;
        let mut blue = 0.5f32;
        #[unroll]
        for k in 0..comptime!(((degree + 1) * (degree + 1)) as usize) {
            red += b[k] * sh[base + 3 * k];
            green += b[k] * sh[base + 3 * k + 1];
            blue += b[k] * sh[base + 3 * k + 2];
        }
        let finite = is_finite(opacity)
            && is_finite(rotations[4 * i])
            && is_finite(rotations[4 * i + 1])
            && is_finite(rotations[4 * i + 2])
            && is_finite(rotations[4 * i + 3])
            && is_finite(p.cz)
            && is_finite(qa + qb + qc)
            && is_finite(p.determinant)
            && is_finite(x + y + extent_x + extent_y)
            && is_finite(red)
            && is_finite(green)
            && is_finite(blue);
        let drawn = finite
            && opacity >= comptime!(ALPHA_MIN)
            && p.cz > comptime!(NEAR)
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
            keys[i] = u32::reinterpret(p.cz);
            let mid = 0.5f32 * (p.ca + p.cc);
            let lambda = mid + f32::sqrt(max(mid * mid - p.determinant, 0.1f32));
            radii[i] = i32::cast_from(min(f32::ceil(3.0f32 * f32::sqrt(lambda)), 1e9f32));
        } else {
            keys[i] = comptime!(CULLED);
            radii[i] = 0i32;
        }
    }
}
