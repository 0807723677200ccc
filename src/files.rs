//! Atomic writing of files and folders: a reader sees the old content or the new, never a part.
//!
//! Everything is first built under a temporary name `.tmp-NAME-PID-N` in the folder of the final
//! path, synced to disk, and then renamed. Nothing about any file format belongs here.

#[cfg(test)]
mod tests;

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

const PREFIX: &str = ".tmp-";

/// Temporaries this process is building now. A process id alone does not tell: in a container the
/// id of a run that was killed comes back in the next one.
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
    temporary.push(format!("-{}-{number}", std::process::id()));
    let temporary = parent_of(path).join(temporary);
    live().insert(temporary.clone());
    Ok(temporary)
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
/// Any error of the file system; the old file then stands as it was and no temporary is left.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = AtomicFile::create(path)?;
    file.write_all(bytes)?;
    file.commit()
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

    /// Syncs the content and gives it its final name, replacing what stood there.
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
        // After a commit the temporary is gone and this does nothing.
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
    /// Makes the temporary folder beside `path`, whose own parent must exist. Where `path` is there already, temporaries
    /// beside it that a killed process left are removed.
    ///
    /// # Errors
    /// `path` has no file name, or the temporary cannot be created.
    pub fn create(path: &Path) -> io::Result<Self> {
        if path.exists() {
            clean_stale(parent_of(path))?;
        }
        let temporary = temporary_for(path)?;
        if let Err(error) = fs::create_dir(&temporary) {
            live().remove(&temporary);
            return Err(error);
        }
        Ok(Self { path: path.to_path_buf(), temporary })
    }

    /// The folder to build in.
    #[must_use]
    pub fn dir(&self) -> &Path {
        &self.temporary
    }

    /// Syncs everything in the folder and gives it its final name.
    ///
    /// # Errors
    /// `AlreadyExists` if something stands at the final path; any error of syncing or renaming.
    pub fn commit(self) -> io::Result<()> {
        if self.path.symlink_metadata().is_ok() {
            return Err(io::Error::new(
                io::ErrorKind::AlreadyExists,
                format!("{} already exists; choose another name or remove it", self.path.display()),
            ));
        }
        self.publish()
    }

    /// Like [`AtomicDir::commit`], but a folder that stands at the final path gives way, in one step where the system can
    /// exchange two names (Linux, macOS). Elsewhere it is moved aside first, and a crash between the two renames leaves
    /// it under a temporary name.
    ///
    /// # Errors
    /// Any error of syncing or renaming; the old folder is put back where that is possible.
    pub fn commit_replacing(self) -> io::Result<()> {
        if self.path.symlink_metadata().is_err() {
            return self.publish();
        }
        sync_tree(&self.temporary)?;
        if exchange(&self.temporary, &self.path)? {
            // the old folder now has the temporary's name, and goes with it
            return sync_dir(parent_of(&self.path));
        }
        let aside = temporary_for(&self.path)?;
        let outcome = fs::rename(&self.path, &aside).and_then(|()| {
            fs::rename(&self.temporary, &self.path).inspect_err(|_| drop(fs::rename(&aside, &self.path)))
        });
        if outcome.is_ok() {
            // The new folder is in place; what is left of the old one is a stale temporary.
            let _ = fs::remove_dir_all(&aside);
        }
        live().remove(&aside);
        outcome.and_then(|()| sync_dir(parent_of(&self.path)))
    }

    fn publish(self) -> io::Result<()> {
        sync_tree(&self.temporary)?;
        fs::rename(&self.temporary, &self.path)?;
        sync_dir(parent_of(&self.path))
    }
}

impl Drop for AtomicDir {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.temporary);
        live().remove(&self.temporary);
    }
}

/// Exchanges what two names stand for; false where the system or the file system cannot.
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

/// Removes the temporaries in `parent` that a killed process left, and returns their paths in
/// name order. Those of this process's open writers and of other living processes stay.
///
/// # Errors
/// Any error of listing the folder or removing an entry.
pub fn clean_stale(parent: &Path) -> io::Result<Vec<PathBuf>> {
    let mut removed = Vec::new();
    for entry in fs::read_dir(parent)? {
        let entry = entry?;
        let name = entry.file_name();
        let Some(pid) = name.to_str().and_then(pid_of_temporary) else {
            continue;
        };
        if in_use(&parent_of_listing(parent).join(&name), pid) {
            continue;
        }
        if entry.file_type()?.is_dir() {
            fs::remove_dir_all(entry.path())?;
        } else {
            fs::remove_file(entry.path())?;
        }
        removed.push(entry.path());
    }
    removed.sort();
    Ok(removed)
}

/// The spelling under which temporaries in `dir` are registered.
fn parent_of_listing(dir: &Path) -> &Path {
    if dir.as_os_str().is_empty() { Path::new(".") } else { dir }
}

/// The process id in `.tmp-NAME-PID-N`, or `None` for a name that is not one of ours.
fn pid_of_temporary(name: &str) -> Option<u32> {
    let mut parts = name.strip_prefix(PREFIX)?.rsplitn(3, '-');
    parts.next()?.parse::<u64>().ok()?;
    let pid = parts.next()?.parse().ok()?;
    parts.next().map(|_| pid)
}

fn in_use(path: &Path, pid: u32) -> bool {
    if pid == std::process::id() {
        let same = |other: &PathBuf| match (other.canonicalize(), path.canonicalize()) {
            (Ok(a), Ok(b)) => a == b,
            _ => other == path,
        };
        return live().iter().any(same);
    }
    // Where there is no /proc a stranger cannot be told from a dead process; its files stay.
    !Path::new("/proc/self").exists() || Path::new("/proc").join(pid.to_string()).exists()
}
