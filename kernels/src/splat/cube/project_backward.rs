//! Propagation of the sums of each Gaussian's entries back to means, covariances, opacity_logits, sh and
//! screen_offsets. The same arithmetic as `cpu::project_backward`.

use super::covariance::{backward, no_gradient};
use super::project::{view, view_direction};
use super::sh::{basis, basis_derivative, count};
use crate::cube::prelude::*;
use crate::cube::vector::{dot, vec3_at};

/// Processes one position of the depth order per unit; writes every output of its Gaussian, zeros where nothing was
/// drawn. For `source`, see [`super::covariance::on_screen`].
#[cube(launch)]
pub(super) fn project_backward(
    means: &[f32],
    source: &[f32],
    log_scales: &[f32],
    sh: &[f32],
    camera: &[f32],
    screen: &[f32],
    order: &[u32],
    starts: &[u32],
    sums: &[f32],
    out_means: &mut [f32],
    out_source: &mut [f32],
    out_log_scales: &mut [f32],
    out_logits: &mut [f32],
    out_sh: &mut [f32],
    out_offsets: &mut [f32],
    n: u32,
    capacity: u32,
    sh_stride: u32,
    #[comptime] degree: u32,
    #[comptime] even: bool,
    #[comptime] entries: bool,
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
                source,
                log_scales,
                sh,
                camera,
                screen,
                &g,
                i,
                out_means,
                out_source,
                out_log_scales,
                out_logits,
                out_sh,
                out_offsets,
                width,
                degree,
                even,
                entries,
            );
        } else {
            #[unroll]
            for k in 0..3usize {
                out_means[3 * i + k] = 0.0f32;
            }
            no_gradient(out_source, out_log_scales, i, entries);
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
    source: &[f32],
    log_scales: &[f32],
    sh: &[f32],
    camera: &[f32],
    screen: &[f32],
    g: &Array<f32>,
    i: usize,
    out_means: &mut [f32],
    out_source: &mut [f32],
    out_log_scales: &mut [f32],
    out_logits: &mut [f32],
    out_sh: &mut [f32],
    out_offsets: &mut [f32],
    width: usize,
    #[comptime] degree: u32,
    #[comptime] even: bool,
    #[comptime] entries: bool,
) {
    let at_camera = view(means, camera, i);
    let (fx, fy) = (camera[0], camera[1]);
    // the conic, from the factors of the exponent: these are minus half its diagonal and minus its off-diagonal entry
    let (ka, kb, kc) = (-2.0f32 * screen[i * 12 + 2], -screen[i * 12 + 3], -2.0f32 * screen[i * 12 + 4]);

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

    // then through the Jacobian and the position to camera space
    let by = backward(source, log_scales, &at_camera, va, vb, vc, out_source, out_log_scales, i, entries);
    let (wx, wy, wz) = (vec3_at(camera, 4), vec3_at(camera, 7), vec3_at(camera, 10));
    let (j00, j02) = (dot(&by.u, &wx), dot(&by.u, &wz));
    let (j11, j12) = (dot(&by.v, &wy), dot(&by.v, &wz));
    let iz = 1.0f32 / at_camera.at.z;
    let iz2 = iz * iz;
    let mut cx = screen_x * fx * iz;
    let mut cy = screen_y * fy * iz;
    let mut cz = -(screen_x * fx * at_camera.at.x + screen_y * fy * at_camera.at.y) * iz2 - (j00 * fx + j11 * fy) * iz2;
    // J02 = -fx slope / z; a clamped slope is a constant, a free one is x/z
    if at_camera.clamped_x {
        cz += j02 * fx * at_camera.slope_x * iz2;
    } else {
        cx -= j02 * fx * iz2;
        cz += 2.0f32 * j02 * fx * at_camera.slope_x * iz2;
    }
    if at_camera.clamped_y {
        cz += j12 * fy * at_camera.slope_y * iz2;
    } else {
        cy -= j12 * fy * iz2;
        cz += 2.0f32 * j12 * fy * at_camera.slope_y * iz2;
    }
    let mut mx = wx.x * cx + wy.x * cy + wz.x * cz;
    let mut my = wx.y * cx + wy.y * cy + wz.y * cz;
    let mut mz = wx.z * cx + wy.z * cy + wz.z * cz;

    // colour; a channel clamped at zero passes no gradient on
    let red = select(screen[i * 12 + 6] > 0.0f32, g[6], 0.0f32);
    let green = select(screen[i * 12 + 7] > 0.0f32, g[7], 0.0f32);
    let blue = select(screen[i * 12 + 8] > 0.0f32, g[8], 0.0f32);
    let d = view_direction(means, camera, i);
    let mut b = Array::<f32>::new(16usize);
    basis(&mut b, &d.unit, degree, even);
    let used = comptime!(count(degree, even));
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
        basis_derivative(&mut by_x, &mut by_y, &mut by_z, &d.unit, degree, even);
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
        let along = vx * d.unit.x + vy * d.unit.y + vz * d.unit.z;
        mx += (vx - along * d.unit.x) * d.inverse;
        my += (vy - along * d.unit.y) * d.inverse;
        mz += (vz - along * d.unit.z) * d.inverse;
    }
    out_means[3 * i] = mx;
    out_means[3 * i + 1] = my;
    out_means[3 * i + 2] = mz;
}
