//! Structural similarity in the two conventions that papers report.
//!
//! Both take images `[H, W, 3]` with values in [0, 1] and compute in `f64`. Rows are filtered in parallel and summed in
//! row order, so the result is bit-identical for any number of threads.

use rayon::prelude::*;

use super::metric::{Better, Metric, MetricDisplay, MetricFailure, MetricInput};
use super::psnr::MetricError;

const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;
const GAUSSIAN_TAPS: usize = 11;
const GAUSSIAN_SIGMA: f64 = 1.5;
const UNIFORM_TAPS: usize = 7;
/// Weights of red, green and blue in scikit-image's `rgb2gray`.
const GRAY: [f64; 3] = [0.2125, 0.7154, 0.0721];

/// SSIM as computed by 3D Gaussian Splatting: an 11-tap Gaussian window with sigma 1.5 on each channel, zeros beyond
/// the border, population covariance, mean over all pixels and channels.
///
/// scikit-image's `gaussian_weights=True` reflects at the border and drops it from the mean; the
/// two agree on pixels at least 5 away from the border.
///
/// # Errors
/// [`MetricError::Size`] if an image does not hold `width * height * 3` values.
///
/// ```
/// let image: Vec<f32> = (0..16 * 16 * 3).map(|i| (i % 7) as f32 / 7.0).collect();
/// let same = volseggs_core::metrics::ssim::ssim_rgb(&image, &image, 16, 16)?;
/// assert!((same - 1.0).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn ssim_rgb(a: &[f32], b: &[f32], width: usize, height: usize) -> Result<f64, MetricError> {
    let maps = rgb_maps(a, b, width, height)?;
    let sum: f64 = maps.iter().map(|map| sum_rows(map, width)).sum();
    Ok(sum / (width * height * 3) as f64)
}

/// SSIM of the grey images as computed by default by scikit-image's `structural_similarity`: `rgb2gray`, 7x7 uniform
/// window, `data_range=1`, sample covariance, mean over the pixels at least 3 away from the border.
///
/// # Errors
/// [`MetricError::Size`] as for [`ssim_rgb`]; [`MetricError::TooSmall`] below 7x7 pixels.
pub fn ssim_gray(a: &[f32], b: &[f32], width: usize, height: usize) -> Result<f64, MetricError> {
    check(a, b, width, height)?;
    if width < UNIFORM_TAPS || height < UNIFORM_TAPS {
        return Err(MetricError::TooSmall { width, height, window: UNIFORM_TAPS });
    }
    let gray = |image: &[f32]| -> Vec<f64> {
        let weigh = |p: &[f32]| (0..3).map(|c| f64::from(p[c]) * GRAY[c]).sum();
        image.chunks_exact(3).map(weigh).collect()
    };
    let taps = [1.0 / UNIFORM_TAPS as f64; UNIFORM_TAPS];
    let count = (UNIFORM_TAPS * UNIFORM_TAPS) as f64;
    let map = ssim_map(&gray(a), &gray(b), width, &taps, count / (count - 1.0));
    let (rows, columns) = (height - UNIFORM_TAPS + 1, width - UNIFORM_TAPS + 1);
    let edge = UNIFORM_TAPS / 2;
    let inner = |row: &[f64]| row[edge..edge + columns].iter().sum::<f64>();
    let sum: f64 = map.chunks_exact(width).skip(edge).take(rows).map(inner).sum();
    Ok(sum / (rows * columns) as f64)
}

/// SSIM of a view: [`ssim_gray`] or [`ssim_rgb`].
pub(super) struct Ssim {
    /// Whether it is that of grey values.
    pub(super) of_gray: bool,
}

impl Metric for Ssim {
    fn value(&self, view: &MetricInput<'_>) -> Result<Option<f64>, MetricFailure> {
        let ssim = if self.of_gray { ssim_gray } else { ssim_rgb };
        Ok(Some(ssim(view.render, view.truth, view.width, view.height)?))
    }

    fn display(&self) -> Option<MetricDisplay> {
        let (head, note) = if self.of_gray { ("SSIM (grey)", "grey, 7x7") } else { ("SSIM", "RGB, Gaussian window") };
        Some(MetricDisplay { note, by_default: !self.of_gray, ..MetricDisplay::new(head, "SSIM", 4, Better::Higher) })
    }
}

fn check(a: &[f32], b: &[f32], width: usize, height: usize) -> Result<(), MetricError> {
    let expected = width.saturating_mul(height).saturating_mul(3);
    if expected == 0 || a.len() != expected || b.len() != expected {
        return Err(MetricError::Size { a: a.len(), b: b.len(), expected });
    }
    Ok(())
}

/// The SSIM map `[H, W]` of each channel.
fn rgb_maps(a: &[f32], b: &[f32], width: usize, height: usize) -> Result<[Vec<f64>; 3], MetricError> {
    check(a, b, width, height)?;
    let mut taps = [0.0; GAUSSIAN_TAPS];
    for (i, tap) in taps.iter_mut().enumerate() {
        let x = i as f64 - (GAUSSIAN_TAPS / 2) as f64;
        *tap = (-x * x / (2.0 * GAUSSIAN_SIGMA * GAUSSIAN_SIGMA)).exp();
    }
    let total: f64 = taps.iter().sum();
    taps.iter_mut().for_each(|tap| *tap /= total);
    let plane =
        |image: &[f32], c: usize| -> Vec<f64> { image.iter().skip(c).step_by(3).map(|v| f64::from(*v)).collect() };
    Ok([0, 1, 2].map(|c| ssim_map(&plane(a, c), &plane(b, c), width, &taps, 1.0)))
}

fn sum_rows(map: &[f64], width: usize) -> f64 {
    map.chunks_exact(width).map(|row| row.iter().sum::<f64>()).sum()
}

