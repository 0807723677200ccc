//! The affinity field of a run: read for clicks and splits, trained on the run's masks.

use super::{OpenRun, RunError};
use crate::config::types::segment::AffinityConfig;
use crate::memory::{MemoryBudget, product};
use crate::points::principal::principal;
use crate::segment::fine::AffinityField;
use crate::segment::fine::file::{self, AffinitySpec};
use crate::segment::fine::network::{FEATURES, PositionBox};
use crate::segment::fine::train::{FineError, train};
use crate::segment::fine::views::read_views;
use crate::segment::masks::MaskReader;
use crate::segment::segmentation::members_key;
use crate::shell;
use std::time::Instant;

/// Mask scale at which features are shown.
const SCALE: f32 = 0.5;

/// Progress of training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AffinityProgress {
    /// Views with masks are being read.
    Read {
        /// Views read so far.
        done: usize,
        /// Number of views in total.
        all: usize,
    },
    /// All views have been read and training begins.
    Begins {
        /// Views of segments.
        views: usize,
        /// Masks in them.
        masks: usize,
        /// Seconds spent reading them.
        seconds: f64,
    },
    /// A training step was taken.
    Step {
        /// Steps taken so far.
        done: usize,
        /// Running mean of the loss.
        loss: f64,
    },
}

/// Outcome of training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainedAffinity {
    /// Running mean of the loss at the end.
    pub loss: f64,
    /// Seconds spent on the steps alone.
    pub seconds: f64,
}

/// Opens the run's affinity field.
///
/// # Errors
/// If the field is missing, damaged, or was trained on another state of the scene.
pub fn open(run: &OpenRun) -> Result<(AffinityField, AffinitySpec), RunError> {
    let path = run.paths().affinity();
    if !path.exists() {
        let run_path = shell::path(&run.path);
        let masks = if run.paths().masks().exists() {
            String::new()
        } else {
            format!("`volseggs segment masks {run_path}` and then ")
        };
        return Err(RunError::input(format!(
            "{}: no affinity field; run {masks}`volseggs segment fine {run_path}`",
            path.display()
        )));
    }
    let (field, spec) = file::load(&path, &run.device()).map_err(RunError::input)?;
    if spec.scene != run.scene.fingerprint() {
        return Err(RunError::input(format!(
            "{}: trained on another state of this scene; run `volseggs segment fine` again",
            path.display()
        )));
    }
    Ok((field, spec))
}

/// Writes a field, trained at `time` on masks with the ascending `spreads` (scene units), to the run.
///
/// # Errors
/// If it cannot be written.
pub fn save(
    run: &OpenRun,
    field: &AffinityField,
    frame: PositionBox,
    time: f64,
    spreads: Vec<f32>,
) -> Result<(), RunError> {
    let spec = AffinitySpec { frame, time, scene: run.scene.fingerprint(), spreads };
    file::save(&run.paths().affinity(), field, &spec).map_err(RunError::failure)
}

/// Returns a colour for each of the scene's N Gaussians, `[N]`: the first three principal components of their affinity
/// features at [`SCALE`], each scaled from its 1st to its 99th percentile.
///
/// # Errors
/// As for [`open`].
pub(super) fn colours(run: &OpenRun) -> Result<Vec<[f32; 3]>, RunError> {
    let (field, spec) = open(run)?;
    let at = run.scene.host_at(spec.time as f32);
    let features = field.features(&spec.frame.encode(&at.means), SCALE);
    let (mean, axes) = principal(&features, FEATURES, 3);
    let mut colours = vec![[0.0; 3]; at.len()];
    for (k, axis) in axes.iter().enumerate() {
        let along =
            |row: &[f32]| row.iter().zip(&mean).zip(axis).map(|((v, m), a)| (f64::from(*v) - m) * a).sum::<f64>();
        let values: Vec<f64> = features.chunks_exact(FEATURES).map(along).collect();
        let mut sorted = values.clone();
        sorted.sort_by(f64::total_cmp);
        let [low, high] = [0.01, 0.99].map(|p| sorted.get((p * sorted.len() as f64) as usize).copied().unwrap_or(0.0));
        for (colour, v) in colours.iter_mut().zip(values) {
            colour[k] = ((v - low) / (high - low).max(1e-12)).clamp(0.0, 1.0) as f32;
        }
    }
    Ok(colours)
}

