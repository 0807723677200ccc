//! Atomic writing of files and folders: a reader sees the old content or the new, never a part of it.
//!
//! Everything is first built under a temporary name `.tmp-NAME-PID@HOST-N` in the folder of the final
//! path, synced to disk, and then renamed. Nothing about any file format belongs here.

use super::replace::{FolderKind, ReplaceError, check_file};
use crate::process::{birth, host_name};
use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

pub(super) const PREFIX: &str = ".tmp-";

/// Age from which an untouched temporary of another machine is stale.
const STALE_AGE: Duration = Duration::from_secs(24 * 3600);

/// Temporaries this process is building now. The process id alone does not identify them: in a container, the id of a
/// killed run recurs in the next one.
static LIVE: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
static COUNTER: AtomicU64 = AtomicU64::new(0);

fn live() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    LIVE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The folder that holds `path`; `.` for a bare name.
fn parent_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Registers and returns a fresh temporary name beside `path`.
fn temporary_for(path: &Path) -> io::Result<PathBuf> {
    let name = path.file_name().ok_or_else(|| {
        io::Error::new(io::ErrorKind::InvalidInput, format!("{} does not end in a file name", path.display()))
    })?;
    let mut temporary = OsString::from(PREFIX);
    temporary.push(name);
    let number = COUNTER.fetch_add(1, Ordering::Relaxed);
    temporary.push(format!("-{}@{:08x}-{number}", std::process::id(), host()));
    let temporary = parent_of(path).join(temporary);
    live().insert(temporary.clone());
    Ok(temporary)
}

/// Identifies this machine among those that share a file system: process ids are meaningful on one machine only.
pub(super) fn host() -> u32 {
    static HOST: OnceLock<u32> = OnceLock::new();
    *HOST.get_or_init(|| {
        // containers may share the machine's name, but not its processes
        let processes = fs::read_link("/proc/self/ns/pid").unwrap_or_default();
        let name = format!("{}{}", host_name().unwrap_or_default(), processes.display());
        name.bytes().fold(0x811c_9dc5, |h: u32, b| (h ^ u32::from(b)).wrapping_mul(0x0100_0193))
    })
}

/// Makes a rename durable. Only Unix lets a folder be opened and synced.
fn sync_dir(dir: &Path) -> io::Result<()> {
    if cfg!(unix) {
        File::open(dir)?.sync_all()?;
    }
    Ok(())
}

/// Writes `bytes` to `path` so that after a crash the file holds the old content or the new.
///
/// # Errors
/// Any error of the file system; the old file is then unchanged and no temporary is left.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = AtomicFile::create(path)?;
    file.write_all(bytes)?;
    file.commit()
}

/// Like [`write_atomic`], for a path named by a user: only a file of this program is replaced, see [`check_file`].
///
/// # Errors
/// As [`check_file`], or any error of the file system; the old file is then unchanged.
pub fn write_named(path: &Path, bytes: &[u8]) -> Result<(), ReplaceError> {
    let mut file = AtomicFile::create_named(path)?;
    file.write_all(bytes).and_then(|()| file.commit()).map_err(|source| ReplaceError::Io { path: path.into(), source })
}

/// A buffered writer whose content appears under its final name only at [`AtomicFile::commit`].
///
/// Dropped without a commit, it removes its temporary and leaves the final path untouched.
#[derive(Debug)]
pub struct AtomicFile {
    path: PathBuf,
    temporary: PathBuf,
    writer: BufWriter<File>,
}

impl AtomicFile {
    /// Opens a temporary beside `path`, whose folder must exist.
    ///
    /// # Errors
    /// `path` has no file name, or the temporary cannot be created.
    pub fn create(path: &Path) -> io::Result<Self> {
        let temporary = temporary_for(path)?;
        match File::create_new(&temporary) {
            Ok(file) => {
                Ok(Self { path: path.to_path_buf(), temporary, writer: BufWriter::with_capacity(1 << 16, file) })
            }
            Err(error) => {
                live().remove(&temporary);
                Err(error)
            }
        }
    }

    /// Like [`AtomicFile::create`], for a path named by a user: only a file of this program is replaced, see
    /// [`check_file`]. Temporaries beside it that a killed process left are removed.
    ///
    /// # Errors
    /// As [`check_file`], or the temporary cannot be created.
    pub fn create_named(path: &Path) -> Result<Self, ReplaceError> {
        let io = |source| ReplaceError::Io { path: path.into(), source };
        check_file(path)?;
        clean_stale(parent_of(path)).map_err(io)?;
        Self::create(path).map_err(io)
    }

