//! Total variation and one-prior of the flat field tensors, loss and gradient in one pass.
//! Each task owns the gradient of a few rows and reads their neighbours; losses add up in f64 in row order,
//! so the bits do not depend on the number of threads.

use crate::field::{FieldParams, FieldShape, TensorSpan};
use crate::splat::cpu::lanes::wide;
use rayon::prelude::*;
use std::ops::Range;

/// Elements per task, rounded to whole rows.
const TASK: usize = 16_384;
/// Elements summed in f32 before they are added to the f64 sum.
const FLUSH: usize = 256;
const LANES: usize = 8;

/// Which differences are penalised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TvKind {
    /// Squared first differences: along both axes of a plane, along a line, along time (paper eq. 6).
    First,
    /// Squared second differences along the slow axis of a plane, along a line, along time.
    Second,
}

/// Reduction of the squared differences of each tensor (of a plane: along each of its axes separately).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DifferenceReduction {
    /// Their mean.
    Mean,
    /// Their sum (paper eq. 6).
    Sum,
}

impl DifferenceReduction {
    /// Returns the factor of each of `count` squared differences in a penalty of weight `weight`; 0 if there are none.
    fn factor(self, weight: f32, count: usize) -> f32 {
        match (self, count) {
            (_, 0) => 0.0,
            (Self::Mean, count) => weight / count as f32,
            (Self::Sum, _) => weight,
        }
    }
}

/// Factors of the penalty terms. A term whose weight is 0 does not affect the loss or the gradient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TvWeights {
    /// Differences in planes and lines.
    pub space: f32,
    /// Differences in times.
    pub time: f32,
    /// Mean |1 - g| of every plane and line tensor.
    pub one_prior_space: f32,
    /// Mean |1 - g| of every time tensor.
    pub one_prior_time: f32,
    /// Whether differences contribute their mean or their sum; |1 - g| always contributes its mean.
    pub reduction: DifferenceReduction,
}

impl TvWeights {
    /// Returns the penalty terms of the planes, the lines and the times.
    pub(super) fn terms(self, kind: TvKind) -> [Terms; 3] {
        let Self { space, time, one_prior_space, one_prior_time, reduction } = self;
        [(space, one_prior_space), (space, one_prior_space), (time, one_prior_time)].map(|(weight, prior)| Terms {
            kind,
            reduction,
            weight,
            prior,
        })
    }
}

/// The penalty terms of the tensors of one buffer.
#[derive(Clone, Copy)]
pub(super) struct Terms {
    kind: TvKind,
    reduction: DifferenceReduction,
    weight: f32,
    prior: f32,
}

impl Terms {
    /// Returns the factors of a tensor `[height, width, channels]`.
    pub(super) fn factors(self, span: &TensorSpan, channels: usize) -> Factors {
        let row = span.width * channels;
        let factor = |count| self.reduction.factor(self.weight, count);
        let (slow, fast) = match self.kind {
            TvKind::First => (factor((span.height - 1) * row), factor(span.height * (span.width - 1) * channels)),
            TvKind::Second => (factor(span.height.saturating_sub(2) * row), 0.0),
        };
        Factors { slow, fast, prior: DifferenceReduction::Mean.factor(self.prior, span.height * row) }
    }
}

/// Weight of one squared difference along each axis, and of one |1 - g|.
#[derive(Clone, Copy)]
pub(super) struct Factors {
    pub(super) slow: f32,
    pub(super) fast: f32,
    pub(super) prior: f32,
}

/// Gradient buffers that [`tv`] adds to; laid out like the parameters.
#[derive(Debug)]
pub struct TvGrads<'a> {
    /// Gradient of the plane buffer.
    pub planes: &'a mut [f32],
    /// Gradient of the line buffer.
    pub lines: &'a mut [f32],
    /// Gradient of the time buffer.
    pub times: &'a mut [f32],
}

/// Returns the weighted penalty and adds its gradient to `grads`. An axis too short for a difference contributes 0. The
/// slope of |1 - g| at g = 1 is taken as 0. Non-finite parameters make the loss non-finite but affect only the gradient
/// of their neighbours.
///
/// # Panics
/// If a slice length does not fit `shape`, or `shape` has an extent of 0.
pub fn tv(params: FieldParams<'_>, shape: &FieldShape, kind: TvKind, weights: TvWeights, grads: TvGrads<'_>) -> f64 {
    if let Err(error) = shape.validate() {
        panic!("{error}");
    }
    let kinds = [
        (shape.plane_spans(), params.planes, grads.planes),
        (shape.line_spans(), params.lines, grads.lines),
        (shape.time_spans(), params.times, grads.times),
    ];
    let expected = [shape.planes_len(), shape.lines_len(), shape.times_len()];
    let mut tasks = Vec::new();
    for (((spans, data, grad), len), terms) in kinds.into_iter().zip(expected).zip(weights.terms(kind)) {
        assert_eq!(data.len(), len, "parameters do not fit the field shape");
        assert_eq!(grad.len(), len, "gradients do not fit the field shape");
        if terms.weight != 0.0 || terms.prior != 0.0 {
            push_tasks(&mut tasks, &spans, shape.channels, terms, data, grad);
        }
    }
    let losses: Vec<f64> = tasks.into_par_iter().with_max_len(1).map(|rows| wide!(rows.run())).collect();
    losses.iter().sum()
}

fn push_tasks<'a>(
    tasks: &mut Vec<TvRows<'a>>,
    spans: &[TensorSpan],
    channels: usize,
    terms: Terms,
    data: &'a [f32],
    mut grad: &'a mut [f32],
) {
    for span in spans {
        let row = span.width * channels;
        let len = span.height * row;
        let data = &data[span.offset..span.offset + len];
        let (own, rest) = grad.split_at_mut(len);
        grad = rest;
        let factors = terms.factors(span, channels);
        let rows = (TASK / row).max(1);
        for (index, grad) in own.chunks_mut(rows * row).enumerate() {
            tasks.push(TvRows { data, first: index * rows, row, channels, kind: terms.kind, factors, grad });
        }
    }
}

