//! How long and with which moments: from the environment.

use std::str::FromStr;

/// The variables, described at the top of the target.
pub struct Settings {
    /// Kills in all; none for two of each command.
    pub kills: Option<usize>,
    /// Edits and groups in all.
    pub edits: usize,
    /// Seed of the moments.
    pub seed: u64,
    /// Part of the names of the commands that are killed.
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
