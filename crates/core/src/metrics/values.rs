//! Values of metrics by name, as they are measured, averaged and written.

use super::METRICS;
use super::metric::{MetricDisplay, MetricFailure, MetricInput, default_names, display, headline};
use serde::de::Error;
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::Value;
use std::collections::BTreeMap;

/// Key in files of what is not built in.
const OTHERS: &str = "extra";

/// The values of one view, or means over views, by name of the metric. What has no value is absent.
///
/// In files the built-in metrics are keys, `null` without a value, and all others are in the object `extra`, which is
/// absent if it is empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MetricValues(BTreeMap<String, f64>);

impl MetricValues {
    /// Measures one view by all metrics.
    ///
    /// # Errors
    /// The first metric that fails.
    pub fn measure(view: &MetricInput<'_>) -> Result<Self, MetricFailure> {
        let mut values = BTreeMap::new();
        for (name, metric) in METRICS.all() {
            values.extend(metric.value(view)?.map(|value| (name, value)));
        }
        Ok(Self(values))
    }

    /// Returns the mean of each metric over the views that have it.
    pub fn mean<'a>(views: impl IntoIterator<Item = &'a Self>) -> Self {
        let mut sums: BTreeMap<&str, (f64, usize)> = BTreeMap::new();
        for (name, value) in views.into_iter().flat_map(|view| &view.0) {
            let (sum, count) = sums.entry(name).or_default();
            *sum += value;
            *count += 1;
        }
        Self(sums.into_iter().map(|(name, (sum, count))| (name.to_owned(), sum / count as f64)).collect())
    }

    /// Returns the value of a metric, if it has one.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.0.get(name).copied()
    }

    /// Returns the value of the first metric of the table; NaN if it has none.
    pub fn headline(&self) -> f64 {
        METRICS.names().first().and_then(|name| self.get(name)).unwrap_or(f64::NAN)
    }

    /// Returns that value as text, with its unit.
    pub fn headline_text(&self) -> String {
        headline().with_unit(self.headline())
    }

    /// Returns all built-in metrics in the order of the table, with or without a value, then the others, sorted.
    pub fn in_order(&self) -> Vec<(&str, Option<f64>)> {
        let built_in = METRICS.built_in_names().map(|name| (name, self.get(name)));
        built_in.chain(self.others().map(|(name, value)| (name, Some(value)))).collect()
    }

    /// Returns what has a value, by name.
    pub fn iter(&self) -> impl Iterator<Item = (&str, f64)> {
        self.0.iter().map(|(name, value)| (name.as_str(), *value))
    }

    /// Returns the values that tables have unless told otherwise, each with how it is shown.
    pub fn shown_by_default(&self) -> Vec<(MetricDisplay, f64)> {
        default_names().iter().filter_map(|name| Some((display(name), self.get(name)?))).collect()
    }

    fn others(&self) -> impl Iterator<Item = (&str, f64)> {
        self.iter().filter(|(name, _)| METRICS.built_in_names().all(|known| known != *name))
    }
}

impl<S: Into<String>> FromIterator<(S, f64)> for MetricValues {
    fn from_iter<I: IntoIterator<Item = (S, f64)>>(values: I) -> Self {
        Self(values.into_iter().map(|(name, value)| (name.into(), value)).collect())
    }
}

