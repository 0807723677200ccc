//! The quantities known to tables: the metrics of images, and what else is measured of a run or its segments. Names that
//! are not known can be shown too.

use crate::metrics::METRICS;
pub use crate::metrics::metric::Better;
use crate::metrics::metric::{MetricDisplay, default_names};
use serde::Serialize;

const fn row(
    id: &'static str,
    head: &'static str,
    short: &'static str,
    digits: usize,
    better: Better,
) -> (&'static str, MetricDisplay) {
    (id, MetricDisplay::new(head, short, digits, better))
}

/// What can be reported besides the metrics of images, by its name in files, on the command line and in sweep files.
static QUANTITIES: &[(&str, MetricDisplay)] = &[
    row("psnr_training", "PSNR of training views, dB", "training PSNR", 2, Better::Higher),
    row("psnr_edge", "PSNR at edges, dB", "edge PSNR", 2, Better::Higher),
    row("psnr_interior", "PSNR of the interior, dB", "interior PSNR", 2, Better::Higher),
    row("iou_3d", "3D IoU, %", "3D IoU", 2, Better::Higher),
    row("iou_3d_least", "minimum 3D IoU, %", "minimum 3D IoU", 2, Better::Higher),
    row("iou", "IoU, %", "IoU", 2, Better::Higher),
    row("iou_least", "minimum IoU, %", "minimum IoU", 2, Better::Higher),
    row("iou_3d_oracle", "3D IoU by oracle, %", "oracle 3D IoU", 2, Better::Higher),
    row("iou_oracle", "IoU by oracle, %", "oracle IoU", 2, Better::Higher),
    row("fps", "frames/s", "FPS", 1, Better::Higher),
    row("fps_with_copy", "frames/s with copy", "FPS with copy", 1, Better::Higher),
    row("training_minutes", "training, min", "TT", 2, Better::Lower),
    row("model_mib", "model, MiB", "MS (MiB)", 2, Better::Lower),
    row("model_mb", "model, MB", "MS (MB)", 2, Better::Lower),
    row("gaussians", "Gaussians", "N", 0, Better::Neither),
    row("peak_memory_gb", "memory, GB", "RAM", 2, Better::Lower),
    row("segment_seconds", "segmentation, s", "ST", 1, Better::Lower),
];

/// Returns the names of all that can be reported: the metrics of images, then the rest.
pub fn known() -> Vec<String> {
    METRICS.names().into_iter().chain(QUANTITIES.iter().map(|(id, _)| (*id).to_owned())).collect()
}

/// Returns the names of the metrics of images that tables have unless told otherwise, after `before` and followed by
/// `after`.
pub fn default_columns(before: &[&str], after: &[&str]) -> Vec<String> {
    let owned = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
    [owned(before), default_names(), owned(after)].concat()
}

/// A metric or another quantity as a column of a table.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct MetricColumn {
    /// The name in files.
    pub id: String,
    /// Heading, with its unit.
    pub head: String,
    /// Heading in LaTeX.
    pub short: String,
    /// Digits after the decimal point.
    pub digits: usize,
    /// Which direction is better.
    pub better: Better,
}

impl MetricColumn {
    /// Returns the column for an id, see [`MetricDisplay::named`] for one that is not [`known`].
    pub fn by_id(id: &str) -> Self {
        let quantity = QUANTITIES.iter().find(|(known, _)| *known == id).map(|(_, display)| display.clone());
        let MetricDisplay { head, short, digits, better, .. } =
            quantity.unwrap_or_else(|| crate::metrics::metric::display(id));
        Self { id: id.to_owned(), head: head.into_owned(), short: short.into_owned(), digits, better }
    }

    /// The heading without its unit.
    pub fn name(&self) -> &str {
        self.head.split(", ").next().unwrap_or(&self.head)
    }

    /// Formats a value with the metric's digits, never as a negative zero.
    pub fn format(&self, value: f64) -> String {
        let text = format!("{value:.*}", self.digits);
        match text.strip_prefix('-') {
            Some(zero) if zero.chars().all(|c| c == '0' || c == '.') => zero.to_owned(),
            _ => text,
        }
    }

    /// Formats a difference with its sign, or without one if it is displayed as zero.
    pub fn signed(&self, value: f64) -> String {
        let text = self.format(value);
        if value > 0.0 && !self.shows_zero(value) { format!("+{text}") } else { text }
    }

    /// Whether a value is displayed as zero.
    pub fn shows_zero(&self, value: f64) -> bool {
        self.format(value) == self.format(0.0)
    }

    /// Whether two values look the same in the table.
    pub fn looks_same(&self, a: f64, b: f64) -> bool {
        self.format(a) == self.format(b)
    }

    /// Orders values from best to worst, or from large to small if neither direction is better.
    pub fn best_first(&self, a: f64, b: f64) -> std::cmp::Ordering {
        match self.better {
            Better::Lower => a.total_cmp(&b),
            Better::Higher | Better::Neither => b.total_cmp(&a),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_ids_become_columns() {
        let known = MetricColumn::by_id("psnr");
        assert_eq!((known.head.as_str(), known.name(), known.digits), ("PSNR, dB", "PSNR", 2));
        let extra = MetricColumn::by_id("edge_error");
        assert_eq!((extra.head.as_str(), extra.digits, extra.better), ("edge_error", 4, Better::Lower));
        assert_eq!(MetricColumn::by_id("alpha_loss").better, Better::Lower);
        assert_eq!(MetricColumn::by_id("foreground_psnr").better, Better::Higher);
    }

    #[test]
    fn zeros_have_no_sign() {
        let psnr = MetricColumn::by_id("psnr");
        assert_eq!(psnr.format(-0.001), "0.00");
        assert_eq!(psnr.format(-0.01), "-0.01");
        assert_eq!(psnr.signed(0.001), "0.00");
        assert_eq!(psnr.signed(0.31), "+0.31");
        assert_eq!(psnr.signed(-0.31), "-0.31");
        assert_eq!(MetricColumn::by_id("gaussians").format(-0.2), "0");
    }
}
