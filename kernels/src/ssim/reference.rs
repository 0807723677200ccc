//! SSIM as plain f64 loops over the full 2D window: the oracle of the fast kernel, gradient included.

use super::{C1, C2, RADIUS, TAPS, window};

/// Returns the mean SSIM of `a` and `b` `[h, w, 3]` and its gradient with respect to `a`.
pub fn ssim_grad(a: &[f64], b: &[f64], h: usize, w: usize) -> (f64, Vec<f64>) {
    let taps = window();
    let mut total = 0.0;
    let mut grad = vec![0.0; a.len()];
    let count = a.len() as f64;
    // Pixels under the window centred on (y, x), with their weights; those outside count as 0.
    let under = |y: usize, x: usize, channel: usize| {
        let mut pixels = Vec::new();
        for ky in 0..TAPS {
            for kx in 0..TAPS {
                let (py, px) = ((y + ky).wrapping_sub(RADIUS), (x + kx).wrapping_sub(RADIUS));
                if py < h && px < w {
                    pixels.push(((py * w + px) * 3 + channel, taps[ky] * taps[kx]));
                }
            }
        }
        pixels
    };
    for y in 0..h {
        for x in 0..w {
            for channel in 0..3 {
                let pixels = under(y, x, channel);
                let mean =
                    |value: &dyn Fn(usize) -> f64| -> f64 { pixels.iter().map(|&(i, weight)| weight * value(i)).sum() };
                let (ma, mb) = (mean(&|i| a[i]), mean(&|i| b[i]));
                let va = mean(&|i| a[i] * a[i]) - ma * ma;
                let vb = mean(&|i| b[i] * b[i]) - mb * mb;
                let cov = mean(&|i| a[i] * b[i]) - ma * mb;
                let (n1, n2) = (2.0 * ma * mb + C1, 2.0 * cov + C2);
                let (d1, d2) = (ma * ma + mb * mb + C1, va + vb + C2);
                total += n1 * n2 / (d1 * d2);
                for &(i, weight) in &pixels {
                    let (d_ma, d_va, d_cov) = (weight, weight * 2.0 * (a[i] - ma), weight * (b[i] - mb));
                    let numerator = 2.0 * mb * d_ma * n2 + n1 * 2.0 * d_cov;
                    let denominator = 2.0 * ma * d_ma * d2 + d1 * d_va;
                    grad[i] += (numerator - n1 * n2 / (d1 * d2) * denominator) / (d1 * d2) / count;
                }
            }
        }
    }
    (total / count, grad)
}
