//! Ground truth for segments on voxels, from label volumes or a synthetic scene, and how well labels agree with it. The
//! scores themselves are in `segment::dice`.

use super::super::RunError;
use super::grid::LabelGrid;
use crate::data::truth::SegmentFile;
use crate::prepare::PrepareRecord;
use crate::segment::dice::{Confusion, LabelMatch, mean_dice};
use crate::versioned;
use crate::volume::series::{Series, SeriesOptions};
use crate::volume::synthetic::Synthetic;
use serde::Serialize;
use std::path::Path;

/// Source of the true labels.
pub enum LabelTruth {
    /// Label volumes.
    Files {
        /// The volumes.
        series: Box<Series>,
        /// Names of their labels, as far as the dataset knows them.
        names: Vec<(u32, String)>,
        /// Time of each volume in [0, 1].
        times: Vec<f64>,
    },
    /// A synthetic scene, sampled on this many voxels along x, y, z.
    Synthetic(Synthetic, [usize; 3]),
}

/// How well the labels agree with the truth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Agreement {
    /// Mean Dice score over true labels, each matched with one segment; `None` if there is no true label.
    pub mean_dice: Option<f64>,
    /// The same, where several segments together may match a true label.
    pub mean_dice_of_sets: Option<f64>,
    /// One entry per true label.
    pub segments: Vec<LabelScore>,
}

/// A true label and the segments matched with it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LabelScore {
    /// Name of the true label.
    pub truth: String,
    /// The segment matched with it in the assignment with the highest sum of Dice scores; `None` if all are taken.
    pub segment: Option<String>,
    /// Dice score of the two.
    pub dice: f64,
    /// Intersection over union of the two.
    pub iou: f64,
    /// Voxels of the true label.
    pub voxels: u64,
    /// The set of segments that covers it best.
    pub set: Vec<String>,
    /// Dice score of that set.
    pub set_dice: f64,
}

impl LabelTruth {
    /// Opens the label volumes that `inputs` name, or the synthetic scene of that name, for comparison at `times`.
    /// `data` is the run's dataset.
    ///
    /// # Errors
    /// If a file cannot be read or is not on the voxels of `grid`; if there are several files, but not one for each
    /// step that the dataset was prepared from, so that their times are unknown; or if there is one file of a series
    /// for several times.
    pub fn open(inputs: &[String], grid: &LabelGrid, data: &Path, times: &[f64]) -> Result<Self, RunError> {
        if let [name] = inputs
            && let Ok(scene) = name.parse::<Synthetic>()
        {
            if !grid.is_source {
                return Err(RunError::input(format!(
                    "--truth {name}: a synthetic scene is known only on the voxels that the dataset was prepared from; \
                     omit --dims and --like, and name the dataset with --data if it was moved"
                )));
            }
            return Ok(Self::Synthetic(scene, grid.file.dims));
        }
        // numbers may be missing, as in the names of the volumes that the dataset was prepared from
        let options = SeriesOptions { allow_gaps: true, ignore_origin: true, ..SeriesOptions::default() };
        let series = Series::open(inputs, &options).map_err(RunError::input)?;
        if series.grid().dims != grid.file.dims {
            return Err(RunError::input(format!(
                "--truth: {} has {:?} voxels, but the labels have {:?}; pass --like with one of the files of the truth",
                series.name(0),
                series.grid().dims,
                grid.file.dims
            )));
        }
        series.lies_on(&grid.file, grid.axes).map_err(|problem| {
            let name = series.name(0);
            RunError::input(format!(
                "--truth: {name} has {problem} as the labels; pass --like with one of the files of the truth"
            ))
        })?;
        let record = prepared(data);
        let steps = record.as_ref().map(|record| record.steps);
        if series.len() == 1 && times.len() > 1 && steps != Some(1) {
            return Err(RunError::input(format!(
                "--truth {}: one step, which cannot be the truth at {} times; give a label volume for each step, or a \
                 single --time",
                inputs.join(" "),
                times.len()
            )));
        }
        if let Some(steps) = steps.filter(|steps| series.len() > 1 && series.len() != *steps) {
            return Err(RunError::input(format!(
                "--truth {}: {} steps, but {} was prepared from {steps}, so their times are unknown; give a label \
                 volume for each step, or a single one with --time",
                inputs.join(" "),
                series.len(),
                data.display()
            )));
        }
        let known = std::fs::read_to_string(data.join("segments.json")).ok();
        let known = known.and_then(|text| versioned::from_json::<SegmentFile>(text).ok());
        let names = known
            .filter(|k| k.source == "labels")
            .map_or(Vec::new(), |k| k.segments.into_iter().map(|s| (u32::from(s.id), s.name)).collect());
        let times = record.and_then(|record| record.times).filter(|times| times.len() == series.len());
        let times = times.unwrap_or_else(|| (0..series.len()).map(|step| series.time(step)).collect());
        Ok(Self::Files { series: Box::new(series), names, times })
    }

    /// Returns the files that are read.
    pub fn files(&self) -> Vec<&Path> {
        match self {
            Self::Files { series, .. } => series.files().iter().map(std::path::PathBuf::as_path).collect(),
            Self::Synthetic(..) => Vec::new(),
        }
    }

    /// Returns notes for the user about the files, one sentence each.
    pub fn notes(&self) -> &[String] {
        match self {
            Self::Files { series, .. } => series.notes(),
            Self::Synthetic(..) => &[],
        }
    }

