//! Opening files for reading: regular files only, as a pipe or a device would keep the program waiting forever.

use crate::memory::Budget;
use std::fs::{File, FileType, Metadata, OpenOptions};
use std::io::{self, ErrorKind, Read};
use std::path::{Component, Path};

/// Size in bytes up to which files are read without checking that they fit into memory.
const MAX_UNCHECKED: u64 = 1 << 26;

/// Opens a regular file (or a link to one) for reading. The errors do not name the path.
///
/// # Errors
/// Any error of the file system; `InvalidInput` for a folder, a pipe, a device or a socket.
pub fn open_regular(path: &Path) -> io::Result<File> {
    regular(&path.metadata()?)?;
    let mut options = OpenOptions::new();
    options.read(true);
    #[cfg(unix)]
    {
        // if a pipe takes the file's place at this moment, opening it still returns at once
        use std::os::unix::fs::OpenOptionsExt;
        options.custom_flags(rustix::fs::OFlags::NONBLOCK.bits().cast_signed());
    }
    let file = options.open(path)?;
    regular(&file.metadata()?)?;
    Ok(file)
}

/// Whether a path that a file names leads out of the folder that it is relative to: an absolute one, or one whose `..`
/// outnumber the folders before them. Links are not resolved, as the user has made them.
#[must_use]
pub fn leads_out(path: &Path) -> bool {
    let mut depth = 0i64;
    path.components().any(|part| {
        match part {
            Component::Prefix(_) | Component::RootDir => return true,
            Component::ParentDir => depth -= 1,
            Component::Normal(_) => depth += 1,
            Component::CurDir => {}
        }
        depth < 0
    })
}

/// Opens a regular file that will be read as a whole, and returns it with its length in bytes.
///
/// # Errors
/// As [`open_regular`]; `InvalidInput` if the file does not fit into memory.
fn open_whole(path: &Path) -> io::Result<(File, u64)> {
    let file = open_regular(path)?;
    let len = file.metadata()?.len();
    if len > MAX_UNCHECKED {
        // read and then parsed, so it is in memory twice
        let free = Budget::now().check("reading it", u128::from(len) * 2);
        free.map_err(|e| io::Error::new(ErrorKind::InvalidInput, e))?;
    }
    Ok((file, len))
}

/// Reads the bytes of a regular file.
///
/// # Errors
/// As [`open_regular`], or any error of reading; `InvalidInput` if the file does not fit into memory.
pub fn read_regular(path: &Path) -> io::Result<Vec<u8>> {
    let (mut file, _) = open_whole(path)?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Reads the text of a regular file.
///
/// # Errors
/// As [`read_regular`]; `InvalidData` if it is not UTF-8.
pub fn read_text(path: &Path) -> io::Result<String> {
    String::from_utf8(read_regular(path)?)
        .map_err(|_| io::Error::new(ErrorKind::InvalidData, "the file is not UTF-8 text"))
}

/// Whether the user can fix the error by giving another path or file; otherwise the system failed or refused.
#[must_use]
pub fn is_user_error(error: &io::Error) -> bool {
    use ErrorKind::{InvalidData, InvalidInput, IsADirectory, NotADirectory, NotFound, UnexpectedEof};
    matches!(error.kind(), NotFound | InvalidInput | InvalidData | IsADirectory | NotADirectory | UnexpectedEof)
}

fn regular(metadata: &Metadata) -> io::Result<()> {
    if metadata.is_file() {
        return Ok(());
    }
    Err(io::Error::new(ErrorKind::InvalidInput, format!("it is {}, not a regular file", kind(metadata.file_type()))))
}

/// What is there instead of a regular file, with its article.
fn kind(found: FileType) -> &'static str {
    if found.is_dir() {
        return "a folder";
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if found.is_fifo() {
            return "a pipe";
        }
        if found.is_socket() {
            return "a socket";
        }
    }
    "a device"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_and_links_to_them_are_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        std::fs::write(&path, "text").unwrap();
        assert_eq!(read_text(&path).unwrap(), "text");
        #[cfg(unix)]
        {
            let link = dir.path().join("link");
            std::os::unix::fs::symlink(&path, &link).unwrap();
            assert_eq!(read_regular(&link).unwrap(), b"text");
        }
        std::fs::write(&path, [0xff, 0xfe]).unwrap();
        assert!(read_text(&path).unwrap_err().to_string().contains("not UTF-8 text"));
        assert!(is_user_error(&read_text(Path::new("not/there")).unwrap_err()));
    }

    #[test]
    fn paths_that_lead_out_of_their_folder_are_known() {
        for out in ["/etc/passwd", "..", "../a", "a/../../b", "./../a", "a/b/../../../c"] {
            assert!(leads_out(Path::new(out)), "{out}");
        }
        for within in ["", "a", "./a/b", "a/../b", "..a", "a/b/../../c"] {
            assert!(!leads_out(Path::new(within)), "{within}");
        }
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn pipes_folders_and_devices_are_refused_without_waiting() {
        let dir = tempfile::tempdir().unwrap();
        let pipe = dir.path().join("pipe");
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, rustix::fs::Mode::RUSR, 0).unwrap();
        for (path, word) in [(pipe.as_path(), "a pipe"), (dir.path(), "a folder"), (Path::new("/dev/null"), "a device")]
        {
            let error = open_regular(path).unwrap_err();
            assert!(error.to_string().contains(word) && is_user_error(&error), "{error}");
        }
    }
}
