//! Curves through the knots of the temporal vectors.
//!
//! The paper's temporal vectors are interpolated linearly, like planes and lines: a moving object then turns sharply at
//! every knot and moves straight in between. A cubic curve has no corners; this one is that of Catmull and Rom, which
//! passes through its knots and depends on four of them at a time.

use crate::config::types::TimeCurve;
use burn::tensor::{Device, Tensor, TensorData};

/// Weights `[knots]` of the knots at `time` in [0, 1], which spans them all.
pub fn weights(curve: TimeCurve, knots: usize, time: f32) -> Vec<f32> {
    match curve {
        TimeCurve::Linear => linear_weights(knots, time),
        TimeCurve::Cubic => cubic_weights(knots, time),
    }
}

/// Locates `time`: the knot before it (never the last one) and the position after that knot, in [0, 1].
fn place(knots: usize, time: f32) -> (usize, f32) {
    let last = (knots - 1) as f32;
    let place = (time * last).clamp(0.0, last);
    let from = (place as usize).min(knots - 2);
    (from, place - from as f32)
}

/// Weights of a straight line between two knots.
fn linear_weights(knots: usize, time: f32) -> Vec<f32> {
    if knots < 2 {
        return vec![1.0; knots];
    }
    let (mut weights, (from, u)) = (vec![0.0; knots], place(knots, time));
    (weights[from], weights[from + 1]) = (1.0 - u, u);
    weights
}

/// Weights of a Catmull-Rom curve. They sum to one, are one at a knot, and reproduce functions linear in time; between
/// inner knots quadratic ones, too.
fn cubic_weights(knots: usize, time: f32) -> Vec<f32> {
    if knots < 2 {
        return vec![1.0; knots];
    }
    let (mut weights, last, (from, u)) = (vec![0.0; knots], knots - 1, place(knots, time));
    let [square, cube] = [u * u, u * u * u];
    let around = [
        0.5 * (2.0 * square - cube - u),
        0.5 * (3.0 * cube - 5.0 * square) + 1.0,
        0.5 * (4.0 * square - 3.0 * cube + u),
        0.5 * (cube - square),
    ];
    for (k, weight) in around.into_iter().enumerate() {
        // the first of the four is one before `from`
        match from + k {
            // beyond an end the curve continues straight: twice the last knot minus the one before
            0 => {
                weights[0] += 2.0 * weight;
                weights[1] -= weight;
            }
            k if k > knots => {
                weights[last] += 2.0 * weight;
                weights[last - 1] -= weight;
            }
            k => weights[k - 1] += weight,
        }
    }
    weights
}

/// The temporal vectors `[levels * R]` at `time` on a cubic curve through those at the knots, flat
/// `[levels, knots, R]`.
pub(super) fn cubic(times: Tensor<1>, levels: usize, knots: usize, time: f32, device: &Device) -> Tensor<1> {
    let channels = times.dims()[0] / (levels * knots);
    let weights = Tensor::<3>::from_data(TensorData::new(cubic_weights(knots, time), [1, knots, 1]), device);
    (times.reshape([levels, knots, channels]) * weights).sum_dim(1).reshape([levels * channels])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn curve(values: &[f32], time: f32) -> f32 {
        cubic_weights(values.len(), time).iter().zip(values).map(|(w, v)| w * v).sum()
    }

    #[test]
    fn the_curve_goes_through_its_knots() {
        let values = [0.3, -1.0, 2.0, 0.5, 7.0];
        for (k, value) in values.iter().enumerate() {
            assert!((curve(&values, k as f32 / 4.0) - value).abs() < 1e-5, "{k}");
        }
        assert_eq!((cubic_weights(1, 0.3), curve(&[2.0, 4.0], 0.25)), (vec![1.0], 2.5));
        assert_eq!([curve(&values, -1.0), curve(&values, 2.0)], [0.3, 7.0], "times beyond the ends are the ends");
    }

    #[test]
    fn straight_lines_have_two_knots() {
        assert_eq!(weights(TimeCurve::Linear, 5, 0.3125), [0.0, 0.75, 0.25, 0.0, 0.0]);
        assert_eq!(weights(TimeCurve::Linear, 3, 1.0), [0.0, 0.0, 1.0]);
        assert_eq!(weights(TimeCurve::Linear, 1, 0.4), [1.0]);
    }

    #[test]
    fn quadratics_come_back_between_inner_knots_and_there_are_no_corners() {
        let values: Vec<f32> = (0..9).map(|k| (k * k) as f32).collect();
        for step in 10..=70 {
            let place = step as f32 / 10.0;
            assert!((curve(&values, place / 8.0) - place * place).abs() < 1e-3, "{place}");
        }
        let wild = [0.0, 3.0, -2.0, 5.0, 1.0];
        let slope = |time: f32, h: f32| (curve(&wild, time + h) - curve(&wild, time)) / h;
        for knot in [0.25, 0.5, 0.75] {
            let (before, after) = (slope(knot, -1e-4), slope(knot, 1e-4));
            assert!((before - after).abs() < 0.5, "{knot}: {before} {after}, of some 20");
        }
    }

    proptest! {
        #[test]
        fn weights_sum_to_one_and_give_back_what_is_linear(knots in 2usize..40, time in -0.5f32..1.5) {
            let weights = cubic_weights(knots, time);
            prop_assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-5);
            let line: Vec<f32> = (0..knots).map(|k| 3.0 - 0.5 * k as f32).collect();
            let place = time.clamp(0.0, 1.0) * (knots - 1) as f32;
            prop_assert!((curve(&line, time) - (3.0 - 0.5 * place)).abs() < 1e-3);
            prop_assert!(weights.iter().filter(|w| **w != 0.0).count() <= 4);
        }
    }
}
