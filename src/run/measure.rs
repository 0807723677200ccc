//! Evaluation of a run: on which data, into which folder, and at what cost.

use super::{AnyRun, OpenRun, RunError, TrainedModel};
use crate::data::dataset::measured_fingerprint;
use crate::data::{Dataset, OpenOptions, Split, SplitName};
use crate::eval::results::{DataId, results_folder, write_results};
use crate::eval::run::{Evaluation, RenderCosts, ViewSample, evaluate};
use crate::files::{FolderKind, WriteError};
use crate::metrics::metric::Networks;
use crate::metrics::values::MetricValues;
use crate::train::{open_trained, trained_times};
use crate::user_error::UserError;
use std::path::{Path, PathBuf};

/// Maximum number of training views measured in addition to those of another split.
const TRAINING_VIEWS: usize = 40;

/// The data that a run is measured on.
#[derive(Clone, Debug)]
pub struct MeasuredOn {
    /// Identity of the data.
    pub data: DataId,
    /// Times that were trained on; empty for data other than the run's.
    pub trained_times: Vec<f64>,
    /// Note for the user.
    pub note: Option<String>,
    /// Whether the run was trained on the training views of this data, but its own dataset has other views of the split,
    /// or other known segments.
    pub other_views: bool,
}

impl MeasuredOn {
    /// Identifies the data in the folder `given`, or the run's own, of which `split` is to be measured.
    ///
    /// # Errors
    /// If the training views of another dataset, which identify it, exist and cannot be read.
    pub fn open<S: TrainedModel>(run: &OpenRun<S>, given: Option<&Path>, split: SplitName) -> Result<Self, RunError> {
        let folder = run.dataset_or(given)?;
        let dataset = std::fs::canonicalize(&folder).unwrap_or_else(|_| folder.clone());
        let options = OpenOptions { downscale: run.config.data.downscale, splits: &[], max_views: None };
        let (mut trained, mut note) = (Vec::new(), None);
        let mut fingerprint = match Dataset::open(&folder, &options) {
            Ok(data) => {
                if data.fingerprint() == run.record.fingerprint {
                    trained = trained_times(&data, &run.config);
                }
                data.fingerprint()
            }
            Err(error) if given.is_none() || dataset == run.record.dataset => {
                note = Some(format!(
                    "the training views cannot be read, so it is not verified that they are unchanged: {error}"
                ));
                run.record.fingerprint.clone()
            }
            // a dataset without training views has no fingerprint, and is not what the run was trained on
            Err(_) if !SplitName::Train.json_path(&folder).exists() => String::new(),
            Err(error) => return Err(error.into()),
        };
        // the same training views with others of this split are other data
        let mut other_views = false;
        if let Ok(own) = run.dataset()
            && dataset != own
            && fingerprint == run.record.fingerprint
            && let (Ok(here), Ok(there)) = (measured_fingerprint(&folder, split), measured_fingerprint(&own, split))
            && here != there
        {
            (fingerprint, trained, other_views) = (format!("{fingerprint}-{here}"), Vec::new(), true);
        }
        Ok(Self { data: DataId { dataset, fingerprint }, trained_times: trained, note, other_views })
    }

    /// Returns the run's own data, as it was when the run was trained.
    pub fn own<S: TrainedModel>(run: &OpenRun<S>, trained_times: Vec<f64>) -> Self {
        let (dataset, fingerprint) = (run.record.dataset.clone(), run.record.fingerprint.clone());
        Self { data: DataId { dataset, fingerprint }, trained_times, note: None, other_views: false }
    }

    /// Returns whether the run was trained on this data.
    pub fn is_own<S: TrainedModel>(&self, run: &OpenRun<S>) -> bool {
        self.data.fingerprint == run.record.fingerprint
    }

    /// Returns the folder of results called `what`, which holds only such results if it exists. To be called before
    /// anything is measured.
    ///
    /// # Errors
    /// If something else is there.
    pub fn folder<S: TrainedModel>(
        &self,
        run: &OpenRun<S>,
        what: &str,
        kind: &FolderKind,
    ) -> Result<PathBuf, RunError> {
        let file = kind.markers.first().copied().unwrap_or_default();
        // results of an older checkpoint are not those of the run
        let what = run.older_step().map_or_else(|| what.to_owned(), |step| format!("{what}-{step}"));
        let folder = results_folder(&run.paths().eval(), &what, file, &self.data, &run.record.fingerprint);
        kind.check(&folder, &[])?;
        Ok(folder)
    }
}

/// Evaluates the run on `split` and, if `split` is not the training views and the data is the run's own, on a sample of
/// the training views; writes the results into `folder`. `progress` receives the number of views done and the metrics of
/// the last one.
///
/// # Errors
/// If images are too small for a metric, weights do not match them, or the results cannot be written.
pub fn measure(
    run: &AnyRun,
    split: &Split,
    networks: &Networks,
    on: &MeasuredOn,
    folder: &Path,
    progress: impl FnMut(usize, &MetricValues),
) -> Result<Evaluation, RunError> {
    let model = std::fs::metadata(&run.scene_path)
        .map_err(|e| RunError::failure(format!("{}: {e}", run.scene_path.display())))?;
    let (mut training_views, mut note) = (None, None);
    if split.name != SplitName::Train && on.is_own(run) {
        match open_trained(&on.data.dataset, &run.config, TRAINING_VIEWS) {
            Ok((split, of)) => training_views = Some(ViewSample { split, of }),
            Err(error) => note = Some(format!("no training views were measured in addition: {error}")),
        }
    }
    let costs = RenderCosts {
        training_seconds: run.training_seconds(),
        steps: run.step(),
        model_bytes: model.len(),
        data: on.data.clone(),
        trained_times: on.trained_times.clone(),
        training_views,
    };
    let mut evaluation = evaluate(run.model(), split, networks, &costs, progress).map_err(RunError::input)?;
    evaluation.summary.notes.extend(note);
    write_results(folder, &evaluation)?;
    Ok(evaluation)
}

impl From<WriteError> for RunError {
    fn from(error: WriteError) -> Self {
        if error.is_input() { Self::input(error) } else { Self::failure(error) }
    }
}
