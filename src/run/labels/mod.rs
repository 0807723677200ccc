//! Labels of a run's segments on the voxels of its volume: which segments count (`choice`), where the voxels lie
//! (`grid`), and the ground truth to compare with (`truth`). How Gaussians vote for a voxel is in `segment::voxels`;
//! the files are written by `export::labels`.

mod choice;
mod grid;
mod truth;

pub use grid::LabelGrid;
pub use truth::{Agreement, Score, Truth};

use super::selection::Selection;
use super::{OpenRun, RunError};
use crate::export::labels::NamedLabel;
use crate::memory::{Budget, product};
use crate::prepare::PrepareRecord;
use crate::segment::segmentation::Segmentation;
use crate::segment::voxels::{LabelledCloud, Vote, label_voxels};
use crate::shell;
use choice::Choice;
use std::path::{Path, PathBuf};

/// Bytes per voxel: the votes, the labels, the truth to compare with, and what is written.
const VOXEL_BYTES: usize = 24;

/// Which labels to compute, and on which voxels.
#[derive(Debug, Clone, Default)]
pub struct LabelPlan {
    /// Names of segments; those without parts if empty.
    pub segments: Vec<String>,
    /// Voxels along x, y, z; those of the prepared volume if `None`.
    pub dims: Option<[usize; 3]>,
    /// Volume file whose voxels are used.
    pub like: Option<PathBuf>,
    /// Density of Gaussians above which a voxel belongs to a segment.
    pub threshold: Option<f32>,
    /// Whether to label the scene with the run's edits, not as trained.
    pub edited: bool,
}

/// Labels of a run's segments, which can be computed at any time.
pub struct Labels<'r> {
    run: &'r OpenRun,
    selection: Selection,
    vote: Vote,
    /// Label of each Gaussian, 0 for none.
    labels: Vec<u32>,
    /// Names of the segments, labelled from 1 in this order.
    pub names: Vec<String>,
    /// The same with values and colours, for files.
    pub listed: Vec<NamedLabel>,
    /// The voxels.
    pub grid: LabelGrid,
    /// The dataset that the voxels come from.
    pub data: PathBuf,
    /// What had to be assumed about the voxels, and what the reader of their file reports, one sentence each.
    pub notes: Vec<String>,
}

impl<'r> Labels<'r> {
    /// Chooses segments and voxels.
    ///
    /// # Errors
    /// If the run has no segments or a name is unknown, or if the voxels are unknown or do not fit the dataset or
    /// memory.
    pub fn new(run: &'r OpenRun, plan: &LabelPlan) -> Result<Self, RunError> {
        let all = run.segments()?;
        let Choice { names, labels } = choice::choose(&all, &plan.segments).map_err(RunError::input)?;
        if names.is_empty() {
            let (path, word) = (run.path.display(), shell::path(&run.path));
            return Err(RunError::input(format!("{path}: no segments yet; run `volseggs segment coarse {word}`")));
        }
        let listed = listed(&names, &all)?;
        let selection = Selection::open(run, &plan.segments, plan.edited)?;
        let data = run.dataset()?;
        let record = PrepareRecord::read(&data).map_err(RunError::input)?;
        let record = record.map(|record| record.normalised(&run.record.normalisation));
        let (grid, notes) = grid::choose(run, &data, record.as_ref(), plan.dims, plan.like.as_deref())?;
        check_memory(&grid, plan.like.as_deref())?;
        let vote = plan.threshold.map_or(Vote::default(), |threshold| Vote { threshold, ..Vote::default() });
        Ok(Self { run, selection, vote, labels, names, listed, grid, data, notes })
    }

    /// Returns the labels of the voxels `[z, y, x]` at `time` in [0, 1], x fastest; 0 is none.
    ///
    /// # Errors
    /// If an edit cannot be applied, or there are more labels than a volume can hold.
    pub fn at(&self, time: f64) -> Result<Vec<u16>, RunError> {
        let at = self.grid.along(self.selection.edited(&self.run.scene, time as f32)?);
        let cloud = LabelledCloud {
            means: &at.means,
            rotations: &at.rotations,
            log_scales: &at.log_scales,
            opacity: &at.opacity(),
            labels: &self.labels,
        };
        label_voxels(&cloud, &self.grid.scene, &self.vote).map_err(RunError::input)
    }
}

fn check_memory(grid: &LabelGrid, like: Option<&Path>) -> Result<(), RunError> {
    let [x, y, z] = grid.file.dims;
    let what = match like {
        Some(file) => format!("--like {} ({x} x {y} x {z} voxels)", file.display()),
        None => format!("--dims {x},{y},{z}"),
    };
    Budget::now().check(what, product(&[x, y, z, VOXEL_BYTES])).map_err(RunError::input)
}

fn listed(names: &[String], all: &Segmentation) -> Result<Vec<NamedLabel>, RunError> {
    let mut listed = Vec::with_capacity(names.len());
    for (i, name) in names.iter().enumerate() {
        let value = u16::try_from(i + 1).map_err(|_| {
            RunError::input(format!("{} segments, but a volume holds at most 65535; name some", names.len()))
        })?;
        let colour = all.get(name).map_err(RunError::input)?.colour.map(|c| c.clamp(0.0, 1.0));
        listed.push(NamedLabel { value, name: name.clone(), colour });
    }
    Ok(listed)
}