impl Serialize for MetricValues {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        for name in METRICS.built_in_names() {
            map.serialize_entry(name, &self.get(name))?;
        }
        let others: BTreeMap<&str, f64> = self.others().collect();
        if !others.is_empty() {
            map.serialize_entry(OTHERS, &others)?;
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for MetricValues {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let keys: BTreeMap<String, Value> = Deserialize::deserialize(deserializer)?;
        let others = keys.get(OTHERS).map(BTreeMap::<String, Option<f64>>::deserialize).transpose();
        let mut values = others.map_err(D::Error::custom)?.unwrap_or_default();
        for name in METRICS.built_in_names() {
            let value = keys.get(name).map(Option::<f64>::deserialize).transpose().map_err(D::Error::custom)?;
            values.insert(name.to_owned(), value.flatten());
        }
        Ok(Self(values.into_iter().filter_map(|(name, value)| Some((name, value?))).collect()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(named: &[(&str, f64)]) -> MetricValues {
        named.iter().copied().collect()
    }

    #[test]
    fn views_without_a_value_are_omitted_from_the_mean_and_others_never() {
        let views = [values(&[("tenth", 0.1), ("psnr", 30.0)]), values(&[("psnr", 20.0)]), values(&[("tenth", 0.3)])];
        let mean = MetricValues::mean(&views);
        assert_eq!(mean.iter().map(|(name, _)| name).collect::<Vec<_>>(), ["psnr", "tenth"]);
        assert!((mean.get("tenth").unwrap() - 0.2).abs() < 1e-12 && mean.headline() == 25.0);
        assert_eq!(MetricValues::mean(&[MetricValues::default()]), MetricValues::default());
        // a render that cannot be measured is not passed over
        assert!(MetricValues::mean(&[values(&[("psnr", f64::NAN)]), values(&[("psnr", 30.0)])]).headline().is_nan());
    }

    #[test]
    fn files_have_built_in_metrics_as_keys_and_others_together() {
        #[derive(Debug, PartialEq, Serialize, Deserialize)]
        struct Outer {
            views: usize,
            #[serde(flatten)]
            metrics: MetricValues,
            fps: f64,
        }
        let metrics = values(&[("mine", 0.5), ("ssim", 0.9), ("psnr", 30.0), ("lpips_vgg", f64::NAN)]);
        let text = serde_json::to_string(&Outer { views: 2, metrics, fps: 9.0 }).unwrap();
        let expected = "{\"views\":2,\"psnr\":30.0,\"ssim\":0.9,\"ssim_gray\":null,\"lpips_alex\":null,\
                        \"lpips_vgg\":null,\"extra\":{\"mine\":0.5},\"fps\":9.0}";
        assert_eq!(text, expected);
        let read: Outer = serde_json::from_str(&text).unwrap();
        assert_eq!(read.metrics, values(&[("mine", 0.5), ("ssim", 0.9), ("psnr", 30.0)]));
        assert_eq!((read.views, read.fps), (2, 9.0));
        assert!(serde_json::from_str::<Outer>(&text.replace("30.0", "\"high\"")).is_err());
        let plain = serde_json::to_string(&values(&[("psnr", 1.0)])).unwrap();
        assert!(!plain.contains("extra"), "{plain}");
        let names: Vec<(&str, Option<f64>)> = read.metrics.in_order();
        assert_eq!((names[0], names[2], names[5]), (("psnr", Some(30.0)), ("ssim_gray", None), ("mine", Some(0.5))));
    }

    #[test]
    fn every_metric_measures_and_says_how_it_is_shown() {
        let (image, alpha) = (vec![0.5; 3 * 64], vec![1.0; 64]);
        let networks = super::super::metric::Networks::default();
        let view = MetricInput {
            render: &image,
            truth: &image,
            alpha: &alpha,
            width: 8,
            height: 8,
            background: [1.0; 3],
            time: 0.0,
            networks: &networks,
        };
        let found = MetricValues::measure(&view).unwrap();
        assert_eq!((found.get("ssim"), found.get("ssim_gray"), found.get("lpips_alex")), (Some(1.0), Some(1.0), None));
        assert!(found.headline().is_finite() && found.headline_text().ends_with(" dB"));
        assert!(METRICS.built_in_names().all(|name| display(name).head != name));
        let error = MetricValues::measure(&MetricInput { width: 4, height: 16, ..view }).unwrap_err().to_string();
        assert!(error.contains("smaller than the 7x7 window"), "{error}");
    }
}
