//! One evaluation from beginning to end: coarse colours, masks, fields and baselines at the chosen time; a click on each
//! known segment; what each method selects, measured at every time.

use super::measure::{FrameScore, Judge};
use super::methods::{Best, Method, Selected, offer_field, offer_saga, offer_sagd};
use super::prompt::{Click, Prompt};
use super::table::Row;
use super::train::{Trained, Trainers};
use super::truth::{TruthFrame, frames, labelled};
use crate::data::paths::Axis;
use crate::data::{DataError, Truth};
use crate::eval::results::DataId;
use crate::export::images::to_rgb8;
use crate::metrics::lpips::Lpips;
use crate::model::{GaussiansAt, Scene};
use crate::segment::baselines::saga::SagaOptions;
use crate::segment::coarse::CoarseOptions;
use crate::segment::fine::train::FineOptions;
use image::RgbImage;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Where masks come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum MaskKind {
    /// Regions of rendered pictures.
    Regions,
    /// Label images of the dataset: an upper bound.
    Labels,
}

/// What to evaluate.
#[derive(Clone, Debug)]
pub struct SegmentOptions {
    /// Time of the clicks in [0, 1]; the training time nearest to it is taken.
    pub time: f64,
    /// The methods.
    pub methods: Vec<Method>,
    /// Known segments to measure; all if empty.
    pub segments: Vec<String>,
    /// Clicks on a segment at most, each further one on what is still missing.
    pub clicks: usize,
    /// Source of the masks.
    pub masks: MaskKind,
    /// Views with masks; not for [`MaskKind::Labels`], whose views are those of the dataset.
    pub views: usize,
    /// Take these views within an angle (radians) of an axis, in place of the whole sphere.
    pub bias: Option<(Axis, f64)>,
    /// Colours.
    pub coarse: CoarseOptions,
    /// Training of the affinity field.
    pub fine: FineOptions,
    /// Training of SAGA.
    pub saga: SagaOptions,
    /// Least alpha of a pixel of a mask; that of the dataset's masks if `None`.
    pub mask_alpha: Option<f32>,
}

/// One segment by one method.
#[derive(Clone, Debug, Serialize)]
pub struct SegmentResult {
    /// Name of the known segment.
    pub segment: String,
    /// The method.
    pub method: Method,
    /// The view that was clicked.
    pub view: String,
    /// Column and row of the first click.
    pub pixel: [u32; 2],
    /// The setting that fits best in that view.
    pub setting: Option<String>,
    /// Its intersection over union there.
    pub fit: f64,
    /// Clicks that it took.
    pub clicks: usize,
    /// Gaussians selected.
    pub gaussians: usize,
    /// Their indices, ascending.
    #[serde(skip)]
    pub members: Vec<u32>,
    /// Seconds from a click to a segment.
    pub click_seconds: f64,
    /// Means at the time nearest to that of the click.
    pub at: Option<Row>,
    /// Means at each time: tracking.
    pub times: Vec<Row>,
}

/// All of it.
#[derive(Clone, Debug, Serialize)]
pub struct SegmentEvaluation {
    /// The data; the caller says which.
    #[serde(flatten)]
    pub data: DataId,
    /// Time of the clicks.
    pub time: f64,
    /// Source of the masks.
    pub masks: MaskKind,
    /// Names of the coarse colours.
    pub palette: Vec<String>,
    /// Seconds of masks and training by method.
    pub training_seconds: BTreeMap<String, f64>,
    /// Segment by segment, method by method.
    pub results: Vec<SegmentResult>,
    /// Truth and each method, a row for each segment.
    #[serde(skip)]
    pub pictures: Vec<(String, RgbImage)>,
    /// Pictures in a row.
    #[serde(skip)]
    pub columns: usize,
}

/// Why segments cannot be evaluated.
#[derive(Debug, thiserror::Error)]
pub enum SegmentEvalError {
    /// What the dataset knows of its segments cannot be used.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A method failed.
    #[error("{0}")]
    Failed(String),
}

impl From<String> for SegmentEvalError {
    fn from(message: String) -> Self {
        Self::Failed(message)
    }
}

