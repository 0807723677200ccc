//! Separable SSIM over f32 rows: columns are filtered straight from the images into one padded row per statistic, rows
//! from there, and the adjoint takes the same path back. Tasks are fixed bands of rows and sums are added in row order,
//! so the bits do not depend on the thread count.

use super::{C1, C2, RADIUS, TAPS, window};
use crate::backend::zeros;
use crate::splat::cpu::lanes::wide;
use rayon::prelude::*;

/// Image rows per task.
const BAND: usize = 8;
/// Channels per pixel.
const RGB: usize = 3;
/// Zeros before the first pixel of a filtered row.
const PAD: usize = RADIUS * RGB;
/// Width of the vector blocks.
const LANES: usize = 8;

/// Returns the mean SSIM of images `a` and `b` `[h, w, 3]` with values in [0, 1]: Gaussian window of 11 taps and sigma
/// 1.5, zero padding, mean over pixels and channels. An empty image gives 1. Non-finite pixels give NaN.
///
/// # Panics
/// If a slice length is not `h * w * 3`.
pub fn ssim(a: &[f32], b: &[f32], h: usize, w: usize) -> f64 {
    check(a, b, h, w);
    if a.is_empty() {
        return 1.0;
    }
    let taps = window().map(|tap| tap as f32);
    let bands = (0..h.div_ceil(BAND)).into_par_iter();
    let sums: Vec<f64> = bands.map(|band| compare_band::<false>((a, b), w, &taps, band, Default::default())).collect();
    sums.iter().sum::<f64>() / a.len() as f64
}

/// As [`ssim`], and adds `scale * d ssim / d a` to `grad_a` `[h, w, 3]`.
///
/// # Panics
/// If a slice length is not `h * w * 3`.
pub fn ssim_grad(a: &[f32], b: &[f32], h: usize, w: usize, scale: f32, grad_a: &mut [f32]) -> f64 {
    check(a, b, h, w);
    assert_eq!(grad_a.len(), a.len(), "grad_a: [h, w, 3]");
    if a.is_empty() {
        return 1.0;
    }
    let taps = window().map(|tap| tap as f32);
    let row = w * RGB;
    let mut slopes = [(); 3].map(|()| zeros(a.len()));
    let [mean, square, product] = &mut slopes;
    let sums: Vec<f64> = mean
        .par_chunks_mut(BAND * row)
        .zip(square.par_chunks_mut(BAND * row))
        .zip(product.par_chunks_mut(BAND * row))
        .enumerate()
        .map(|(band, ((mean, square), product))| compare_band::<true>((a, b), w, &taps, band, [mean, square, product]))
        .collect();
    let [mean, square, product] = &slopes;
    let factor = scale / a.len() as f32;
    grad_a.par_chunks_mut(BAND * row).enumerate().for_each(|(band, grad)| {
        let first = band * BAND;
        let adjoint = Adjoint { a, b, row, first, taps: &taps, slopes: [mean, square, product], factor, grad };
        wide!(adjoint.run());
    });
    sums.iter().sum::<f64>() / a.len() as f64
}

fn check(a: &[f32], b: &[f32], h: usize, w: usize) {
    assert_eq!(a.len(), h * w * RGB, "a: [h, w, 3]");
    assert_eq!(b.len(), h * w * RGB, "b: [h, w, 3]");
}

/// Loads `L` consecutive values of a row, starting at `i`.
#[inline(always)]
fn load<const L: usize>(values: &[f32], i: usize) -> [f32; L] {
    let mut out = [0.0; L];
    out.copy_from_slice(&values[i..i + L]);
    out
}

/// Returns the taps that fall on image rows when centred on row `y`, each with its row.
#[inline(always)]
fn rows_around(y: usize, height: usize) -> impl Iterator<Item = (usize, usize)> {
    let from = RADIUS.saturating_sub(y);
    let to = TAPS.min(height + RADIUS - y);
    (from..to).map(move |tap| (tap, y + tap - RADIUS))
}

/// Filters `values`, a padded row, along the row at element `i`.
#[inline(always)]
fn along_row<const L: usize>(values: &[f32], taps: &[f32; TAPS], i: usize) -> [f32; L] {
    let values = &values[i..i + (TAPS - 1) * RGB + L];
    let mut out = [0.0; L];
    for tap in 0..TAPS {
        for lane in 0..L {
            out[lane] += taps[tap] * values[tap * RGB + lane];
        }
    }
    out
}

/// Calls `$body` for every vector block of a row of `$len` elements, then for the rest one by one.
macro_rules! blocks {
    ($len:expr, |$i:ident, $lanes:ident| $body:expr) => {
        let whole = $len / LANES * LANES;
        for $i in (0..whole).step_by(LANES) {
            const $lanes: usize = LANES;
            $body
        }
        for $i in whole..$len {
            const $lanes: usize = 1;
            $body
        }
    };
}

/// Sums SSIM over a band of image rows; with `SLOPES` also stores, for those rows, its derivatives with respect to the
/// windowed means of a, a * a and a * b.
fn compare_band<const SLOPES: bool>(
    (a, b): (&[f32], &[f32]),
    w: usize,
    taps: &[f32; TAPS],
    band: usize,
    slopes: [&mut [f32]; 3],
) -> f64 {
    let (row, first) = (w * RGB, band * BAND);
    let stats = Stats::<SLOPES> { a, b, row, first, last: (first + BAND).min(a.len() / row), taps, slopes };
    wide!(stats.run())
}

