//! Opening files for reading: regular files only, as a pipe or a device would keep the program waiting forever.

use crate::memory::MemoryBudget;
use std::fs::{File, FileType, Metadata, OpenOptions};
use std::io::{self, ErrorKind, Read};
use std::path::{Component, Path};

/// Size in bytes up to which files are read without checking that they fit into memory.
const MAX_UNCHECKED: u64 = 1 << 26;

/// Maximum size in bytes of a file of settings, such as a configuration, a sweep or a sidecar; the longest here has 20
/// kilobytes.
pub const MAX_SETTINGS: u64 = 1_000_000;

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
        let free = MemoryBudget::now().check("reading it", u128::from(len) * 2);
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

/// Reads the text of a regular file, see [`decode_text`].
///
/// # Errors
/// As [`read_regular`]; `InvalidData` if it is no text.
pub fn read_text(path: &Path) -> io::Result<String> {
    decode_text(read_regular(path)?).map_err(|e| io::Error::new(ErrorKind::InvalidData, e))
}

/// Reads the text of a file that people write by hand, of at most a million bytes: parsers take seconds for what
/// is longer, and it is something else.
///
/// # Errors
/// As [`read_text`]; `InvalidInput` if it is longer.
pub fn read_settings(path: &Path) -> io::Result<String> {
    let file = open_regular(path)?;
    let mut bytes = Vec::new();
    file.take(MAX_SETTINGS + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MAX_SETTINGS {
        let problem = format!("the file is longer than {MAX_SETTINGS} bytes, so it is no file of settings");
        return Err(io::Error::new(ErrorKind::InvalidInput, problem));
    }
    decode_text(bytes).map_err(|e| io::Error::new(ErrorKind::InvalidData, e))
}

/// Bytes that are no text.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the file is not UTF-8 text")]
pub struct NotText {
    /// The first line, from 1, that cannot be read.
    pub line: usize,
}

/// Decodes UTF-8, or UTF-16 that begins with its byte order mark, as editors and shells on Windows write. The result
/// has no mark, which parsers would refuse.
///
/// # Errors
/// Anything else.
pub fn decode_text(mut bytes: Vec<u8>) -> Result<String, NotText> {
    let wide = |unit: fn([u8; 2]) -> u16| {
        let (units, rest) = bytes[2..].as_chunks::<2>();
        let text = char::decode_utf16(units.iter().map(|u| unit(*u))).collect::<Result<String, _>>();
        text.ok().filter(|_| rest.is_empty()).ok_or(NotText { line: 1 })
    };
    match bytes.as_slice() {
        [0xff, 0xfe, ..] => return wide(u16::from_le_bytes),
        [0xfe, 0xff, ..] => return wide(u16::from_be_bytes),
        [0xef, 0xbb, 0xbf, ..] => drop(bytes.drain(..3)),
        _ => {}
    }
    String::from_utf8(bytes).map_err(|error| {
        let before = &error.as_bytes()[..error.utf8_error().valid_up_to()];
        NotText { line: 1 + before.iter().filter(|b| **b == b'\n').count() }
    })
}

/// Whether the user can fix the error by giving another path or file; otherwise the system failed or refused.
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
        std::fs::write(&path, [b'\n', 0xff]).unwrap();
        assert_eq!(decode_text(vec![b'\n', 0xff]), Err(NotText { line: 2 }));
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
    fn byte_order_marks_are_removed() {
        let text = "{\"a\": \"\u{e9}\u{1f600}\"}\r\n";
        let marked = format!("\u{feff}{text}");
        let wide = |bytes: fn(u16) -> [u8; 2]| marked.encode_utf16().flat_map(bytes).collect::<Vec<u8>>();
        for bytes in [text.into(), marked.clone().into_bytes(), wide(u16::to_le_bytes), wide(u16::to_be_bytes)] {
            assert_eq!(decode_text(bytes).as_deref(), Ok(text));
        }
        // half a character, and half a pair
        assert!(decode_text(vec![0xff, 0xfe, 0x41]).is_err() && decode_text(vec![0xff, 0xfe, 0x00, 0xd8]).is_err());
        assert_eq!(decode_text(vec![0xef, 0xbb, 0xbf]).as_deref(), Ok(""));
    }

    #[test]
    fn settings_are_short() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.toml");
        std::fs::write(&path, vec![b' '; MAX_SETTINGS as usize]).unwrap();
        assert_eq!(read_settings(&path).unwrap().len() as u64, MAX_SETTINGS);
        std::fs::write(&path, vec![b' '; MAX_SETTINGS as usize + 1]).unwrap();
        let error = read_settings(&path).unwrap_err();
        assert!(error.to_string().contains("longer than 1000000 bytes") && is_user_error(&error), "{error}");
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
