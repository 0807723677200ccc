//! `output.*`: logs, checkpoints, and when a run has had its time.

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
    /// Test views in such an evaluation, evenly spaced.
    pub eval_views: usize,
    /// Steps between checkpoints.
    pub checkpoint_every: usize,
    /// Checkpoints kept.
    pub keep: usize,
    /// Minutes of training after which a run is complete, whatever step it has come to; 0 for no limit.
    #[serde(default)] // a run from before this key still opens
    pub max_minutes: f64,
}