    /// Path of the content until the commit, for another program to write it; nothing may then be written here.
    pub fn temporary(&self) -> &Path {
        &self.temporary
    }

    /// Syncs the content and gives it its final name, replacing any file there.
    ///
    /// # Errors
    /// Any error of flushing, syncing or renaming; the final path is then unchanged.
    pub fn commit(mut self) -> io::Result<()> {
        self.writer.flush()?;
        self.writer.get_ref().sync_all()?;
        fs::rename(&self.temporary, &self.path)?;
        sync_dir(parent_of(&self.path))
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writer.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.flush()
    }
}

impl Drop for AtomicFile {
    fn drop(&mut self) {
        // after a commit the temporary is gone and this does nothing
        let _ = fs::remove_file(&self.temporary);
        live().remove(&self.temporary);
    }
}

/// A folder that appears under its final name, complete, at [`AtomicDir::commit`].
///
/// Dropped without a commit, it removes what was built.
#[derive(Debug)]
pub struct AtomicDir {
    path: PathBuf,
    temporary: PathBuf,
}

impl AtomicDir {
    /// Makes the temporary folder beside `path`, whose own parent must exist. Temporaries there that a killed process
    /// left are removed.
    ///
    /// # Errors
    /// `path` has no file name, or the temporary cannot be created.
    pub fn create(path: &Path) -> io::Result<Self> {
        clean_stale(parent_of(path))?;
        let temporary = temporary_for(path)?;
        if let Err(error) = fs::create_dir(&temporary) {
            live().remove(&temporary);
            return Err(error);
        }
        Ok(Self { path: path.to_path_buf(), temporary })
    }

    /// Like [`AtomicDir::create`], but first checks that a folder of `kind` may take the path, see
    /// [`FolderKind::check`]: this fails before the work, not only at [`AtomicDir::commit_replacing`]. Missing parent
    /// folders are created.
    ///
    /// # Errors
    /// As [`FolderKind::check`], or a folder cannot be created.
    pub fn create_replacing(path: &Path, kind: &FolderKind, needed: &[&Path]) -> Result<Self, ReplaceError> {
        kind.check(path, needed)?;
        let created = fs::create_dir_all(parent_of(path)).and_then(|()| Self::create(path));
        created.map_err(|source| ReplaceError::Io { path: path.into(), source })
    }

    /// The folder to build in.
    pub fn dir(&self) -> &Path {
        &self.temporary
    }

    /// Syncs everything in the folder and gives it its final name.
    ///
    /// # Errors
    /// `AlreadyExists` if something exists at the final path; any error of syncing or renaming.
    pub fn commit(self) -> io::Result<()> {
        let taken = || io::Error::new(io::ErrorKind::AlreadyExists, "already exists; choose another name or remove it");
        if self.path.symlink_metadata().is_ok() {
            return Err(taken());
        }
        // another process may take the name at this moment
        self.publish().map_err(|e| if is_taken(&e) { taken() } else { e })
    }

    /// Like [`AtomicDir::commit`], but replaces a folder of the same `kind` at the final path, unless it contains
    /// something in `needed` (see [`FolderKind::check`]).
    ///
    /// # Errors
    /// As [`FolderKind::check`]; any error of syncing or renaming, after which the old folder is put back if possible.
    pub fn commit_replacing(self, kind: &FolderKind, needed: &[&Path]) -> Result<(), ReplaceError> {
        let io = |source| ReplaceError::Io { path: self.path.clone(), source };
        kind.check(&self.path, needed)?;
        if self.path.symlink_metadata().is_err() {
            match self.publish() {
                // another process took the name at this moment
                Err(e) if is_taken(&e) => kind.check(&self.path, needed)?,
                outcome => return outcome.map_err(io),
            }
        }
        self.exchange_with_old().map_err(io)
    }

    /// Takes the final path in one step where the system can exchange two names (Linux, macOS). Elsewhere the old
    /// folder is moved aside first, and a crash between the two renames leaves it under a temporary name.
    fn exchange_with_old(&self) -> io::Result<()> {
        sync_tree(&self.temporary)?;
        if exchange(&self.temporary, &self.path)? {
            // the old folder now has the temporary's name, and is removed with it
            return sync_dir(parent_of(&self.path));
        }
        let aside = temporary_for(&self.path)?;
        let outcome = fs::rename(&self.path, &aside).and_then(|()| {
            fs::rename(&self.temporary, &self.path).inspect_err(|_| drop(fs::rename(&aside, &self.path)))
        });
        if outcome.is_ok() {
            // the new folder is in place; what is left of the old one is a stale temporary
            let _ = fs::remove_dir_all(&aside);
        }
        live().remove(&aside);
        outcome.and_then(|()| sync_dir(parent_of(&self.path)))
    }

