//! Which run of the present plan a queued task does. A submission numbers runs as in its own plan, and every edit of
//! the sweep file makes another one; runs with the same key are the same.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::io::ErrorKind;
use std::path::Path;

use serde::Deserialize;

use super::submit::Submission;
use super::{SlurmError, io_at};
use crate::files::read_text;
use crate::versioned;

/// What is needed of a stored plan.
#[derive(Default, Deserialize)]
struct StoredPlan {
    runs: Vec<StoredRun>,
}

#[derive(Deserialize)]
struct StoredRun {
    key: String,
}

/// Numbers tasks of earlier plans as in the present one.
pub(super) struct Tasks<'a> {
    dir: &'a Path,
    /// Hash of the present plan.
    plan: &'a str,
    /// Its runs by key.
    runs: HashMap<String, usize>,
    /// Present numbers of the runs of earlier plans, by hash; each plan is read when first needed.
    earlier: HashMap<String, Vec<Option<usize>>>,
}

impl<'a> Tasks<'a> {
    /// Prepares for tasks of `submissions` of the sweep in `dir`, whose present plan has the hash `plan`.
    ///
    /// # Errors
    /// [`SlurmError::Io`].
    pub(super) fn new(dir: &'a Path, plan: &'a str, submissions: &[Submission]) -> Result<Self, SlurmError> {
        let mut keys = Vec::new();
        if submissions.iter().any(|submission| submission.plan != plan) {
            keys = stored(dir, plan)?;
        }
        let runs = keys.into_iter().enumerate().map(|(run, key)| (key, run)).collect();
        Ok(Self { dir, plan, runs, earlier: HashMap::new() })
    }

    /// Returns the run that `task` of `submission` does; `None` if the present plan does not have it.
    ///
    /// # Errors
    /// [`SlurmError::Io`].
    pub(super) fn run(&mut self, submission: &Submission, task: usize) -> Result<Option<usize>, SlurmError> {
        if submission.plan == self.plan {
            return Ok(Some(task));
        }
        let runs = match self.earlier.entry(submission.plan.clone()) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(new) => {
                let keys = stored(self.dir, &submission.plan)?;
                new.insert(keys.iter().map(|key| self.runs.get(key).copied()).collect())
            }
        };
        Ok(runs.get(task).copied().flatten())
    }
}

/// The keys of the runs of the plan with that hash; none if the plan is missing, damaged or of another version of the
/// program, as its tasks then cannot start either.
fn stored(dir: &Path, hash: &str) -> Result<Vec<String>, SlurmError> {
    let path = dir.join("plans").join(format!("{hash}.json"));
    let text = match read_text(&path) {
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::InvalidData) => return Ok(Vec::new()),
        read => read.map_err(io_at(&path))?,
    };
    let plan: StoredPlan = versioned::from_json(&text).unwrap_or_default();
    Ok(plan.runs.into_iter().map(|run| run.key).collect())
}
