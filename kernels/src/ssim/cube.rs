//! SSIM on a GPU: five statistics filtered along rows, then along columns; their slopes take the same path back.

use super::ops::{SsimForward, SsimOps};
use super::{C1, C2, RADIUS, TAPS, window};
use crate::cube::prelude::*;
use crate::cube::reduce::{over_cube, total};
use crate::cube::{UNITS, Words, arg, cubes, empty_f32, launched, rows};

/// Filters a, b, a^2, b^2 and ab along the rows: `out` `[5, H * W * 3]`.
#[cube(launch)]
fn images_along_rows(a: &[f32], b: &[f32], taps: &[f32], out: &mut [f32], width: u32, stride: u32, len: u32) {
    let e = ABSOLUTE_POS as u32;
    if e < len {
        let (pixel, channel) = (e / 3u32, e % 3u32);
        let x = pixel % width;
        let row = pixel - x;
        let mut ma = 0.0f32;
        let mut mb = 0.0f32;
        let mut aa = 0.0f32;
        let mut bb = 0.0f32;
        let mut ab = 0.0f32;
        for k in 0..comptime!(TAPS as u32) {
            let at = x + k;
            if at >= comptime!(RADIUS as u32) && at - comptime!(RADIUS as u32) < width {
                let from = ((row + at - comptime!(RADIUS as u32)) * stride + channel) as usize;
                let tap = taps[k as usize];
                let (va, vb) = (a[from], b[from]);
                ma += tap * va;
                mb += tap * vb;
                aa += tap * va * va;
                bb += tap * vb * vb;
                ab += tap * va * vb;
            }
        }
        let step = len as usize;
        let at = e as usize;
        out[at] = ma;
        out[at + step] = mb;
        out[at + 2 * step] = aa;
        out[at + 3 * step] = bb;
        out[at + 4 * step] = ab;
    }
}

/// Filters the five along the columns, sums the similarity of each cube, and writes its slopes with respect to the
/// filtered a, a^2 and ab, `[3, H * W * 3]`.
#[cube(launch)]
fn similarity(
    filtered: &[f32],
    taps: &[f32],
    slopes: &mut [f32],
    parts: &mut [f32],
    width: u32,
    height: u32,
    len: u32,
    #[comptime] with_grad: bool,
) {
    let e = ABSOLUTE_POS as u32;
    let mut value = 0.0f32;
    if e < len {
        let y = e / 3u32 / width;
        let pitch = 3u32 * width;
        let step = len as usize;
        let mut ma = 0.0f32;
        let mut mb = 0.0f32;
        let mut aa = 0.0f32;
        let mut bb = 0.0f32;
        let mut ab = 0.0f32;
        for k in 0..comptime!(TAPS as u32) {
            let at = y + k;
            if at >= comptime!(RADIUS as u32) && at - comptime!(RADIUS as u32) < height {
                let from = (e + (at - comptime!(RADIUS as u32)) * pitch - y * pitch) as usize;
                let tap = taps[k as usize];
                ma += tap * filtered[from];
                mb += tap * filtered[from + step];
                aa += tap * filtered[from + 2 * step];
                bb += tap * filtered[from + 3 * step];
                ab += tap * filtered[from + 4 * step];
            }
        }
        let c1 = comptime!(C1 as f32);
        let c2 = comptime!(C2 as f32);
        let n1 = 2.0f32 * ma * mb + c1;
        let n2 = 2.0f32 * (ab - ma * mb) + c2;
        let d1 = ma * ma + mb * mb + c1;
        let d2 = (aa - ma * ma) + (bb - mb * mb) + c2;
        let inverse = 1.0f32 / (d1 * d2);
        value = n1 * n2 * inverse;
        if comptime!(with_grad) {
            let at = e as usize;
            slopes[at] = 2.0f32 * mb * (n2 - n1) * inverse - value * 2.0f32 * ma * (1.0f32 / d1 - 1.0f32 / d2);
            slopes[at + step] = -value / d2;
            slopes[at + 2 * step] = 2.0f32 * n1 * inverse;
        }
    }
    let value = over_cube(value);
    if UNIT_POS == 0u32 {
        parts[CUBE_POS] = value;
    }
}

