//! What may be replaced: a folder or file that the program made itself, and nothing that is still needed.
//!
//! Every replacement goes through here. A folder is recognised by its [`FolderKind`]: a marker in it, and no file that
//! the program does not put there. A file is recognised by [`MARK`] among its first bytes, or as its last.

use crate::user_error::UserError;
use std::fmt::Display;
use std::fs;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Mark by which files are recognised: near the beginning of each file whose name a user chooses (PNG, PLY, NRRD, VTI),
/// or at its end if another program writes the beginning (MP4), or it has no room for a comment (NPY).
pub const MARK: &str = "volseggs";
/// Number of first bytes in which the mark is looked for.
const HEAD: u64 = 4096;

/// A kind of folder that the program makes, and how it recognises one.
#[derive(Clone, Copy, Debug)]
pub struct FolderKind {
    /// What it is, for messages: `a dataset`.
    pub what: &'static str,
    /// Files of which at least one is in each folder of this kind.
    pub markers: &'static [&'static str],
    /// All other files that the program puts into it, as glob patterns of paths within it, such as `masks/[0-9]*.png`;
    /// `**` stands for folders at any depth.
    pub entries: &'static [&'static str],
}

/// Why a file or folder is not replaced.
#[derive(Debug, thiserror::Error)]
pub enum ReplaceError {
    /// It is not recognised as the program's own.
    #[error("{}: {reason}, so it is not replaced; choose another name or remove it yourself", path.display())]
    Foreign {
        /// The file or folder.
        path: PathBuf,
        /// Why it is not recognised as the program's own.
        reason: String,
    },
    /// It contains something that is needed.
    #[error("{}: contains {}, which is in use, so it is not replaced; choose another name", path.display(), inner.display())]
    Needed {
        /// The folder.
        path: PathBuf,
        /// An input, the run or the working directory.
        inner: PathBuf,
    },
    /// Its folder does not exist.
    #[error("{}: there is no folder {}; make it first", path.display(), folder.display())]
    NoFolder {
        /// The file to be written.
        path: PathBuf,
        /// The folder.
        folder: PathBuf,
    },
    /// The file system failed.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

impl UserError for ReplaceError {
    /// Whether the user can fix it with another name.
    fn is_input(&self) -> bool {
        !matches!(self, Self::Io { .. })
    }
}

/// Why results were not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// Something else is where they belong.
    #[error(transparent)]
    Replace(#[from] ReplaceError),
    /// A file could not be written.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file, or its folder.
        path: PathBuf,
        /// The reason.
        reason: String,
    },
}

impl UserError for WriteError {
    /// Whether the user can fix it by making room.
    fn is_input(&self) -> bool {
        matches!(self, Self::Replace(error) if error.is_input())
    }
}

impl WriteError {
    /// Returns a conversion of the reason why `path` could not be written.
    pub fn writing<E: Display>(path: &Path) -> impl Fn(E) -> Self {
        move |e| Self::File { path: path.to_owned(), reason: e.to_string() }
    }
}

