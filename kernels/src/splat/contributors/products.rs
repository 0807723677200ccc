//! Products of the weights with features of Gaussians: `W f` to the pixels and `W^T g` back.
//!
//! Sums run in a fixed order, that of the entries, whatever the number of threads.

use super::Contributors;
use crate::splat::cpu::lanes::wide;
use rayon::prelude::*;

/// Pixels summed by one task of [`Contributors::gather`].
const GATHER_ROWS: usize = 64;
/// Approximate number of values of the Gaussians of one task of [`Contributors::scatter`], which keeps them in cache.
const SCATTER_VALUES: usize = 1 << 18;
/// Maximum number of tasks, as each walks all entries.
const SCATTER_TASKS: usize = 32;

impl Contributors {
    /// Computes the features of the pixels, `W f`: `[N, C]` of the Gaussians to `[P, C]`, row-major.
    ///
    /// Pixels without contributors get zeros; weights are not normalised by the pixel's alpha.
    ///
    /// # Panics
    /// If `features` is not a whole number of rows of `channels`, or has no row for a listed Gaussian: errors of the
    /// calling program.
    pub fn gather(&self, features: &[f32], channels: usize) -> Vec<f32> {
        let mut out = vec![0.0f32; self.len() * channels];
        if channels == 0 {
            return out;
        }
        assert_eq!(features.len() % channels, 0, "gather: features are [N, {channels}], got {}", features.len());
        self.check_indices("gather", features.len() / channels);
        out.par_chunks_mut(GATHER_ROWS * channels).enumerate().for_each(|(k, chunk)| {
            wide!(for (p, pixel) in chunk.chunks_exact_mut(channels).enumerate() {
                let (indices, weights) = self.row(k * GATHER_ROWS + p);
                for (&i, &w) in indices.iter().zip(weights) {
                    add_scaled(pixel, &features[i as usize * channels..][..channels], w);
                }
            });
        });
        out
    }

    /// Computes the gradients of the Gaussians' features, `W^T g`: `[P, C]` of the pixels to `[N, C]`, row-major.
    ///
    /// The transpose of [`Self::gather`]; `n` is the number of Gaussians.
    ///
    /// # Panics
    /// If `grads` is not `[P, C]`, or `n` does not exceed every listed Gaussian: errors of the calling program.
    pub fn scatter(&self, grads: &[f32], n: usize, channels: usize) -> Vec<f32> {
        assert_eq!(grads.len(), self.len() * channels, "scatter: grads are [P, C] = [{}, {channels}]", self.len());
        self.check_indices("scatter", n);
        let mut out = vec![0.0f32; n * channels];
        if out.is_empty() {
            return out;
        }
        // each task owns a range of Gaussians and walks all entries in order, so that the order of the additions to a
        // Gaussian does not depend on how the ranges are chosen
        let range = (SCATTER_VALUES / channels).max(n.div_ceil(SCATTER_TASKS)).max(1);
        out.par_chunks_mut(range * channels).enumerate().for_each(|(k, chunk)| {
            let (start, size) = ((k * range) as u32, (chunk.len() / channels) as u32);
            wide!(for (p, grad) in grads.chunks_exact(channels).enumerate() {
                let (indices, weights) = self.row(p);
                for (&i, &w) in indices.iter().zip(weights) {
                    let at = i.wrapping_sub(start);
                    if at < size {
                        add_scaled(&mut chunk[at as usize * channels..][..channels], grad, w);
                    }
                }
            });
        });
        out
    }

    fn check_indices(&self, who: &str, n: usize) {
        if let Some(&largest) = self.indices.par_iter().max() {
            assert!((largest as usize) < n, "{who}: Gaussian {largest} is listed, but there are {n}");
        }
    }
}

/// `sum += w * values`, without fused multiply-add, so that the bits are the same on every machine.
#[inline(always)]
fn add_scaled(sum: &mut [f32], values: &[f32], w: f32) {
    for (s, v) in sum.iter_mut().zip(values) {
        *s += w * v;
    }
}
