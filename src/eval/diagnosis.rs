//! Table of what limits quality: views that were trained on, unseen views by their distance in time, and where in the
//! pictures the error lies.
//!
//! Training views far above test views at trained times indicate too few views, or an appearance that does not
//! generalise to other views. Test views at trained times far above those between them indicate a problem of
//! interpolation in time. Low values everywhere indicate a problem of the model or its training.

use super::regions::{ByRegion, ErrorRegion};
use super::run::Summary;
use crate::metrics::METRICS;
use crate::metrics::metric::display;
use crate::metrics::values::MetricValues;
use serde::{Deserialize, Serialize};

/// Means over views that the scene was trained on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingViews {
    /// Number of views measured: all, or a sample that is the same in every evaluation of the dataset.
    pub views: usize,
    /// Number of views that were trained on.
    pub of: usize,
    /// Means of the metrics that need no network.
    #[serde(flatten)]
    pub metrics: MetricValues,
    /// Error by region.
    pub by_region: ByRegion,
}

/// Names of the metrics in the table: the first two of all.
fn metrics() -> [String; 2] {
    let mut names = METRICS.names().into_iter();
    std::array::from_fn(|_| names.next().unwrap_or_default())
}

/// Returns the column headings of [`rows`].
pub fn head() -> [String; 6] {
    let [a, b] = metrics().map(|name| display(&name).name().split(", ").take(2).collect::<Vec<_>>().join(", "));
    ["what".into(), "views".into(), a, b, "pixels, %".into(), "squared error, %".into()]
}

/// Returns the table: a row for the training views, for each distance from a trained time, and for each region of the
/// pictures.
pub fn rows(summary: &Summary) -> Vec<[String; 6]> {
    let none = String::new;
    let shown = metrics();
    let views = |what: String, views: String, values: &MetricValues| {
        let value = |name: &String| values.get(name).map(|value| format!("{value:.*}", display(name).digits));
        let [a, b] = shown.each_ref().map(|name| value(name).unwrap_or_else(|| "-".to_owned()));
        [what, views, a, b, none(), none()]
    };
    let mut out = Vec::new();
    if let Some(t) = &summary.training_views {
        let count = if t.views == t.of { t.views.to_string() } else { format!("{} of {}", t.views, t.of) };
        out.push(views("training views".to_owned(), count, &t.metrics));
    }
    let split = &summary.split;
    out.push(views(format!("{split} views"), summary.views.to_string(), &summary.metrics));
    for at in &summary.by_distance {
        let distance = if at.to < 1e-4 {
            "at a trained time".to_owned()
        } else if at.to - at.from < 1e-4 {
            format!("{:.4} from a trained time", at.to)
        } else {
            format!("{:.4} to {:.4} from a trained time", at.from, at.to)
        };
        out.push(views(format!("{split} views {distance}"), at.views.to_string(), &at.metrics));
    }
    let training = summary.training_views.as_ref().map(|t| ("training", t.by_region));
    for (whose, parts) in [(split.as_str(), summary.by_region)].into_iter().chain(training) {
        for (name, part) in [("edges", parts.edge), ("interior", parts.interior), ("outside", parts.outside)] {
            let ErrorRegion { pixels, error, psnr } = part;
            let psnr = psnr.map_or("-".to_owned(), |psnr| format!("{psnr:.2}"));
            let share = |v: f64| format!("{:.1}", 100.0 * v);
            out.push([format!("{name} of {whose} views"), none(), psnr, none(), share(pixels), share(error)]);
        }
    }
    out
}
