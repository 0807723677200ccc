//! Evaluation of a trained model over a split: all metrics for each view and their mean.

use super::diagnosis::TrainingViews;
use super::distance::{AtDistance, by_distance};
use super::regions::{ByRegion, RegionSums};
use super::results::DataId;
use super::sheet::{SheetRow, contact_sheet};
use super::speed::{self, RenderSpeed};
use crate::csv;
use crate::data::Split;
use crate::metrics::METRICS;
use crate::metrics::metric::{MetricInput, Networks, display};
use crate::metrics::psnr::to_8_bits;
use crate::metrics::values::MetricValues;
use crate::model::{Model, ToKernel};
use image::RgbImage;
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::path::PathBuf;

/// Metrics of one view.
#[derive(Clone, Debug, Serialize)]
pub struct ViewMetrics {
    /// Name of the view.
    pub view: String,
    /// Its time in [0, 1].
    pub time: f64,
    /// The metrics.
    #[serde(flatten)]
    pub metrics: MetricValues,
}

/// Means over a split, and the cost of the model.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Summary {
    /// Name of the split.
    pub split: String,
    /// Folder of the dataset.
    pub dataset: PathBuf,
    /// Fingerprint of the dataset; empty if it has no training views.
    pub fingerprint: String,
    /// Number of views.
    pub views: usize,
    /// Means of the metrics, over the views that have them.
    #[serde(flatten)]
    pub metrics: MetricValues,
    /// The same means by the views' distance from the nearest trained time; empty if those times are unknown.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub by_distance: Vec<AtDistance>,
    /// Means over training views, in addition to those of the split; absent if they are unknown or are the split
    /// itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub training_views: Option<TrainingViews>,
    /// Error by region of the pictures.
    pub by_region: ByRegion,
    /// Frames per second: `fps`, `fps_frames`, `fps_with_copy`.
    #[serde(flatten)]
    pub speed: RenderSpeed,
    /// Seconds of training.
    pub training_seconds: f64,
    /// Steps of training; `None` if they are unknown.
    pub steps: Option<usize>,
    /// Size of the model: bytes of the checkpoint's `scene.safetensors`, which holds all parameters in f32 (for
    /// VolSegGS, 59 numbers per Gaussian at SH degree 3, and the field) and about 2 kB of header and digest, but
    /// nothing that only training, edits or segments need.
    pub model_bytes: u64,
    /// Number of Gaussians; 0 for a method without primitives.
    pub gaussians: usize,
    /// Number of parameters of the model.
    pub parameters: usize,
    /// Width of the images in pixels.
    pub width: u32,
    /// Height of the images in pixels.
    pub height: u32,
    /// Background that images were composited over.
    pub background: [f32; 3],
    /// Digest of the program that measured, see [`crate::program`].
    pub build: String,
    /// What limits the comparison, in words.
    pub notes: Vec<String>,
}

/// Result of an evaluation.
#[derive(Debug)]
pub struct Evaluation {
    /// Metrics of each view.
    pub views: Vec<ViewMetrics>,
    /// The means.
    pub summary: Summary,
    /// Ground truth, render and error of a few views.
    pub sheet: Option<RgbImage>,
    /// The same views as separate pictures.
    pub pictures: Vec<ViewPicture>,
}

/// The ground truth and the render of one view.
#[derive(Clone, Debug)]
pub struct ViewPicture {
    /// Name of the view.
    pub view: String,
    /// The image of the dataset.
    pub truth: RgbImage,
    /// The render.
    pub render: RgbImage,
}

/// What the evaluation cannot determine itself.
#[derive(Debug, Default)]
pub struct RenderCosts {
    /// Seconds of training.
    pub training_seconds: f64,
    /// Steps of training, if known.
    pub steps: Option<usize>,
    /// Bytes of the scene file.
    pub model_bytes: u64,
    /// The data.
    pub data: DataId,
    /// Times in [0, 1] that were trained on; empty if unknown.
    pub trained_times: Vec<f64>,
    /// Training views to measure in addition to the split's; `None` if they are the split, or unknown.
    pub training_views: Option<ViewSample>,
}

/// A sample of views.
#[derive(Debug)]
pub struct ViewSample {
    /// The views, with their images.
    pub split: Split,
    /// Number of views that it is a sample of.
    pub of: usize,
}

/// The render and the ground truth of a view, as 8-bit images.
struct ViewPair {
    /// `[H, W, 3]`
    render: Vec<f32>,
    /// `[H, W, 3]` over the model's background.
    truth: Vec<f32>,
    /// `[H, W]`, of the ground truth.
    alpha: Vec<f32>,
}

impl ViewPair {
    fn new(split: &Split) -> Self {
        let pixels = split.images.width as usize * split.images.height as usize;
        Self { render: vec![0.0; 3 * pixels], truth: vec![0.0; 3 * pixels], alpha: vec![0.0; pixels] }
    }

    /// Draws view `i` of `split`, loads its ground truth and measures it, also by region.
    fn measure(
        &mut self,
        model: &dyn Model,
        split: &Split,
        i: usize,
        networks: &Networks,
        regions: &mut RegionSums,
    ) -> Result<MetricValues, String> {
        let (frame, background) = (&split.frames[i], model.background());
        let image = model.render(frame.camera.to_kernel(), frame.time as f32);
        for (to, from) in self.render.chunks_exact_mut(3).zip(image.chunks_exact(4)) {
            to.iter_mut().zip(from).for_each(|(to, from)| *to = to_8_bits(*from));
        }
        split.images.composite(i, background, &mut self.truth);
        self.truth.iter_mut().for_each(|v| *v = to_8_bits(*v));
        split.images.alpha(i, &mut self.alpha);
        let Self { render, truth, alpha } = &*self;
        let (width, height) = (split.images.width as usize, split.images.height as usize);
        regions.add(render, truth, alpha, width);
        let view = MetricInput { render, truth, alpha, width, height, background, time: frame.time, networks };
        MetricValues::measure(&view).map_err(|e| e.to_string())
    }
}

