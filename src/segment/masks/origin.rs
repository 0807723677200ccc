//! Opens the selected mask source: the one place where commands, evaluations and sweeps do so.

use super::make::MaskJob;
use super::sam::SamError;
use super::source::MaskSource;
use super::source::foreign::Foreign;
use super::source::labels::Labels;
use super::source::regions::Regions;
use super::source::sam::SamSource;
use super::store::StoreError;
use crate::data::Truth;
use crate::data::truth::LabelledView;
use std::path::PathBuf;
use thiserror::Error;

/// Default number of points along a side of the grid that prompts the network; as published.
pub const SAM_POINTS: usize = 32;

/// Which source of masks to use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum MaskKind {
    /// Regions of rendered pictures.
    Regions,
    /// Label images of the dataset: an upper bound.
    Labels,
    /// Masks that another program made of pictures written for it: a folder `GROUP/VIEW_NUMBER.png` or a COCO file.
    Dir(PathBuf),
    /// MobileSAM.
    Sam {
        /// The file of weights.
        weights: PathBuf,
        /// Points along a side of the prompt grid.
        points: usize,
    },
}

impl MaskKind {
    /// Its name on the command line and in files.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Regions => "regions",
            Self::Labels => "labels",
            Self::Dir(_) => "dir",
            Self::Sam { .. } => "sam",
        }
    }
}

/// Where the masks of a job come from.
#[derive(Clone, Debug)]
pub enum MaskOrigin {
    /// Regions of the pictures themselves.
    Regions,
    /// The dataset's label images of these views, which are those of the job's shots, in the same order.
    Labels(Truth, Vec<LabelledView>),
    /// Masks of another program.
    Dir {
        /// A folder `GROUP/VIEW_NUMBER.png`, or a COCO file.
        path: PathBuf,
        /// Groups that it may know besides those of the job; their masks are skipped.
        others: Vec<String>,
    },
    /// MobileSAM.
    Sam {
        /// The file of weights.
        weights: PathBuf,
        /// Points along a side of the prompt grid.
        points: usize,
    },
}

/// Why a source cannot be opened.
#[derive(Debug, Error)]
pub enum OriginError {
    /// Masks of another program cannot be opened.
    #[error(transparent)]
    Dir(#[from] StoreError),
    /// The network cannot be loaded.
    #[error(transparent)]
    Sam(#[from] SamError),
}

impl MaskOrigin {
    /// Opens the source for the groups and views of `job`.
    ///
    /// # Errors
    /// If masks of another program do not fit the job, or the network cannot be loaded; the error names the file.
    pub fn open(&self, job: &MaskJob<'_>) -> Result<Box<dyn MaskSource>, OriginError> {
        Ok(match self {
            Self::Regions => Box::new(Regions::new(job.rendering.background, job.config.clone())),
            Self::Labels(truth, views) => Box::new(Labels::new(truth.clone(), views.clone(), job.config.label_pixels)),
            Self::Dir { path, others } => {
                let groups: Vec<String> = job.groups.iter().map(|g| g.name.clone()).collect();
                let views: Vec<String> = job.shots.iter().map(|s| format!("{}.png", s.file)).collect();
                let size = job.shots.first().map_or((0, 0), |s| (s.camera.width, s.camera.height));
                Box::new(Foreign::open(path, &groups, others, &views, [size.0, size.1])?)
            }
            Self::Sam { weights, points } => Box::new(SamSource::load(weights, *points, job.config, job.device)?),
        })
    }
}
