//! Reads the checkpoints of a run that may be training: it may remove old ones at any time, even while they are read.

use super::checkpoint::{list, locate};
use std::path::{Path, PathBuf};

/// Whether a listed checkpoint no longer exists. Checkpoints are moved away before they are removed.
fn is_gone(checkpoint: &Path) -> bool {
    !checkpoint.join("state.json").is_file()
}

/// Returns the run that `path` refers to, see [`locate`], and its checkpoint with the result of `read`. If that
/// checkpoint is removed meanwhile, the newest is located once again.
///
/// # Errors
/// Those of `read`.
pub fn read_located<T, E>(
    path: &Path,
    read: impl Fn(&Path) -> Result<T, E>,
) -> Result<(PathBuf, Option<(PathBuf, T)>), E> {
    let (run, found) = locate(path);
    let Some(found) = found else { return Ok((run, None)) };
    let (found, value) = match read(&found) {
        Err(error) if is_gone(&found) => match locate(path).1 {
            Some(newer) => (newer.clone(), read(&newer)?),
            None => return Err(error),
        },
        value => (found, value?),
    };
    Ok((run, Some((found, value))))
}

/// Calls `read` for all checkpoints of a run, and returns the steps, paths and results of those that still exist, oldest
/// first.
pub fn read_all<E>(run: &Path, read: impl Fn(&Path) -> Result<(), E>) -> Vec<(usize, PathBuf, Result<(), E>)> {
    let mut found = Vec::new();
    for (step, path) in list(run) {
        let outcome = read(&path);
        if outcome.is_ok() || !is_gone(&path) {
            found.push((step, path, outcome));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::checkpoint::folder_name;
    use std::fs;

    fn run(steps: &[usize]) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        steps.iter().for_each(|step| add(dir.path(), *step));
        dir
    }

    fn add(run: &Path, step: usize) {
        let path = run.join("checkpoints").join(folder_name(step));
        fs::create_dir_all(&path).unwrap();
        fs::write(path.join("state.json"), "{}").unwrap();
    }

    #[test]
    fn a_checkpoint_that_vanishes_while_it_is_read_is_located_again() {
        let dir = run(&[10]);
        let read = |path: &Path| {
            if path.ends_with("step-000010") {
                add(dir.path(), 20);
                fs::remove_dir_all(path).unwrap();
                return Err("not there");
            }
            Ok(7)
        };
        let (found, checkpoint) = read_located(dir.path(), read).unwrap();
        assert_eq!(found, dir.path());
        assert_eq!(checkpoint, Some((dir.path().join("checkpoints/step-000020"), 7)));
        // a damaged checkpoint is an error, and so is the removal of the only one
        assert_eq!(read_located(dir.path(), |_| Err::<(), _>("damaged")), Err("damaged"));
        let last = |path: &Path| fs::remove_dir_all(path).map_or(Ok(()), |()| Err("gone"));
        assert_eq!(read_located(dir.path(), last), Err("gone"));
        assert_eq!(read_located(dir.path(), last).unwrap().1, None);
    }

    #[test]
    fn vanished_checkpoints_are_skipped_and_damaged_ones_are_reported() {
        let dir = run(&[10, 20, 30]);
        let read = |path: &Path| {
            if path.ends_with("step-000010") {
                fs::remove_dir_all(path).unwrap();
                return Err("not there");
            }
            Ok(())
        };
        let outcomes = |read: &dyn Fn(&Path) -> Result<(), &'static str>| -> Vec<_> {
            read_all(dir.path(), read).into_iter().map(|(step, _, outcome)| (step, outcome)).collect()
        };
        assert_eq!(outcomes(&read), [(20, Ok(())), (30, Ok(()))]);
        let damaged = |path: &Path| if path.ends_with("step-000030") { Err("damaged") } else { Ok(()) };
        assert_eq!(outcomes(&damaged), [(20, Ok(())), (30, Err("damaged"))]);
    }
}
