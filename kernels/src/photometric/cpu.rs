//! The fast pass over f32 images. Tasks are fixed pieces of the image and their sums are added in order, so the bits do
//! not depend on the number of threads.

use super::Distance;
use crate::splat::cpu::lanes::wide;
use rayon::prelude::*;

/// Values per task, a whole number of pixels.
const PIECE: usize = 4 * 8192;
/// Sums that run in parallel: four pixels of four channels.
const LANES: usize = 16;

/// Returns the mean over pixels and colours of the distance between `image` and `target` `[pixels, 4]`, plus `alpha`
/// times that of the fourth channel; and the mean squared difference of the colours, whatever the distance. Writes the
/// gradient with respect to `image` to `grad`.
///
/// An empty image gives zeros; non-finite values give NaN or infinity.
///
/// # Panics
/// If the lengths differ or are not a whole number of pixels.
pub fn photometric(image: &[f32], target: &[f32], kind: Distance, alpha: f32, grad: &mut [f32]) -> (f64, f64) {
    assert!(image.len().is_multiple_of(4), "image: [pixels, 4]");
    assert_eq!(target.len(), image.len(), "target: as many values as image");
    assert_eq!(grad.len(), image.len(), "grad: as many values as image");
    if image.is_empty() {
        return (0.0, 0.0);
    }
    let pixels = image.len() as f64 / 4.0;
    let weights = [1.0 / (3.0 * pixels), 1.0 / (3.0 * pixels), 1.0 / (3.0 * pixels), f64::from(alpha) / pixels];
    let slopes: [f32; LANES] = std::array::from_fn(|i| weights[i % 4] as f32);
    let sums: Vec<[[f64; 4]; 2]> = grad
        .par_chunks_mut(PIECE)
        .zip(image.par_chunks(PIECE).zip(target.par_chunks(PIECE)))
        .map(|(grad, (image, target))| {
            wide!(match kind {
                Distance::Absolute => piece::<true>(image, target, &slopes, grad),
                Distance::Squared => piece::<false>(image, target, &slopes, grad),
            })
        })
        .collect();
    let (mut value, mut squared) = (0.0, 0.0);
    for [distance, square] in sums {
        for channel in 0..4 {
            value += weights[channel] * distance[channel];
            squared += if channel < 3 { weights[channel] * square[channel] } else { 0.0 };
        }
    }
    (value, squared)
}

/// Returns the sums of the distances and of the squares, by channel.
#[inline(always)]
fn piece<const ABSOLUTE: bool>(
    image: &[f32],
    target: &[f32],
    slopes: &[f32; LANES],
    grad: &mut [f32],
) -> [[f64; 4]; 2] {
    let (mut distance, mut square) = ([0.0f32; LANES], [0.0f32; LANES]);
    let mut totals = [[0.0f64; 4]; 2];
    // short runs in f32, so that rounding stays small
    const RUN: usize = 64 * LANES;
    for ((image, target), grad) in image.chunks(RUN).zip(target.chunks(RUN)).zip(grad.chunks_mut(RUN)) {
        let whole = image.len() / LANES * LANES;
        for at in (0..whole).step_by(LANES) {
            let (a, b) = (&image[at..at + LANES], &target[at..at + LANES]);
            let out = &mut grad[at..at + LANES];
            for lane in 0..LANES {
                let difference = a[lane] - b[lane];
                square[lane] += difference * difference;
                if ABSOLUTE {
                    distance[lane] += difference.abs();
                    out[lane] = slopes[lane] * sign(difference);
                } else {
                    out[lane] = 2.0 * slopes[lane] * difference;
                }
            }
        }
        for (lane, at) in (whole..image.len()).enumerate() {
            let difference = image[at] - target[at];
            square[lane] += difference * difference;
            distance[lane] += difference.abs();
            grad[at] = slopes[lane] * if ABSOLUTE { sign(difference) } else { 2.0 * difference };
        }
        for lane in 0..LANES {
            let counted = if ABSOLUTE { distance[lane] } else { square[lane] };
            totals[0][lane % 4] += f64::from(counted);
            totals[1][lane % 4] += f64::from(square[lane]);
        }
        (distance, square) = ([0.0; LANES], [0.0; LANES]);
    }
    totals
}

/// Returns -1, 0 or 1; NaN stays NaN.
#[inline(always)]
fn sign(v: f32) -> f32 {
    if v == 0.0 { 0.0 } else { 1.0f32.copysign(v) + v * 0.0 }
}
