//! What a metric is: how an image is measured, and how values are shown. The table is in the module above.

use super::METRICS;
use super::lpips::{Lpips, LpipsError};
use burn::tensor::Device;
use serde::Serialize;
use std::borrow::Cow;
use std::path::PathBuf;

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
    /// The networks that are loaded.
    pub networks: &'a Networks,
}

/// Networks, with their weights, that metrics compare images by.
#[derive(Clone, Debug, Default)]
pub struct Networks {
    lpips: Vec<Lpips>,
}

impl Networks {
    /// Loads networks of LPIPS from `files` onto `device`; each file says which network it is of.
    ///
    /// # Errors
    /// As [`Lpips::load`].
    pub fn load(files: &[PathBuf], device: &Device) -> Result<Self, LpipsError> {
        Ok(Self { lpips: files.iter().map(|path| Lpips::load(path, device)).collect::<Result<_, _>>()? })
    }

    /// The networks of LPIPS, in the order of their files.
    pub fn lpips(&self) -> &[Lpips] {
        &self.lpips
    }
}

/// Why a metric could not be computed, such as an image smaller than its window.
pub type MetricFailure = Box<dyn std::error::Error + Send + Sync>;

/// A measure of a rendered image, computed by `volseggs eval` for each view and as the mean over views.
pub trait Metric: Send + Sync {
    /// Returns the value for one view; `None` if the view has none, such as a mean over no pixels, or if a network is
    /// missing. Means omit such views. A value that is not finite makes the mean not finite, which files state as `null`.
    ///
    /// # Errors
    /// If no image of this size can be measured; the evaluation then ends.
    fn value(&self, view: &MetricInput<'_>) -> Result<Option<f64>, MetricFailure>;

    /// How tables show it; `None` for [`MetricDisplay::named`].
    fn display(&self) -> Option<MetricDisplay> {
        None
    }

    /// Whether it can be computed with these networks.
    fn is_available(&self, _networks: &Networks) -> bool {
        true
    }

    /// What a reader of the means should know, if anything, of these `values`, one for each view that has one, of images of
    /// `pixels` pixels. Metrics that say the same are quoted once.
    fn note(&self, _values: &[f64], _pixels: usize, _networks: &Networks) -> Option<String> {
        None
    }
}

/// Which direction of a metric is better.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Better {
    /// Larger is better.
    Higher,
    /// Smaller is better.
    Lower,
    /// Neither, such as a number of Gaussians.
    Neither,
}

/// How a metric is shown.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MetricDisplay {
    /// Heading, with its unit.
    pub head: Cow<'static, str>,
    /// The usual abbreviation, which several metrics may share.
    pub short: Cow<'static, str>,
    /// Unit of a value; empty if it has none.
    pub unit: &'static str,
    /// What distinguishes it from others of the same abbreviation, in words; may be empty.
    pub note: &'static str,
    /// Digits after the decimal point.
    pub digits: usize,
    /// Which direction is better.
    pub better: Better,
    /// Whether tables have it unless told otherwise.
    pub by_default: bool,
}

impl MetricDisplay {
    /// Describes a value without unit and note that tables have only on request.
    pub const fn new(head: &'static str, short: &'static str, digits: usize, better: Better) -> Self {
        let (head, short) = (Cow::Borrowed(head), Cow::Borrowed(short));
        Self { head, short, unit: "", note: "", digits, better, by_default: false }
    }

    /// Describes a value of which only the name is known: shown under it with four digits; larger is better, unless the
    /// name ends in `_loss` or `_error`.
    pub fn named(name: &str) -> Self {
        let better = if name.ends_with("_loss") || name.ends_with("_error") { Better::Lower } else { Better::Higher };
        Self { head: Cow::Owned(name.to_owned()), short: Cow::Owned(name.to_owned()), ..Self::new("", "", 4, better) }
    }

    /// Returns its abbreviation, unit and note, separated by commas.
    pub fn name(&self) -> String {
        let parts = [&*self.short, self.unit, self.note];
        parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(", ")
    }

    /// Formats a value with its unit.
    pub fn with_unit(&self, value: f64) -> String {
        let space = if self.unit.is_empty() { "" } else { " " };
        format!("{value:.*}{space}{}", self.digits, self.unit)
    }
}

/// Returns how the metric called `name` is shown, whether this program knows it or not.
pub fn display(name: &str) -> MetricDisplay {
    let known = METRICS.get(name).ok().and_then(Metric::display);
    known.unwrap_or_else(|| MetricDisplay::named(name))
}

/// Returns how the headline is shown.
pub fn headline() -> MetricDisplay {
    METRICS.names().first().map_or_else(|| MetricDisplay::named(""), |name| display(name))
}

/// Returns the names of the metrics that tables have unless told otherwise.
pub fn default_names() -> Vec<String> {
    METRICS.names().into_iter().filter(|name| display(name).by_default).collect()
}
