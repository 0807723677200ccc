//! How the training of a run stands.

use crate::files::RunLock;
use std::path::Path;

/// As records say it of a training that goes on.
pub const RUNNING: &str = "running";
/// It does not go on, and could not say so: its process was killed, or its machine stopped.
pub const BROKEN_OFF: &str = "broken off";

/// How the training of the run in folder `run` stands, whose record says `recorded`: that, or [`BROKEN_OFF`] where it says
/// [`RUNNING`] and nobody holds the run's lock. Where the system does not tell of locks, the record is believed.
#[must_use]
pub fn status<'r>(run: &Path, recorded: &'r str) -> &'r str {
    match RunLock::is_held(run) {
        Some(false) if recorded == RUNNING => BROKEN_OFF,
        _ => recorded,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::Work;

    #[test]
    fn only_whoever_holds_the_run_trains_it() {
        let dir = tempfile::tempdir().unwrap();
        let says = |recorded| status(dir.path(), recorded);
        assert_eq!([says("running"), says("interrupted"), says("complete")], [BROKEN_OFF, "interrupted", "complete"]);
        let held = RunLock::acquire(dir.path(), "volseggs train", Work::Long).unwrap();
        assert_eq!(says("running"), RUNNING);
        drop(held);
        assert_eq!(says("running"), BROKEN_OFF);
    }
}