/// Some rows of one tensor `[height, width, R]`.
struct TvRows<'a> {
    data: &'a [f32],
    first: usize,
    /// Elements per row, `width * R`.
    row: usize,
    channels: usize,
    kind: TvKind,
    factors: Factors,
    grad: &'a mut [f32],
}

impl TvRows<'_> {
    /// Returns the penalty and adds its gradient.
    #[inline(always)]
    fn run(self) -> f64 {
        let (data, row, r) = (self.data, self.row, self.channels);
        let height = data.len() / row;
        let mut loss = 0.0;
        for (y, grad) in (self.first..).zip(self.grad.chunks_exact_mut(row)) {
            // a missing neighbour is replaced by the nearest existing row
            let line = |y: usize| &data[y.min(height - 1) * row..][..row];
            let (up, cur, down) = (line(y.saturating_sub(1)), line(y), line(y + 1));
            match self.kind {
                TvKind::First => {
                    let rows = [up, cur, down];
                    // the first and last node stand in for the neighbour that they lack on one side
                    if row == r {
                        loss += first(rows, 0..r, [0, 0], self.factors, grad);
                    } else {
                        let last = row - r;
                        loss += first(rows, 0..r, [0, r], self.factors, grad);
                        loss += first(rows, r..last, [0, 2 * r], self.factors, grad);
                        loss += first(rows, last..row, [last - r, last], self.factors, grad);
                    }
                }
                TvKind::Second => {
                    let valid = |ok: bool| if ok { 1.0 } else { 0.0 };
                    let masks = [valid(y >= 2), valid(y >= 1 && y + 1 < height), valid(y + 2 < height)];
                    let near = [up, down, line(y.saturating_sub(2)), line(y + 2)];
                    loss += second(cur, near, masks, self.factors, grad);
                }
            }
        }
        loss
    }
}

/// Returns the loss and gradient of |1 - g| with factor `prior`.
#[inline(always)]
fn one_prior(value: f32, prior: f32) -> (f32, f32) {
    let over = value - 1.0;
    let slope = if over > 0.0 { prior } else { -prior };
    (over.abs() * prior, if over == 0.0 { 0.0 } else { slope })
}

/// Accumulates first differences in `part` of the middle one of three rows; its left and right neighbours start at
/// `beside`. The loss counts the differences to below and right.
#[inline(always)]
fn first(
    [up, cur, down]: [&[f32]; 3],
    part: Range<usize>,
    beside: [usize; 2],
    factors: Factors,
    grad: &mut [f32],
) -> f64 {
    let Factors { slow, fast, prior } = factors;
    let near =
        [&up[part.clone()], &down[part.clone()], &cur[beside[0]..][..part.len()], &cur[beside[1]..][..part.len()]];
    let (cur, grad) = (&cur[part.clone()], &mut grad[part]);
    accumulate(cur, near, grad, |cur, [up, down, left, right]| {
        let (below, beside) = (down - cur, right - cur);
        let (loss, slope) = one_prior(cur, prior);
        let slow_slope = 2.0 * slow * ((cur - up) - below);
        let fast_slope = 2.0 * fast * ((cur - left) - beside);
        (slow * (below * below) + fast * (beside * beside) + loss, slow_slope + fast_slope + slope)
    })
}

/// Accumulates second differences along the slow axis with `near` = up, down, two up, two down. `masks` tell which of
/// the differences centred above, here and below exist. The loss counts the one centred here.
#[inline(always)]
fn second(cur: &[f32], near: [&[f32]; 4], masks: [f32; 3], factors: Factors, grad: &mut [f32]) -> f64 {
    let Factors { slow, prior, .. } = factors;
    accumulate(cur, near, grad, |cur, [up, down, up2, down2]| {
        let above = masks[0] * ((up2 - up) - (up - cur));
        let here = masks[1] * ((up - cur) - (cur - down));
        let below = masks[2] * ((cur - down) - (down - down2));
        let (loss, slope) = one_prior(cur, prior);
        (slow * (here * here) + loss, 2.0 * slow * (above - 2.0 * here + below) + slope)
    })
}

/// Applies `term` (loss, gradient) to every element; returns the summed loss and adds the gradient.
#[inline(always)]
fn accumulate(cur: &[f32], near: [&[f32]; 4], grad: &mut [f32], term: impl Fn(f32, [f32; 4]) -> (f32, f32)) -> f64 {
    let len = cur.len();
    let [up, down, third, fourth] = near;
    let (up, down) = (&up[..len], &down[..len]);
    let (third, fourth) = (&third[..len], &fourth[..len]);
    let grad = &mut grad[..len];
    let mut loss = 0.0;
    let mut from = 0;
    while from < len {
        let to = (from + FLUSH).min(len);
        let whole = from + (to - from) / LANES * LANES;
        let mut sums = [0.0f32; LANES];
        for at in (from..whole).step_by(LANES) {
            for lane in 0..LANES {
                let i = at + lane;
                let (l, g) = term(cur[i], [up[i], down[i], third[i], fourth[i]]);
                sums[lane] += l;
                grad[i] += g;
            }
        }
        for i in whole..to {
            let (l, g) = term(cur[i], [up[i], down[i], third[i], fourth[i]]);
            sums[0] += l;
            grad[i] += g;
        }
        loss += f64::from(sums.iter().sum::<f32>());
        from = to;
    }
    loss
}
