//! A complete evaluation: coarse colours, masks, fields and baselines at the chosen time; a click on each known
//! segment; what each method selects, measured at every time, in space and in pictures.

use super::measure::{FrameScore, SelectionJudge};
use super::method::SelectionMethod;
use super::options::{SegmentEvalError, SegmentEvalOptions};
use super::oracle;
use super::prompt::ClickPrompt;
use super::result::{SegmentEvaluation, SegmentResult, SelectionOutcome, VolumeScore, nearest};
use super::select::{MethodSelection, Scenery, fixed};
use super::setting::{MethodSetting, TRIES};
use super::target::{EvalTarget, targets};
use super::train::{TrainedMethods, Trainers};
use super::truth::labelled;
use super::volume::TruthCells;
use crate::data::Truth;
use crate::eval::results::DataId;
use crate::export::images::to_rgb8;
use crate::metrics::lpips::Lpips;
use crate::model::{HostGaussians, Scene};
use crate::segment::propagate::propagate;
use image::RgbImage;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

/// Runs an evaluation of a scene whose Gaussians drawing widens by the standard deviation `widening`, scene units;
/// `work` is a folder for temporary files, and `say` receives messages about progress. Returns it with what the methods
/// have learnt before the clicks.
///
/// # Errors
/// If the ground truth is missing, masks cannot be used, or a method failed.
pub fn evaluate_segments(
    scene: &Scene,
    widening: f64,
    truth: &Truth,
    options: &SegmentEvalOptions,
    networks: &[Lpips],
    work: &Path,
    mut say: impl FnMut(&str),
) -> Result<(SegmentEvaluation, TrainedMethods), SegmentEvalError> {
    let views = labelled(truth, options.time)?;
    let time = views.first().map_or(options.time, |v| v.view.time);
    let (source, config) = (options.check()?, options.config());
    let targets = targets(truth, &options.only, &options.unions, time)?;
    let device = scene.gaussians.means.val().device();
    let at = scene.host_at(time as f32);
    let (config, source) = (&config, &source);
    let trainers = Trainers { scene, truth, at: &at, views: &views, options, config, source, device: &device };
    let trained = trainers.train(time, work, &mut say)?;
    let scenery = Scenery { at: &at, trained: &trained, config };

    let (mut clicked, mut not_seen) = (Vec::new(), Vec::new());
    for target in &targets {
        say(&format!("segment {}: clicks", target.name));
        let prompt = ClickPrompt::new(
            &views,
            &target.ids,
            (&at, scene.spec.rendering()),
            (options.clicks, &config.click),
            &device,
        )
        .map_err(|e| e.to_string())?;
        let Some(prompt) = prompt else {
            say(&format!(
                "segment {}: not visible at time {time:.3}, so it cannot be clicked; try another --time",
                target.name
            ));
            not_seen.push(target.name.clone());
            continue;
        };
        let choices: Vec<MethodChoice> = options
            .methods
            .iter()
            .map(|&m| choose(m, scenery, &prompt, options, (scene, time)))
            .collect::<Result<_, _>>()?;
        clicked.push(ClickedTarget { target, prompt, choices });
    }

    let volume_times = truth.volume_times();
    let mut evaluation = SegmentEvaluation {
        data: DataId::default(),
        time,
        masks: options.masks.clone(),
        mask_views: trainers.mask_views(),
        seed: options.seed,
        oracle_tries: if options.oracle { TRIES } else { 0 },
        volume_times: volume_times.clone(),
        palette: trained.coarse().palette.iter().map(|p| p.name.clone()).collect(),
        training_seconds: trained.seconds.iter().map(|(m, s)| (m.name().to_owned(), *s)).collect(),
        means: Vec::new(),
        not_seen,
        labelled_share: None,
        partly_known: clicked
            .iter()
            .filter(|c| !c.is_known_at_all_times(truth, time))
            .map(|c| c.target.name.clone())
            .collect(),
        results: Vec::new(),
        pictures: Vec::new(),
        columns: 1 + options.methods.len(),
    };
    let mut deformed = ScenesByTime { scene, known: BTreeMap::new() };
    let mut volumes = Vec::new();
    for &volume_time in &volume_times {
        say(&format!("IoU in space at time {volume_time:.3}"));
        let volume = truth.volume(volume_time)?;
        let cells = TruthCells::new(&volume, deformed.at(volume_time), widening).map_err(|e| e.to_string())?;
        if nearest(&volume_times, time, |t| *t) == Some(&volume_time) {
            evaluation.labelled_share = cells.labelled_share();
        }
        volumes.push(in_space(truth, &cells, [time, volume_time], &clicked)?);
    }
    let judge = SelectionJudge {
        device: &device,
        rendering: scene.spec.rendering(),
        mask_alpha: options.mask_alpha,
        truth_alpha: truth.file.mask_alpha,
        networks,
    };
    for (t, one) in clicked.into_iter().enumerate() {
        say(&format!("segment {}: pictures", one.target.name));
        let scores = in_pictures(&judge, &mut deformed, &one, time, &options.methods, &mut evaluation.pictures)?;
        for (m, (choice, scores)) in one.choices.into_iter().zip(scores).enumerate() {
            let volumes_of = |pick: &dyn Fn(&FixedAndOracle<Option<f64>>) -> Option<f64>| -> Vec<VolumeScore> {
                let of_time = |(time, all): (&f64, &Vec<Vec<FixedAndOracle<Option<f64>>>>)| VolumeScore {
                    time: *time,
                    iou_3d: pick(&all[t][m]).map(|v| 100.0 * v),
                };
                volume_times.iter().zip(&volumes).map(of_time).collect()
            };
            let mut fixed = outcome(choice.fixed);
            fixed.fill(time, &scores.fixed, volumes_of(&|v| v.fixed));
            let oracle = choice.oracle.zip(scores.oracle).map(|(chosen, scores)| {
                let mut out = outcome(chosen);
                out.fill(time, &scores, volumes_of(&|v| v.oracle.flatten()));
                out
            });
            evaluation.results.push(SegmentResult {
                segment: one.target.name.clone(),
                method: options.methods[m],
                view: one.prompt.view.clone(),
                pixel: one.prompt.pixel,
                fixed,
                oracle,
            });
        }
    }
    let single: Vec<&str> = targets.iter().filter(|t| t.ids.len() == 1).map(|t| t.name.as_str()).collect();
    evaluation.take_means(&options.methods, &single);
    Ok((evaluation, trained))
}

