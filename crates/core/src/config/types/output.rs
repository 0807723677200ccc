//! `output.*`: logs, checkpoints, and the time limit of a run.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `output.*`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OutputConfig {
    /// Steps between log lines.
    pub log_every: usize,
    /// Steps between evaluations on a few test views; 0 for never.
    pub eval_every: usize,
    /// Number of test views in such an evaluation, evenly spaced.
    pub eval_views: usize,
    /// Steps between checkpoints.
    pub checkpoint_every: usize,
    /// Number of checkpoints to keep.
    pub keep: usize,
    /// Minutes of training after which a run is complete, whatever step it has reached; 0 for no limit.
    pub max_minutes: f64,
}

impl Default for OutputConfig {
    fn default() -> Self {
        Self { log_every: 10, eval_every: 1000, eval_views: 6, checkpoint_every: 1000, keep: 2, max_minutes: 0.0 }
    }
}
