//! Sweeps: from one file to runs, on this machine or on Slurm, and back to one table.
//!
//! `file` and `axes` define what is requested, `resolve` turns it into configurations, `plan` determines what will run,
//! `builds` what other builds of the program have run, `claim` which process runs it, `work` how one run proceeds,
//! `local` and `slurm` where; `result` and `collect` gather the results. Tables and pages are made by `compare`.
//!
//! ```text
//! file -> axes -> plan      every variant resolved and checked; run key = hash(configuration, dataset, device, version, tag)-build
//! builds                    runs that other builds finished: reported, shown if there are no others, adopted on request
//! claim                     claim-NNNN in the run's folder, by create_new; heartbeats; the next number takes over from a dead one
//! work                      train (resuming), evaluate, measure segments; each result a small file keyed by how it was measured
//! local | slurm             one process per run, children end with their parent; one job array, tasks claim by the same key
//! collect -> compare        ResultSet -> statistics over seeds -> tables, page, TensorBoard
//! ```
//!
//! Runs lie in `OUT/runs/KEY` and belong to no sweep: a run in two sweeps is trained once. All state is in files, so
//! killing any process at any time loses at most the steps since the last checkpoint.

pub mod axes;
pub mod builds;
mod checks;
pub mod claim;
pub mod collect;
mod contents;
mod datasets;
pub mod devices;
mod error;
pub mod estimate;
pub mod file;
pub mod halving;
pub mod key;
pub mod local;
pub mod plan;
mod resolve;
pub mod result;
pub mod slurm;
pub mod work;

pub use contents::ContentDigests;
pub use datasets::DataPlan;
pub use error::SweepError;
pub use plan::{Plan, PlanEntry, PlanOptions, PlannedRun};
