//! The datasets of a sweep: existing folders, and synthetic scenes that are rendered before the first run.

use super::SweepError;
use super::file::{DataSource, SweepFile, SyntheticSpec};
use super::key::short_hash;
use crate::data::dataset::measured_fingerprint;
use crate::data::{Dataset, OpenOptions, SplitName, Truth};
use crate::log::progress;
use crate::prepare::views::{TrainingTimes, ViewOptions};
use crate::prepare::{
    self, EVEN_STEPS, IMAGES, PrepareError, PrepareOptions, PrepareSource, SegmentOptions, SegmentSteps, TRUTH,
    image_count, prepare,
};
use crate::volume::transfer::TransferFunction;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// Time steps of a synthetic series; training uses some of them, the test views all.
const STEPS: usize = 60;
/// Test views that show each segment alone, if each view has a time of its own.
const OWN_VIEWS: usize = 7;

/// A dataset of the plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DataPlan {
    /// Its folder.
    pub folder: PathBuf,
    /// Where it comes from.
    pub source: DataSource,
    /// Number of training views.
    pub views: usize,
    /// Number of test views.
    pub test_views: usize,
    /// Width and height of the images as stored on disk.
    pub size: [u32; 2],
    /// What distinguishes its test views and ground truth from others with the same training views.
    pub measured: String,
}

/// The last name in the path of a folder, even if it is given as `.` or with a trailing slash.
fn folder_name(folder: &Path) -> String {
    let whole = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
    whole.file_name().map_or_else(|| folder.display().to_string(), |n| n.to_string_lossy().into_owned())
}

/// The datasets of `file`, or those `given` instead; synthetic ones will be below `out`.
pub(super) fn datasets(
    file: &SweepFile,
    given: &[PathBuf],
    out: &Path,
) -> Result<BTreeMap<String, DataPlan>, SweepError> {
    let sources = if given.is_empty() {
        file.datasets()?
    } else {
        given.iter().map(|d| (folder_name(d), DataSource::Folder(d.clone()))).collect()
    };
    for (i, (name, _)) in sources.iter().enumerate() {
        if sources[..i].iter().any(|(other, _)| other == name) {
            let problem = format!("two datasets are called \"{name}\"; name them in the file: [data] one = \"...\"");
            return Err(file.wrong("--data", problem));
        }
    }
    if sources.is_empty() {
        let problem = "no dataset is given; add [data] with NAME = \"FOLDER\", or pass --data FOLDER";
        return Err(file.wrong("data", problem));
    }
    let plan = |(name, source): (String, DataSource)| {
        let bad = |e: &dyn Display| file.wrong(format!("data.{name}"), e);
        let planned = match &source {
            DataSource::Folder(folder) => {
                let open = OpenOptions { downscale: 1, splits: &[], max_views: None };
                let dataset = Dataset::open(folder, &open).map_err(|e| bad(&e))?;
                if !Dataset::present(folder).contains(&SplitName::Test) {
                    let json = SplitName::Test.json_path(folder);
                    return Err(bad(&format!("{} is missing; runs are measured on test views", json.display())));
                }
                let test = SplitName::Test.views(folder).map_err(|e| bad(&e))?;
                DataPlan {
                    folder: std::fs::canonicalize(folder).map_err(|e| bad(&e))?,
                    views: dataset.train.frames.len(),
                    test_views: test.frames.len(),
                    size: [dataset.train.images.width, dataset.train.images.height],
                    measured: measured_fingerprint(folder, SplitName::Test).map_err(|e| bad(&e))?,
                    source,
                }
            }
            DataSource::Synthetic(spec) => {
                // ground truth made by another version may differ
                let truth = if spec.segments { format!("truth {TRUTH}") } else { String::new() };
                let text = recipe(spec).map_err(|e| bad(&e))? + &truth;
                let folder = out.join("datasets").join(format!("{name}-{}", short_hash(&text)));
                if !is_rendered(&folder) {
                    SyntheticRendering::new(spec).and_then(|r| r.check(&folder)).map_err(|e| bad(&e))?;
                }
                DataPlan {
                    folder,
                    views: spec.times.saturating_mul(spec.views),
                    test_views: spec.test_views,
                    size: [spec.size; 2],
                    measured: truth,
                    source,
                }
            }
        };
        Ok((name, planned))
    };
    sources.into_iter().map(plan).collect()
}

/// Refuses datasets whose segments are not known, for sweeps that measure segments.
pub(super) fn check_truth(data: &BTreeMap<String, DataPlan>, file: &SweepFile) -> Result<(), SweepError> {
    for (name, data) in data {
        let problem = match &data.source {
            DataSource::Folder(folder) => Truth::read(folder)
                .err()
                .map(|e| format!("segments are to be measured, but their ground truth cannot be read: {e}")),
            DataSource::Synthetic(spec) => {
                (!spec.segments).then(|| "segments are to be measured; add segments = true".to_owned())
            }
        };
        if let Some(problem) = problem {
            return Err(file.wrong(format!("data.{name}"), problem));
        }
    }
    Ok(())
}

