//! Cost of drawing: ray casting the volumes of a run's dataset, compared with drawing the run instead. This is the
//! paper's table of direct volume rendering and splatting, from measured times.
//!
//! Each side should be measured in a process of its own, as peak memory is a property of the process.

use super::{AnyRun, RunError};
use crate::data::Split;
use crate::eval::speed;
use crate::memory::{MemoryBudget, peak_memory, product};
use crate::prepare::PrepareRecord;
use crate::volume::raycast::RayCaster;
use crate::volume::series::Series;
use crate::volume::transfer::TransferFunction;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Bytes per voxel while a volume is read and laid out.
const VOXEL_BYTES: usize = 16;
/// Largest difference between components of the directions of axes that are the same.
const DIRECTION: f64 = 1e-3;

/// A dataset made by `prepare`, with what is needed to draw its volumes again as they were.
#[derive(Debug)]
pub struct PreparedDataset {
    folder: PathBuf,
    record: PrepareRecord,
    transfer: TransferFunction,
}

/// Cost of drawing the volumes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VolumeCosts {
    /// Number of steps in the series.
    pub steps: usize,
    /// Bytes of its files.
    pub raw_bytes: u64,
    /// Number of steps loaded, evenly spread.
    pub loaded: usize,
    /// Number of views drawn, over all of these steps.
    pub views: usize,
    /// Seconds until a step can be drawn: reading it, from disk where the system can drop its cache, and laying it out.
    pub load_seconds: f64,
    /// Seconds per view.
    pub view_seconds: f64,
    /// Peak memory of a process that does nothing else, bytes; 0 if unknown.
    pub peak_memory_bytes: u64,
}

/// Cost of drawing the run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunCosts {
    /// Bytes of the model file, which covers all times.
    pub model_bytes: u64,
    /// Seconds to open it.
    pub load_seconds: f64,
    /// Seconds per view at any time, including the copy of the image to the host.
    pub view_seconds: f64,
    /// Peak memory of the process, without that of a GPU, bytes; 0 if unknown.
    pub peak_memory_bytes: u64,
    /// Seconds spent making the images; `None` for images from elsewhere.
    pub preparation_seconds: Option<f64>,
    /// Seconds of training.
    pub training_seconds: f64,
}

impl PreparedDataset {
    /// Opens the dataset in `folder`.
    ///
    /// # Errors
    /// If it was not made by `prepare`, or one of its files is damaged.
    pub fn open(folder: &Path) -> Result<Self, RunError> {
        let record = PrepareRecord::read(folder).map_err(RunError::input)?.ok_or_else(|| {
            RunError::input(format!(
                "{}: no prepare.json in it, so it is unknown how its volumes were drawn; give a dataset made by \
                 `volseggs prepare` with --data",
                folder.display()
            ))
        })?;
        let path = folder.join("transfer-function.toml");
        let transfer = TransferFunction::load(&path.to_string_lossy()).map_err(RunError::input)?;
        Ok(Self { folder: folder.to_owned(), record, transfer })
    }

    /// Loads `steps` evenly spread steps of `series`, and draws `views`, distributed over them.
    ///
    /// # Errors
    /// As for [`PreparedDataset::check`], or if a step cannot be read.
    pub fn draw_volumes(&self, series: &Series, views: &Split, steps: usize) -> Result<VolumeCosts, RunError> {
        self.check(series)?;
        let steps = steps.clamp(1, series.len());
        let placement = self.record.placement();
        let (mut loading, mut drawing, mut drawn) = (0.0, 0.0, 0);
        for k in 0..steps {
            series.files().iter().for_each(|file| forget(file));
            let started = Instant::now();
            let volume = series.load(k * series.len() / steps).map_err(RunError::input)?;
            let record = &self.record;
            let caster = RayCaster::new(&volume, None, &self.transfer, record.span, placement, record.step);
            drop(volume);
            loading += started.elapsed().as_secs_f64();
            let started = Instant::now();
            for frame in views.frames.iter().skip(k).step_by(steps) {
                drop(caster.render(&frame.camera, None));
                drawn += 1;
            }
            drawing += started.elapsed().as_secs_f64();
        }
        Ok(VolumeCosts {
            steps: series.len(),
            raw_bytes: series.files().iter().filter_map(|file| file.metadata().ok()).map(|m| m.len()).sum(),
            loaded: steps,
            views: drawn,
            load_seconds: loading / steps as f64,
            view_seconds: drawing / drawn.max(1) as f64,
            peak_memory_bytes: peak_memory(),
        })
    }