impl FolderKind {
    /// Checks that `path` is free, or is an empty folder or one of this kind that may be replaced. `needed` are the
    /// inputs of the command and its run; the working directory is always needed.
    ///
    /// # Errors
    /// If something else exists there, or the folder contains something that is needed.
    pub fn check(&self, path: &Path, needed: &[&Path]) -> Result<(), ReplaceError> {
        let foreign = |reason: String| Err(ReplaceError::Foreign { path: path.into(), reason });
        let io = |source| ReplaceError::Io { path: path.into(), source };
        let kind = match path.symlink_metadata() {
            Err(_) if path.file_name().is_none() => return foreign("does not end in a folder name".into()),
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(()),
            Err(e) if e.kind() == io::ErrorKind::NotADirectory => {
                return foreign("is below a file, so no folder can be created there".into());
            }
            found => found.map_err(io)?.file_type(),
        };
        if kind.is_symlink() {
            return foreign("is a symbolic link".into());
        }
        if !kind.is_dir() {
            return foreign(format!("is a file, not {}", self.what));
        }
        refuse_needed(path, needed)?;
        let mut files = Vec::new();
        files_below(path, Path::new(""), &mut files).map_err(io)?;
        files.sort();
        if files.is_empty() {
            return Ok(());
        }
        if !self.markers.iter().any(|m| files.iter().any(|f| f == Path::new(m))) {
            return foreign(format!("is not {} (no {} in it)", self.what, self.markers.join(" or ")));
        }
        let patterns = self.entries.iter().chain(self.markers).map(|p| glob::Pattern::new(p));
        let patterns: Vec<glob::Pattern> = patterns.filter_map(Result::ok).collect();
        let options = glob::MatchOptions { require_literal_separator: true, ..glob::MatchOptions::default() };
        match files.iter().find(|f| !patterns.iter().any(|p| p.matches_path_with(f, options))) {
            Some(file) => foreign(format!("contains {}, which does not belong to {}", file.display(), self.what)),
            None => Ok(()),
        }
    }
}

/// Files that operating systems and file managers leave in any folder; they do not prevent replacement.
const LITTER: [&str; 4] = [".DS_Store", "Thumbs.db", "desktop.ini", ".directory"];

/// Collects the paths within `folder` of all files below `inner`. Links count as files; litter and the temporaries of
/// killed writers are skipped.
fn files_below(folder: &Path, inner: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    for entry in fs::read_dir(folder.join(inner))? {
        let entry = entry?;
        let name = entry.file_name();
        let text = name.to_string_lossy();
        if text.starts_with(super::atomic::PREFIX) || text.starts_with(".nfs") || LITTER.contains(&text.as_ref()) {
            continue;
        }
        let path = inner.join(&name);
        if entry.file_type()?.is_dir() { files_below(folder, &path, files)? } else { files.push(path) }
    }
    Ok(())
}

/// Refuses a folder that contains the working directory or something in `needed`.
fn refuse_needed(path: &Path, needed: &[&Path]) -> Result<(), ReplaceError> {
    let io = |source| ReplaceError::Io { path: path.into(), source };
    let folder = path.canonicalize().map_err(io)?;
    let here = std::env::current_dir().ok();
    for inner in needed.iter().copied().chain(here.as_deref()) {
        // what does not exist cannot be lost
        if inner.canonicalize().is_ok_and(|i| i.starts_with(&folder)) {
            return Err(ReplaceError::Needed { path: path.into(), inner: inner.into() });
        }
    }
    Ok(())
}

/// Returns the first of `others` that is the file at `path`, under whatever name; `None` if nothing is there.
pub fn same_file<'a>(path: &Path, others: impl IntoIterator<Item = &'a Path>) -> Option<&'a Path> {
    let whole = path.canonicalize().ok()?;
    others.into_iter().find(|other| other.canonicalize().is_ok_and(|other| other == whole))
}

/// Checks that a file named by a user may be written at `path`: its folder exists, and a file already at the path is
/// empty or was made by this program ([`MARK`]).
///
/// # Errors
/// If the folder is missing, or something else exists at the path.
pub fn check_file(path: &Path) -> Result<(), ReplaceError> {
    let foreign = |reason: &str| Err(ReplaceError::Foreign { path: path.into(), reason: reason.into() });
    let io = |source| ReplaceError::Io { path: path.into(), source };
    if path.file_name().is_none() {
        return foreign("does not end in a file name");
    }
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
    if let Some(folder) = folder.filter(|f| !f.is_dir()) {
        return Err(ReplaceError::NoFolder { path: path.into(), folder: folder.into() });
    }
    let kind = match path.symlink_metadata() {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(()),
        found => found.map_err(io)?.file_type(),
    };
    if !kind.is_file() {
        return foreign(if kind.is_dir() { "is a folder" } else { "is not a regular file" });
    }
    let empty = path.metadata().map_err(io)?.len() == 0;
    if empty || has_mark(path).map_err(io)? { Ok(()) } else { foreign("was not made by volseggs") }
}

