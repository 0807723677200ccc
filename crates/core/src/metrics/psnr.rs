//! Peak signal-to-noise ratio, and the size checks shared by the image metrics.

use super::metric::{Better, Metric, MetricDisplay, MetricFailure, MetricInput, Networks};

/// Why a metric cannot be computed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MetricError {
    /// The two images differ in size, or their number of values does not match the size.
    #[error("the images hold {a} and {b} values but {expected} are expected; render both at the same size")]
    Size {
        /// Values in the first image.
        a: usize,
        /// Values in the second image.
        b: usize,
        /// `width * height * 3`, or the length of the first image.
        expected: usize,
    },
    /// The image is too small for the window of the metric.
    #[error("an image of {width}x{height} pixels is smaller than the {window}x{window} window")]
    TooSmall {
        /// Pixels in a row.
        width: usize,
        /// Rows.
        height: usize,
        /// Side length of the window in pixels.
        window: usize,
    },
}

/// Peak signal-to-noise ratio in dB of two images `[H, W, 3]` with values in [0, 1]:
/// `-10 log10(mean (a - b)^2)`, in `f64`. Equal images give infinity; a NaN in either gives NaN.
///
/// # Errors
/// [`MetricError::Size`] if the lengths differ or are zero.
///
/// ```
/// let decibels = volseggs_core::metrics::psnr::psnr(&[0.0; 12], &[0.1; 12])?;
/// assert!((decibels - 20.0).abs() < 1e-5);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn psnr(a: &[f32], b: &[f32]) -> Result<f64, MetricError> {
    if a.len() != b.len() || a.is_empty() {
        return Err(MetricError::Size { a: a.len(), b: b.len(), expected: a.len().max(3) });
    }
    let squared = |(x, y): (&f32, &f32)| (f64::from(*x) - f64::from(*y)).powi(2);
    let sum: f64 = a.iter().zip(b).map(squared).sum();
    Ok(-10.0 * (sum / a.len() as f64).log10())
}

/// `value` rounded to 8 bits and back, as an image file would.
pub fn to_8_bits(value: f32) -> f32 {
    (value.clamp(0.0, 1.0) * 255.0).round() / 255.0
}

/// [`psnr`] of two 8-bit images as values in [0, 1], never infinite: equal images count as if one of their values
/// differed by one step of 255. Otherwise a view that shows nothing, drawn as nothing, would make the mean over all
/// views infinite.
///
/// # Errors
/// As [`psnr`].
pub fn psnr_of_pictures(a: &[f32], b: &[f32]) -> Result<f64, MetricError> {
    let most = max_psnr_of_pictures(a.len());
    // NaN is kept
    psnr(a, b).map(|value| if value > most { most } else { value })
}

/// The PSNR in dB assigned to equal 8-bit images of `values` values.
pub fn max_psnr_of_pictures(values: usize) -> f64 {
    20.0 * 255f64.log10() + 10.0 * (values as f64).log10()
}

/// PSNR in decibels, over all pixels and channels of the 8-bit render; finite, see [`psnr_of_pictures`].
pub(super) struct Psnr;

impl Metric for Psnr {
    fn value(&self, view: &MetricInput<'_>) -> Result<Option<f64>, MetricFailure> {
        Ok(Some(psnr_of_pictures(view.render, view.truth)?))
    }

    fn display(&self) -> Option<MetricDisplay> {
        let display = MetricDisplay::new("PSNR, dB", "PSNR", 2, Better::Higher);
        Some(MetricDisplay { unit: "dB", by_default: true, ..display })
    }

    fn note(&self, values: &[f64], pixels: usize, _networks: &Networks) -> Option<String> {
        let most = max_psnr_of_pictures(3 * pixels);
        let (all, equal) = (values.len(), values.iter().filter(|v| **v >= most).count());
        (equal > 0).then(|| {
            format!(
                "{equal} of {all} renders equal the ground truth; their PSNR is that of one value off by one step of 255"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::ssim::tests::images;

    #[test]
    fn equal_pictures_have_the_psnr_of_one_differing_value() {
        let a = [0.2f32, 0.4, 0.6, 0.8, 1.0, 0.0].map(|v| (v * 255.0).round() / 255.0);
        let mut b = a;
        b[3] -= 1.0 / 255.0;
        let (equal, nearly) = (psnr_of_pictures(&a, &a).unwrap(), psnr_of_pictures(&a, &b).unwrap());
        assert!(equal.is_finite() && (equal - nearly).abs() < 1e-4, "{equal} {nearly}");
        b[0] = f32::NAN;
        assert!(psnr_of_pictures(&a, &b).unwrap().is_nan());
    }

    #[test]
    fn agrees_with_scikit_image() {
        // skimage.metrics.peak_signal_noise_ratio(a, b, data_range=1), scikit-image 0.26.0, on the images described at
        // `images`
        let (a, b) = images();
        assert!((psnr(&a, &b).unwrap() - 29.097_538_940_181_252).abs() < 1e-10);
    }

    #[test]
    fn edge_cases() {
        let a = [0.5; 12];
        assert_eq!(psnr(&a, &a).unwrap(), f64::INFINITY);
        assert!((psnr(&[0.0; 3], &[1.0; 3]).unwrap()).abs() < 1e-12);
        let mut poisoned = a;
        poisoned[5] = f32::NAN;
        assert!(psnr(&a, &poisoned).unwrap().is_nan());
        assert!(psnr(&a, &a[..9]).is_err());
        assert!(psnr(&[], &[]).is_err());
    }
}