/// Evaluates; `work` is a folder for files that nobody needs afterwards, and `say` is told what is being done.
///
/// # Errors
/// A message: the truth is not there, or a method failed.
pub fn evaluate_segments(
    scene: &Scene,
    truth: &Truth,
    options: &SegmentOptions,
    networks: &[Lpips],
    work: &Path,
    mut say: impl FnMut(&str),
) -> Result<SegmentEvaluation, SegmentEvalError> {
    let views = labelled(truth, options.time)?;
    let time = views.first().map_or(options.time, |v| v.view.time);
    let device = scene.gaussians.means.val().device();
    let at = scene.host_at(time as f32);
    let trainers = Trainers { scene, truth, at: &at, views: &views, options, work, device: &device };
    let trained = trainers.train(time, &mut say)?;

    let judge = Judge {
        device: &device,
        background: scene.spec.background,
        sh_degree: scene.spec.sh_degree,
        mask_alpha: options.mask_alpha,
        truth_alpha: truth.file.mask_alpha,
        networks,
    };
    let mut evaluation = SegmentEvaluation {
        data: DataId::default(),
        time,
        masks: options.masks,
        palette: trained.coarse.palette.iter().map(|p| p.name.clone()).collect(),
        training_seconds: trained.seconds.iter().map(|(m, s)| (m.name().to_owned(), *s)).collect(),
        results: Vec::new(),
        pictures: Vec::new(),
        columns: 1 + options.methods.len(),
    };
    let mut deformed = Times { scene, known: BTreeMap::new() };
    for entry in &truth.file.segments {
        if !options.segments.is_empty() && !options.segments.contains(&entry.name) {
            continue;
        }
        say(&format!("segment {}", entry.name));
        let frames = frames(truth, entry.id);
        let prompt = Prompt::new(&views, entry.id, &at, &device).map_err(|e| e.to_string())?;
        let Some(prompt) = prompt else {
            say(&format!(
                "segment {}: cannot be seen at time {time:.3}, so not be clicked; try another --time",
                entry.name
            ));
            continue;
        };
        let methods = options.methods.iter();
        let best: Vec<Chosen> =
            methods.map(|&method| choose(method, &prompt, &at, &trained, options)).collect::<Result<_, _>>()?;
        let scores = measure(&judge, &mut deformed, &frames, &best, time, (&entry.name, options), &mut evaluation)?;
        let near = nearest(&frames, time);
        for ((&method, chosen), scores) in options.methods.iter().zip(best).zip(scores) {
            let at_time = |t: f64| scores.iter().filter(move |s| s.time == t).collect::<Vec<_>>();
            let mut times: Vec<f64> = scores.iter().map(|s| s.time).collect();
            times.sort_by(f64::total_cmp);
            times.dedup();
            evaluation.results.push(SegmentResult {
                segment: entry.name.clone(),
                method,
                view: prompt.view.clone(),
                pixel: prompt.pixel,
                setting: chosen.selected.as_ref().map(|s| s.setting.clone()),
                fit: chosen.fit,
                clicks: chosen.clicks,
                gaussians: chosen.selected.as_ref().map_or(0, |s| s.members.len()),
                members: chosen.selected.map(|s| s.members).unwrap_or_default(),
                click_seconds: chosen.seconds,
                at: near.and_then(|t| Row::mean(&entry.name, method, Some(t), &at_time(t))),
                times: times.iter().filter_map(|&t| Row::mean(&entry.name, method, Some(t), &at_time(t))).collect(),
            });
        }
    }
    Ok(evaluation)
}

/// What a method makes of the clicks on a segment.
struct Chosen {
    selected: Option<Selected>,
    fit: f64,
    seconds: f64,
    clicks: usize,
}

fn choose(
    method: Method,
    prompt: &Prompt,
    at: &GaussiansAt,
    trained: &Trained,
    options: &SegmentOptions,
) -> Result<Chosen, String> {
    let mut best = Best::new(prompt, at.len());
    let mut click = Some(prompt.first());
    let mut clicks = 0;
    while let Some(place) = click.take().filter(|_| clicks < options.clicks.max(1)) {
        let fit = best.fit;
        offer(method, &mut best, &place, at, trained, options.fine.seed)?;
        if best.fit <= fit {
            break;
        }
        clicks += 1;
        click = best.next_click();
    }
    let seconds = if best.seconds.is_finite() { best.seconds } else { 0.0 };
    Ok(Chosen { fit: best.fit.max(0.0), selected: best.selected, seconds, clicks })
}