/// Measures views that were trained on, of which there is at least one, by what needs no network.
fn measure_sample(model: &dyn Model, sample: &ViewSample) -> Result<TrainingViews, String> {
    let mut pair = ViewPair::new(&sample.split);
    let (mut views, mut regions) = (Vec::new(), RegionSums::default());
    for i in 0..sample.split.frames.len() {
        views.push(pair.measure(model, &sample.split, i, &Networks::default(), &mut regions)?);
    }
    let by_region = regions.finish();
    Ok(TrainingViews { views: views.len(), of: sample.of, metrics: MetricValues::mean(&views), by_region })
}

/// Evaluates every view of `split`; `progress` is called after each with the number of views done and its metrics. Renders
/// and ground truth are compared as 8-bit images.
///
/// # Errors
/// A message if a metric cannot be computed (an image is too small for its window), or the device fails.
pub fn evaluate(
    model: &dyn Model,
    split: &Split,
    networks: &Networks,
    costs: &RenderCosts,
    mut progress: impl FnMut(usize, &MetricValues),
) -> Result<Evaluation, String> {
    let (w, h) = (split.images.width as usize, split.images.height as usize);
    let n = split.frames.len();
    let shown: Vec<usize> = (0..n.min(6)).map(|k| (2 * k + 1) * n / (2 * n.min(6))).collect();
    let (mut kept, mut pictures) = (Vec::new(), Vec::new());
    let mut views = Vec::with_capacity(n);
    let mut pair = ViewPair::new(split);
    let mut regions = RegionSums::default();
    let speed = speed::measure(model, split)?;
    for (i, frame) in split.frames.iter().enumerate() {
        let metrics = pair.measure(model, split, i, networks, &mut regions)?;
        let ViewPair { render, truth, .. } = &pair;
        progress(i + 1, &metrics);
        if shown.contains(&i) {
            let picture = |rgb: &[f32]| {
                let bytes = rgb.iter().map(|v| (v * 255.0).round() as u8).collect();
                RgbImage::from_raw(w as u32, h as u32, bytes).unwrap_or_default()
            };
            let (truth_picture, render_picture) = (picture(truth), picture(render));
            pictures.push(ViewPicture { view: frame.name.clone(), truth: truth_picture, render: render_picture });
            let label = format!("{} t {:.2} {}", frame.name, frame.time, metrics.headline_text());
            kept.push((label, truth.clone(), render.clone()));
        }
        views.push(ViewMetrics { view: frame.name.clone(), time: frame.time, metrics });
    }
    let mut notes = vec!["renders and the ground truth are compared as 8-bit images".to_owned()];
    for (name, metric) in METRICS.all() {
        let values: Vec<f64> = views.iter().filter_map(|v| v.metrics.get(&name)).collect();
        notes.extend(metric.note(&values, w * h, networks).filter(|note| !notes.contains(note)));
    }
    let counts = model.counts();
    let summary = Summary {
        split: split.name.as_str().to_owned(),
        dataset: costs.data.dataset.clone(),
        fingerprint: costs.data.fingerprint.clone(),
        views: n,
        metrics: MetricValues::mean(views.iter().map(|v| &v.metrics)),
        by_distance: by_distance(&views, &costs.trained_times),
        training_views: costs.training_views.as_ref().map(|sample| measure_sample(model, sample)).transpose()?,
        by_region: regions.finish(),
        speed,
        training_seconds: costs.training_seconds,
        steps: costs.steps,
        model_bytes: costs.model_bytes,
        gaussians: counts.primitives,
        parameters: counts.parameters,
        width: split.images.width,
        height: split.images.height,
        background: model.background(),
        build: crate::program::build().map(|build| build.digest.clone()).unwrap_or_default(),
        notes,
    };
    let rows: Vec<SheetRow<'_>> =
        kept.iter().map(|(label, truth, render)| SheetRow { label: label.clone(), truth, render }).collect();
    let sheet = contact_sheet(&rows, w, h).ok();
    Ok(Evaluation { views, summary, sheet, pictures })
}

/// Formats the metrics of each view as CSV, those that are not built in last; a missing value is an empty cell.
pub fn to_csv(views: &[ViewMetrics]) -> String {
    let mean = MetricValues::mean(views.iter().map(|v| &v.metrics));
    let columns: Vec<(&str, usize)> =
        mean.in_order().into_iter().map(|(name, _)| (name, display(name).digits + 2)).collect();
    let mut out = String::from("view,time");
    columns.iter().for_each(|(name, _)| out.extend([",", name]));
    out.push('\n');
    for v in views {
        // writing to a String cannot fail
        let _ = write!(out, "{},{:.6}", csv::field(&v.view), v.time);
        for (name, digits) in &columns {
            let cell = v.metrics.get(name).map(|value| format!("{value:.digits$}")).unwrap_or_default();
            out.extend([",", &cell]);
        }
        out.push('\n');
    }
    out
}