/// A value for the fixed setting and, if the oracle was used, one for its setting.
struct FixedAndOracle<T> {
    fixed: T,
    oracle: Option<T>,
}

type MethodChoice = FixedAndOracle<MethodSelection>;

/// A segment, where it was clicked, and what each method selected.
struct ClickedTarget<'a> {
    target: &'a EvalTarget,
    prompt: ClickPrompt,
    choices: Vec<MethodChoice>,
}

impl ClickedTarget<'_> {
    /// Returns whether, at every time of the ground truth, some ids identify the material that was clicked at time
    /// `from`.
    fn is_known_at_all_times(&self, truth: &Truth, from: f64) -> bool {
        let own = truth.file.segments.iter().filter(|s| self.target.ids.contains(&s.id));
        let pictures = own.flat_map(|s| &s.frames).map(|f| f.time);
        truth.volume_times().into_iter().chain(pictures).all(|t| truth.ids_at(&self.target.ids, from, t).is_some())
    }
}

/// Returns what a method selects: at its fixed setting, which knows only where the clicks are, and by the oracle.
fn choose(
    method: SelectionMethod,
    scenery: Scenery<'_>,
    prompt: &ClickPrompt,
    options: &SegmentEvalOptions,
    (scene, time): (&Scene, f64),
) -> Result<MethodChoice, SegmentEvalError> {
    let setting = MethodSetting::fixed(method, scenery.config);
    let next = |members: &[u32]| prompt.next(&oracle::flags(members, scenery.at.len()));
    let mut fixed = fixed(scenery, (method, &setting), prompt.first(), options.clicks.max(1), next)?;
    let best = || oracle::best(scenery, method, prompt, options.clicks.max(1));
    let mut oracle = options.oracle.then(best).transpose()?;
    if matches!(method, SelectionMethod::Fine | SelectionMethod::CoarseFine) {
        // as `segment pick` does, and the user waits for it
        for MethodSelection { selected, seconds, .. } in [Some(&mut fixed), oracle.as_mut()].into_iter().flatten() {
            let started = Instant::now();
            let within = scenery.searched(method, &selected.members);
            selected.members =
                propagate(scene, &selected.members, &within, time, scenery.config).map_err(|e| e.to_string())?;
            *seconds += started.elapsed().as_secs_f64();
        }
    }
    Ok(FixedAndOracle { fixed, oracle })
}

