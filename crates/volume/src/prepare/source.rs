//! The source of the steps of a series: volume files, or a synthetic scene.

use crate::data::Calibration;
use crate::data::calibration::PhysicalTime;
use crate::data::lineage::{LineageChange, LineageEvent};
use crate::name::Name;
use crate::volume::components::{PartChange, PartOptions, PartsError, SeriesParts, part_name};
use crate::volume::error::VolumeError;
use crate::volume::grid::{Grid, Volume, VolumeLabels};
use crate::volume::placement::VoxelPlacement;
use crate::volume::series::Series;
use crate::volume::synthetic::Synthetic;
use crate::volume::transfer::TransferFunction;
use std::path::{Path, PathBuf};

/// A time series that is held one step at a time.
#[derive(Debug)]
pub enum PrepareSource {
    /// Volume files.
    Files {
        /// The values.
        series: Box<Series>,
        /// The segments, where known.
        labels: FileLabels,
    },
    /// A synthetic scene.
    Synthetic {
        /// Which scene.
        scene: Synthetic,
        /// Voxels along x, y, z.
        dims: [usize; 3],
        /// Number of steps.
        steps: usize,
    },
}

/// The segments of volume files.
#[derive(Debug)]
pub enum FileLabels {
    /// Unknown.
    None,
    /// From label volumes.
    Files {
        /// The labels, of the same grid and number of steps as the values.
        series: Box<Series>,
        /// Names of ids, where given.
        names: Vec<(u16, Name)>,
    },
    /// The connected parts above a value.
    Parts(SeriesParts),
}

impl FileLabels {
    /// The connected parts of a series; reads every step of it once.
    ///
    /// # Errors
    /// As for [`SeriesParts::follow`].
    pub fn parts(series: &Series, options: PartOptions) -> Result<Self, PartsError> {
        SeriesParts::follow(series.grid(), series.len(), options, |step| series.load(step)).map(Self::Parts)
    }

    fn files(&self) -> impl Iterator<Item = &PathBuf> {
        let series = if let Self::Files { series, .. } = self { series.files() } else { &[] };
        series.iter()
    }

    /// The source of the segments as named in a dataset.
    fn kind(&self) -> Option<&'static str> {
        match self {
            Self::None => None,
            Self::Files { .. } => Some("labels"),
            Self::Parts(_) => Some("components"),
        }
    }

    fn load(&self, step: usize, volume: &Volume) -> Result<Option<VolumeLabels>, VolumeError> {
        match self {
            Self::None => Ok(None),
            Self::Files { series, .. } => series.load_labels(step).map(Some),
            Self::Parts(parts) => Ok(Some(parts.labels(step, volume))),
        }
    }
}

impl PrepareSource {
    /// Number of steps.
    pub fn len(&self) -> usize {
        match self {
            Self::Files { series, .. } => series.len(),
            Self::Synthetic { steps, .. } => *steps,
        }
    }

    /// True if there are no steps.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The volume files, in order of time, without labels.
    pub fn volumes(&self) -> &[PathBuf] {
        match self {
            Self::Files { series, .. } => series.files(),
            Self::Synthetic { .. } => &[],
        }
    }

    /// The files that are read.
    pub fn files(&self) -> Vec<&Path> {
        match self {
            Self::Files { series, labels, .. } => {
                series.files().iter().chain(labels.files()).map(PathBuf::as_path).collect()
            }
            Self::Synthetic { .. } => Vec::new(),
        }
    }

    /// Time of a step, in [0, 1].
    pub fn time(&self, step: usize) -> f64 {
        match self {
            Self::Files { series, .. } => series.time(step),
            Self::Synthetic { steps, .. } => step as f64 / (steps - 1).max(1) as f64,
        }
    }

    /// The time of each step as the files or the user give it; `None` where it is unknown.
    pub fn time_values(&self) -> Option<&[f64]> {
        match self {
            Self::Files { series, .. } => series.time_values(),
            Self::Synthetic { .. } => None,
        }
    }

