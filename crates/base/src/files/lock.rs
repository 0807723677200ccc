//! One writer per run: an advisory lock on `RUN/.lock`, held by everything that writes to a run while it does.
//!
//! The system releases the lock when its process ends, however it ends, so there are no stale locks. The content of the
//! file is for users, and for deciding between waiting and giving up.

use super::atomic::clean_stale;
use crate::user_error::UserError;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Name of the file within a run folder.
const FILE: &str = ".lock";
/// Longest wait for short work.
pub const LOCK_PATIENCE: Duration = Duration::from_secs(60);
/// Time between two attempts.
const PAUSE: Duration = Duration::from_millis(10);
/// How long nobody is refused for a locked file that does not yet say who holds it.
const MAX_UNSIGNED: Duration = Duration::from_secs(2);

/// A user whose number the system does not tell.
const UNKNOWN: &str = "an unknown user";

/// Depth of the folders of a run that may hold temporaries: `eval/test/pictures`.
const DEPTH: usize = 3;

/// How long a writer will hold the lock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LockDuration {
    /// Seconds, such as an edit: others wait for their turn.
    Short,
    /// Minutes or more, such as training: others are refused at once.
    Long,
}

/// Who holds a run, as recorded in the lock file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LockHolder {
    /// The user, as the system identifies the process: the number with the name, if that is known here.
    pub user: String,
    /// Name of the machine.
    pub host: String,
    /// Process id.
    pub pid: u32,
    /// The command it runs.
    pub command: String,
    /// How long the work takes.
    pub work: LockDuration,
    /// When it began, in seconds since 1970.
    pub since: u64,
}

