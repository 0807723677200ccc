//! A sweep on a cluster with Slurm: one job array whose tasks are workers on the sweep's folder.
//!
//! A [`SlurmProfile`] specifies what a task may use, [`script()`] writes the batch script, [`submit()`] passes the
//! tasks to `sbatch`, [`queue()`] asks `squeue` for their state. The accounting database, which many sites lack, is not
//! used. What a worker does, and which tasks there are, is decided elsewhere.

pub mod profile;
pub mod queue;
pub mod script;
pub mod submit;
mod tasks;

use std::env;
use std::ffi::{OsStr, OsString};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

pub use profile::SlurmProfile;
pub use queue::{TaskState, queue};
pub use script::{SlurmJob, script};
pub use submit::{Submission, submissions, submit};

use crate::log::jsonl::JsonlError;
use crate::user_error::UserError;
use crate::versioned::VersionedError;

/// Why Slurm cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SlurmError {
    /// The file system failed.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The profile is not TOML, or has an unknown key or a value of the wrong type.
    #[error("{path}: {source}")]
    Toml {
        /// The profile.
        path: PathBuf,
        /// The parser's error, which shows line and key.
        source: Box<toml::de::Error>,
    },
    /// A key of the profile has a value that Slurm would not accept.
    #[error("{path}: {key} = {value}: {fix}")]
    Key {
        /// The profile.
        path: PathBuf,
        /// The key.
        key: &'static str,
        /// Its value.
        value: String,
        /// What it should be.
        fix: &'static str,
    },
    /// The sweep's folder has a path that batch scripts cannot contain.
    #[error("{path}: Slurm does not accept a path with {what}; rename or move the folder")]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What is not accepted.
        what: &'static str,
    },
    /// A program of Slurm was not found.
    #[error(
        "{program} is not on the PATH: run this on the cluster's login node (some need `module load slurm` first), \
         or omit --slurm to train here"
    )]
    Missing {
        /// The program.
        program: String,
    },
    /// A program of Slurm could not be started.
    #[error("{program}: {source}")]
    Start {
        /// The program.
        program: String,
        /// The system's error.
        source: io::Error,
    },
    /// A program of Slurm refused a request.
    #[error("{program} refused: {said}; check the Slurm profile (partition, account, qos, time, memory, gpus)")]
    Refused {
        /// The program and its arguments.
        program: String,
        /// Its message.
        said: String,
    },
    /// A program of Slurm gave an unexpected answer.
    #[error("{program} answered {said:?}, which is not a job number")]
    Answer {
        /// The program.
        program: String,
        /// Its message.
        said: String,
    },
    /// The cluster accepts no job arrays.
    #[error("this cluster accepts no job arrays (MaxArraySize is 0); start the workers by hand, one job each")]
    NoArrays,
    /// The list of submitted jobs cannot be written.
    #[error(transparent)]
    Jobs(#[from] JsonlError),
    /// A line of the list of submitted jobs cannot be read.
    #[error("{path}:{line}: {source}; fix or remove the line")]
    JobLine {
        /// The list.
        path: PathBuf,
        /// The line number, from 1.
        line: usize,
        /// The parser's error.
        source: VersionedError,
    },
}

impl UserError for SlurmError {
    fn is_input(&self) -> bool {
        !matches!(self, Self::Refused { .. } | Self::Answer { .. } | Self::Start { .. })
    }
}

fn io_at(path: &Path) -> impl Fn(io::Error) -> SlurmError + '_ {
    |source| SlurmError::Io { path: path.to_path_buf(), source }
}

/// Finds and calls the programs of Slurm.
#[derive(Debug, Clone)]
pub struct SlurmTools {
    path: OsString,
}

impl Default for SlurmTools {
    /// The folders of this process's `PATH`.
    fn default() -> Self {
        Self::new(&env::var_os("PATH").unwrap_or_default())
    }
}

impl SlurmTools {
    /// Looks in the folders of `path`, which has the form of the variable `PATH`.
    pub fn new(path: &OsStr) -> Self {
        Self { path: path.to_owned() }
    }

    /// Whether `program` is found.
    pub fn have(&self, program: &str) -> bool {
        self.find(program).is_some()
    }

    fn find(&self, program: &str) -> Option<PathBuf> {
        env::split_paths(&self.path).map(|folder| folder.join(program)).find(|file| file.is_file())
    }

    /// Runs `program` to its end.
    fn call(&self, program: &str, arguments: &[OsString]) -> Result<Output, SlurmError> {
        let file = self.find(program).ok_or_else(|| SlurmError::Missing { program: program.to_owned() })?;
        let mut command = Command::new(file);
        command.args(arguments).env("PATH", &self.path).stdin(Stdio::null());
        command.output().map_err(|source| SlurmError::Start { program: program.to_owned(), source })
    }
}

/// The message of a program that failed, on one line.
fn complaint(output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stderr);
    let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    if lines.is_empty() { format!("no reason given, {}", output.status) } else { lines.join("; ") }
}

#[cfg(unix)]
#[cfg(test)]
mod fake {
    //! Fake programs of Slurm: shell scripts that come first on a `PATH` of their own.

    use super::*;
    use std::fs;
    use std::os::unix::fs::PermissionsExt;

    /// Writes a program into `folder`.
    pub(super) fn program(folder: &Path, name: &str, body: &str) {
        fs::create_dir_all(folder).unwrap();
        let file = folder.join(name);
        fs::write(&file, format!("#!/bin/bash\n{body}\n")).unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o755)).unwrap();
    }

    /// A `PATH` with `folder` before the system's own folders.
    pub(super) fn path(folder: &Path) -> OsString {
        let own = env::var_os("PATH").unwrap_or_default();
        env::join_paths(std::iter::once(folder.to_path_buf()).chain(env::split_paths(&own))).unwrap()
    }
}

#[cfg(unix)]
#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_program_says_what_to_do() {
        let dir = tempfile::tempdir().unwrap();
        let tools = SlurmTools::new(dir.path().as_os_str());
        assert!(!tools.have("sbatch"));
        let text = tools.call("sbatch", &[]).unwrap_err().to_string();
        assert!(text.contains("sbatch") && text.contains("login node") && text.contains("--slurm"), "{text}");
        assert!(!SlurmTools::new(OsStr::new("")).have("sbatch"));
    }

    #[test]
    fn a_complaint_is_one_line() {
        let dir = tempfile::tempdir().unwrap();
        fake::program(dir.path(), "sinfo", "echo 'a: no' >&2; echo >&2; echo ' b' >&2; exit 3");
        fake::program(dir.path(), "sdiag", "exit 4");
        let tools = SlurmTools::new(&fake::path(dir.path()));
        assert_eq!(complaint(&tools.call("sinfo", &[]).unwrap()), "a: no; b");
        assert!(complaint(&tools.call("sdiag", &[]).unwrap()).contains('4'));
    }
}
