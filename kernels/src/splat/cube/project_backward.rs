//! Per Gaussian: its entries' sums back to means, rotations, log_scales, opacity_logits, sh and screen_offsets.
//! The same arithmetic as `cpu::project_backward`.

use super::project::{project_gaussian, view_direction};
use super::sh::{basis, basis_derivative};
use burn_cubecl::cubecl;
use burn_cubecl::cubecl::prelude::*;

/// A unit a place in the order of depth; writes every output of its Gaussian, zeros where nothing was drawn.
#[cube(launch)]
pub(super) fn project_backward(
    means: &[f32],
    rotations: &[f32],
    log_scales: &[f32],
    sh: &[f32],
    camera: &[f32],
    screen: &[f32],
    order: &[u32],
    starts: &[u32],
    sums: &[f32],
    out_means: &mut [f32],
    out_rotations: &mut [f32],
    out_log_scales: &mut [f32],
    out_logits: &mut [f32],
    out_sh: &mut [f32],
    out_offsets: &mut [f32],
    n: u32,
    capacity: u32,
    sh_stride: u32,
    #[comptime] degree: u32,
) {
    let rank = ABSOLUTE_POS;
    if rank < n as usize {
        let i = order[rank] as usize;
        let width = 3 * sh_stride as usize;
        let mut g = Array::<f32>::new(9usize);
        #[unroll]
        for k in 0..9usize {
            g[k] = 0.0f32;
        }
        let first = min(starts[rank], capacity);
        let end = min(starts[rank + 1], capacity);
        for e in first..end {
            let at = e as usize * 9;
            #[unroll]
            for k in 0..9usize {
                g[k] += sums[at + k];
            }
        }
        let mut any = false;
        #[unroll]
        for k in 0..9usize {
            any = any || g[k] != 0.0f32;
        }
        if any {
            one(
                means,
                rotations,
                log_scales,
                sh,
                camera,
                screen,
                &g,
                i,
                out_means,
                out_rotations,
                out_log_scales,
                out_logits,
                out_sh,
                out_offsets,
                width,
                degree,
            );
        } else {
            #[unroll]
            for k in 0..3usize {
                out_means[3 * i + k] = 0.0f32;
                out_log_scales[3 * i + k] = 0.0f32;
            }
            #[unroll]
            for k in 0..4usize {
                out_rotations[4 * i + k] = 0.0f32;
            }
            out_logits[i] = 0.0f32;
            out_offsets[2 * i] = 0.0f32;
            out_offsets[2 * i + 1] = 0.0f32;
            for k in 0..width {
                out_sh[i * width + k] = 0.0f32;
            }
        }
    }
}