/// Why a run cannot be written to.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    /// Another process is writing to it.
    #[error("{}: in use by {holder}; wait until that ends, or stop it", run.display())]
    Held {
        /// The run folder.
        run: PathBuf,
        /// Who holds the lock.
        holder: Box<LockHolder>,
    },
    /// The run is somebody else's, or on a medium that cannot be written to.
    #[error(
        "{}: this folder cannot be written to ({source}), which this command needs; work on a copy of it, or ask its \
         owner",
        run.display()
    )]
    ReadOnly {
        /// The run folder.
        run: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The lock file cannot be created or locked.
    #[error("{}: {source}", path.display())]
    Io {
        /// The lock file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

impl UserError for LockError {
    fn is_input(&self) -> bool {
        !matches!(self, Self::Io { .. })
    }
}

/// The right to write to a run, until it is dropped.
#[derive(Debug)]
pub struct RunLock {
    run: PathBuf,
    /// The locked file; closing it releases the lock.
    _file: File,
}

impl RunLock {
    /// Like [`RunLock::acquire_within`], with a patience of [`LOCK_PATIENCE`].
    ///
    /// # Errors
    /// As [`RunLock::acquire_within`].
    pub fn acquire(run: &Path, command: &str, work: LockDuration) -> Result<Self, LockError> {
        Self::acquire_within(LOCK_PATIENCE, run, command, work)
    }

    /// Acquires the lock of the run in folder `run`, which must exist, for `command` (shown to others). Waits while its
    /// holder's work is short, for at most `patience`. Temporaries in the run that killed writers left are then
    /// removed.
    ///
    /// # Errors
    /// [`LockError::Held`] if another process has it, [`LockError::ReadOnly`] in a folder of somebody else,
    /// [`LockError::Io`] if the lock file cannot be used.
    pub fn acquire_within(
        patience: Duration,
        run: &Path,
        command: &str,
        work: LockDuration,
    ) -> Result<Self, LockError> {
        let path = run.join(FILE);
        let io = |source| LockError::Io { path: path.clone(), source };
        let opening = |source: io::Error| match source.kind() {
            ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => {
                LockError::ReadOnly { run: run.into(), source }
            }
            _ => io(source),
        };
        let mut file =
            OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path).map_err(opening)?;
        let started = Instant::now();
        // since when the file has not said who holds the lock
        let mut unsigned: Option<Instant> = None;
        let mut last: Option<LockHolder> = None;
        loop {
            match file.try_lock() {
                Ok(()) => break,
                Err(TryLockError::WouldBlock) => {}
                // a file system without locks: claims of sweeps still work, and a single user knows what is running
                Err(TryLockError::Error(e)) if has_no_locks(&e) => break,
                Err(TryLockError::Error(e)) => return Err(io(e)),
            }
            let holder = LockHolder::read(&path);
            let give_up = match &holder {
                // seen twice: what a killed process wrote stays until the next holder has signed the file
                Some(now) if now.work == LockDuration::Long && last.as_ref() == Some(now) => true,
                Some(_) => started.elapsed() > patience,
                None => unsigned.get_or_insert_with(Instant::now).elapsed() > MAX_UNSIGNED.min(patience),
            };
            if give_up {
                let holder = Box::new(holder.unwrap_or_else(LockHolder::unknown));
                return Err(LockError::Held { run: run.into(), holder });
            }
            if holder.is_some() {
                unsigned = None;
            }
            last = holder;
            std::thread::sleep(PAUSE);
        }
        let text = serde_json::to_vec(&LockHolder::me(command, work)).map_err(|e| io(e.into()))?;
        let signed = file.seek(SeekFrom::Start(0)).and_then(|_| file.set_len(0)).and_then(|()| file.write_all(&text));
        signed.map_err(io)?;
        clean_below(run, DEPTH);
        Ok(Self { run: run.into(), _file: file })
    }

    /// Whether a process is writing to the run in folder `run` now. Nothing is left there, not even a lock file. `None`
    /// if the system cannot determine it, as on file systems without locks.
    pub fn is_held(run: &Path) -> Option<bool> {
        let file = match File::open(run.join(FILE)) {
            Ok(file) => file,
            // any writer would have created one
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Some(false),
            Err(_) => return None,
        };
        // shared with others who ask, and released at once: a process that wants the lock itself tries again
        match file.try_lock_shared() {
            Ok(()) => Some(false),
            Err(TryLockError::WouldBlock) => Some(true),
            Err(TryLockError::Error(_)) => None,
        }
    }

    /// The folder of the run.
    pub fn run(&self) -> &Path {
        &self.run
    }
}

/// Whether the error means that the file system does not support locks, like NFS without its lock service.
fn has_no_locks(error: &io::Error) -> bool {
    #[cfg(unix)]
    if error.raw_os_error() == Some(rustix::io::Errno::NOLCK.raw_os_error()) {
        return true;
    }
    error.kind() == io::ErrorKind::Unsupported
}

/// Removes stale temporaries in `folder` and, down to `depth` levels, in its subfolders. What cannot be removed, such
/// as a file of another user, does not prevent writing.
fn clean_below(folder: &Path, depth: usize) {
    let _ = clean_stale(folder);
    if depth > 0 {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let folders = entries.filter(|e| e.file_type().is_ok_and(|kind| kind.is_dir()));
        folders.for_each(|e| clean_below(&e.path(), depth - 1));
    }
}

impl Drop for RunLock {
    fn drop(&mut self) {
        // a free lock names no holder
        let _ = self._file.set_len(0);
        let _ = self._file.unlock();
    }
}

impl LockHolder {
    /// This process.
    fn me(command: &str, work: LockDuration) -> Self {
        let variable = |name: &str| std::env::var(name).ok().filter(|v| !v.is_empty());
        let host = crate::process::host_name().or_else(|| variable("HOSTNAME"));
        Self {
            user: crate::process::user().unwrap_or_else(|| UNKNOWN.into()),
            host: host.unwrap_or_else(|| "this machine".into()),
            pid: std::process::id(),
            command: command.to_owned(),
            work,
            since: now(),
        }
    }

    fn unknown() -> Self {
        Self {
            user: UNKNOWN.into(),
            host: "this machine".into(),
            pid: 0,
            command: "volseggs".into(),
            work: LockDuration::Short,
            since: now(),
        }
    }

    /// Reads the holder from the lock file; `None` while it is being written.
    fn read(path: &Path) -> Option<Self> {
        let mut text = String::new();
        File::open(path).ok()?.read_to_string(&mut text).ok()?;
        serde_json::from_str(&text).ok()
    }
}

impl fmt::Display for LockHolder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { user, host, pid, command, .. } = self;
        let seconds = now().saturating_sub(self.since) as f64;
        write!(f, "`{command}`, run by {user} (process {pid} on {host}, for {})", crate::durations::duration(seconds))
    }
}

