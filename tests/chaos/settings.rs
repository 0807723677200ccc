//! Length of the tests and seed of their moments, from the environment.

use std::str::FromStr;

/// The environment variables, described at the top of `main.rs`.
pub struct Settings {
    /// Kills in total; `None` for three of each command.
    pub kills: Option<usize>,
    /// Edits and groups in total.
    pub edits: usize,
    /// Seed of the moments.
    pub seed: u64,
    /// Part of the names of the commands to kill.
    pub only: String,
}

impl Settings {
    pub fn read() -> Self {
        Self {
            kills: number("VOLSEGGS_CHAOS_KILLS"),
            edits: number("VOLSEGGS_CHAOS_EDITS").unwrap_or(60),
            seed: number("VOLSEGGS_CHAOS_SEED").unwrap_or(1),
            only: std::env::var("VOLSEGGS_CHAOS_ONLY").unwrap_or_default(),
        }
    }
}

fn number<T: FromStr>(name: &str) -> Option<T> {
    let text = std::env::var(name).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{name}={text}: a whole number")))
}
