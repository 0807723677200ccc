//! Evaluation of a trained model over a split: the paper's metrics for each view and their mean.

use super::diagnosis::TrainingViews;
use super::distance::{AtDistance, by_distance};
use super::metric::{self, MetricInput};
use super::regions::{ByRegion, RegionSums};
use super::results::DataId;
use super::sheet::{SheetRow, contact_sheet};
use super::speed::{self, Speed};
use crate::csv;
use crate::data::Split;
use crate::metrics::lpips::{Lpips, LpipsNet};
use crate::metrics::psnr::{max_psnr_of_pictures, psnr_of_pictures, to_8_bits};
use crate::metrics::ssim::{ssim_gray, ssim_rgb};
use crate::model::{Model, ToKernel};
use image::RgbImage;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::PathBuf;

/// Metrics of one view.
#[derive(Clone, Debug, Serialize)]
pub struct ViewMetrics {
    /// Name of the view.
    pub view: String,
    /// Its time in [0, 1].
    pub time: f64,
    /// Decibels, over all pixels and channels of the 8-bit render; finite, see [`psnr_of_pictures`].
    pub psnr: f64,
    /// SSIM on RGB, 11-tap Gaussian window, zero padding.
    pub ssim: f64,
    /// SSIM on grey values, 7x7 uniform window, scikit-image's default.
    pub ssim_gray: f64,
    /// LPIPS, AlexNet.
    pub lpips_alex: Option<f64>,
    /// LPIPS, VGG-16.
    pub lpips_vgg: Option<f64>,
    /// Registered metrics by name; those that are not finite in this view are absent.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub extra: BTreeMap<String, f64>,
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
    /// Mean PSNR, decibels.
    pub psnr: f64,
    /// Mean SSIM, RGB.
    pub ssim: f64,
    /// Mean SSIM, grey.
    pub ssim_gray: f64,
    /// Mean LPIPS with AlexNet; null without weights.
    pub lpips_alex: Option<f64>,
    /// Mean LPIPS with VGG-16; null without weights.
    pub lpips_vgg: Option<f64>,
    /// Means of registered metrics by name, over the views that have them.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub extra: BTreeMap<String, f64>,
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
    pub speed: Speed,
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
pub struct Costs {
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
    pub training_views: Option<Sample>,
}

/// A sample of views.
#[derive(Debug)]
pub struct Sample {
    /// The views, with their images.
    pub split: Split,
    /// Number of views that it is a sample of.
    pub of: usize,
}

/// Where LPIPS weights come from.
const LPIPS_WEIGHTS: &str = "LPIPS is null without --lpips-weights FILE: convert the published files with `volseggs lpips`; \
                             see `volseggs lpips --help`";

/// The render and the ground truth of a view, as 8-bit images.
struct Pair {
    /// `[H, W, 3]`
    render: Vec<f32>,
    /// `[H, W, 3]` over the model's background.
    truth: Vec<f32>,
    /// `[H, W]`, of the ground truth.
    alpha: Vec<f32>,
}

impl Pair {
    fn new(width: usize, height: usize) -> Self {
        let pixels = width * height;
        Self { render: vec![0.0; 3 * pixels], truth: vec![0.0; 3 * pixels], alpha: vec![0.0; pixels] }
    }

