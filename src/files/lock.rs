//! One writer a run: an advisory lock on `RUN/.lock`, which everything that writes into a run holds while it does.
//!
//! The system lets go of the lock when its process ends, however it ends, so a stale one cannot be. What the file says
//! is for people, and for the choice between waiting and giving up.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Name of the file within a run folder.
const FILE: &str = ".lock";
/// Longest wait for work that is short.
const PATIENCE: Duration = Duration::from_secs(60);
/// Time between two tries.
const PAUSE: Duration = Duration::from_millis(10);
/// A file that has just been locked does not say yet by whom; this long nobody is refused for it.
const UNSIGNED: Duration = Duration::from_secs(2);

/// How long a writer will hold the lock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Work {
    /// Seconds, such as an edit: others wait for their turn.
    Short,
    /// Minutes or more, such as a training: others are refused at once.
    Long,
}

/// Who holds a run, as the lock file says it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Holder {
    /// The user's name.
    pub user: String,
    /// Name of the machine.
    pub host: String,
    /// Process.
    pub pid: u32,
    /// What it does, as it was called.
    pub command: String,
    /// How long that takes.
    pub work: Work,
    /// When it began, seconds since 1970.
    pub since: u64,
}

/// Why a run cannot be written into.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    /// Another process writes into it.
    #[error("{}: in use by {holder}; wait until that ends, or stop it", run.display())]
    Held {
        /// The run folder.
        run: PathBuf,
        /// Who.
        holder: Box<Holder>,
    },
    /// The lock file cannot be made or locked.
    #[error("{}: {source}", path.display())]
    Io {
        /// The lock file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

/// The right to write into a run, until it is dropped.
#[derive(Debug)]
pub struct RunLock {
    run: PathBuf,
    /// Locked; closing it lets go.
    _file: File,
}

impl RunLock {
    /// Takes the lock of the run in folder `run`, which must be there, for `command` (shown to others). Waits while its
    /// holder's work is short, a minute at most.
    ///
    /// # Errors
    /// [`LockError::Held`] if another process has it, [`LockError::Io`] if the lock file cannot be used.
    pub fn acquire(run: &Path, command: &str, work: Work) -> Result<Self, LockError> {
        let path = run.join(FILE);
        let io = |source| LockError::Io { path: path.clone(), source };
        let mut file =
            OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path).map_err(io)?;
        let started = Instant::now();
        loop {
            match file.try_lock() {
                Ok(()) => break,
                Err(TryLockError::WouldBlock) => {}
                // a file system without locks: claims of sweeps still hold there, and one person knows what runs
                Err(TryLockError::Error(e)) if e.kind() == io::ErrorKind::Unsupported => break,
                Err(TryLockError::Error(e)) => return Err(io(e)),
            }
            let holder = Holder::read(&path);
            let waited = started.elapsed();
            let give_up = match &holder {
                Some(holder) => holder.work == Work::Long || waited > PATIENCE,
                None => waited > UNSIGNED,
            };
            if give_up {
                let holder = Box::new(holder.unwrap_or_else(Holder::unknown));
                return Err(LockError::Held { run: run.into(), holder });
            }
            std::thread::sleep(PAUSE);
        }
        let text = serde_json::to_vec(&Holder::me(command, work)).map_err(|e| io(e.into()))?;
        let signed = file.seek(SeekFrom::Start(0)).and_then(|_| file.set_len(0)).and_then(|()| file.write_all(&text));
        signed.map_err(io)?;
        Ok(Self { run: run.into(), _file: file })
    }

    /// The folder of the run.
    #[must_use]
    pub fn run(&self) -> &Path {
        &self.run
    }
}

impl Drop for RunLock {
    fn drop(&mut self) {
        // nobody's name stands in a free lock
        let _ = self._file.set_len(0);
        let _ = self._file.unlock();
    }
}

impl Holder {
    /// This process.
    fn me(command: &str, work: Work) -> Self {
        let variable = |name: &str| std::env::var(name).ok().filter(|v| !v.is_empty());
        let host = std::fs::read_to_string("/proc/sys/kernel/hostname").ok().or_else(|| variable("HOSTNAME"));
        Self {
            user: variable("USER").or_else(|| variable("LOGNAME")).unwrap_or_else(|| "somebody".into()),
            host: host.map_or_else(|| "this machine".into(), |h| h.trim().to_owned()),
            pid: std::process::id(),
            command: command.to_owned(),
            work,
            since: now(),
        }
    }

    fn unknown() -> Self {
        Self {
            user: "somebody".into(),
            host: "this machine".into(),
            pid: 0,
            command: "volseggs".into(),
            work: Work::Short,
            since: now(),
        }
    }

    /// What the lock file says; none while it is being written.
    fn read(path: &Path) -> Option<Self> {
        let mut text = String::new();
        File::open(path).ok()?.read_to_string(&mut text).ok()?;
        serde_json::from_str(&text).ok()
    }
}

impl fmt::Display for Holder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { user, host, pid, command, .. } = self;
        let seconds = now().saturating_sub(self.since) as f64;
        write!(f, "`{command}` of {user} (process {pid} on {host}, for {})", crate::log::progress::duration(seconds))
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
    fn long_work_refuses_others_by_name_and_short_work_lets_them_wait() {
        let dir = tempfile::tempdir().unwrap();
        let held = RunLock::acquire(dir.path(), "volseggs train", Work::Long).unwrap();
        let started = Instant::now();
        let error = RunLock::acquire(dir.path(), "volseggs edit", Work::Short).unwrap_err().to_string();
        assert!(error.contains("`volseggs train` of") && error.contains("process"), "{error}");
        assert!(started.elapsed() < Duration::from_secs(2));
        drop(held);
        let (inside, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        std::thread::scope(|s| {
            for _ in 0..8 {
                s.spawn(|| {
                    let _lock = RunLock::acquire(dir.path(), "volseggs edit", Work::Short).unwrap();
                    most.fetch_max(inside.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
                    std::thread::sleep(Duration::from_millis(5));
                    inside.fetch_sub(1, Ordering::SeqCst);
                });
            }
        });
        assert_eq!(most.into_inner(), 1);
    }

    #[test]
    fn what_a_dead_process_wrote_into_the_file_holds_nobody_back() {
        let dir = tempfile::tempdir().unwrap();
        let text = serde_json::to_string(&Holder::me("volseggs train", Work::Long)).unwrap();
        std::fs::write(dir.path().join(FILE), text).unwrap();
        RunLock::acquire(dir.path(), "volseggs edit", Work::Short).unwrap();
        std::fs::write(dir.path().join(FILE), "garbage").unwrap();
        RunLock::acquire(dir.path(), "volseggs edit", Work::Short).unwrap();
    }
}
