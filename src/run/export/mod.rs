//! Export of a run's Gaussians, and of the labels of its segments, to files of other programs.

mod output;
mod refit;
mod units;

pub use output::{ExportOutput, ExportRecord};
pub use refit::{MEASURED, Refit, RefitPlan};
pub use units::ExportUnits;

use super::labels::RunLabels;
use super::selection::Selection;
use super::{OpenRun, RunError};
use crate::data::calibration::AxisConvention;
use crate::export::exporters::{Content, Exporter, LabelWriter};
use crate::export::labels::{LabelVolume, LabelsError};
use crate::export::ply::MAX_SH_DEGREE;
use crate::export::splat_file::{SplatFileError, SplatFileOptions};
use crate::model::Model;
use std::path::Path;

/// What the files of Gaussians hold.
#[derive(Clone, Debug, PartialEq)]
pub struct SplatPlan {
    /// Their format, which is one of Gaussians.
    pub format: &'static Exporter,
    /// Their coordinates; [`ExportUnits::Physical`] only if the run knows the physical space of its data.
    pub units: ExportUnits,
    /// Degree of the harmonics, see [`SplatFileOptions::sh_degree`].
    pub sh_degree: usize,
    /// How they are refitted to how other programs draw them, if so.
    pub refit: Option<RefitPlan>,
}

impl SplatPlan {
    /// Plans files as they are written by default.
    pub fn new(run: &OpenRun, format: &'static Exporter) -> Self {
        let refit = RefitPlan::new(run, None);
        Self { format, units: ExportUnits::Scene, sh_degree: MAX_SH_DEGREE, refit }
    }

    /// Number of steps in which each file is refitted; 0 as trained.
    pub fn refit_steps(&self) -> usize {
        self.refit.as_ref().map_or(0, |refit| refit.steps)
    }
}

/// What was written.
#[derive(Clone, Debug, PartialEq)]
pub struct WrittenExport {
    /// Gaussians in each file.
    pub gaussians: usize,
    /// What refitting achieved for each file; empty without it.
    pub refits: Vec<Refit>,
}

/// Writes what is shown at each of `times` in [0, 1] to its place in `output`: edited, reduced to the selected
/// segments, without the Gaussians that edits hide; as planned.
/// Returns `None` if `goes_on`, called after each step and after each file, stopped it.
///
/// # Errors
/// If nothing is left to write, an edit cannot be applied, refitting fails, or a file cannot be written.
pub fn write_splats(
    run: &OpenRun,
    shown: &Selection,
    times: &[f64],
    output: &ExportOutput,
    plan: &SplatPlan,
    mut goes_on: impl FnMut() -> bool,
) -> Result<Option<WrittenExport>, RunError> {
    // what is hidden is hidden at every time
    let all = shown.visible(&run.scene, 0.0)?;
    let count = all.len();
    if count == 0 {
        return Err(RunError::input(
            "nothing to write: no Gaussian is left; see `volseggs edit list`, or pass --no-edits",
        ));
    }
    let Content::Gaussians { write, log_scales, has_sh_degree } = &plan.format.content else {
        return Err(RunError::input(format!(".{} holds no Gaussians; write .ply", plan.format.extension)));
    };
    if *has_sh_degree && plan.sh_degree < MAX_SH_DEGREE {
        let least = all.baked().sh_degree();
        if plan.sh_degree < least {
            return Err(RunError::input(format!(
                "--sh-degree {}: the colours of the scene have degree {least}; choose that or more",
                plan.sh_degree
            )));
        }
    }
    let mut refits = Vec::new();
    for (i, time) in times.iter().enumerate() {
        let mut at = shown.visible(&run.scene, *time as f32)?.with_unit_rotations();
        if let Some(plan) = &plan.refit {
            let (rendering, device) = (run.scene.spec.rendering(), run.scene.device());
            let refitted = refit::refit(&at, rendering, plan, &device, &mut goes_on)?;
            let Some((gaussians, refit)) = refitted else { return Ok(None) };
            at = gaussians;
            refits.push(refit);
        }
        let calibration = run.calibration();
        if let (ExportUnits::Physical, Some(space)) = (plan.units, &calibration.space) {
            units::to_physical(&mut at, space, log_scales, plan.format.extension)?;
        }
        let (path, comments) = (output.paths_of(i).0, units::comments(calibration, plan.units, *time));
        let options = SplatFileOptions { sh_degree: plan.sh_degree, comments };
        write(&at, &path, &options).map_err(|e| match e {
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
    Ok(Some(WrittenExport { gaussians: count, refits }))
}

/// Writes the label of each voxel, as returned by [`RunLabels::labels_at`], to `path`; `edited` says whether they are
/// of the edited scene, and `space` what the axes of space shall mean that the file states: as in the data if `None`.
///
/// # Errors
/// If something else is there, or it cannot be written.
pub fn write_labels(
    path: &Path,
    labels: &RunLabels<'_>,
    ids: &[u16],
    edited: bool,
    write: LabelWriter,
    space: Option<Option<AxisConvention>>,
) -> Result<(), RunError> {
    let (grid, axes) = labels.grid.stated(space);
    let volume = LabelVolume { grid, axes, unit: labels.grid.unit.as_deref(), ids, names: &labels.listed, edited };
    write(path, &volume).map_err(|e| match e {
        LabelsError::Replace(e) => e.into(),
        e => RunError::failure(e),
    })
}
