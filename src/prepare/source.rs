//! Where the steps of a series come from: volume files, or a synthetic scene.

use crate::name::Name;
use crate::volume::error::VolumeError;
use crate::volume::grid::{Grid, Labels, Volume};
use crate::volume::series::Series;
use crate::volume::synthetic::Synthetic;
use std::path::{Path, PathBuf};

/// A time series that is held one step at a time.
#[derive(Debug)]
pub enum Source {
    /// Volume files, and label files with the names of their ids if there are any.
    Files {
        /// The values.
        series: Box<Series>,
        /// The labels, of the same grid and number of steps.
        labels: Option<Box<Series>>,
        /// Names of ids, where given.
        names: Vec<(u16, Name)>,
    },
    /// A synthetic scene.
    Synthetic {
        /// Which.
        scene: Synthetic,
        /// Voxels along x, y, z.
        dims: [usize; 3],
        /// Number of steps.
        steps: usize,
    },
}

impl Source {
    /// Number of steps.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            Self::Files { series, .. } => series.len(),
            Self::Synthetic { steps, .. } => *steps,
        }
    }

    /// True without any step.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The files that are read.
    #[must_use]
    pub fn files(&self) -> Vec<&Path> {
        match self {
            Self::Files { series, labels, .. } => {
                let series = std::iter::once(series).chain(labels);
                series.flat_map(|s| s.files()).map(PathBuf::as_path).collect()
            }
            Self::Synthetic { .. } => Vec::new(),
        }
    }

    /// Time of a step, in [0, 1].
    #[must_use]
    pub fn time(&self, step: usize) -> f64 {
        match self {
            Self::Files { series, .. } => series.time(step),
            Self::Synthetic { steps, .. } => step as f64 / (steps - 1).max(1) as f64,
        }
    }

    /// The grid of every step.
    #[must_use]
    pub fn grid(&self) -> Grid {
        match self {
            Self::Files { series, .. } => *series.grid(),
            Self::Synthetic { dims, .. } => Grid::unit(*dims),
        }
    }

    /// Smallest and largest value over all steps.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn range(&self) -> Result<[f64; 2], VolumeError> {
        match self {
            Self::Files { series, .. } => Ok(series.range()?.map(f64::from)),
            Self::Synthetic { .. } => Ok([0.0, 1.0]),
        }
    }

    /// Whether labels come with the values.
    #[must_use]
    pub fn has_labels(&self) -> bool {
        match self {
            Self::Files { labels, .. } => labels.is_some(),
            Self::Synthetic { .. } => true,
        }
    }

    /// The name of a segment id (from 1).
    #[must_use]
    pub fn segment_name(&self, id: u16) -> String {
        let given = match self {
            Self::Files { names, .. } => names.iter().find(|(i, _)| *i == id).map(|(_, n)| n.to_string()),
            Self::Synthetic { scene, .. } => scene.segment_names().get(usize::from(id) - 1).map(|n| (*n).to_owned()),
        };
        given.unwrap_or_else(|| format!("segment-{id}"))
    }

    /// Reads one step.
    ///
    /// # Errors
    /// A file that cannot be read or used.
    pub fn load(&self, step: usize) -> Result<(Volume, Option<Labels>), VolumeError> {
        match self {
            Self::Files { series, labels, .. } => {
                let labels = labels.as_ref().map(|l| l.load_labels(step)).transpose()?;
                Ok((series.load(step)?, labels))
            }
            Self::Synthetic { scene, dims, .. } => {
                let (volume, labels) = scene.sample(*dims, self.time(step));
                Ok((volume, Some(labels)))
            }
        }
    }

    /// What it is, for the record and the terminal.
    #[must_use]
    pub fn describe(&self) -> String {
        let [x, y, z] = self.grid().dims;
        match self {
            Self::Files { series, .. } if series.len() == 1 => format!("{} ({x}x{y}x{z})", series.name(0)),
            Self::Files { series, .. } => {
                format!("{} .. {} ({x}x{y}x{z}, {} steps)", series.name(0), series.name(series.len() - 1), series.len())
            }
            Self::Synthetic { scene, steps, .. } => format!("synthetic {scene} ({x}x{y}x{z}, {steps} steps)"),
        }
    }
}