    /// Checks, as far as possible, that the dataset was made from these volumes, and that they fit into memory.
    ///
    /// # Errors
    /// If not; the error says what the dataset was made from, or how much memory there is.
    pub fn check(&self, series: &Series) -> Result<(), RunError> {
        let (dims, made) = (series.grid().dims, &self.record);
        if (dims, series.len()) != (made.dims, made.steps) {
            return Err(RunError::input(format!(
                "--volume: {} steps of {dims:?} voxels, but {} was made of {} of {:?}; give those",
                series.len(),
                self.folder.display(),
                made.steps,
                made.dims
            )));
        }
        if !series.grid().directions.agree(&made.directions, DIRECTION) {
            return Err(RunError::input(format!(
                "--volume: axes along {}, but those of the volumes that {} was made of were along {}; give those",
                series.grid().directions,
                self.folder.display(),
                made.directions
            )));
        }
        let bytes = product(&[dims[0], dims[1], dims[2], VOXEL_BYTES]);
        MemoryBudget::now().check(format!("a volume of {dims:?} voxels"), bytes).map_err(RunError::input)
    }
}

/// Asks the system to drop its cache of a file, so that the next read goes to the disk; where it does not, a file that
/// was read before loads faster.
fn forget(file: &Path) {
    #[cfg(target_os = "linux")]
    if let Ok(file) = std::fs::File::open(file) {
        // only a hint
        let _ = rustix::fs::fadvise(&file, 0, None, rustix::fs::Advice::DontNeed);
    }
    #[cfg(not(target_os = "linux"))]
    let _ = file;
}

/// Measures the cost of drawing a run that took `load_seconds` to open and was trained on the dataset in `data`.
///
/// # Errors
/// If there is no view, the device fails, or the model file is missing.
pub fn draw_run(run: &AnyRun, views: &Split, data: &Path, load_seconds: f64) -> Result<RunCosts, RunError> {
    let speed = speed::measure(run.model(), views).map_err(RunError::failure)?;
    let model = std::fs::metadata(&run.scene_path);
    let model = model.map_err(|e| RunError::failure(format!("{}: {e}", run.scene_path.display())))?;
    Ok(RunCosts {
        model_bytes: model.len(),
        load_seconds,
        view_seconds: 1.0 / speed.fps_with_copy,
        peak_memory_bytes: peak_memory(),
        preparation_seconds: PrepareRecord::read(data).map_err(RunError::input)?.map(|record| record.seconds),
        training_seconds: run.training_seconds(),
    })
}

/// Formats both sides as a Markdown table.
pub fn table(volumes: &VolumeCosts, run: &RunCosts) -> String {
    let gigabytes = |bytes: u64| if bytes == 0 { "unknown".to_owned() } else { format!("{:.2}", bytes as f64 / 1e9) };
    let milliseconds = |seconds: f64| format!("{:.1}", 1e3 * seconds);
    let minutes = |seconds: f64| format!("{:.2}", seconds / 60.0);
    let before = run.preparation_seconds.map_or_else(|| "unknown".to_owned(), minutes);
    let another = volumes.load_seconds + volumes.view_seconds;
    let rows = [
        ("data, MB", format!("{:.2}", volumes.raw_bytes as f64 / 1e6), format!("{:.2}", run.model_bytes as f64 / 1e6)),
        ("memory, GB", gigabytes(volumes.peak_memory_bytes), gigabytes(run.peak_memory_bytes)),
        ("before the first image, min", "0".to_owned(), format!("{before} + {}", minutes(run.training_seconds))),
        (
            "loading, s",
            format!("{:.3} per step", volumes.load_seconds),
            format!("{:.3} for all {} steps", run.load_seconds, volumes.steps),
        ),
        ("drawing a view, ms", milliseconds(volumes.view_seconds), milliseconds(run.view_seconds)),
        ("a view at another step, ms", milliseconds(another), milliseconds(run.view_seconds)),
    ];
    let mut text = "| | volume rendering | splatting |\n|---|--:|--:|\n".to_owned();
    for (what, left, right) in rows {
        text += &format!("| {what} | {left} | {right} |\n");
    }
    text + &format!(
        "\nDrawing a view from the volumes takes {:.2} times as long, at another step {:.1} times ({} views at {} of \
         {} steps).\n",
        volumes.view_seconds / run.view_seconds,
        another / run.view_seconds,
        volumes.views,
        volumes.loaded,
        volumes.steps
    )
}