/// Whether a file was made by this program: [`MARK`] is among its first bytes, or its last.
///
/// # Errors
/// Any error of reading.
pub fn has_mark(path: &Path) -> io::Result<bool> {
    let mut file = fs::File::open(path)?;
    let (mut head, mut end) = (Vec::new(), Vec::new());
    file.by_ref().take(HEAD).read_to_end(&mut head)?;
    let length = file.seek(SeekFrom::End(0))?;
    file.seek(SeekFrom::Start(length.saturating_sub(MARK.len() as u64)))?;
    file.take(MARK.len() as u64).read_to_end(&mut end)?;
    Ok(head.windows(MARK.len()).any(|w| w == MARK.as_bytes()) || end == MARK.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    const KIND: FolderKind = FolderKind {
        what: "a dataset",
        markers: &["prepare.json"],
        entries: &["train", "*.txt", "r_[0-9]*.png", "sub/*.txt"],
    };

    fn folder(entries: &[&str]) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        entries.iter().for_each(|e| fs::write(dir.path().join(e), "x").unwrap());
        dir
    }

    fn refusal(dir: &Path, needed: &[&Path]) -> String {
        KIND.check(dir, needed).unwrap_err().to_string()
    }

    #[test]
    fn only_a_folder_of_the_same_kind_is_replaced() {
        for good in [&[][..], &["prepare.json"], &["prepare.json", "train", "a.txt", "r_3.png", ".tmp-x-1-0"]] {
            KIND.check(folder(good).path(), &[]).unwrap();
        }
        KIND.check(Path::new("not/there"), &[]).unwrap();
        assert!(refusal(folder(&["train"]).path(), &[]).contains("is not a dataset (no prepare.json in it)"));
        let other = folder(&["prepare.json", "thesis.tex"]);
        assert!(refusal(other.path(), &[]).contains("thesis.tex"));
        assert!(refusal(&other.path().join("thesis.tex"), &[]).contains("is a file"));
        let deep = folder(&["prepare.json", ".DS_Store"]);
        fs::create_dir_all(deep.path().join("sub/more")).unwrap();
        fs::write(deep.path().join("sub/a.txt"), "x").unwrap();
        KIND.check(deep.path(), &[]).unwrap();
        fs::write(deep.path().join("sub/more/mine.txt"), "x").unwrap();
        assert!(refusal(deep.path(), &[]).contains("sub/more/mine.txt, which does not belong to a dataset"));
    }

    #[test]
    fn a_folder_with_needed_content_is_not_replaced() {
        let dir = folder(&["prepare.json", "train"]);
        let inner = dir.path().join("train");
        assert!(refusal(dir.path(), &[&inner]).contains("which is in use"));
        assert!(refusal(dir.path(), &[dir.path()]).contains("which is in use"));
        KIND.check(dir.path(), &[Path::new("/not/there")]).unwrap();
    }

    #[test]
    #[cfg(unix)]
    fn a_link_is_not_replaced() {
        let dir = folder(&["prepare.json"]);
        let beside = tempfile::tempdir().unwrap();
        let link = beside.path().join("link");
        std::os::unix::fs::symlink(dir.path(), &link).unwrap();
        assert!(refusal(&link, &[]).contains("symbolic link"));
    }

    #[test]
    fn only_a_file_with_the_mark_is_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x");
        check_file(&path).unwrap();
        fs::write(&path, "ply\ncomment volseggs\n").unwrap();
        check_file(&path).unwrap();
        fs::write(&path, "a thesis").unwrap();
        assert!(check_file(&path).unwrap_err().to_string().contains("was not made by volseggs"));
        assert!(check_file(dir.path()).unwrap_err().to_string().contains("is a folder"));
        assert!(check_file(&dir.path().join("no/x")).unwrap_err().to_string().contains("make it first"));
        assert!(check_file(Path::new("..")).is_err());
    }
}