    /// Physical space and time of the scene in which the volumes are placed; none of a synthetic scene.
    pub fn calibration(&self, placement: &VoxelPlacement) -> Calibration {
        let Self::Files { series, .. } = self else { return Calibration::default() };
        let unit = || series.time_unit().map(str::to_owned);
        let time = match series.time_values() {
            Some(&[start, .., end]) => Some(PhysicalTime { start, end, unit: unit() }),
            _ => None,
        };
        Calibration { space: Some(placement.space(series.physical())), time }
    }

    /// The grid of every step.
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

    /// The source of each voxel's segment, as named in `segments.json`: `labels` or `components`; `None` if there is
    /// none.
    pub fn label_kind(&self) -> Option<&'static str> {
        match self {
            Self::Files { labels, .. } => labels.kind(),
            Self::Synthetic { .. } => Some("labels"),
        }
    }

    /// Whether segments are known: from labels, or from the ranges of `transfer`.
    pub fn has_segments(&self, transfer: &TransferFunction) -> bool {
        self.label_kind().is_some() || !transfer.segments.is_empty()
    }

    /// The ends and beginnings of connected parts, and of the cells of a synthetic scene, by time; empty for labels that
    /// are given.
    pub fn lineage(&self) -> Vec<LineageEvent> {
        if let Self::Synthetic { scene, steps, .. } = self {
            return scene.lineage(&(0..*steps).map(|step| self.time(step)).collect::<Vec<f64>>());
        }
        let Self::Files { labels: FileLabels::Parts(parts), .. } = self else { return Vec::new() };
        let change = |ends| if ends { LineageChange::Ended } else { LineageChange::Began };
        let turn = |c: &PartChange| LineageEvent {
            time: self.time(c.step),
            segment: c.id,
            change: change(c.ends),
            other: c.other,
        };
        parts.changes().iter().map(turn).collect()
    }

    /// The name of a segment id (from 1).
    pub fn segment_name(&self, id: u16) -> String {
        let given = match self {
            Self::Files { labels: FileLabels::Files { names, .. }, .. } => {
                names.iter().find(|(i, _)| *i == id).map(|(_, n)| n.to_string())
            }
            Self::Files { labels: FileLabels::Parts(_), .. } => Some(part_name(id)),
            Self::Files { labels: FileLabels::None, .. } => None,
            Self::Synthetic { scene, .. } => scene.segment_names().into_iter().nth(usize::from(id) - 1),
        };
        given.unwrap_or_else(|| format!("segment-{id}"))
    }

    /// Reads one step.
    ///
    /// # Errors
    /// A file that cannot be read or used.
    pub fn load(&self, step: usize) -> Result<(Volume, Option<VolumeLabels>), VolumeError> {
        match self {
            Self::Files { series, labels, .. } => {
                let volume = series.load(step)?;
                let labels = labels.load(step, &volume)?;
                Ok((volume, labels))
            }
            Self::Synthetic { scene, dims, .. } => {
                let (volume, labels) = scene.sample(*dims, self.time(step));
                Ok((volume, Some(labels)))
            }
        }
    }

    /// A description for the record and the terminal.
    pub fn describe(&self) -> String {
        let [x, y, z] = self.grid().dims;
        let of = |series: &Series| series.variable().map_or_else(String::new, |name| format!("{name}, "));
        match self {
            Self::Files { series, .. } if series.len() == 1 => {
                format!("{} ({}{x}x{y}x{z})", series.name(0), of(series))
            }
            Self::Files { series, .. } => {
                let (first, last) = (series.name(0), series.name(series.len() - 1));
                format!("{first} .. {last} ({}{x}x{y}x{z}, {} steps)", of(series), series.len())
            }
            Self::Synthetic { scene, steps, .. } => format!("synthetic {scene} ({x}x{y}x{z}, {steps} steps)"),
        }
    }
}
