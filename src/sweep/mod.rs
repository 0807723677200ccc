//! Sweeps: from one file to runs, on this machine or on Slurm, and back to one table.
//!
//! `file` and `axes` define what is requested, `resolve` turns it into configurations, `plan` determines what will run,
//! `builds` what other builds of the program have run, `claim` which process runs it, `work` how one run proceeds,
//! `local` and `slurm` where; `result` and `collect` gather the results. Tables and pages are made by `compare`.

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

pub use contents::Contents;
pub use datasets::DataPlan;
pub use error::SweepError;
pub use plan::{Entry, Plan, PlanOptions, Run};