/// Trains the field on the run's masks and writes it to the run. Returns `None` if `goes_on` stopped the training; an
/// earlier field is then unchanged.
///
/// # Errors
/// If there are no masks, they do not match the run's segments, or the field cannot be written.
pub fn fit(
    run: &OpenRun,
    options: &AffinityConfig,
    seed: u64,
    mut goes_on: impl FnMut(AffinityProgress) -> bool,
) -> Result<Option<TrainedAffinity>, RunError> {
    let all = run.segments()?;
    let path = run.paths().masks();
    if !path.exists() {
        return Err(RunError::input(format!("{}: no masks yet; run `volseggs segment masks`", path.display())));
    }
    let started = Instant::now();
    let masks = MaskReader::open(&path).map_err(RunError::input)?;
    let header = masks.header().clone();
    if !(0.0..=1.0).contains(&header.time) {
        return Err(RunError::input(format!("{}: header, time: {} is not in [0, 1]", path.display(), header.time)));
    }
    // which pixels the masks of a view cover
    let covered = product(&[header.width as usize, header.height as usize, 2]);
    let what = format!("{}: pictures of {}x{} pixels", path.display(), header.width, header.height);
    MemoryBudget::now().check(what, covered).map_err(RunError::input)?;
    let at = run.scene.host_at(header.time as f32);
    let frame = PositionBox::around(&at.visible_means());
    let again = format!("run `volseggs segment masks {} --replace`", shell::path(&run.path));
    let keys: Vec<String> = all.segments.iter().map(|s| members_key(&s.members)).collect();
    let of = |(i, name): (usize, &String)| {
        let key = header.members.get(i);
        // by the Gaussians, as another segment may have the name by now
        if let Some((same, _)) = all.segments.iter().zip(&keys).find(|(_, k)| Some(*k) == key) {
            return Ok(same.members.clone());
        }
        let named =
            all.get(name).map_err(|e| RunError::input(format!("{}: masks of {name}: {e}; {again}", path.display())))?;
        if key.is_some() {
            return Err(RunError::input(format!(
                "{}: the Gaussians of segment {name} have changed since its masks were made; {again}",
                path.display()
            )));
        }
        Ok(named.members.clone())
    };
    let members = header.segments.iter().enumerate().map(of).collect::<Result<Vec<_>, RunError>>()?;
    let (rendering, device, mut done) = (run.scene.spec.rendering(), run.device(), 0);
    let (views, spreads) = read_views(&masks, (&at, rendering), &frame, &members, seed, &device, |_| {
        done += 1;
        goes_on(AffinityProgress::Read { done, all: header.views.len() });
    })
    .map_err(RunError::input)?;
    let seconds = started.elapsed().as_secs_f64();
    if !goes_on(AffinityProgress::Begins { views: views.len(), masks: spreads.len(), seconds }) {
        return Ok(None);
    }

    let (mut smooth, mut stopped) = (None, false);
    let started = Instant::now();
    let field = train(&views, options, seed, &device, |step, loss| {
        let mean = smooth.map_or(loss, |s: f64| 0.98 * s + 0.02 * loss);
        smooth = Some(mean);
        stopped = !goes_on(AffinityProgress::Step { done: step + 1, loss: mean });
        !stopped
    })
    .map_err(|e| match e {
        FineError::NoMasks => RunError::input(format!("{}: {e}", path.display())),
        FineError::NotFinite { .. } => RunError::input(e),
    })?;
    if stopped {
        return Ok(None);
    }
    let seconds = started.elapsed().as_secs_f64();
    save(run, &field, frame, header.time, spreads)?;
    Ok(Some(TrainedAffinity { loss: smooth.unwrap_or_default(), seconds }))
}
