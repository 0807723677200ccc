//! Where the error lies: at edges of the ground-truth images, inside what is shown, or outside it.
//!
//! A pixel is *strong* where the ground-truth image or its alpha changes by more than [`STRONG`] per pixel. The change
//! is the length of the vector of central differences along both axes, with the border repeated, in the channel (red,
//! green, blue over the background, alpha) where it is largest. *Edge* pixels are at most [`REACH`] rows and columns
//! from a strong one; *interior* pixels are the others that are covered at all (alpha above 0); *outside* pixels are
//! the rest. Both constants are fixed, so that figures of different scenes and sizes are comparable.

use serde::{Deserialize, Serialize};

/// Change per pixel that an edge exceeds, in units of the range [0, 1]: that of a step of a fifth.
pub const STRONG: f32 = 0.1;
/// How many rows and columns an edge extends beyond strong pixels.
pub const REACH: usize = 1;

/// Error of the pixels of one region, over all views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ErrorRegion {
    /// Their fraction of all pixels, in [0, 1].
    pub pixels: f64,
    /// Their fraction of the squared error of all pixels, in [0, 1]; 0 if there is no error at all.
    pub error: f64,
    /// PSNR from their mean squared error over all views, decibels; null if there are no pixels or there is no error.
    pub psnr: Option<f64>,
}

/// Error by region.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ByRegion {
    /// Near strong changes of the ground-truth image or its alpha.
    pub edge: ErrorRegion,
    /// Covered, and not near an edge.
    pub interior: ErrorRegion,
    /// All other pixels.
    pub outside: ErrorRegion,
}

/// Sums over views, for edge, interior and outside.
#[derive(Clone, Copy, Debug, Default)]
pub struct RegionSums {
    squared: [f64; 3],
    pixels: [u64; 3],
}

impl RegionSums {
    /// Adds a view: its render and ground truth `[H, W, 3]` in [0, 1] and the true alpha `[H, W]`.
    pub fn add(&mut self, render: &[f32], truth: &[f32], alpha: &[f32], width: usize) {
        let edge = edges(truth, alpha, width);
        for (i, (r, t)) in render.chunks_exact(3).zip(truth.chunks_exact(3)).enumerate() {
            let region = if edge[i] { 0 } else { usize::from(alpha[i] <= 0.0) + 1 };
            self.pixels[region] += 1;
            self.squared[region] += r.iter().zip(t).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum::<f64>();
        }
    }

    /// Returns fractions and PSNR over all views that were added.
    pub fn finish(&self) -> ByRegion {
        let share = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
        let (pixels, squared) = (self.pixels.iter().sum::<u64>() as f64, self.squared.iter().sum::<f64>());
        let region = |i: usize| {
            let mean = share(self.squared[i], 3.0 * self.pixels[i] as f64);
            ErrorRegion {
                pixels: share(self.pixels[i] as f64, pixels),
                error: share(self.squared[i], squared),
                psnr: (mean > 0.0).then(|| -10.0 * mean.log10()),
            }
        };
        ByRegion { edge: region(0), interior: region(1), outside: region(2) }
    }
}

/// Returns whether each pixel is near a strong one, `[H, W]`.
fn edges(truth: &[f32], alpha: &[f32], width: usize) -> Vec<bool> {
    let height = alpha.len() / width.max(1);
    let channels = |i: usize| [truth[3 * i], truth[3 * i + 1], truth[3 * i + 2], alpha[i]];
    let change = |a: usize, b: usize| -> [f32; 4] {
        let (a, b) = (channels(a), channels(b));
        std::array::from_fn(|c| 0.5 * (b[c] - a[c]))
    };
    let mut near = vec![false; alpha.len()];
    for y in 0..height {
        for x in 0..width {
            let row = y * width;
            let along = change(row + x.saturating_sub(1), row + (x + 1).min(width - 1));
            let across = change(y.saturating_sub(1) * width + x, (y + 1).min(height - 1) * width + x);
            if along.iter().zip(across).any(|(a, b)| a.hypot(b) > STRONG) {
                for ny in y.saturating_sub(REACH)..=(y + REACH).min(height - 1) {
                    near[ny * width + x.saturating_sub(REACH)..=ny * width + (x + REACH).min(width - 1)].fill(true);
                }
            }
        }
    }
    near
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture of 12 x 5 pixels: white and empty on the left, covered and of one colour from column 6 on.
    fn picture(colour: f32) -> (Vec<f32>, Vec<f32>) {
        let covered = |i: usize| i % 12 >= 6;
        let truth = (0..60).flat_map(|i| [if covered(i) { colour } else { 1.0 }; 3]).collect();
        (truth, (0..60).map(|i| f32::from(u8::from(covered(i)))).collect())
    }

    #[test]
    fn regions_depend_only_on_the_ground_truth() {
        let (truth, alpha) = picture(0.2);
        // columns 5 and 6 are strong, 4 to 7 are edge, 8 to 11 interior
        let mut render = truth.clone();
        for y in 0..5 {
            render[3 * (12 * y + 7)] += 0.3; // edge
            render[3 * (12 * y + 9)] += 0.1; // interior
        }
        let mut sums = RegionSums::default();
        sums.add(&render, &truth, &alpha, 12);
        let found = sums.finish();
        let close = |a: f64, b: f64| (a - b).abs() < 1e-6;
        for (region, share) in [(found.edge, 1.0 / 3.0), (found.interior, 1.0 / 3.0), (found.outside, 1.0 / 3.0)] {
            assert!(close(region.pixels, share), "{found:?}");
        }
        assert!(close(found.edge.error, 0.9) && close(found.interior.error, 0.1), "{found:?}");
        // 5 of 60 values are off by 0.3, and 5 of 60 by 0.1
        assert!(close(found.edge.psnr.unwrap(), -10.0 * (0.09f64 / 12.0).log10()), "{found:?}");
        assert!(close(found.interior.psnr.unwrap(), -10.0 * (0.01f64 / 12.0).log10()), "{found:?}");
        assert_eq!((found.outside.error, found.outside.psnr), (0.0, None));
    }

    #[test]
    fn alpha_makes_edges_where_colours_do_not() {
        let (truth, alpha) = picture(1.0);
        assert_eq!(edges(&truth, &alpha, 12).iter().filter(|e| **e).count(), 20);
        let (truth, none) = (picture(1.0).0, vec![0.0; 60]);
        assert!(edges(&truth, &none, 12).iter().all(|e| !e));
        // a change below the threshold makes no edge
        let (truth, alpha) = (picture(0.81).0, vec![1.0; 60]);
        assert!(edges(&truth, &alpha, 12).iter().all(|e| !e));
    }

    #[test]
    fn a_single_pixel_and_no_pictures_are_measured() {
        assert_eq!(RegionSums::default().finish(), ByRegion::default());
        let mut sums = RegionSums::default();
        sums.add(&[0.5; 3], &[1.0; 3], &[0.0], 1);
        assert_eq!((sums.finish().outside.pixels, sums.finish().outside.error), (1.0, 1.0));
    }
}