/// Filters the three slopes along the rows.
#[cube(launch)]
fn slopes_along_rows(slopes: &[f32], taps: &[f32], out: &mut [f32], width: u32, len: u32) {
    let e = ABSOLUTE_POS as u32;
    if e < len {
        let x = e / 3u32 % width;
        let step = len as usize;
        let mut mean = 0.0f32;
        let mut square = 0.0f32;
        let mut product = 0.0f32;
        for k in 0..comptime!(TAPS as u32) {
            let at = x + k;
            if at >= comptime!(RADIUS as u32) && at - comptime!(RADIUS as u32) < width {
                let from = (e + 3u32 * (at - comptime!(RADIUS as u32)) - 3u32 * x) as usize;
                let tap = taps[k as usize];
                mean += tap * slopes[from];
                square += tap * slopes[from + step];
                product += tap * slopes[from + 2 * step];
            }
        }
        let at = e as usize;
        out[at] = mean;
        out[at + step] = square;
        out[at + 2 * step] = product;
    }
}

/// Filters them along the columns and assembles the gradient with respect to a; alpha gets 0.
#[cube(launch)]
fn gradient(
    filtered: &[f32],
    a: &[f32],
    b: &[f32],
    taps: &[f32],
    out: &mut [f32],
    width: u32,
    height: u32,
    stride: u32,
    len: u32,
    factor: f32,
) {
    let e = ABSOLUTE_POS as u32;
    if e < len {
        let (pixel, channel) = (e / 3u32, e % 3u32);
        let y = pixel / width;
        let pitch = 3u32 * width;
        let step = len as usize;
        let mut mean = 0.0f32;
        let mut square = 0.0f32;
        let mut product = 0.0f32;
        for k in 0..comptime!(TAPS as u32) {
            let at = y + k;
            if at >= comptime!(RADIUS as u32) && at - comptime!(RADIUS as u32) < height {
                let from = (e + (at - comptime!(RADIUS as u32)) * pitch - y * pitch) as usize;
                let tap = taps[k as usize];
                mean += tap * filtered[from];
                square += tap * filtered[from + step];
                product += tap * filtered[from + 2 * step];
            }
        }
        let at = (pixel * stride + channel) as usize;
        out[at] = factor * (mean + 2.0f32 * a[at] * square + b[at] * product);
        if stride == 4u32 && channel == 2u32 {
            out[at + 1] = 0.0f32;
        }
    }
}

impl SsimOps for CubeBackend {
    fn ssim_forward(a: FloatTensor<Self>, b: FloatTensor<Self>, with_grad: bool) -> SsimForward<Self> {
        let (a, b) = (rows(a), rows(b));
        let client = a.client.clone();
        let shape = a.meta.shape().clone();
        let (height, width, stride) = (shape[0], shape[1], shape[2]);
        let len = height * width * 3;
        let taps: Vec<f32> = window().iter().map(|tap| *tap as f32).collect();
        let taps = Words::f32s(&client, &taps);
        let (count, dim) = (cubes(len, UNITS), CubeDim::new_1d(UNITS));
        let filtered = Words::empty(&client, 5 * len);
        let (w, h, s, l) = (width as u32, height as u32, stride as u32, len as u32);
        images_along_rows::launch(&client, count.clone(), dim, arg(&a), arg(&b), taps.arg(), filtered.arg(), w, s, l);
        let slopes = Words::empty(&client, if with_grad { 3 * len } else { 1 });
        let parts = Words::empty(&client, launched(&count));
        let args = (filtered.arg(), taps.arg(), slopes.arg(), parts.arg());
        similarity::launch(&client, count.clone(), dim, args.0, args.1, args.2, args.3, w, h, l, with_grad);
        let value = empty_f32(&a, [1]);
        total(&client, &parts, &value, 1.0 / len as f32);
        if !with_grad {
            return SsimForward { grad: value.clone(), value };
        }
        let grad = empty_f32(&a, shape);
        slopes_along_rows::launch(&client, count.clone(), dim, slopes.arg(), taps.arg(), filtered.arg(), w, l);
        gradient::launch(
            &client,
            count,
            dim,
            filtered.arg(),
            arg(&a),
            arg(&b),
            taps.arg(),
            arg(&grad),
            w,
            h,
            s,
            l,
            1.0 / len as f32,
        );
        SsimForward { value, grad }
    }
}