/// What distinguishes one dataset from another in a key.
pub(super) fn fingerprint(data: &DataPlan, downscale: u32, file: &SweepFile, name: &str) -> Result<String, SweepError> {
    let bad = |e: &dyn Display| file.wrong(format!("data.{name}"), e);
    match &data.source {
        DataSource::Folder(folder) => {
            let open = OpenOptions { downscale, splits: &[], max_views: None };
            Ok(Dataset::open(folder, &open).map_err(|e| bad(&e))?.fingerprint())
        }
        DataSource::Synthetic(spec) => {
            if downscale == 0 || spec.size % downscale != 0 {
                return Err(bad(&format!("data.downscale = {downscale} does not divide size = {}", spec.size)));
            }
            recipe(spec).map_err(|e| bad(&e))
        }
    }
}

/// What determines the images of a synthetic scene.
fn recipe(spec: &SyntheticSpec) -> serde_json::Result<String> {
    // the first version of the images was keyed by the text alone
    let images = if IMAGES > 1 { format!("images {IMAGES}") } else { String::new() };
    Ok(serde_json::to_string(spec)? + &images)
}

impl DataPlan {
    /// Number of pictures of single segments that [`DataPlan::make`] renders.
    pub(super) fn segment_images(&self) -> usize {
        let DataSource::Synthetic(spec) = &self.source else { return 0 };
        let segments = spec.scene().map_or(0, |scene| scene.segment_names().len());
        match spec.segment_views {
            _ if !spec.segments => 0,
            Some(views) => views.saturating_mul(EVEN_STEPS).saturating_mul(segments),
            None => OWN_VIEWS * segments,
        }
    }

    /// Renders the dataset if it is a synthetic scene that has not been rendered yet.
    ///
    /// # Errors
    /// If it cannot be rendered, or `stop` was raised.
    pub fn make(&self, stop: &AtomicBool) -> Result<(), SweepError> {
        let DataSource::Synthetic(spec) = &self.source else { return Ok(()) };
        if is_rendered(&self.folder) {
            return Ok(());
        }
        let rendering = SyntheticRendering::new(spec).map_err(|e| SweepError::io(&self.folder, e))?;
        rendering.make(&self.folder, stop)
    }
}

/// Whether the dataset of a synthetic scene is in its folder, where it appears whole.
fn is_rendered(folder: &Path) -> bool {
    SplitName::Test.json_path(folder).is_file()
}

/// What `prepare` is asked for to make a synthetic scene.
struct SyntheticRendering {
    source: PrepareSource,
    transfer: TransferFunction,
    options: PrepareOptions,
}

impl SyntheticRendering {
    fn new(spec: &SyntheticSpec) -> Result<Self, PrepareError> {
        let scene = spec.scene().map_err(PrepareError::Options)?;
        let mut transfer = scene.transfer_function()?;
        spec.shading.apply(&mut transfer.shading);
        let segments = match spec.segment_views {
            _ if !spec.segments => SegmentOptions::NONE,
            Some(views) => SegmentOptions { views, ..SegmentOptions::default() },
            None => SegmentOptions { views: OWN_VIEWS, steps: SegmentSteps::OfViews, label_images: true },
        };
        let views = ViewOptions {
            size: [spec.size; 2],
            times: TrainingTimes::Count(spec.times),
            views_per_time: spec.views,
            test_views: spec.test_views,
            ..ViewOptions::default()
        };
        let options = PrepareOptions { views, segments, ..PrepareOptions::default() };
        Ok(Self {
            source: PrepareSource::Synthetic { scene, dims: [spec.voxels(); 3], steps: STEPS },
            transfer,
            options,
        })
    }

    /// Refuses what `prepare` would refuse.
    fn check(&self, folder: &Path) -> Result<(), PrepareError> {
        prepare::check(&self.source, &self.transfer, &self.options, folder)
    }

    fn make(&self, folder: &Path, stop: &AtomicBool) -> Result<(), SweepError> {
        let images = image_count(&self.source, &self.options);
        errln!("{}: rendering {images} images", folder.display());
        let bar = progress::bar(images, "images");
        let step = |n| bar.set_position(n as u64);
        let made = prepare(&self.source, &self.transfer, &self.options, folder, &step, stop);
        bar.finish_and_clear();
        match made {
            Ok(_) => Ok(()),
            Err(PrepareError::Interrupted) => Err(SweepError::Interrupted),
            // another process of the same sweep was faster
            Err(_) if is_rendered(folder) => Ok(()),
            Err(e) => Err(SweepError::io(folder, e)),
        }
    }
}