    /// Returns the true labels at `time` in [0, 1], `[z, y, x]`; of files, those of the nearest step.
    ///
    /// # Errors
    /// If a file cannot be read.
    pub fn labels_at(&self, time: f64) -> Result<Vec<u16>, RunError> {
        match self {
            Self::Files { series, times, .. } => {
                let off = |step: &usize| (times[*step] - time).abs();
                let nearest = (0..series.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0);
                Ok(series.load_labels(nearest).map_err(RunError::input)?.ids)
            }
            Self::Synthetic(scene, dims) => Ok(scene.sample(*dims, time).1.ids),
        }
    }

    /// Matches the true labels with the segments `names`, labelled from 1.
    pub fn agreement(&self, pairs: &Confusion, names: &[String]) -> Agreement {
        let segments = |m: &LabelMatch| -> Vec<String> {
            m.predicted.iter().filter_map(|p| names.get((*p as usize).checked_sub(1)?)).cloned().collect()
        };
        let (ones, sets) = (pairs.match_one_to_one(), pairs.match_sets());
        let score = |(one, set): (&LabelMatch, &LabelMatch)| LabelScore {
            truth: self.name(one.truth),
            segment: segments(one).pop(),
            dice: one.overlap.dice(),
            iou: one.overlap.iou(),
            voxels: one.overlap.truth,
            set: segments(set),
            set_dice: set.overlap.dice(),
        };
        Agreement {
            mean_dice: mean_dice(&ones),
            mean_dice_of_sets: mean_dice(&sets),
            segments: ones.iter().zip(&sets).map(score).collect(),
        }
    }

    fn name(&self, label: u32) -> String {
        let known = match self {
            Self::Files { names, .. } => names.iter().find(|(id, _)| *id == label).map(|(_, name)| name.clone()),
            Self::Synthetic(scene, _) => scene.segment_names().into_iter().nth((label as usize).wrapping_sub(1)),
        };
        known.unwrap_or_else(|| format!("label {label}"))
    }
}

/// Returns what the dataset at `data` records about the series that it was prepared from, if known.
fn prepared(data: &Path) -> Option<PrepareRecord> {
    // a damaged record was already reported when the voxels were chosen
    PrepareRecord::read(data).ok().flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two by two by two labels, all 0.
    fn npy() -> Vec<u8> {
        let header = format!("{:<117}\n", "{'descr': '|u1', 'fortran_order': False, 'shape': (2, 2, 2), }");
        [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes(), header.as_bytes(), &[0; 8]].concat()
    }

    #[test]
    fn several_label_volumes_are_one_for_each_step() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let grid = LabelGrid::unit([2; 3]);
        let inputs: Vec<String> = ["t00.npy", "t10.npy", "t30.npy"]
            .iter()
            .map(|name| {
                std::fs::write(root.join(name), npy()).unwrap();
                root.join(name).display().to_string()
            })
            .collect();
        let prepare = |steps: usize| {
            let json = serde_json::json!({
                "format": 1, "version": "", "source": "", "transfer_function": "", "span": [0, 1], "dims": [2, 2, 2],
                "spacing": [1, 1, 1], "origin": [0, 0, 0], "directions": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "side": 2,
                "half_size": [1, 1, 1], "steps": steps, "step": 1, "train_views": 1, "test_views": 1, "size": [8, 8],
                "segments": [], "seconds": 1, "load_seconds": 0, "peak_memory_bytes": 0, "calibration": {}, "empty_times": [],
            });
            std::fs::write(root.join("prepare.json"), json.to_string()).unwrap();
        };
        let open_at =
            |inputs: &[String], times: &[f64]| LabelTruth::open(inputs, &grid, root, times).map_err(|e| e.to_string());
        let open = |inputs: &[String]| open_at(inputs, &[0.0]);
        assert!(open(&inputs).is_ok_and(|truth| truth.notes().len() == 1), "a gap, and an unknown number of steps");
        prepare(100);
        let Err(error) = open(&inputs) else { panic!("three steps of a hundred") };
        for words in ["--truth", "3 steps", &root.display().to_string(), "from 100", "--time"] {
            assert!(error.contains(words), "{words}: {error}");
        }
        assert!(open(&inputs[..1]).is_ok(), "one alone");
        let Err(error) = open_at(&inputs[..1], &[0.0, 1.0]) else { panic!("one step at two times") };
        assert!(error.contains("2 times") && error.contains("--time"), "{error}");
        prepare(3);
        assert!(open(&inputs).is_ok() && open_at(&inputs, &[0.0, 1.0]).is_ok());
        let second = |json: &str| {
            let mut record: serde_json::Value = serde_json::from_str(json).unwrap();
            record["times"] = serde_json::json!([0.0, 0.1, 1.0]);
            std::fs::write(root.join("prepare.json"), record.to_string()).unwrap();
            let two = [0, 7, 0, 0, 0, 0, 0, 0];
            std::fs::write(&inputs[1], [&npy()[..npy().len() - 8], &two].concat()).unwrap();
            open(&inputs).unwrap().labels_at(0.1).unwrap()
        };
        let json = std::fs::read_to_string(root.join("prepare.json")).unwrap();
        assert_eq!(second(&json)[1], 7, "the second step is at a tenth of the time");
        prepare(1);
        assert!(open_at(&inputs[..1], &[0.0, 1.0]).is_ok(), "a static volume");
    }
}