    fn publish(&self) -> io::Result<()> {
        sync_tree(&self.temporary)?;
        fs::rename(&self.temporary, &self.path)?;
        sync_dir(parent_of(&self.path))
    }
}

/// Whether a rename failed because the name is already taken.
fn is_taken(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::AlreadyExists | io::ErrorKind::DirectoryNotEmpty)
}

impl Drop for AtomicDir {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.temporary);
        live().remove(&self.temporary);
    }
}

/// Exchanges two names; returns false if the system or the file system cannot.
#[cfg(any(target_os = "linux", target_os = "macos"))]
fn exchange(a: &Path, b: &Path) -> io::Result<bool> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    use rustix::io::Errno;
    match renameat_with(CWD, a, CWD, b, RenameFlags::EXCHANGE) {
        Ok(()) => Ok(true),
        Err(Errno::INVAL | Errno::NOSYS | Errno::NOTSUP) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

#[cfg(not(any(target_os = "linux", target_os = "macos")))]
fn exchange(_: &Path, _: &Path) -> io::Result<bool> {
    Ok(false)
}

fn sync_tree(dir: &Path) -> io::Result<()> {
    for entry in fs::read_dir(dir)? {
        let entry = entry?;
        let kind = entry.file_type()?;
        if kind.is_dir() {
            sync_tree(&entry.path())?;
        } else if kind.is_file() {
            File::open(entry.path())?.sync_all()?;
        }
    }
    sync_dir(dir)
}

/// Removes a folder that the program made, in one step as seen by readers: it is renamed first, so that a process
/// killed midway leaves a temporary and never half a folder.
///
/// # Errors
/// Any error of renaming or removing.
pub fn remove_whole(path: &Path) -> io::Result<()> {
    let doomed = temporary_for(path)?;
    let outcome = fs::rename(path, &doomed).and_then(|()| fs::remove_dir_all(&doomed));
    live().remove(&doomed);
    outcome
}

/// Removes the temporaries in `parent` that killed processes left, and returns their paths in name order. Those of this
/// process's open writers and of other running processes stay; those of other machines stay for a day.
///
/// # Errors
/// Any error of listing the folder. What cannot be removed stays.
pub fn clean_stale(parent: &Path) -> io::Result<Vec<PathBuf>> {
    let parent = if parent.as_os_str().is_empty() { Path::new(".") } else { parent };
    let mut removed = Vec::new();
    for entry in fs::read_dir(parent)? {
        let entry = entry?;
        let name = entry.file_name();
        let Some(maker) = name.to_str().and_then(maker_of) else {
            continue;
        };
        if in_use(&parent.join(&name), maker) {
            continue;
        }
        let outcome =
            if entry.file_type()?.is_dir() { fs::remove_dir_all(entry.path()) } else { fs::remove_file(entry.path()) };
        // not if it was removed by another process at the same moment, or is another user's: no reason not to write
        if outcome.is_ok() {
            removed.push(entry.path());
        }
    }
    removed.sort();
    Ok(removed)
}

/// Process and machine in `.tmp-NAME-PID@HOST-N`; `None` for any other name.
fn maker_of(name: &str) -> Option<(u32, u32)> {
    let mut parts = name.strip_prefix(PREFIX)?.rsplitn(3, '-');
    parts.next()?.parse::<u64>().ok()?;
    let (pid, host) = parts.next()?.split_once('@')?;
    parts.next()?;
    Some((pid.parse().ok()?, u32::from_str_radix(host, 16).ok()?))
}

fn in_use(path: &Path, (pid, maker_host): (u32, u32)) -> bool {
    if maker_host != host() {
        let touched = path.symlink_metadata().and_then(|m| m.modified()).ok();
        return touched.and_then(|t| t.elapsed().ok()).is_none_or(|age| age < STALE_AGE);
    }
    if pid == std::process::id() {
        let same = |other: &PathBuf| match (other.canonicalize(), path.canonicalize()) {
            (Ok(a), Ok(b)) => a == b,
            _ => other == path,
        };
        return live().iter().any(same);
    }
    // without /proc, another running process cannot be distinguished from a dead one; its files stay
    !Path::new("/proc/self").exists() || birth(pid).is_some()
}
