//! Training status of a run.

use crate::files::RunLock;
use std::path::Path;

/// Status that records give to a training in progress.
pub const RUNNING: &str = "running";
/// Status of a training that stopped without recording it: its process was killed, or its machine stopped.
pub const BROKEN_OFF: &str = "broken off";

/// Returns the training status of the run in folder `run` whose record says `recorded`: that, or [`BROKEN_OFF`] if it
/// says [`RUNNING`] but nobody holds the run's lock. If the system gives no information about locks, the record is
/// trusted.
pub fn status<'r>(run: &Path, recorded: &'r str) -> &'r str {
    match RunLock::is_held(run) {
        Some(false) if recorded == RUNNING => BROKEN_OFF,
        _ => recorded,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::LockDuration;

    #[test]
    fn a_run_is_running_only_while_it_is_locked() {
        let dir = tempfile::tempdir().unwrap();
        let says = |recorded| status(dir.path(), recorded);
        assert_eq!([says("running"), says("interrupted"), says("complete")], [BROKEN_OFF, "interrupted", "complete"]);
        let held = RunLock::acquire(dir.path(), "volseggs train", LockDuration::Long).unwrap();
        assert_eq!(says("running"), RUNNING);
        drop(held);
        assert_eq!(says("running"), BROKEN_OFF);
    }
}