/// Image rows `first..last`.
struct Stats<'a, const SLOPES: bool> {
    a: &'a [f32],
    b: &'a [f32],
    row: usize,
    first: usize,
    last: usize,
    taps: &'a [f32; TAPS],
    slopes: [&'a mut [f32]; 3],
}

impl<const SLOPES: bool> Stats<'_, SLOPES> {
    #[inline(always)]
    fn run(mut self) -> f64 {
        let row = self.row;
        let mut columns = [(); 5].map(|()| vec![0.0f32; row + 2 * PAD]);
        let mut sum = 0.0;
        for y in self.first..self.last {
            blocks!(row, |i, L| self.filter_columns::<L>(y, i, &mut columns));
            let at = (y - self.first) * row;
            blocks!(row, |i, L| sum += self.compare::<L>(&columns, i, at));
        }
        sum
    }

    #[inline(always)]
    fn filter_columns<const L: usize>(&self, y: usize, i: usize, columns: &mut [Vec<f32>; 5]) {
        let mut sums = [[0.0f32; L]; 5];
        for (tap, near) in rows_around(y, self.a.len() / self.row) {
            let at = near * self.row + i;
            let (a, b) = (load::<L>(self.a, at), load::<L>(self.b, at));
            let tap = self.taps[tap];
            for lane in 0..L {
                let (wa, wb) = (tap * a[lane], tap * b[lane]);
                sums[0][lane] += wa;
                sums[1][lane] += wb;
                sums[2][lane] += wa * a[lane];
                sums[3][lane] += wb * b[lane];
                sums[4][lane] += wa * b[lane];
            }
        }
        for (column, sum) in columns.iter_mut().zip(&sums) {
            column[PAD + i..PAD + i + L].copy_from_slice(sum);
        }
    }

    #[inline(always)]
    fn compare<const L: usize>(&mut self, columns: &[Vec<f32>; 5], i: usize, at: usize) -> f64 {
        let (c1, c2) = (C1 as f32, C2 as f32);
        let mut stats = [[0.0f32; L]; 5];
        for (stat, column) in stats.iter_mut().zip(columns) {
            *stat = along_row(column, self.taps, i);
        }
        let mut total = [0.0f32; L];
        let mut slopes = [[0.0f32; L]; 3];
        for lane in 0..L {
            let (ma, mb) = (stats[0][lane], stats[1][lane]);
            let (aa, bb, ab) = (stats[2][lane], stats[3][lane], stats[4][lane]);
            let means = 2.0 * ma * mb + c1;
            let covariance = 2.0 * (ab - ma * mb) + c2;
            let powers = ma * ma + mb * mb + c1;
            let variances = (aa - ma * ma) + (bb - mb * mb) + c2;
            let inverse = 1.0 / (powers * variances);
            let value = means * covariance * inverse;
            total[lane] = value;
            let by_square = -value * powers * inverse;
            let by_product = 2.0 * means * inverse;
            slopes[0][lane] =
                2.0 * (mb * covariance - ma * value * variances) * inverse - 2.0 * ma * by_square - mb * by_product;
            slopes[1][lane] = by_square;
            slopes[2][lane] = by_product;
        }
        if SLOPES {
            for (target, slope) in self.slopes.iter_mut().zip(&slopes) {
                target[at + i..at + i + L].copy_from_slice(slope);
            }
        }
        total.iter().map(|&v| f64::from(v)).sum()
    }
}

/// Propagates the derivatives with respect to the windowed means back to the pixels of a band of image rows.
struct Adjoint<'a> {
    a: &'a [f32],
    b: &'a [f32],
    row: usize,
    first: usize,
    taps: &'a [f32; TAPS],
    slopes: [&'a [f32]; 3],
    factor: f32,
    grad: &'a mut [f32],
}

impl Adjoint<'_> {
    #[inline(always)]
    fn run(mut self) {
        let row = self.row;
        let mut columns = [(); 3].map(|()| vec![0.0f32; row + 2 * PAD]);
        for line in 0..self.grad.len() / row {
            blocks!(row, |i, L| self.filter_columns::<L>(line, i, &mut columns));
            blocks!(row, |i, L| self.add_gradient::<L>(&columns, i, line));
        }
    }

    #[inline(always)]
    fn filter_columns<const L: usize>(&self, line: usize, i: usize, columns: &mut [Vec<f32>; 3]) {
        let mut sums = [[0.0f32; L]; 3];
        for (tap, near) in rows_around(self.first + line, self.a.len() / self.row) {
            let at = near * self.row + i;
            for (sum, slopes) in sums.iter_mut().zip(self.slopes) {
                let values = load::<L>(slopes, at);
                for lane in 0..L {
                    sum[lane] += self.taps[tap] * values[lane];
                }
            }
        }
        for (column, sum) in columns.iter_mut().zip(&sums) {
            column[PAD + i..PAD + i + L].copy_from_slice(sum);
        }
    }

    #[inline(always)]
    fn add_gradient<const L: usize>(&mut self, columns: &[Vec<f32>; 3], i: usize, line: usize) {
        let mean = along_row::<L>(&columns[0], self.taps, i);
        let square = along_row::<L>(&columns[1], self.taps, i);
        let product = along_row::<L>(&columns[2], self.taps, i);
        let at = (self.first + line) * self.row + i;
        let (a, b) = (load::<L>(self.a, at), load::<L>(self.b, at));
        let grad = &mut self.grad[line * self.row + i..][..L];
        for lane in 0..L {
            let slope = mean[lane] + 2.0 * a[lane] * square[lane] + b[lane] * product[lane];
            grad[lane] += self.factor * slope;
        }
    }
}