/// SSIM at each pixel of two planes `[H, W]` under the separable window `taps`, with zeros beyond
/// the border; `norm` scales the covariances.
fn ssim_map(a: &[f64], b: &[f64], width: usize, taps: &[f64], norm: f64) -> Vec<f64> {
    let product = |x: &[f64], y: &[f64]| -> Vec<f64> { x.iter().zip(y).map(|(x, y)| x * y).collect() };
    let [ma, mb] = [a, b].map(|plane| filter(plane, width, taps));
    let [aa, bb, ab] = [(a, a), (b, b), (a, b)].map(|(x, y)| filter(&product(x, y), width, taps));
    (0..a.len())
        .map(|i| {
            let (m1, m2) = (ma[i], mb[i]);
            let v1 = norm * (aa[i] - m1 * m1);
            let v2 = norm * (bb[i] - m2 * m2);
            let v12 = norm * (ab[i] - m1 * m2);
            (2.0 * m1 * m2 + C1) * (2.0 * v12 + C2) / ((m1 * m1 + m2 * m2 + C1) * (v1 + v2 + C2))
        })
        .collect()
}

fn filter(plane: &[f64], width: usize, taps: &[f64]) -> Vec<f64> {
    let half = taps.len() / 2;
    let height = plane.len() / width;
    let mut across = vec![0.0; plane.len()];
    across.par_chunks_mut(width).zip(plane.par_chunks(width)).for_each(|(out, row)| {
        for (x, value) in out.iter_mut().enumerate() {
            let (from, to) = (x.saturating_sub(half), (x + half + 1).min(width));
            let weights = &taps[from + half - x..];
            *value = row[from..to].iter().zip(weights).map(|(v, w)| v * w).sum();
        }
    });
    let mut out = vec![0.0; plane.len()];
    out.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        let (from, to) = (y.saturating_sub(half), (y + half + 1).min(height));
        for row in from..to {
            let weight = taps[row + half - y];
            let source = &across[row * width..][..width];
            out.iter_mut().zip(source).for_each(|(o, v)| *o += weight * v);
        }
    });
    out
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    const W: usize = 37;
    const H: usize = 29;

    /// Two images of 37x29 pixels. At row y, column x, channel c, in integers:
    /// `A = (x*x + 2*y*y + 17*c*x + 5*y) mod 251` and
    /// `B = clamp(A + (7*x + 3*y + 5*c) mod 31 - 15, 0, 250)`; the value is `A / 250` in `f32`.
    pub(crate) fn images() -> (Vec<f32>, Vec<f32>) {
        let (mut a, mut b) = (Vec::new(), Vec::new());
        for y in 0..H {
            for x in 0..W {
                for c in 0..3 {
                    let first = ((x * x + 2 * y * y + 17 * c * x + 5 * y) % 251) as i32;
                    let second = first + ((7 * x + 3 * y + 5 * c) % 31) as i32 - 15;
                    a.push(first as f32 / 250.0);
                    b.push(second.clamp(0, 250) as f32 / 250.0);
                }
            }
        }
        (a, b)
    }

    #[test]
    fn gray_agrees_with_scikit_image() {
        // structural_similarity(rgb2gray(a), rgb2gray(b), data_range=1) in float64, scikit-image 0.26.0
        let (a, b) = images();
        let value = ssim_gray(&a, &b, W, H).unwrap();
        assert!((value - 0.991_503_213_269_444_4).abs() < 1e-10, "{value}");
    }

    #[test]
    fn rgb_agrees_with_scikit_image_inside_and_with_numpy_at_the_border() {
        let (a, b) = images();
        // structural_similarity(a, b, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, channel_axis=2,
        // data_range=1, full=True), mean of the map over [5:-5, 5:-5], scikit-image 0.26.0. Its border reflects, so
        // only the inside agrees
        let mut sum = 0.0;
        for map in rgb_maps(&a, &b, W, H).unwrap() {
            for row in map.chunks_exact(W).skip(5).take(H - 10) {
                sum += row[5..W - 5].iter().sum::<f64>();
            }
        }
        let inside = sum / ((W - 10) * (H - 10) * 3) as f64;
        assert!((inside - 0.992_553_356_170_349_7).abs() < 1e-10, "{inside}");
        // the same formula with np.pad(..., 5) zeros around every filtered plane, mean over everything, numpy 2.4.6
        let value = ssim_rgb(&a, &b, W, H).unwrap();
        assert!((value - 0.992_724_773_996_961_1).abs() < 1e-10, "{value}");
    }

    #[test]
    fn edge_cases() {
        let (a, mut b) = images();
        assert!((ssim_rgb(&a, &a, W, H).unwrap() - 1.0).abs() < 1e-12);
        assert!((ssim_gray(&a, &a, W, H).unwrap() - 1.0).abs() < 1e-12);
        b[1000] = f32::NAN;
        assert!(ssim_rgb(&a, &b, W, H).unwrap().is_nan());
        assert!(ssim_gray(&a, &b, W, H).unwrap().is_nan());
        assert!(ssim_rgb(&a, &b, W, H + 1).is_err());
        assert!(ssim_rgb(&[], &[], 0, 0).is_err());
        assert!(ssim_rgb(&[0.5; 3], &[0.5; 3], 1, 1).is_ok());
        let small = [0.5; 6 * 9 * 3];
        assert!(matches!(ssim_gray(&small, &small, 6, 9), Err(MetricError::TooSmall { .. })));
    }

    #[test]
    fn the_thread_count_does_not_change_a_bit() {
        let (a, b) = images();
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.unwrap().install(|| ssim_rgb(&a, &b, W, H).unwrap().to_bits())
        };
        assert_eq!(on(1), on(3));
    }
}