    /// Draws view `i` of `split` and loads its ground truth.
    fn fill(&mut self, model: &dyn Model, split: &Split, i: usize) {
        let frame = &split.frames[i];
        let image = model.render(frame.camera.to_kernel(), frame.time as f32);
        for (to, from) in self.render.chunks_exact_mut(3).zip(image.chunks_exact(4)) {
            to.iter_mut().zip(from).for_each(|(to, from)| *to = to_8_bits(*from));
        }
        split.images.composite(i, model.background(), &mut self.truth);
        self.truth.iter_mut().for_each(|v| *v = to_8_bits(*v));
        split.images.alpha(i, &mut self.alpha);
    }
}

/// Returns the means over views that were trained on, of which there is at least one.
fn measure_sample(model: &dyn Model, sample: &Sample) -> Result<TrainingViews, String> {
    let split = &sample.split;
    let (w, h) = (split.images.width as usize, split.images.height as usize);
    let mut pair = Pair::new(w, h);
    let (mut sums, mut regions) = ([0.0; 3], RegionSums::default());
    for i in 0..split.frames.len() {
        pair.fill(model, split, i);
        let Pair { render, truth, alpha } = &pair;
        regions.add(render, truth, alpha, w);
        for (sum, value) in sums.iter_mut().zip([
            psnr_of_pictures(render, truth).map_err(|e| e.to_string())?,
            ssim_rgb(render, truth, w, h).map_err(|e| e.to_string())?,
            ssim_gray(render, truth, w, h).map_err(|e| e.to_string())?,
        ]) {
            *sum += value;
        }
    }
    let views = split.frames.len();
    let [psnr, ssim, ssim_gray] = sums.map(|sum| sum / views as f64);
    Ok(TrainingViews { views, of: sample.of, psnr, ssim, ssim_gray, by_region: regions.finish() })
}

/// Evaluates every view of `split`; `progress` is called after each with the number of views done and its PSNR. Renders
/// and ground truth are compared as 8-bit images.
///
/// # Errors
/// A message if a metric cannot be computed (an image is too small for its window), or the device fails.
pub fn evaluate(
    model: &dyn Model,
    split: &Split,
    networks: &[Lpips],
    costs: &Costs,
    mut progress: impl FnMut(usize, f64),
) -> Result<Evaluation, String> {
    let (w, h) = (split.images.width as usize, split.images.height as usize);
    let n = split.frames.len();
    let background = model.background();
    let shown: Vec<usize> = (0..n.min(6)).map(|k| (2 * k + 1) * n / (2 * n.min(6))).collect();
    let (mut kept, mut pictures) = (Vec::new(), Vec::new());
    let mut views = Vec::with_capacity(n);
    let mut pair = Pair::new(w, h);
    let mut regions = RegionSums::default();
    let registered = metric::registered();
    let speed = speed::measure(model, split)?;
    for (i, frame) in split.frames.iter().enumerate() {
        pair.fill(model, split, i);
        let Pair { render, truth, alpha } = &pair;
        let lpips = |net: LpipsNet| -> Result<Option<f64>, String> {
            let network = networks.iter().find(|n| n.net() == net);
            network.map(|n| n.distance(render, truth, h, w).map_err(|e| e.to_string())).transpose()
        };
        regions.add(render, truth, alpha, w);
        let input = MetricInput { render, truth, alpha, width: w, height: h, background, time: frame.time };
        let metrics = ViewMetrics {
            view: frame.name.clone(),
            time: frame.time,
            psnr: psnr_of_pictures(render, truth).map_err(|e| e.to_string())?,
            ssim: ssim_rgb(render, truth, w, h).map_err(|e| e.to_string())?,
            ssim_gray: ssim_gray(render, truth, w, h).map_err(|e| e.to_string())?,
            lpips_alex: lpips(LpipsNet::Alex)?,
            lpips_vgg: lpips(LpipsNet::Vgg)?,
            extra: metric::measure(&registered, &input),
        };
        progress(i + 1, metrics.psnr);
        if shown.contains(&i) {
            let picture = |rgb: &[f32]| {
                let bytes = rgb.iter().map(|v| (v * 255.0).round() as u8).collect();
                RgbImage::from_raw(w as u32, h as u32, bytes).unwrap_or_default()
            };
            let (truth_picture, render_picture) = (picture(truth), picture(render));
            pictures.push(ViewPicture { view: frame.name.clone(), truth: truth_picture, render: render_picture });
            kept.push((
                format!("{} t {:.2} {:.2} dB", frame.name, frame.time, metrics.psnr),
                truth.clone(),
                render.clone(),
            ));
        }
        views.push(metrics);
    }
    let all: Vec<&ViewMetrics> = views.iter().collect();
    let mean = |f: &dyn Fn(&ViewMetrics) -> f64| mean_of(&all, |v| Some(f(v))).unwrap_or(f64::NAN);
    let mean_option = |f: &dyn Fn(&ViewMetrics) -> Option<f64>| mean_of(&all, f);
    let mut notes = vec!["renders and the ground truth are compared as 8-bit images".to_owned()];
    if networks.is_empty() {
        notes.push(LPIPS_WEIGHTS.to_owned());
    }
    let equal = pictures_equal(&views, w * h);
    if equal > 0 {
        notes.push(format!(
            "{equal} of {n} renders equal the ground truth; their PSNR is that of one value off by one step of 255"
        ));
    }
    let counts = model.counts();
    let summary = Summary {
        split: split.name.as_str().to_owned(),
        dataset: costs.data.dataset.clone(),
        fingerprint: costs.data.fingerprint.clone(),
        views: n,
        psnr: mean(&|v| v.psnr),
        ssim: mean(&|v| v.ssim),
        ssim_gray: mean(&|v| v.ssim_gray),
        lpips_alex: mean_option(&|v| v.lpips_alex),
        lpips_vgg: mean_option(&|v| v.lpips_vgg),
        extra: metric::means(views.iter().map(|v| &v.extra)),
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
        background,
        build: crate::program::build().map(|build| build.digest.clone()).unwrap_or_default(),
        notes,
    };
    let rows: Vec<SheetRow<'_>> =
        kept.iter().map(|(label, truth, render)| SheetRow { label: label.clone(), truth, render }).collect();
    let sheet = contact_sheet(&rows, w, h).ok();
    Ok(Evaluation { views, summary, sheet, pictures })
}

/// Returns how many of `views`, of `pixels` pixels each, have the PSNR of equal images.
fn pictures_equal(views: &[ViewMetrics], pixels: usize) -> usize {
    let most = max_psnr_of_pictures(3 * pixels);
    views.iter().filter(|v| v.psnr >= most).count()
}

/// Returns the mean over views; `None` if there are no views, or one lacks the value.
pub(super) fn mean_of(views: &[&ViewMetrics], value: impl Fn(&ViewMetrics) -> Option<f64>) -> Option<f64> {
    let sum = views.iter().map(|v| value(v)).sum::<Option<f64>>()?;
    (!views.is_empty()).then(|| sum / views.len() as f64)
}

/// Formats the metrics of each view as CSV, registered ones last; a missing value is an empty cell.
pub fn to_csv(views: &[ViewMetrics]) -> String {
    let mut out = String::from("view,time,psnr,ssim,ssim_gray,lpips_alex,lpips_vgg");
    let names: BTreeSet<&String> = views.iter().flat_map(|v| v.extra.keys()).collect();
    names.iter().for_each(|name| out.extend([",", name.as_str()]));
    out.push('\n');
    let cell = |v: Option<f64>| v.map(|v| format!("{v:.6}")).unwrap_or_default();
    for v in views {
        let (alex, vgg) = (cell(v.lpips_alex), cell(v.lpips_vgg));
        // writing to a String cannot fail
        let _ = write!(
            out,
            "{},{:.6},{:.4},{:.6},{:.6},{alex},{vgg}",
            csv::field(&v.view),
            v.time,
            v.psnr,
            v.ssim,
            v.ssim_gray
        );
        names.iter().for_each(|name| out.extend([",", &cell(v.extra.get(*name).copied())]));
        out.push('\n');
    }
    out
}
