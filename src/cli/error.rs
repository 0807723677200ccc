//! Errors as shown on the terminal.

use crate::files::LockError;
use crate::run::RunError;
use crate::user_error::UserError;
use crate::words::plain;
use std::fmt;

/// Adds the option --out to the error of a run that cannot be written to.
pub(super) fn or_elsewhere(error: RunError) -> CliError {
    let cannot = matches!(error, RunError::Lock(LockError::ReadOnly { .. }));
    match cannot {
        true => {
            CliError::input(format!("{error}; if the run is not yours to write to, pass --out DIR for the results"))
        }
        false => error.into(),
    }
}

/// Refuses the first of these flags that was given.
pub(super) fn refuse(flags: &[(&str, bool)], why: impl fmt::Display) -> Result<(), CliError> {
    match flags.iter().find(|(_, given)| *given) {
        Some((flag, _)) => Err(CliError::input(format!("{flag}: {why}"))),
        None => Ok(()),
    }
}

/// A message and an exit code: 2 for bad input or usage, 1 for anything else.
#[derive(Debug)]
pub struct CliError {
    message: String,
    code: u8,
}

impl CliError {
    /// Bad input or usage.
    pub fn input(error: impl fmt::Display) -> Self {
        Self::with_code(error, 2)
    }

    /// Anything else.
    pub fn failure(error: impl fmt::Display) -> Self {
        Self::with_code(error, 1)
    }

    /// An error with the given exit code, in plain words wherever a parser of some file was the first to speak.
    pub(super) fn with_code(error: impl fmt::Display, code: u8) -> Self {
        Self { message: plain(&error.to_string()), code }
    }

    /// The exit code.
    pub fn code(&self) -> u8 {
        self.code
    }
}

impl fmt::Display for CliError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for CliError {}

impl<E: UserError> From<E> for CliError {
    fn from(error: E) -> Self {
        if error.is_input() { Self::input(error) } else { Self::failure(error) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::error::VolumeError;
    use std::io::ErrorKind;
    use std::path::Path;

    #[test]
    fn no_message_names_a_rust_type() {
        let problem = "invalid type: sequence, expected u64 at line 1 column 9";
        let error = CliError::input(VolumeError::invalid(Path::new("v.raw.json"), "sidecar", problem, "give dims"));
        assert_eq!(
            error.to_string(),
            "v.raw.json: sidecar: expected a whole number, 0 or above, not a list at line 1 column 9; give dims"
        );
    }

    #[test]
    fn a_run_that_cannot_be_written_to_has_a_way_out() {
        let denied = LockError::ReadOnly { run: "run".into(), source: ErrorKind::PermissionDenied.into() };
        let error = or_elsewhere(denied.into());
        assert!(error.code() == 2 && error.to_string().contains("--out DIR"), "{error}");
        let full = LockError::Io { path: "run/.lock".into(), source: ErrorKind::StorageFull.into() };
        assert!(!or_elsewhere(full.into()).to_string().contains("--out"));
    }

    #[test]
    fn volume_errors_that_users_can_fix_are_2_and_system_errors_are_1() {
        let path = Path::new("a.nrrd");
        let io = |kind: ErrorKind| VolumeError::io(path, "open the file", kind.into(), "check it");
        for (error, code) in [
            (VolumeError::invalid(path, "sizes", "too few", "correct them"), 2),
            (io(ErrorKind::NotFound), 2),
            (io(ErrorKind::StorageFull), 1),
        ] {
            assert_eq!(CliError::from(error).code(), code);
        }
    }
}
