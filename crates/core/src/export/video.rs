//! MP4 files from a sequence of frames, encoded by the program `ffmpeg` where it is installed. Each ends with [`MARK`],
//! which identifies it as this program's own when a user has it replaced.

use crate::files::{AtomicFile, MARK, ReplaceError};
use std::ffi::OsString;
use std::fs::OpenOptions;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::JoinHandle;

/// Name of the program.
const FFMPEG: &str = "ffmpeg";
/// Maximum length of its message that is passed on, bytes.
const MAX_MESSAGE: u64 = 2000;

/// Why a film cannot be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VideoError {
    /// The program cannot be started.
    #[error("{path}: MP4 needs the program `{FFMPEG}` ({source}); install it, or write NAME.png or a folder")]
    Missing {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
    /// The program failed.
    #[error("{path}: `{FFMPEG}` failed: {message}")]
    Failed {
        /// The file.
        path: PathBuf,
        /// Its message.
        message: String,
    },
    /// Something that may not be replaced is there.
    #[error(transparent)]
    Replace(#[from] ReplaceError),
    /// The file system failed.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
}

/// A film that is written frame by frame. It appears when it is finished; if dropped before, nothing is left.
#[derive(Debug)]
pub struct Mp4 {
    path: PathBuf,
    encoder: VideoEncoder,
    file: AtomicFile,
}

impl Mp4 {
    /// Begins a film of `width` x `height` pixels at `fps` frames per second.
    ///
    /// # Errors
    /// If there is no `ffmpeg`, or the file cannot be written.
    pub fn create(path: &Path, (width, height): (u32, u32), fps: u16) -> Result<Self, VideoError> {
        let file = AtomicFile::create_named(path)?;
        let mut command = Command::new(FFMPEG);
        command.args(["-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"]);
        command.args(["-s", &format!("{width}x{height}"), "-r", &fps.to_string(), "-i", "-", "-an"]);
        // players require 4:2:0, which requires even sides
        command.args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p"]);
        // as a file, whatever its name: `12:30/film.mp4` would be taken for the protocol `12`
        let mut out = OsString::from("file:");
        out.push(file.temporary());
        command.args(["-movflags", "+faststart", "-f", "mp4"]).arg(out);
        let missing = |source| VideoError::Missing { path: path.into(), source };
        Ok(Self { path: path.into(), encoder: VideoEncoder::start(&mut command).map_err(missing)?, file })
    }

    /// Adds a frame `[height, width, 3]` of 8-bit RGB.
    ///
    /// # Errors
    /// If `ffmpeg` has failed.
    pub fn add(&mut self, frame: &[u8]) -> Result<(), VideoError> {
        let written = self.encoder.child.stdin.as_mut().map_or(Ok(()), |stdin| stdin.write_all(frame));
        // its own message says more than a closed pipe
        written.or_else(|e| self.encoder.end().and(Err(e.to_string()))).map_err(|e| self.failed(e))
    }

    /// Finishes the film and gives it its name.
    ///
    /// # Errors
    /// If `ffmpeg` or the file system fails.
    pub fn finish(mut self) -> Result<(), VideoError> {
        self.encoder.end().map_err(|e| self.failed(e))?;
        let Self { path, file, .. } = self;
        let marked = OpenOptions::new().append(true).open(file.temporary()).and_then(|mut f| f.write_all(&mark()));
        marked.and_then(|()| file.commit()).map_err(|source| VideoError::Io { path, source })
    }

    fn failed(&self, message: String) -> VideoError {
        VideoError::Failed { path: self.path.clone(), message }
    }
}

/// Returns the mark in a box that players skip (`free`, ISO/IEC 14496-12) and that may be at the end of a file.
fn mark() -> Vec<u8> {
    let length = 8 + MARK.len() as u32;
    [&length.to_be_bytes(), &b"free"[..], MARK.as_bytes()].concat()
}

/// The running program; killed if it is dropped before its end.
#[derive(Debug)]
struct VideoEncoder {
    child: Child,
    message: Option<JoinHandle<String>>,
}

impl VideoEncoder {
    fn start(command: &mut Command) -> io::Result<Self> {
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        // Ctrl-C is for this program, which then ends the other
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(command, 0);
        let mut child = command.spawn()?;
        let message = child.stderr.take().map(|mut stderr| {
            std::thread::spawn(move || {
                let mut text = Vec::new();
                // everything is read, so that the program never blocks on its output; errors of reading are ignored
                let _ = stderr.by_ref().take(MAX_MESSAGE).read_to_end(&mut text);
                let _ = io::copy(&mut stderr, &mut io::sink());
                String::from_utf8_lossy(&text).trim().to_owned()
            })
        });
        Ok(Self { child, message })
    }

    /// Waits for its end; returns its status and message if it failed.
    fn end(&mut self) -> Result<(), String> {
        drop(self.child.stdin.take());
        let status = self.child.wait().map_err(|e| e.to_string())?;
        let message = self.message.take().and_then(|reader| reader.join().ok()).unwrap_or_default();
        if status.success() { Ok(()) } else { Err(format!("{status}; {message}")) }
    }
}

impl Drop for VideoEncoder {
    fn drop(&mut self) {
        // without effect after its end
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
