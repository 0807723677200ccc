//! The whole program under attack: it is killed at random moments, run twenty times at once, left without anybody who
//! reads what it prints, and told to stop in every way. Nothing may be lost, nothing may panic, nothing may stay locked.
//!
//! The short form is an ordinary part of `cargo test`. The long form is the same code with more rounds:
//!
//! ```text
//! VOLSEGGS_CHAOS_KILLS=300 VOLSEGGS_CHAOS_EDITS=1000 VOLSEGGS_CHAOS_SEED=7 cargo test --test chaos -- --nocapture
//! ```
//!
//! | variable | what | if not given |
//! |---|---|---|
//! | `VOLSEGGS_CHAOS_KILLS` | kills of living processes in all, dealt to the writing commands in turn | three of each command, one on a slow machine |
//! | `VOLSEGGS_CHAOS_EDITS` | edits and groups by 20 writers at a time | 60 |
//! | `VOLSEGGS_CHAOS_SEED` | seed of the moments | 1 |
//! | `VOLSEGGS_CHAOS_ONLY` | only commands whose name holds this are killed, such as `prepare` | all |
//!
//! One part alone: `cargo test --test chaos kill`, or `writers`, `training`, `streams`, `signals`. What a failed round left
//! stays in `target/tmp/chaos/work`; its message has the command, the moment, the seed and the number of the kill, which
//! together give the same round again (as far as a clock can).
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

/// One test at a time: the moments of kills are shares of a duration that was measured, and each test takes all cores.
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
fn twenty_writers_at_once_are_all_heard() {
    let _alone = alone();
    parallel::writers();
}

#[test]
fn writers_that_waited_long_are_heard() {
    let _alone = alone();
    parallel::writers_that_waited();
}

#[test]
fn writers_that_are_killed_harm_no_other() {
    let _alone = alone();
    parallel::killed_writers();
}

#[test]
fn a_run_in_training_refuses_other_writers_until_it_is_killed() {
    let _alone = alone();
    parallel::beside_a_training();
}

#[test]
fn of_two_trainings_into_one_folder_one_is_refused() {
    let _alone = alone();
    parallel::two_trainings();
}

#[test]
fn streams_that_are_gone_or_full_do_no_harm() {
    let _alone = alone();
    streams::all_forms();
}

#[test]
fn signals_to_a_training_save_a_checkpoint() {
    let _alone = alone();
    signals::to_trainings();
}

#[test]
fn a_signal_to_prepare_leaves_nothing() {
    let _alone = alone();
    signals::to_prepare();
}
