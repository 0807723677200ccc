//! Export of a run's Gaussians, and of the labels of its segments, to files of other programs.

mod output;
mod refit;

pub use output::{Output, Record};
pub use refit::{MEASURED, Refit, RefitPlan};

use super::labels::Labels;
use super::selection::Selection;
use super::{OpenRun, RunError};
use crate::data::calibration::AxisConvention;
use crate::export::labels::{LabelVolume, LabelsError, write_nrrd, write_vti};
use crate::export::splat_file::SplatFileError;
use crate::export::{ply, spz};
use crate::model::Model;
use std::path::Path;

/// The format of a file of Gaussians.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SplatFormat {
    /// That of 3DGS viewers, as exact as the scene.
    Ply,
    /// Niantic's, about a fifth of the size.
    Spz,
}

impl SplatFormat {
    /// Returns the file name extension.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Self::Ply => "ply",
            Self::Spz => "spz",
        }
    }
}

/// The format of a label volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LabelFormat {
    /// For 3D Slicer and others, with the meaning of the axes of space that the file states: that of the data if `None`.
    Nrrd(Option<Option<AxisConvention>>),
    /// For VTK and ParaView.
    Vti,
}

impl LabelFormat {
    /// Returns the file name extension.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Self::Nrrd(_) => "nrrd",
            Self::Vti => "vti",
        }
    }

    /// Returns the meaning of the axes of space that was chosen, if any.
    #[must_use]
    pub fn space(self) -> Option<Option<AxisConvention>> {
        match self {
            Self::Nrrd(space) => space,
            Self::Vti => None,
        }
    }
}

/// What was written.
#[derive(Clone, Debug, PartialEq)]
pub struct Written {
    /// Gaussians in each file.
    pub gaussians: usize,
    /// What refitting achieved for each file; empty without it.
    pub refits: Vec<Refit>,
}

/// Writes what is shown at each of `times` in [0, 1] to its place in `output`: edited, reduced to the selected
/// segments, without the Gaussians that edits hide; with a `plan`, refitted to how other programs draw them.
/// Returns `None` if `goes_on`, called after each step and after each file, stopped it.
///
/// # Errors
/// If nothing is left to write, an edit cannot be applied, refitting fails, or a file cannot be written.
pub fn write_splats(
    run: &OpenRun,
    shown: &Selection,
    times: &[f64],
    output: &Output,
    format: SplatFormat,
    plan: Option<&RefitPlan>,
    mut goes_on: impl FnMut() -> bool,
) -> Result<Option<Written>, RunError> {
    // what is hidden is hidden at every time
    let count = shown.visible(&run.scene, 0.0)?.len();
    if count == 0 {
        return Err(RunError::input(
            "nothing to write: no Gaussian is left; see `volseggs edit list`, or pass --no-edits",
        ));
    }
    let mut refits = Vec::new();
    for (i, time) in times.iter().enumerate() {
        let mut at = shown.visible(&run.scene, *time as f32)?.with_unit_rotations();
        if let Some(plan) = plan {
            let (rendering, device) = (run.scene.spec.rendering(), run.scene.device());
            let refitted = refit::refit(&at, rendering, plan, &device, &mut goes_on)?;
            let Some((gaussians, refit)) = refitted else { return Ok(None) };
            at = gaussians;
            refits.push(refit);
        }
        let write = match format {
            SplatFormat::Ply => ply::write,
            SplatFormat::Spz => spz::write,
        };
        write(&at, &output.place(i).0).map_err(|e| match e {
            SplatFileError::Replace(e) => e.into(),
            // an edit moved or scaled them beyond what the format holds
            e @ SplatFileError::Shape(_) => RunError::input(format!("{e}; write .ply, or pass --no-edits")),
            e => RunError::failure(e),
        })?;
        // after the last file there is nothing left to stop
        if !goes_on() && i + 1 < times.len() {
            return Ok(None);
        }
    }
    Ok(Some(Written { gaussians: count, refits }))
}

/// Writes the label of each voxel, as returned by [`Labels::at`], to `path`; `edited` says whether they are of the
/// edited scene.
///
/// # Errors
/// If something else is there, or it cannot be written.
pub fn write_labels(
    path: &Path,
    labels: &Labels<'_>,
    ids: &[u16],
    edited: bool,
    format: LabelFormat,
) -> Result<(), RunError> {
    let (grid, axes) = labels.grid.stated(format.space());
    let volume = LabelVolume { grid, axes, unit: labels.grid.unit.as_deref(), ids, names: &labels.listed, edited };
    let written = match format {
        LabelFormat::Vti => write_vti(path, &volume),
        LabelFormat::Nrrd(_) => write_nrrd(path, &volume),
    };
    written.map_err(|e| match e {
        LabelsError::Replace(e) => e.into(),
        e => RunError::failure(e),
    })
}
