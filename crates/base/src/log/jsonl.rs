//! Append-only metrics file, one JSON object per line.
//!
//! A resumed run first drops the lines after its checkpoint, so that no step occurs twice.

use std::fs::{File, OpenOptions};
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::Value;

use crate::files::AtomicFile;

/// Why the metrics file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum JsonlError {
    /// The file system failed.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A complete line is not JSON.
    #[error("{path}:{line}: not a JSON line: {source}; fix or remove that line, or remove the file")]
    Line {
        /// The file.
        path: PathBuf,
        /// The line number, from 1.
        line: usize,
        /// The parser's error.
        source: serde_json::Error,
    },
    /// A record has no JSON form.
    #[error("{path}: the record cannot be written as JSON: {source}")]
    Record {
        /// The file.
        path: PathBuf,
        /// The serialiser's error.
        source: serde_json::Error,
    },
}

fn io_at(path: &Path) -> impl Fn(io::Error) -> JsonlError + '_ {
    |source| JsonlError::Io { path: path.to_path_buf(), source }
}

/// Appends records to a metrics file.
#[derive(Debug)]
pub struct JsonlWriter {
    path: PathBuf,
    file: File,
}

impl JsonlWriter {
    /// Opens the file for appending, or creates it. An incomplete last line, which a killed run leaves, is cut off.
    ///
    /// # Errors
    /// [`JsonlError::Io`] from the file system.
    pub fn open(path: &Path) -> Result<Self, JsonlError> {
        let io_error = io_at(path);
        let mut options = OpenOptions::new();
        let options = options.read(true).append(true).create(true);
        let mut file = options.open(path).map_err(&io_error)?;
        let whole = whole_lines(&mut file).map_err(&io_error)?;
        file.set_len(whole).map_err(&io_error)?;
        Ok(Self { path: path.to_path_buf(), file })
    }

    /// Appends one record as one line, passed to the system in one call. A NaN becomes `null`.
    ///
    /// # Errors
    /// [`JsonlError::Record`] or [`JsonlError::Io`].
    pub fn append(&mut self, record: &impl Serialize) -> Result<(), JsonlError> {
        let mut line =
            serde_json::to_vec(record).map_err(|source| JsonlError::Record { path: self.path.clone(), source })?;
        line.push(b'\n');
        self.file.write_all(&line).map_err(io_at(&self.path))
    }

    /// Makes all lines durable.
    ///
    /// # Errors
    /// [`JsonlError::Io`] from the file system.
    pub fn sync(&mut self) -> Result<(), JsonlError> {
        self.file.sync_all().map_err(io_at(&self.path))
    }
}

/// Number of bytes up to and including the last line end.
fn whole_lines(file: &mut File) -> io::Result<u64> {
    const BLOCK: u64 = 4096;
    let mut end = file.metadata()?.len();
    let mut block = Vec::new();
    while end > 0 {
        let start = end.saturating_sub(BLOCK);
        file.seek(SeekFrom::Start(start))?;
        block.clear();
        Read::take(&mut *file, end - start).read_to_end(&mut block)?;
        if let Some(at) = block.iter().rposition(|b| *b == b'\n') {
            return Ok(start + at as u64 + 1);
        }
        end = start;
    }
    Ok(0)
}

/// Atomically drops the lines whose `step` is above `step`, and a half-written last line. Lines without a `step` stay.
/// Returns the number of complete lines dropped, 0 for a missing file.
///
/// # Errors
/// [`JsonlError::Line`] for a complete line that is not JSON, [`JsonlError::Io`] from the file system. The file is then
/// unchanged.
pub fn truncate_after(path: &Path, step: u64) -> Result<usize, JsonlError> {
    let io_error = io_at(path);
    let file = match File::open(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(0),
        opened => opened.map_err(&io_error)?,
    };
    let mut input = BufReader::new(file);
    let mut out = AtomicFile::create(path).map_err(&io_error)?;
    let (mut line, mut number, mut dropped) = (Vec::new(), 0, 0);
    loop {
        line.clear();
        input.read_until(b'\n', &mut line).map_err(&io_error)?;
        if line.last() != Some(&b'\n') {
            break;
        }
        number += 1;
        let record: Value = serde_json::from_slice(&line).map_err(|source| JsonlError::Line {
            path: path.to_path_buf(),
            line: number,
            source,
        })?;
        let at = record.get("step").and_then(Value::as_f64);
        if at.is_some_and(|at| at > step as f64) {
            dropped += 1;
        } else {
            out.write_all(&line).map_err(&io_error)?;
        }
    }
    out.commit().map_err(&io_error)?;
    Ok(dropped)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[derive(Serialize)]
    struct Record {
        step: u64,
        loss: f32,
    }

    fn write(path: &Path, steps: impl IntoIterator<Item = u64>) {
        let mut writer = JsonlWriter::open(path).unwrap();
        for step in steps {
            writer.append(&Record { step, loss: 0.5 }).unwrap();
        }
        writer.sync().unwrap();
    }

    fn steps(path: &Path) -> Vec<u64> {
        let text = fs::read_to_string(path).unwrap();
        let step = |line| serde_json::from_str::<Value>(line).unwrap()["step"].as_u64();
        text.lines().filter_map(step).collect()
    }

    #[test]
    fn a_resumed_run_has_each_step_once() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("metrics.jsonl");
        assert_eq!(truncate_after(&path, 3).unwrap(), 0);
        write(&path, 0..10);
        let mut file = OpenOptions::new().append(true).open(&path).unwrap();
        file.write_all(b"{\"step\":10,\"lo").unwrap();
        assert_eq!(truncate_after(&path, 6).unwrap(), 3);
        write(&path, 7..12);
        assert_eq!(steps(&path), (0..12).collect::<Vec<_>>());
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_half_written_line_is_cut_off_at_opening() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("m");
        for long in [3, 5000, 9000] {
            fs::write(&path, format!("{{\"step\":1}}\n{}", "x".repeat(long))).unwrap();
            write(&path, [2]);
            assert_eq!(steps(&path), [1, 2]);
        }
        fs::write(&path, "x".repeat(9000)).unwrap();
        write(&path, [5]);
        assert_eq!(steps(&path), [5]);
    }

    #[test]
    fn a_broken_line_in_the_middle_is_named_and_nothing_changes() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("m");
        let text = "{\"note\":\"kept\"}\nbroken\n{\"step\":9}\n";
        fs::write(&path, text).unwrap();
        let error = truncate_after(&path, 1).unwrap_err().to_string();
        assert!(error.contains("m:2: not a JSON line"), "{error}");
        assert_eq!(fs::read_to_string(&path).unwrap(), text);
        fs::write(&path, text.replace("broken", "")).unwrap();
        assert!(truncate_after(&path, 1).is_err());
        fs::write(&path, text.replace("broken\n", "")).unwrap();
        assert_eq!(truncate_after(&path, 1).unwrap(), 1);
        assert_eq!(fs::read_to_string(&path).unwrap(), "{\"note\":\"kept\"}\n");
    }

    #[test]
    fn a_nan_becomes_null() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("m");
        let mut writer = JsonlWriter::open(&path).unwrap();
        let loss = f32::NAN;
        writer.append(&Record { step: 1, loss }).unwrap();
        let text = fs::read_to_string(&path).unwrap();
        assert_eq!(text, "{\"step\":1,\"loss\":null}\n");
    }
}
