//! Total variation and one-prior as plain f64 loops: the oracle of the fast kernel, gradient included.

use super::cpu::{DifferenceReduction, TvKind};
use crate::field::TensorSpan;

/// Returns the penalty of one kind of tensor: `weight` times the mean or sum of the squared differences and `prior`
/// times mean |1 - g| of every tensor in `spans`. Adds the gradient to `grad`.
pub fn tv(
    data: &[f64],
    spans: &[TensorSpan],
    channels: usize,
    kind: TvKind,
    reduction: DifferenceReduction,
    weight: f64,
    prior: f64,
    grad: &mut [f64],
) -> f64 {
    let mut loss = 0.0;
    for span in spans {
        let row = span.width * channels;
        // Stencils as (coefficient, node steps along slow and fast axis).
        let stencils: &[&[(f64, usize, usize)]] = match kind {
            TvKind::First => &[&[(-1.0, 0, 0), (1.0, 1, 0)], &[(-1.0, 0, 0), (1.0, 0, 1)]],
            TvKind::Second => &[&[(1.0, 0, 0), (-2.0, 1, 0), (1.0, 2, 0)]],
        };
        for stencil in stencils {
            let (_, dy, dx) = stencil[stencil.len() - 1];
            let (height, width) = (span.height.saturating_sub(dy), span.width.saturating_sub(dx));
            let count = match reduction {
                DifferenceReduction::Mean => (height * width * channels) as f64,
                DifferenceReduction::Sum => 1.0,
            };
            for y in 0..height {
                for x in 0..width {
                    for r in 0..channels {
                        let at = span.offset + y * row + x * channels + r;
                        let index = |sy: usize, sx: usize| at + sy * row + sx * channels;
                        let difference: f64 = stencil.iter().map(|&(c, sy, sx)| c * data[index(sy, sx)]).sum();
                        loss += weight * difference * difference / count;
                        for &(c, sy, sx) in *stencil {
                            grad[index(sy, sx)] += 2.0 * weight * c * difference / count;
                        }
                    }
                }
            }
        }
        let len = span.height * row;
        for at in span.offset..span.offset + len {
            let over = data[at] - 1.0;
            loss += prior * over.abs() / len as f64;
            if over != 0.0 {
                grad[at] += prior * over.signum() / len as f64;
            }
        }
    }
    loss
}