/// Offers what a method makes of one click.
fn offer(
    method: Method,
    best: &mut Best<'_>,
    click: &Click,
    at: &GaussiansAt,
    trained: &Trained,
    seed: u64,
) -> Result<(), String> {
    let coarse = &trained.coarse.labels;
    match method {
        Method::Coarse | Method::CoarseFine => {
            // a click on an outlier or on haze goes to what lies behind it
            let Some(clicked) = click.on(|i| coarse[i as usize] > 0) else { return Ok(()) };
            let label = coarse[clicked as usize];
            let within: Vec<u32> = (0..at.len() as u32).filter(|&i| coarse[i as usize] == label).collect();
            let setting = format!("all {}", trained.coarse.palette[label as usize - 1].name);
            best.offer(Selected { members: within.clone(), setting, ..Selected::default() }, f64::INFINITY);
            match (method, &trained.parts) {
                (Method::CoarseFine, Some((field, frame))) => {
                    offer_field(best, (field, frame), at, &within, clicked, seed)?;
                }
                _ => best.seconds = 0.0,
            }
        }
        Method::Fine => {
            if let (Some((field, frame)), Some(clicked)) = (&trained.whole, click.on(|_| true)) {
                let all: Vec<u32> = (0..at.len() as u32).collect();
                offer_field(best, (field, frame), at, &all, clicked, seed)?;
            }
        }
        Method::Saga => {
            if let (Some(model), Some(clicked)) = (&trained.saga, click.on(|_| true)) {
                offer_saga(best, model, clicked);
            }
        }
        Method::Sagd => {
            if let (Some(views), Some(clicked)) = (&trained.votes, click.on(|_| true)) {
                offer_sagd(best, at, views, clicked)?;
            }
        }
    }
    Ok(())
}

/// Scores of each method in each frame; adds a row of pictures to the sheet.
fn measure(
    judge: &Judge<'_>,
    deformed: &mut Times<'_>,
    frames: &[TruthFrame],
    best: &[Chosen],
    time: f64,
    (name, options): (&str, &SegmentOptions),
    evaluation: &mut SegmentEvaluation,
) -> Result<Vec<Vec<FrameScore>>, String> {
    let mut scores = vec![Vec::new(); best.len()];
    let shown = nearest(frames, time).and_then(|near| frames.iter().position(|f| f.time == near));
    let nothing = Selected::default();
    for (i, frame) in frames.iter().enumerate() {
        let truth = frame.load().map_err(|e| e.to_string())?;
        let at = deformed.at(frame.time);
        let (w, h) = (frame.camera.width as usize, frame.camera.height as usize);
        let picture = |rgb: &[f32]| {
            let rgba: Vec<f32> = rgb.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], 1.0]).collect();
            to_rgb8(&rgba, w, h)
        };
        if shown == Some(i) {
            evaluation.pictures.push((format!("{name}, t = {:.2}", frame.time), picture(&judge.composite(&truth))));
        }
        for ((chosen, scores), method) in best.iter().zip(&mut scores).zip(&options.methods) {
            let selected = chosen.selected.as_ref().unwrap_or(&nothing);
            let (score, render) = judge.score(at, selected, frame, &truth)?;
            if shown == Some(i) {
                let iou = score.iou.map_or("-".into(), |v| format!("{:.1} %", 100.0 * v));
                evaluation.pictures.push((format!("{method} {iou}"), picture(&render)));
            }
            scores.push(score);
        }
    }
    Ok(scores)
}

/// The time of a frame nearest to `time`.
fn nearest(frames: &[TruthFrame], time: f64) -> Option<f64> {
    frames.iter().map(|f| f.time).min_by(|a, b| (a - time).abs().total_cmp(&(b - time).abs()))
}

/// The scene at the times of the truth, each deformed once.
struct Times<'a> {
    scene: &'a Scene,
    known: BTreeMap<u64, GaussiansAt>,
}

impl Times<'_> {
    fn at(&mut self, time: f64) -> &GaussiansAt {
        // a few times stay; a dataset in which each view has its own would hold the scene hundreds of times
        if self.known.len() > 16 && !self.known.contains_key(&time.to_bits()) {
            self.known.clear();
        }
        self.known.entry(time.to_bits()).or_insert_with(|| self.scene.host_at(time as f32))
    }
}
