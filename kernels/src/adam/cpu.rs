//! Fused Adam step: one pass that checks the gradient, one that updates parameter and moments in place.
//! Elementwise, so the bits do not depend on the number of threads. Keeps no state of its own.

use crate::splat::cpu::lanes::wide;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

/// Elements per task, rounded to whole patterns.
const TASK: usize = 16_384;
const LANES: usize = 8;

/// Learning rate that depends on the position in a row: in SH rows `[K * 3]`, for example, the first 3 values (the base
/// colour) use the full rate and the rest a lower one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LrPattern {
    /// Values per row; at least 1.
    pub row_len: usize,
    /// Number of leading values of a row that use the full rate.
    pub head_len: usize,
    /// Factor on the rate of the remaining values.
    pub tail_factor: f32,
}

/// Settings of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamStep {
    /// Learning rate.
    pub lr: f32,
    /// Decay of the first moment.
    pub beta1: f32,
    /// Decay of the second moment.
    pub beta2: f32,
    /// Added to the square root of the corrected second moment.
    pub eps: f32,
    /// `1 - beta1^t` for the step `t`, counted from 1.
    pub bias_correction1: f32,
    /// `1 - beta2^t`.
    pub bias_correction2: f32,
    /// Rates within a row; `None` for a uniform rate.
    pub lr_pattern: Option<LrPattern>,
}

/// A gradient that would permanently corrupt the moments: NaN, infinite, or so large that its square overflows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("gradient element {index} is not finite (or its square overflows); nothing was updated")]
pub struct NonFiniteGradient {
    /// Index of the first such element of the gradient.
    pub index: usize,
}

/// Runs one Adam step in place: `m = beta1 m + (1 - beta1) g`, `v = beta2 v + (1 - beta2) g^2`,
/// `param -= lr / bias_correction1 * m / (sqrt(v / bias_correction2) + eps)`.
///
/// # Errors
/// [`NonFiniteGradient`] with the first offending element; every buffer is then untouched.
///
/// # Panics
/// If the slices differ in length, or `lr_pattern.row_len` is 0 or does not divide that length.
pub fn adam_step(
    param: &mut [f32],
    grad: &[f32],
    m: &mut [f32],
    v: &mut [f32],
    step: AdamStep,
) -> Result<(), NonFiniteGradient> {
    let len = param.len();
    assert_eq!(grad.len(), len, "grad must be as long as param");
    assert_eq!(m.len(), len, "m must be as long as param");
    assert_eq!(v.len(), len, "v must be as long as param");
    let rates = rates(step);
    let row_len = step.lr_pattern.map_or(1, |pattern| pattern.row_len);
    assert!(len.is_multiple_of(row_len), "param must be whole rows");
    if let Some(index) = first_non_finite(grad) {
        return Err(NonFiniteGradient { index });
    }
    let task = (TASK / rates.len()).max(1) * rates.len();
    param
        .par_chunks_mut(task)
        .zip(grad.par_chunks(task))
        .zip(m.par_chunks_mut(task))
        .zip(v.par_chunks_mut(task))
        .for_each(|(((param, grad), m), v)| {
            wide!(update(param, grad, m, v, &rates, step));
        });
    Ok(())
}

/// Bias-corrected rates of 8 rows (without a pattern, of one long uniform row), so that whole vectors fit.
fn rates(step: AdamStep) -> Vec<f32> {
    let rate = step.lr / step.bias_correction1;
    let Some(pattern) = step.lr_pattern else {
        return vec![rate; 1024];
    };
    assert!(pattern.row_len > 0, "lr_pattern.row_len must be at least 1");
    (0..pattern.row_len * LANES)
        .map(|i| match i % pattern.row_len < pattern.head_len {
            true => rate,
            false => rate * pattern.tail_factor,
        })
        .collect()
}

pub(super) fn first_non_finite(grad: &[f32]) -> Option<usize> {
    grad.par_chunks(TASK)
        .enumerate()
        .filter_map(|(chunk, grad)| {
            if !crate::arch().dispatch(NonFiniteCheck(grad)) {
                return None;
            }
            let at = grad.iter().position(|&g| !(g * g).is_finite());
            at.map(|at| chunk * TASK + at)
        })
        .min()
}

/// Checks whether the square of any value is non-finite.
struct NonFiniteCheck<'a>(&'a [f32]);

impl WithSimd for NonFiniteCheck<'_> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> bool {
        let (blocks, rest) = S::as_simd_f32s(self.0);
        // 0 * x is NaN for NaN and infinity and stays 0 otherwise.
        let zero = simd.splat_f32s(0.0);
        let check = |g| simd.mul_f32s(simd.mul_f32s(g, g), zero);
        let (quads, single) = blocks.as_chunks::<4>();
        let mut sums = [zero; 4];
        for quad in quads {
            for k in 0..4 {
                sums[k] = simd.add_f32s(sums[k], check(quad[k]));
            }
        }
        for &g in single {
            sums[0] = simd.add_f32s(sums[0], check(g));
        }
        let rest: f32 = rest.iter().map(|g| g * g * 0.0).sum();
        let sums = sums.map(|sum| simd.reduce_sum_f32s(sum));
        (sums.iter().sum::<f32>() + rest).is_nan()
    }
}

/// Updates rows of as many elements as there are rates.
#[inline(always)]
fn update(param: &mut [f32], grad: &[f32], m: &mut [f32], v: &mut [f32], rates: &[f32], step: AdamStep) {
    let (keep1, keep2) = (step.beta1, step.beta2);
    let (take1, take2) = (1.0 - keep1, 1.0 - keep2);
    let root = 1.0 / step.bias_correction2.sqrt();
    let rows = rates.len();
    let params = param.chunks_mut(rows).zip(grad.chunks(rows));
    for ((param, grad), (m, v)) in params.zip(m.chunks_mut(rows).zip(v.chunks_mut(rows))) {
        let len = param.len();
        let (grad, m, v, rates) = (&grad[..len], &mut m[..len], &mut v[..len], &rates[..len]);
        for i in 0..len {
            let g = grad[i];
            let first = keep1 * m[i] + take1 * g;
            let second = keep2 * v[i] + take2 * (g * g);
            m[i] = first;
            v[i] = second;
            param[i] -= rates[i] * first / (second.sqrt() * root + step.eps);
        }
    }
}
