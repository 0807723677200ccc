//! Sweeps: one file into runs, on this machine or on Slurm, and back into one table.
//!
//! `file` and `axes` say what is asked for, `resolve` makes a configuration of it, `plan` says what will run, `builds` what
//! other builds of the program have run, `claim` who runs it, `work` how one run goes, `local` and `slurm` where; `result`
//! and `collect` are what is left in the end. Tables and pages are `compare`'s.

pub mod axes;
pub mod builds;
mod checks;
pub mod claim;
pub mod collect;
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
pub mod spec;
pub mod work;

pub use datasets::DataPlan;
pub use error::SweepError;
pub use plan::{Entry, Plan, PlanOptions, Run};
