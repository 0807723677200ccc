//! What can be wrong with a dataset. Each variant names the file, the place in it and a way to fix it.

use crate::user_error::UserError;
use crate::versioned::{KEY, VersionedError};
use crate::words::plain;
use std::path::{Path, PathBuf};

/// An error in reading, checking or writing a dataset.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DataError {
    /// The file system reported an error.
    #[error("{}: cannot {action}: {source}. Hint: {hint}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was attempted, as in "read the file".
        action: &'static str,
        /// The file system's error.
        source: std::io::Error,
        /// How to fix it.
        hint: String,
    },
    /// The text is not JSON, or ends too early.
    #[error("{}: line {line}, column {column}{}: {problem}. Hint: {hint}", path.display(), in_frame(*frame))]
    Syntax {
        /// The JSON file.
        path: PathBuf,
        /// The frame in which the error occurs, counted from 0, if one had begun.
        frame: Option<usize>,
        /// Line, counted from 1.
        line: usize,
        /// Column, counted from 1.
        column: usize,
        /// What the parser found.
        problem: String,
        /// How to fix it.
        hint: String,
    },
    /// A field is missing or holds a value that cannot be used.
    #[error("{}{}, field `{field}`: {problem}. Hint: {hint}", path.display(), in_frame(*frame))]
    Field {
        /// The JSON file.
        path: PathBuf,
        /// The frame, counted from 0; none for a field at the top level.
        frame: Option<usize>,
        /// The field's name.
        field: String,
        /// What is wrong with it.
        problem: String,
        /// How to fix it.
        hint: String,
    },
    /// An image is missing, broken, or does not fit what the JSON says.
    #[error("{}: {problem} (field `file_path`{} of {}). Hint: {hint}", path.display(), in_frame(Some(*frame)), json.display())]
    Image {
        /// The image.
        path: PathBuf,
        /// The JSON file that names it.
        json: PathBuf,
        /// The frame that names it, counted from 0.
        frame: usize,
        /// What is wrong.
        problem: String,
        /// How to fix it.
        hint: String,
    },
    /// Two images of one split have different sizes.
    #[error(
        "{} is {}x{} pixels but {} is {}x{} (field `file_path`, frame {frame} of {}). Hint: all images of a \
         split must have the same size; render them again, or resize those that differ",
        first.display(), first_size.0, first_size.1, second.display(), second_size.0, second_size.1, json.display()
    )]
    MixedResolution {
        /// The JSON file that names both.
        json: PathBuf,
        /// The split's first image.
        first: PathBuf,
        /// Its width and height.
        first_size: (u32, u32),
        /// The first image that differs.
        second: PathBuf,
        /// Its width and height.
        second_size: (u32, u32),
        /// The frame of the second image, counted from 0.
        frame: usize,
    },
    /// An option does not fit the data.
    #[error("{}: option `{option}`: {problem}. Hint: {hint}", path.display())]
    Option {
        /// The dataset or file it was meant for.
        path: PathBuf,
        /// The option's name.
        option: &'static str,
        /// What is wrong.
        problem: String,
        /// How to fix it.
        hint: String,
    },
    /// The visual hull of the alpha masks is empty.
    #[error(
        "split `{split}`: the visual hull of the {views} alpha masks is empty. Hint: check that the images are \
         not all transparent and that `transform_matrix` is camera-to-world with +y up and -z forward"
    )]
    EmptyHull {
        /// The split's name.
        split: String,
        /// Number of views carved.
        views: usize,
    },
}

impl UserError for DataError {
    fn is_input(&self) -> bool {
        match self {
            Self::Io { source, .. } => crate::files::is_user_error(source),
            _ => true,
        }
    }
}

impl DataError {
    /// Returns the error for a record that cannot be read.
    pub(super) fn of_record(path: &Path, error: VersionedError, hint: &str) -> Self {
        let (path, hint) = (path.to_owned(), hint.to_owned());
        match error {
            VersionedError::Json(e) => {
                let (line, column, problem) = (e.line(), e.column(), plain(&e.to_string()));
                Self::Syntax { path, frame: None, line, column, problem, hint }
            }
            VersionedError::Format(e) => {
                Self::Field { path, frame: None, field: KEY.to_owned(), problem: e.problem, hint }
            }
        }
    }

    /// Makes the error for what the file system reported while `action` was attempted on `path`.
    pub(super) fn io(path: &Path, action: &'static str, hint: &str) -> impl FnOnce(std::io::Error) -> Self {
        let (path, hint) = (path.to_owned(), hint.to_owned());
        move |source| Self::Io { path, action, source, hint }
    }

    /// The error of an option that does not fit the data at `path`.
    pub(super) fn option(path: &Path, option: &'static str, problem: impl ToString, hint: impl Into<String>) -> Self {
        Self::Option { path: path.to_owned(), option, problem: problem.to_string(), hint: hint.into() }
    }

    /// The error of a value in a field of a JSON file, of frame `frame` if it is in one.
    pub fn field_error(
        path: &Path,
        frame: Option<usize>,
        field: &str,
        problem: impl Into<String>,
        hint: impl Into<String>,
    ) -> Self {
        let (field, problem, hint) = (field.to_owned(), problem.into(), hint.into());
        Self::Field { path: path.to_owned(), frame, field, problem, hint }
    }
}

fn in_frame(frame: Option<usize>) -> String {
    frame.map(|i| format!(", frame {i}")).unwrap_or_default()
}
