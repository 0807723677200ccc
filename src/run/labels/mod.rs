//! Labels of a run's segments on the voxels of its volume: which segments count (`choice`), where the voxels lie
//! (`grid`), and the ground truth to compare with (`truth`). Where a segment is, `segment::place` says; the files are
//! written by `export::labels`.

mod choice;
pub(super) mod grid;
mod truth;

pub use grid::LabelGrid;
pub use truth::{Agreement, LabelScore, LabelTruth};

use super::selection::Selection;
use super::{OpenRun, RunError};
use crate::export::labels::NamedLabel;
use crate::prepare::PrepareRecord;
use crate::segment::place::{Cloud, SHARE, SegmentPlaces, scene_grid};
use crate::segment::segmentation::Segmentation;
use crate::shell;
use choice::LabelChoice;
use std::path::PathBuf;

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
    /// Share of its typical local opacity down to which a segment is at a place; [`SHARE`] if `None`.
    pub threshold: Option<f32>,
    /// Whether to label the scene with the run's edits, not as trained.
    pub edited: bool,
}

/// Labels of a run's segments, which can be computed at any time.
pub struct RunLabels<'r> {
    run: &'r OpenRun,
    selection: Selection,
    share: f32,
    /// Label of each Gaussian, 0 for none; those above the number of `names` are of segments that are not exported.
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

impl<'r> RunLabels<'r> {
    /// Chooses segments and voxels.
    ///
    /// # Errors
    /// If the run has no segments or a name is unknown, or if the voxels are unknown or do not fit the dataset or
    /// memory.
    pub fn new(run: &'r OpenRun, plan: &LabelPlan) -> Result<Self, RunError> {
        let all = run.segments()?;
        let LabelChoice { names, labels } = choice::choose(&all, &plan.segments).map_err(RunError::input)?;
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
        grid::check_memory(&grid, plan.like.as_deref(), VOXEL_BYTES)?;
        let share = plan.threshold.unwrap_or(SHARE);
        Ok(Self { run, selection, share, labels, names, listed, grid, data, notes })
    }

    /// Labels the voxels at `time` in [0, 1].
    ///
    /// # Errors
    /// If an edit cannot be applied, or there are more labels than a volume can hold.
    pub fn labels_at(&self, time: f64) -> Result<VoxelLabels, RunError> {
        let at = self.selection.edited(&self.run.scene, time as f32)?.widened(self.run.widening());
        let (opacity, spec) = (at.opacity(), &self.run.scene.spec);
        let grid = scene_grid(spec.centre, spec.half_size);
        let cloud = Cloud::new(&at, &opacity, &self.labels);
        let places = SegmentPlaces::new(cloud, &grid, self.share).map_err(RunError::input)?;
        let turned = self.grid.along(at.clone());
        let turned = Cloud::new(&turned, &opacity, &self.labels);
        let in_scene = |place| self.grid.in_scene(place);
        let mut ids = places.labels_on(turned, &self.grid.scene, in_scene).map_err(RunError::input)?;
        let last = self.names.len();
        ids.iter_mut().filter(|id| usize::from(**id) > last).for_each(|id| *id = 0);
        let mut shares: Vec<Option<f64>> = places.shares().into_iter().skip(1).take(last).collect();
        shares.resize(last, None);
        Ok(VoxelLabels { ids, shares })
    }
}

/// Labels of voxels at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct VoxelLabels {
    /// The label of each voxel `[z, y, x]`, x fastest; 0 is none.
    pub ids: Vec<u16>,
    /// For each label, the share of the segment's content whose Gaussians lie in its place, in [0, 1]; `None` if none
    /// of its Gaussians is visible.
    pub shares: Vec<Option<f64>>,
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