fn now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[test]
    fn long_work_refuses_others_and_names_its_holder_and_short_work_lets_them_wait() {
        let dir = tempfile::tempdir().unwrap();
        let held = RunLock::acquire(dir.path(), "volseggs train", LockDuration::Long).unwrap();
        let started = Instant::now();
        let error = RunLock::acquire(dir.path(), "volseggs edit", LockDuration::Short).unwrap_err().to_string();
        assert!(error.contains("`volseggs train`, run by") && error.contains("process"), "{error}");
        #[cfg(target_os = "linux")]
        assert!(error.contains("uid "), "{error}");
        assert!(started.elapsed() < Duration::from_secs(2));
        assert_eq!(RunLock::is_held(dir.path()), Some(true));
        drop(held);
        assert_eq!(RunLock::is_held(dir.path()), Some(false));
        let (inside, max_inside) = (AtomicUsize::new(0), AtomicUsize::new(0));
        std::thread::scope(|s| {
            for _ in 0..8 {
                s.spawn(|| {
                    let _lock = RunLock::acquire(dir.path(), "volseggs edit", LockDuration::Short).unwrap();
                    max_inside.fetch_max(inside.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
                    std::thread::sleep(Duration::from_millis(5));
                    inside.fetch_sub(1, Ordering::SeqCst);
                });
            }
        });
        assert_eq!(max_inside.into_inner(), 1);
    }

    #[test]
    fn a_long_waiter_is_not_refused_while_the_lock_file_is_unsigned() {
        let dir = tempfile::tempdir().unwrap();
        let held = RunLock::acquire(dir.path(), "volseggs edit", LockDuration::Short).unwrap();
        std::thread::scope(|s| {
            let waiting = s.spawn(|| RunLock::acquire(dir.path(), "volseggs edit", LockDuration::Short).map(drop));
            std::thread::sleep(MAX_UNSIGNED + Duration::from_millis(300));
            // as between acquiring the lock and signing the file
            held._file.set_len(0).unwrap();
            std::thread::sleep(Duration::from_millis(100));
            drop(held);
            waiting.join().unwrap().unwrap();
        });
    }

    #[test]
    fn temporaries_of_killed_writers_are_removed() {
        let dir = tempfile::tempdir().unwrap();
        let pictures = dir.path().join("eval/test/pictures");
        std::fs::create_dir_all(&pictures).unwrap();
        let left = format!(".tmp-x.png-{}@{:08x}-0", u32::MAX, super::super::atomic::host());
        for folder in [dir.path(), &pictures] {
            std::fs::write(folder.join(&left), "half").unwrap();
        }
        RunLock::acquire(dir.path(), "volseggs edit", LockDuration::Short).unwrap();
        assert!(!dir.path().join(&left).exists() && !pictures.join(&left).exists());
    }

    #[test]
    fn the_record_of_a_dead_process_blocks_nobody() {
        let dir = tempfile::tempdir().unwrap();
        let text = serde_json::to_string(&LockHolder::me("volseggs train", LockDuration::Long)).unwrap();
        assert!(RunLock::is_held(dir.path()) == Some(false) && !dir.path().join(FILE).exists());
        std::fs::write(dir.path().join(FILE), text).unwrap();
        assert_eq!(RunLock::is_held(dir.path()), Some(false));
        RunLock::acquire(dir.path(), "volseggs edit", LockDuration::Short).unwrap();
        std::fs::write(dir.path().join(FILE), "garbage").unwrap();
        RunLock::acquire(dir.path(), "volseggs edit", LockDuration::Short).unwrap();
    }
}
