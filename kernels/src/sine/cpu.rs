//! Sines of rows over f32 slices, and their gradients. Work is split by the size of the input alone, and every value is
//! computed by the same few operations, none of them fused, so the bits depend on neither threads nor processors.

use crate::splat::cpu::lanes::wide;
use rayon::prelude::*;

/// Approximate number of values per task.
const TASK: usize = 16_384;

/// Arguments beyond this lose digits in the reduction, and are left to the standard library.
const LARGE: f32 = 20_000.0;

/// Pi in three parts, the first two with so few bits that their products with integers are exact (Cody and Waite).
const PI: [f32; 3] = [3.140_625, 9.675_026e-4, 1.509_957_9e-7];
/// `sin(r) / r` as a polynomial of `r^2` through its values at Chebyshev nodes of `[-pi/2, pi/2]`, with an error of at
/// most 1.3e-8.
const SINE: [f32; 5] = [1.0, -0.166_666_58, 8.333_05e-3, -1.980_901_7e-4, 2.605_107_7e-6];
/// Adding and then subtracting this rounds to the nearest integer, whose parity is the last bit of the sum.
const ROUND: f32 = 12_582_912.0;

/// `sin(x + shift * pi)` for `shift` 0 or one half, where `|x|` is at most [`LARGE`].
#[inline(always)]
fn shifted_sine(x: f32, shift: f32) -> f32 {
    let rounded = x * std::f32::consts::FRAC_1_PI + shift + ROUND;
    let k = rounded - ROUND - shift;
    let r = ((x - k * PI[0]) - k * PI[1]) - k * PI[2];
    let u = r * r;
    let value = r * (SINE[0] + u * (SINE[1] + u * (SINE[2] + u * (SINE[3] + u * SINE[4]))));
    f32::from_bits(value.to_bits() ^ rounded.to_bits() << 31)
}

fn is_small(values: &[f32], bias: &[f32], omega: f32) -> bool {
    let largest = |values: &[f32]| values.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    // NaN is ignored here and gives NaN either way
    (largest(values) + largest(bias)) * omega.abs() <= LARGE
}

/// Returns the number of rows per task.
fn rows(width: usize) -> usize {
    (TASK / width.max(1)).max(1)
}

/// Writes `sin(omega (x + bias))` of `x` `[N, W]` with `bias` `[W]` to `out` `[N, W]`.
///
/// # Panics
/// If a slice does not fit.
pub fn forward(x: &[f32], bias: &[f32], omega: f32, out: &mut [f32]) {
    check(x.len(), bias.len());
    assert_eq!(out.len(), x.len(), "out: [N, W]");
    let task = rows(bias.len()) * bias.len();
    out.par_chunks_mut(task).zip(x.par_chunks(task)).for_each(|(out, x)| {
        if is_small(x, bias, omega) {
            wide!(sines(x, bias, omega, out, |v| shifted_sine(v, 0.0)));
        } else {
            sines(x, bias, omega, out, f32::sin);
        }
    });
}

/// Plain loops, which the compiler turns into vector instructions if `sine` has no calls.
#[inline(always)]
fn sines(x: &[f32], bias: &[f32], omega: f32, out: &mut [f32], sine: impl Fn(f32) -> f32) {
    let width = bias.len();
    for (out, x) in out.chunks_exact_mut(width).zip(x.chunks_exact(width)) {
        let (x, bias) = (&x[..out.len()], &bias[..out.len()]);
        for i in 0..out.len() {
            out[i] = sine(omega * (x[i] + bias[i]));
        }
    }
}

/// Computes the gradients of [`forward`] for `grad` `[N, W]`: with respect to `x` into `grad_x` `[N, W]`, with respect
/// to the biases into `grad_bias` `[W]`.
///
/// # Panics
/// If a slice does not fit.
pub fn backward(x: &[f32], bias: &[f32], omega: f32, grad: &[f32], grad_x: &mut [f32], grad_bias: &mut [f32]) {
    check(x.len(), bias.len());
    assert_eq!([grad.len(), grad_x.len()], [x.len(); 2], "grad: [N, W]");
    assert_eq!(grad_bias.len(), bias.len(), "grad_bias: [W]");
    let width = bias.len();
    let task = rows(width) * width;
    let parts: Vec<Vec<f32>> = grad_x
        .par_chunks_mut(task)
        .zip(x.par_chunks(task))
        .zip(grad.par_chunks(task))
        .map(|((grad_x, x), grad)| {
            let mut sums = vec![0.0; width];
            if is_small(x, bias, omega) {
                wide!(slopes((x, bias, omega), grad, grad_x, &mut sums, |v| shifted_sine(v, 0.5)));
            } else {
                slopes((x, bias, omega), grad, grad_x, &mut sums, f32::cos);
            }
            sums
        })
        .collect();
    grad_bias.fill(0.0);
    for part in parts {
        grad_bias.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
    }
}

/// As [`sines`]; adds the gradients of the biases to `sums`.
#[inline(always)]
fn slopes(
    (x, bias, omega): (&[f32], &[f32], f32),
    grad: &[f32],
    grad_x: &mut [f32],
    sums: &mut [f32],
    cosine: impl Fn(f32) -> f32,
) {
    let width = bias.len();
    let rows = x.chunks_exact(width).zip(grad.chunks_exact(width));
    for ((x, grad), grad_x) in rows.zip(grad_x.chunks_exact_mut(width)) {
        let n = grad_x.len();
        let (x, grad, bias, sums) = (&x[..n], &grad[..n], &bias[..n], &mut sums[..n]);
        for i in 0..n {
            grad_x[i] = grad[i] * (omega * cosine(omega * (x[i] + bias[i])));
            sums[i] += grad_x[i];
        }
    }
}

fn check(values: usize, width: usize) {
    assert!(width > 0 && values.is_multiple_of(width), "x: [N, W] with W biases");
}
