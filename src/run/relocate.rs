//! Records where the dataset of a run is after it was moved.

use super::{AnyRun, RunError};
use crate::data::Calibration;
use crate::files::write_atomic;
use crate::versioned;
use std::path::Path;

/// Writes into the record of `run`, whose lock is held, that its dataset is in the folder `data`, with what is kept of
/// it.
///
/// # Errors
/// If `data` does not hold the dataset that the run was trained on, or the record cannot be written.
pub fn relocate(run: AnyRun, data: &Path) -> Result<AnyRun, RunError> {
    let mut run = run.with_dataset(Some(data))?;
    run.record.calibration = run.record.normalisation.calibration(Calibration::of_dataset(data)?);
    run.record.set_dataset(&run.path, data);
    let json = versioned::to_json_pretty(&run.record).map_err(RunError::failure)?;
    let path = run.paths().record();
    write_atomic(&path, &json).map_err(|e| RunError::failure(format!("{}: {e}", path.display())))?;
    Ok(run)
}
