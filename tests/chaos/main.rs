//! The whole program under attack: it is killed at random moments, run twenty times at once, left with output streams
//! that nobody reads, and told to stop in every way. Nothing may be lost, panic or stay locked.
//!
//! The short form is an ordinary part of `cargo test`. The long form is the same code with more rounds:
//!
//! ```text
//! VOLSEGGS_CHAOS_KILLS=300 VOLSEGGS_CHAOS_EDITS=1000 VOLSEGGS_CHAOS_SEED=7 cargo test --test chaos -- --nocapture
//! ```
//!
//! | variable | meaning | default |
//! |---|---|---|
//! | `VOLSEGGS_CHAOS_KILLS` | kills of living processes, over all writing commands | 3 each, 1 on a slow machine |
//! | `VOLSEGGS_CHAOS_EDITS` | edits and groups, by 20 writers at a time | 60 |
//! | `VOLSEGGS_CHAOS_SEED` | seed of the moments | 1 |
//! | `VOLSEGGS_CHAOS_ONLY` | kill only commands whose name contains this, such as `prepare` | all |
//!
//! To run one part alone: `cargo test --test chaos kill`, or `writers`, `training`, `streams`, `signals`. The files of
//! a failed round stay in `target/tmp/chaos/work`; its message holds the command, the moment, the seed and the number
//! of the kill, which together reproduce the round (as far as a clock can).
#![cfg(unix)]
#![allow(clippy::unwrap_used)]

mod check;
#[path = "../common/mod.rs"]
mod common;
mod files;
mod jobs;
mod kills;
mod parallel;
mod program;
mod settings;
mod signals;
mod streams;
mod whole;
mod world;

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Runs one test at a time: kills come at fractions of a measured duration, and each test uses all cores.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

#[test]
fn a_kill_at_any_moment_loses_nothing() {
    let _alone = alone();
    kills::strike_all();
}

#[test]
fn twenty_simultaneous_writers_all_succeed() {
    let _alone = alone();
    parallel::writers();
}

#[test]
fn writers_that_waited_long_succeed() {
    let _alone = alone();
    parallel::writers_that_waited();
}

#[test]
fn killed_writers_do_not_affect_the_others() {
    let _alone = alone();
    parallel::killed_writers();
}

#[test]
fn a_run_in_training_refuses_other_writers_until_it_is_killed() {
    let _alone = alone();
    parallel::beside_a_training();
}

#[test]
fn one_of_two_trainings_into_the_same_folder_is_refused() {
    let _alone = alone();
    parallel::two_trainings();
}

#[test]
fn closed_or_full_streams_lose_no_work() {
    let _alone = alone();
    streams::all_forms();
}

#[test]
fn signals_to_a_training_save_a_checkpoint() {
    let _alone = alone();
    signals::to_trainings();
}

#[test]
fn signals_to_prepare_leave_nothing_behind() {
    let _alone = alone();
    signals::to_prepare();
}
