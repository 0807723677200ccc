//! Metrics of images.

use crate::registry::Registry;
use std::collections::BTreeMap;

pub(crate) static METRICS: Registry<dyn Metric> = Registry::new("metric", &[]);

/// One view of an evaluation, on the host.
#[derive(Clone, Copy, Debug)]
pub struct MetricInput<'a> {
    /// The rendered image `[H, W, 3]` in [0, 1], row by row from the top, rounded to 8 bits as in an image file.
    pub render: &'a [f32],
    /// The ground-truth image in the same form, over the same background.
    pub truth: &'a [f32],
    /// Alpha of the ground-truth image `[H, W]` in [0, 1].
    pub alpha: &'a [f32],
    /// Width W in pixels.
    pub width: usize,
    /// Height H in pixels.
    pub height: usize,
    /// Background of both images.
    pub background: [f32; 3],
    /// Time of the view in [0, 1].
    pub time: f64,
}

/// A measure of a rendered image, computed by `volseggs eval` for each view and as the mean over views.
pub trait Metric: Send + Sync {
    /// Returns the value for one view; a non-finite value counts as not measured and is excluded from the mean.
    fn value(&self, view: &MetricInput<'_>) -> f64;
}

/// Returns all registered metrics by name, sorted by name.
#[must_use]
pub fn registered() -> Vec<(String, &'static dyn Metric)> {
    METRICS.all()
}

/// Returns the values of one view by name, without non-finite ones.
pub(crate) fn measure(metrics: &[(String, &'static dyn Metric)], view: &MetricInput<'_>) -> BTreeMap<String, f64> {
    let values = metrics.iter().map(|(name, metric)| (name.clone(), metric.value(view)));
    values.filter(|(_, value)| value.is_finite()).collect()
}

/// Returns the mean of each metric over the views that have it.
pub(crate) fn means<'a>(views: impl Iterator<Item = &'a BTreeMap<String, f64>>) -> BTreeMap<String, f64> {
    let mut sums: BTreeMap<String, (f64, usize)> = BTreeMap::new();
    for (name, value) in views.flatten() {
        let (sum, count) = sums.entry(name.clone()).or_default();
        *sum += value;
        *count += 1;
    }
    sums.into_iter().map(|(name, (sum, count))| (name, sum / count as f64)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tenth of the time, if there are any pixels.
    struct Tenth;

    impl Metric for Tenth {
        fn value(&self, view: &MetricInput<'_>) -> f64 {
            if view.alpha.is_empty() { f64::NAN } else { view.time / 10.0 }
        }
    }

    #[test]
    fn non_finite_values_are_skipped() {
        let metrics: Vec<(String, &'static dyn Metric)> = vec![("tenth".into(), &Tenth)];
        let view = |alpha: &[f32], time: f64| {
            let (width, height, background) = (1, alpha.len(), [1.0; 3]);
            measure(&metrics, &MetricInput { render: &[], truth: &[], alpha, width, height, background, time })
        };
        let views = [view(&[1.0], 1.0), view(&[], 0.5), view(&[0.0], 3.0), view(&[0.0], f64::INFINITY)];
        assert_eq!(views.iter().map(BTreeMap::len).collect::<Vec<_>>(), [1, 0, 1, 0]);
        let mean = means(views.iter());
        assert_eq!(mean.len(), 1);
        assert!((mean["tenth"] - 0.2).abs() < 1e-12);
        assert!(means(views[1..2].iter()).is_empty());
    }
}