fn outcome(chosen: MethodSelection) -> SelectionOutcome {
    SelectionOutcome {
        setting: chosen.setting,
        asked: chosen.selected.asked,
        fit: chosen.fit,
        clicks: chosen.clicks,
        gaussians: chosen.selected.members.len(),
        members: chosen.selected.members,
        click_seconds: chosen.seconds,
        ..SelectionOutcome::default()
    }
}

/// Returns the IoU in space of all selections at one time: by segment, then by method, in [0, 1]; `None` if the segment
/// is part of something larger then, or shows in pictures but is thinner than the cells, which do not hold it.
fn in_space(
    truth: &Truth,
    cells: &TruthCells<'_>,
    [from, time]: [f64; 2],
    clicked: &[ClickedTarget<'_>],
) -> Result<Vec<Vec<FixedAndOracle<Option<f64>>>>, SegmentEvalError> {
    let mut out = Vec::new();
    for one in clicked {
        let ids = truth.ids_at(&one.target.ids, from, time);
        let ids = ids.filter(|ids| cells.hold(ids) || !truth.is_pictured(ids, time));
        let of = |chosen: &MethodSelection| match &ids {
            Some(ids) => cells.iou(&chosen.selected, ids).map_err(|e| e.to_string()),
            None => Ok(None),
        };
        let mut row = Vec::new();
        for choice in &one.choices {
            let fixed = of(&choice.fixed)?;
            let oracle = match &choice.oracle {
                Some(same) if same.selected == choice.fixed.selected => Some(fixed),
                other => other.as_ref().map(of).transpose()?,
            };
            row.push(FixedAndOracle { fixed, oracle });
        }
        out.push(row);
    }
    Ok(out)
}

/// Returns the scores of each method in each frame, and adds a row of pictures to the sheet.
fn in_pictures(
    judge: &SelectionJudge<'_>,
    deformed: &mut ScenesByTime<'_>,
    clicked: &ClickedTarget<'_>,
    time: f64,
    methods: &[SelectionMethod],
    pictures: &mut Vec<(String, RgbImage)>,
) -> Result<Vec<FixedAndOracle<Vec<FrameScore>>>, SegmentEvalError> {
    let empty = |c: &MethodChoice| FixedAndOracle { fixed: Vec::new(), oracle: c.oracle.as_ref().map(|_| Vec::new()) };
    let mut scores: Vec<FixedAndOracle<Vec<FrameScore>>> = clicked.choices.iter().map(empty).collect();
    let frames = &clicked.target.frames;
    let shown = nearest(frames, time, |f| f.time).and_then(|near| frames.iter().position(|f| f.time == near.time));
    for (i, frame) in frames.iter().enumerate() {
        let truth = frame.load()?;
        let at = deformed.at(frame.time);
        let (w, h) = (frame.camera.width as usize, frame.camera.height as usize);
        let picture = |rgb: &[f32]| {
            let rgba: Vec<f32> = rgb.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], 1.0]).collect();
            to_rgb8(&rgba, w, h)
        };
        if shown == Some(i) {
            let name = format!("{}, t = {:.2}", clicked.target.name, frame.time);
            pictures.push((name, picture(&judge.shown(&truth))));
        }
        for ((choice, scores), method) in clicked.choices.iter().zip(&mut scores).zip(methods) {
            let (score, render) = judge.score(at, &choice.fixed.selected, frame, &truth)?;
            if shown == Some(i) {
                let iou = score.iou.map_or("-".into(), |v| format!("{:.1} %", 100.0 * v));
                pictures.push((format!("{method} {iou}"), picture(&render)));
            }
            if let (Some(oracle), Some(scores)) = (&choice.oracle, &mut scores.oracle) {
                let same = oracle.selected == choice.fixed.selected;
                scores.push(if same { score.clone() } else { judge.score(at, &oracle.selected, frame, &truth)?.0 });
            }
            scores.fixed.push(score);
        }
    }
    Ok(scores)
}

/// The scene at the times of the ground truth, each deformed once.
struct ScenesByTime<'a> {
    scene: &'a Scene,
    known: BTreeMap<u64, HostGaussians>,
}

impl ScenesByTime<'_> {
    fn at(&mut self, time: f64) -> &HostGaussians {
        // only a few times are kept: if each view had its own, they would hold the scene hundreds of times
        if self.known.len() > 16 && !self.known.contains_key(&time.to_bits()) {
            self.known.clear();
        }
        self.known.entry(time.to_bits()).or_insert_with(|| self.scene.host_at(time as f32))
    }
}
