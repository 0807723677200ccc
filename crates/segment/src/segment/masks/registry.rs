//! Mask sources by name: what one says of itself, and its choice with its options. Commands, evaluations, sweeps and the
//! viewer take sources from the table [`MASK_SOURCES`].

use super::make::MaskJob;
use super::source::{MASK_SOURCES, MaskSource, SourceError};
use crate::data::Truth;
use crate::data::truth::LabelledView;
use std::fmt;
use std::path::PathBuf;
use thiserror::Error;

/// Default number of points along a side of the grid that prompts a network; as published for MobileSAM.
pub const DEFAULT_POINTS: usize = 32;

/// A kind of mask source: what is known of it before there is anything to mask.
pub trait MaskSourceKind: Send + Sync {
    /// What it is, in one line, for help.
    fn help(&self) -> &str;

    /// The options that it reads.
    fn reads(&self) -> &[SourceOption] {
        &[]
    }

    /// Which views it has masks of.
    fn views(&self) -> SourceViews {
        SourceViews::Around
    }

    /// Completes the options that it reads: defaults, the places of files.
    ///
    /// # Errors
    /// If one is missing, too large, or names no file.
    fn complete(&self, options: SourceOptions) -> Result<SourceOptions, ChooseSourceError> {
        Ok(options)
    }

    /// Estimates the seconds that `pictures` pictures take on a CPU of two cores, if that is worth a warning.
    fn seconds(&self, _pictures: usize, _options: &SourceOptions) -> Option<f64> {
        None
    }

    /// Opens the source for the groups and views of a job.
    ///
    /// # Errors
    /// If it has no masks of these, or a file cannot be read; the error names the file.
    fn open(&self, input: &SourceInput<'_>) -> Result<Box<dyn MaskSource>, SourceError>;
}

/// Which views a source has masks of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SourceViews {
    /// Any: views around the scene are drawn.
    Around,
    /// Those of the dataset that have a label image.
    Labelled,
    /// Those whose pictures were written for another program.
    HandedOut,
}

/// Options of mask sources.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SourceOptions {
    /// A folder of masks, `GROUP/VIEW_NUMBER.png`, or a COCO file.
    pub path: Option<PathBuf>,
    /// A file of a network's weights.
    pub weights: Option<PathBuf>,
    /// Points along a side of the grid that prompts a network.
    pub points: Option<usize>,
}

/// One of the [`SourceOptions`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SourceOption {
    /// [`SourceOptions::path`]
    Path,
    /// [`SourceOptions::weights`]
    Weights,
    /// [`SourceOptions::points`]
    Points,
}

impl fmt::Display for SourceOption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Path => "path",
            Self::Weights => "weights",
            Self::Points => "points",
        })
    }
}

/// Why a source cannot be used. A caller with names of its own for the options words this itself.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ChooseSourceError {
    /// There is none of this name.
    #[error("\"{name}\" is not one of {}", names())]
    Unknown {
        /// The name.
        name: String,
    },
    /// An option is given that the source does not read.
    #[error("{option}: only for masks from {by}")]
    NotRead {
        /// The option.
        option: SourceOption,
        /// A source that does read it; empty if there is none.
        by: String,
    },
    /// An option is missing.
    #[error("{option}: name {what}")]
    Missing {
        /// The option.
        option: SourceOption,
        /// What it has to name.
        what: &'static str,
    },
    /// An option cannot be used.
    #[error("{option}: {problem}")]
    Unusable {
        /// The option.
        option: SourceOption,
        /// Why.
        problem: String,
    },
}

/// What a source is opened for.
#[derive(Clone, Copy)]
pub struct SourceInput<'a> {
    /// The groups and views.
    pub job: &'a MaskJob<'a>,
    /// Its options, completed.
    pub options: &'a SourceOptions,
    /// Groups that there may be masks of besides those of the job, to be skipped.
    pub others: &'a [String],
    /// For [`SourceViews::Labelled`]: the ground truth, and its views, which are those of the job in the same order.
    pub labelled: Option<(&'a Truth, &'a [LabelledView])>,
}

/// A source chosen by name, with its options.
#[derive(Clone)]
pub struct ChosenSource {
    /// Its name.
    pub name: String,
    /// The source.
    pub kind: &'static dyn MaskSourceKind,
    /// Its options, completed.
    pub options: SourceOptions,
}

impl ChosenSource {
    /// Finds the source `name`, and completes its `options`.
    ///
    /// # Errors
    /// If there is no such source, it does not read one of the options, or one is missing or wrong.
    pub fn new(name: &str, options: SourceOptions) -> Result<Self, ChooseSourceError> {
        let kind = MASK_SOURCES.get(name).map_err(|_| ChooseSourceError::Unknown { name: name.to_owned() })?;
        let given = [
            (SourceOption::Path, options.path.is_some()),
            (SourceOption::Weights, options.weights.is_some()),
            (SourceOption::Points, options.points.is_some()),
        ];
        if let Some((option, _)) = given.into_iter().find(|(option, given)| *given && !kind.reads().contains(option)) {
            let reader = MASK_SOURCES.all().into_iter().find(|(_, kind)| kind.reads().contains(&option));
            return Err(ChooseSourceError::NotRead { option, by: reader.map(|(name, _)| name).unwrap_or_default() });
        }
        let options = kind.complete(options)?;
        Ok(Self { name: name.to_owned(), kind, options })
    }
}

impl fmt::Debug for ChosenSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ChosenSource").field("name", &self.name).field("options", &self.options).finish()
    }
}

/// Returns the names of all sources, for messages.
pub fn names() -> String {
    MASK_SOURCES.names().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Guest;

    impl MaskSourceKind for Guest {
        fn help(&self) -> &str {
            "The guest's."
        }

        fn open(&self, _: &SourceInput<'_>) -> Result<Box<dyn MaskSource>, SourceError> {
            Err(SourceError::Other("no masks".to_owned()))
        }
    }

    #[test]
    fn built_in_sources_come_first_and_a_guest_is_found_by_its_name() {
        MASK_SOURCES.insert("guest-of-a-test", Box::new(Guest));
        let names = MASK_SOURCES.names();
        assert_eq!(names[..4], ["regions", "labels", "dir", "sam"]);
        assert!(names.contains(&"guest-of-a-test".to_owned()));
        assert_eq!(MASK_SOURCES.get("guest-of-a-test").unwrap().help(), "The guest's.");
        let guest = ChosenSource::new("guest-of-a-test", SourceOptions::default()).unwrap();
        assert_eq!((guest.name.as_str(), guest.kind.views()), ("guest-of-a-test", SourceViews::Around));
        assert_eq!(guest.kind.seconds(9, &guest.options), None);
    }

    #[test]
    fn options_are_for_the_sources_that_read_them() {
        let of = |name: &str, options: SourceOptions| ChosenSource::new(name, options).map(|_| ()).unwrap_err();
        let points = SourceOptions { points: Some(4), ..SourceOptions::default() };
        let error = ChooseSourceError::NotRead { option: SourceOption::Points, by: "sam".to_owned() };
        assert_eq!(of("regions", points), error);
        assert_eq!(of("guess", SourceOptions::default()), ChooseSourceError::Unknown { name: "guess".to_owned() });
        let missing = of("dir", SourceOptions::default());
        assert!(matches!(missing, ChooseSourceError::Missing { option: SourceOption::Path, .. }), "{missing}");
    }
}