#[cube]
fn one(
    means: &[f32],
    rotations: &[f32],
    log_scales: &[f32],
    sh: &[f32],
    camera: &[f32],
    screen: &[f32],
    g: &Array<f32>,
    i: usize,
    out_means: &mut [f32],
    out_rotations: &mut [f32],
    out_log_scales: &mut [f32],
    out_logits: &mut [f32],
    out_sh: &mut [f32],
    out_offsets: &mut [f32],
    width: usize,
    #[comptime] degree: u32,
) {
    let p = project_gaussian(means, rotations, log_scales, camera, i);
    let (fx, fy) = (camera[0], camera[1]);
    let inverse = 1.0f32 / p.determinant;
    let (ka, kb, kc) = (p.cc * inverse, -p.cb * inverse, p.ca * inverse);

    // power = -1/2 (A dx^2 + C dy^2) - B dx dy with (dx, dy) = pixel - mean
    let screen_x = ka * g[1] + kb * g[2];
    let screen_y = kb * g[1] + kc * g[2];
    let opacity = f32::exp(screen[i * 12 + 5]);
    out_logits[i] = g[0] * (1.0f32 - opacity);
    out_offsets[2 * i] = screen_x;
    out_offsets[2 * i + 1] = screen_y;

    // dL/dCov = -Conic G Conic with the symmetric G = dL/dConic
    let (ga, gb, gc) = (-0.5f32 * g[3], -0.5f32 * g[4], -0.5f32 * g[5]);
    let (t00, t01) = (ka * ga + kb * gb, ka * gb + kb * gc);
    let (t10, t11) = (kb * ga + kc * gb, kb * gb + kc * gc);
    let va = -(t00 * ka + t01 * kb);
    let vb = -(t00 * kb + t01 * kc);
    let vc = -(t10 * kb + t11 * kc);

    // Cov = X X^T, X = (J W)(R S)
    let x00 = 2.0f32 * (va * p.a0 + vb * p.b0);
    let x01 = 2.0f32 * (va * p.a1 + vb * p.b1);
    let x02 = 2.0f32 * (va * p.a2 + vb * p.b2);
    let x10 = 2.0f32 * (vb * p.a0 + vc * p.b0);
    let x11 = 2.0f32 * (vb * p.a1 + vc * p.b1);
    let x12 = 2.0f32 * (vb * p.a2 + vc * p.b2);
    // dL/d(R S) = (J W)^T vX, its columns not yet scaled
    let m00 = p.u0 * x00 + p.v0 * x10;
    let m01 = p.u0 * x01 + p.v0 * x11;
    let m02 = p.u0 * x02 + p.v0 * x12;
    let m10 = p.u1 * x00 + p.v1 * x10;
    let m11 = p.u1 * x01 + p.v1 * x11;
    let m12 = p.u1 * x02 + p.v1 * x12;
    let m20 = p.u2 * x00 + p.v2 * x10;
    let m21 = p.u2 * x01 + p.v2 * x11;
    let m22 = p.u2 * x02 + p.v2 * x12;
    out_log_scales[3 * i] = p.s0 * (m00 * p.r00 + m10 * p.r10 + m20 * p.r20);
    out_log_scales[3 * i + 1] = p.s1 * (m01 * p.r01 + m11 * p.r11 + m21 * p.r21);
    out_log_scales[3 * i + 2] = p.s2 * (m02 * p.r02 + m12 * p.r12 + m22 * p.r22);

    // through the rotation matrix and the normalisation of the quaternion
    let (v00, v01, v02) = (m00 * p.s0, m01 * p.s1, m02 * p.s2);
    let (v10, v11, v12) = (m10 * p.s0, m11 * p.s1, m12 * p.s2);
    let (v20, v21, v22) = (m20 * p.s0, m21 * p.s1, m22 * p.s2);
    let (w, x, y, z) = (p.qw, p.qx, p.qy, p.qz);
    let gw = 2.0f32 * (x * (v21 - v12) + y * (v02 - v20) + z * (v10 - v01));
    let gx = 2.0f32 * (-2.0f32 * x * (v11 + v22) + y * (v01 + v10) + z * (v02 + v20) + w * (v21 - v12));
    let gy = 2.0f32 * (x * (v01 + v10) - 2.0f32 * y * (v00 + v22) + z * (v12 + v21) + w * (v02 - v20));
    let gz = 2.0f32 * (x * (v02 + v20) + y * (v12 + v21) - 2.0f32 * z * (v00 + v11) + w * (v10 - v01));
    let along = gw * w + gx * x + gy * y + gz * z;
    out_rotations[4 * i] = (gw - along * w) * p.inverse_norm;
    out_rotations[4 * i + 1] = (gx - along * x) * p.inverse_norm;
    out_rotations[4 * i + 2] = (gy - along * y) * p.inverse_norm;
    out_rotations[4 * i + 3] = (gz - along * z) * p.inverse_norm;

    // dL/d(J W) = vX (R S)^T, then through the Jacobian and the position to camera space
    let (e00, e01, e02) = (x00 * p.s0, x01 * p.s1, x02 * p.s2);
    let (e10, e11, e12) = (x10 * p.s0, x11 * p.s1, x12 * p.s2);
    let ju0 = e00 * p.r00 + e01 * p.r01 + e02 * p.r02;
    let ju1 = e00 * p.r10 + e01 * p.r11 + e02 * p.r12;
    let ju2 = e00 * p.r20 + e01 * p.r21 + e02 * p.r22;
    let jv0 = e10 * p.r00 + e11 * p.r01 + e12 * p.r02;
    let jv1 = e10 * p.r10 + e11 * p.r11 + e12 * p.r12;
    let jv2 = e10 * p.r20 + e11 * p.r21 + e12 * p.r22;
    let j00 = ju0 * camera[4] + ju1 * camera[5] + ju2 * camera[6];
    let j02 = ju0 * camera[10] + ju1 * camera[11] + ju2 * camera[12];
    let j11 = jv0 * camera[7] + jv1 * camera[8] + jv2 * camera[9];
    let j12 = jv0 * camera[10] + jv1 * camera[11] + jv2 * camera[12];
    let iz = 1.0f32 / p.cz;
    let iz2 = iz * iz;
    let mut cx = screen_x * fx * iz;
    let mut cy = screen_y * fy * iz;
    let mut cz = -(screen_x * fx * p.cx + screen_y * fy * p.cy) * iz2 - (j00 * fx + j11 * fy) * iz2;
    // J02 = -fx slope / z; a clamped slope is a constant, a free one is x/z
    if p.clamped_x {
        cz += j02 * fx * p.slope_x * iz2;
    } else {
        cx -= j02 * fx * iz2;
        cz += 2.0f32 * j02 * fx * p.slope_x * iz2;
    }
    if p.clamped_y {
        cz += j12 * fy * p.slope_y * iz2;
    } else {
        cy -= j12 * fy * iz2;
        cz += 2.0f32 * j12 * fy * p.slope_y * iz2;
    }
    let mut mx = camera[4] * cx + camera[7] * cy + camera[10] * cz;
    let mut my = camera[5] * cx + camera[8] * cy + camera[11] * cz;
    let mut mz = camera[6] * cx + camera[9] * cy + camera[12] * cz;

    // colour; a channel clamped at zero passes nothing on
    let red = select(screen[i * 12 + 6] > 0.0f32, g[6], 0.0f32);
    let green = select(screen[i * 12 + 7] > 0.0f32, g[7], 0.0f32);
    let blue = select(screen[i * 12 + 8] > 0.0f32, g[8], 0.0f32);
    let d = view_direction(means, camera, i);
    let mut b = Array::<f32>::new(16usize);
    basis(&mut b, d.x, d.y, d.z, degree);
    let used = comptime!(((degree + 1) * (degree + 1)) as usize);
    let base = i * width;
    #[unroll]
    for k in 0..used {
        out_sh[base + 3 * k] = b[k] * red;
        out_sh[base + 3 * k + 1] = b[k] * green;
        out_sh[base + 3 * k + 2] = b[k] * blue;
    }
    for k in comptime!(3 * used)..width {
        out_sh[base + k] = 0.0f32;
    }
    if comptime!(degree > 0) {
        let mut by_x = Array::<f32>::new(16usize);
        let mut by_y = Array::<f32>::new(16usize);
        let mut by_z = Array::<f32>::new(16usize);
        basis_derivative(&mut by_x, &mut by_y, &mut by_z, d.x, d.y, d.z, degree);
        let mut vx = 0.0f32;
        let mut vy = 0.0f32;
        let mut vz = 0.0f32;
        #[unroll]
        for k in 1..used {
            let e = sh[base + 3 * k] * red + sh[base + 3 * k + 1] * green + sh[base + 3 * k + 2] * blue;
            vx += by_x[k] * e;
            vy += by_y[k] * e;
            vz += by_z[k] * e;
        }
        let along = vx * d.x + vy * d.y + vz * d.z;
        mx += (vx - along * d.x) * d.inverse;
        my += (vy - along * d.y) * d.inverse;
        mz += (vz - along * d.z) * d.inverse;
    }
    out_means[3 * i] = mx;
    out_means[3 * i + 1] = my;
    out_means[3 * i + 2] = mz;
}
