//! A metric: PSNR of the foreground. Over the whole image, an empty background counts as well rendered.

use volseggs::extend::{Metric, MetricFailure, MetricInput};

/// PSNR over the pixels inside the true silhouette (alpha above 0), decibels.
pub struct ForegroundPsnr;

impl Metric for ForegroundPsnr {
    fn value(&self, view: &MetricInput<'_>) -> Result<Option<f64>, MetricFailure> {
        let pixels = view.render.chunks_exact(3).zip(view.truth.chunks_exact(3)).zip(view.alpha);
        let (mut sum, mut count) = (0.0, 0);
        for ((render, truth), _) in pixels.filter(|(_, alpha)| **alpha > 0.0) {
            sum += render.iter().zip(truth).map(|(r, t)| f64::from(r - t).powi(2)).sum::<f64>();
            count += 3;
        }
        let psnr = -10.0 * (sum / f64::from(count)).log10();
        // a view without a silhouette, or with one that is exact, does not count
        Ok(psnr.is_finite().then_some(psnr))
    }
}
