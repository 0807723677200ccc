//! Configuration errors, each with the place it came from.

use super::KeyOrigin;
use crate::files::is_user_error;
use crate::user_error::UserError;
use std::path::PathBuf;

/// Why no configuration could be built.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// A configuration file cannot be read.
    #[error("cannot read configuration file {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system reported.
        source: std::io::Error,
    },
    /// Neither a file nor a built-in preset.
    #[error(
        "{wanted_by}: no file {name} and no built-in preset of that name (presets: {known}); \
         give the path of a TOML file or a preset's name"
    )]
    NotFound {
        /// What was asked for.
        name: String,
        /// Who asked: the command line or the file with the `extends` key.
        wanted_by: String,
        /// The built-in presets, comma separated.
        known: String,
    },
    /// The text is not TOML.
    #[error("{place} is not valid TOML: {message}")]
    Syntax {
        /// The file or preset.
        place: String,
        /// The parser's message, with the line.
        message: String,
    },
    /// `extends` leads back to a file that is already being read.
    #[error("circular `extends`: {0}; remove one of these keys")]
    Cycle(String),
    /// `extends` is not a string.
    #[error("{0}: `extends` must be a string that names a file or a preset")]
    Extends(KeyOrigin),
    /// An override is not of the form `a.b=value`.
    #[error("--set {0:?}: expected KEY=VALUE with a dotted key such as loss.dssim=0.2")]
    Override(String),
    /// An environment variable cannot be understood.
    #[error("environment variable {name}: {reason}")]
    Env {
        /// The variable.
        name: String,
        /// What is wrong.
        reason: String,
    },
    /// A key that the configuration does not have.
    #[error("{origin}: unknown key `{key}`{}", hint(.suggestion))]
    UnknownKey {
        /// Where the key was given.
        origin: KeyOrigin,
        /// The dotted key.
        key: String,
        /// The closest key that exists.
        suggestion: Option<String>,
    },
    /// A value of the wrong type or outside its range.
    #[error(transparent)]
    Value(Box<ValueError>),
    /// A key is missing in a file that must state all.
    #[error(
        "{}: the key `{key}` is missing, but the configuration of a run states every key; restore the file, or train again \
         with this version of the program",
        path.display()
    )]
    Incomplete {
        /// The file.
        path: PathBuf,
        /// The dotted key.
        key: String,
    },
    /// Values that are valid individually but not together.
    #[error("the configuration is not consistent: {0}")]
    Inconsistent(String),
    /// The built-in defaults cannot be written as TOML.
    #[error("the built-in defaults cannot be written as TOML: {0}")]
    Defaults(String),
}

impl UserError for ConfigError {
    fn is_input(&self) -> bool {
        !matches!(self, Self::Read { source, .. } if !is_user_error(source))
    }
}

/// A value that a key cannot take.
#[derive(Debug, thiserror::Error)]
#[error("{origin}: key `{key}`: {message} (got `{got}`{})", default_note(.default))]
pub struct ValueError {
    /// Where the value was given.
    pub origin: KeyOrigin,
    /// The dotted key.
    pub key: String,
    /// What was expected.
    pub message: String,
    /// The value as TOML.
    pub got: String,
    /// The default as TOML, for comparison.
    pub default: Option<String>,
}

fn hint(suggestion: &Option<String>) -> String {
    suggestion.as_ref().map_or_else(String::new, |key| format!("; did you mean `{key}`?"))
}

fn default_note(default: &Option<String>) -> String {
    default.as_ref().map_or_else(String::new, |value| format!("; the default is `{value}`"))
}
