//! Where a scene lies in the physical space and time of its data.
//!
//! The axes of a scene are those of physical space, so that directions agree and nothing is mirrored. Positions are
//! moved to the centre of the data and scaled uniformly, times are mapped to `[0, 1]`:
//!
//! ```text
//! physical position = centre + scale * scene position
//! physical time     = start + (end - start) * scene time
//! ```
//!
//! A dataset without this record is measured in scene units, which outputs call "normalised".

use super::DataError;
use super::transforms::read_text;
use crate::versioned;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::Path;

/// The file in a dataset's folder in which `prepare` records it.
pub const PREPARED: &str = "prepare.json";

/// Which way the axes x, y, z of physical space point; all are right-handed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum AxisConvention {
    /// Towards a patient's left, back and head (DICOM, ITK, 3D Slicer's files).
    LeftPosteriorSuperior,
    /// Towards a patient's right, front and head (NIfTI).
    RightAnteriorSuperior,
}

impl AxisConvention {
    /// The name that NRRD uses: `left-posterior-superior` or `right-anterior-superior`.
    pub fn name(self) -> &'static str {
        match self {
            Self::LeftPosteriorSuperior => "left-posterior-superior",
            Self::RightAnteriorSuperior => "right-anterior-superior",
        }
    }

    /// The letter of where an axis of space leads: forwards or backwards along x, y or z (0, 1, 2).
    pub fn letter(self, axis: usize, forwards: bool) -> char {
        let ahead = forwards == (axis > 1 || self == Self::RightAnteriorSuperior);
        [['L', 'R'], ['P', 'A'], ['I', 'S']][axis][usize::from(ahead)]
    }

    /// A position or direction in another convention.
    pub fn convert(self, [x, y, z]: [f64; 3], to: Self) -> [f64; 3] {
        // adding 0 makes a 0 of -0
        if self == to { [x, y, z] } else { [-x + 0.0, -y + 0.0, z] }
    }
}

impl fmt::Display for AxisConvention {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The physical space of a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PhysicalSpace {
    /// The physical position of the scene's origin, in `unit`.
    pub centre: [f64; 3],
    /// Length of one scene unit, in `unit`; finite and positive.
    pub scale: f64,
    /// Unit of length as the data name it, such as `mm`; `None` where they do not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// What the axes mean; `None` where the data do not say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axes: Option<AxisConvention>,
}

impl PhysicalSpace {
    /// The physical position of a point of the scene.
    pub fn position(&self, scene: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|a| self.centre[a] + self.scale * scene[a])
    }

    /// The point of the scene at a physical position.
    pub fn to_scene(&self, position: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|a| (position[a] - self.centre[a]) / self.scale)
    }

    /// The unit of length in words: the data's, or `data units` where they name none.
    pub fn unit_name(&self) -> &str {
        self.unit.as_deref().unwrap_or("data units")
    }
}

/// The physical time of a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PhysicalTime {
    /// Time of the first step, in `unit`.
    pub start: f64,
    /// Time of the last step, in `unit`; above `start`.
    pub end: f64,
    /// Unit of time as the data name it, such as `s`; `None` where they do not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
}

impl PhysicalTime {
    /// The physical time of a scene time in `[0, 1]`.
    pub fn time(&self, scene: f64) -> f64 {
        // exact at both ends
        self.start * (1.0 - scene) + self.end * scene
    }

    /// The scene time of a physical time; outside `[0, 1]` before the first or after the last step.
    pub fn to_scene(&self, time: f64) -> f64 {
        (time - self.start) / (self.end - self.start)
    }

    /// The unit of time in words: the data's, or `data time units` where they name none.
    pub fn unit_name(&self) -> &str {
        self.unit.as_deref().unwrap_or("data time units")
    }
}

/// Physical space and time of a scene. Written by `prepare` into `prepare.json`, kept by training in `run.json`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Calibration {
    /// Physical space; `None` where it is unknown, so that lengths are normalised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub space: Option<PhysicalSpace>,
    /// Physical time; `None` where it is unknown (steps without time values, a single step), so that times are
    /// normalised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<PhysicalTime>,
}

/// Where lengths or times have no physical unit.
pub const NORMALISED: &str = "normalised";

impl Calibration {
    /// What `prepare` recorded in the dataset folder `root`. Nothing is known of a dataset from elsewhere.
    ///
    /// # Errors
    /// A record that cannot be read.
    pub fn of_dataset(root: &Path) -> Result<Self, DataError> {
        #[derive(Deserialize)]
        struct Prepared {
            calibration: Calibration,
        }
        let path = root.join(PREPARED);
        if !path.exists() {
            return Ok(Self::default());
        }
        let read = versioned::from_json::<Prepared>(read_text(&path)?);
        let hint = "restore the file from a copy, or prepare the dataset again";
        read.map(|prepared| prepared.calibration).map_err(|e| DataError::of_record(&path, e, hint))
    }

    /// The physical position of a point of the scene, or the point itself if space is normalised.
    pub fn position(&self, scene: [f64; 3]) -> [f64; 3] {
        self.space.as_ref().map_or(scene, |s| s.position(scene))
    }

    /// Length of one scene unit; 1 if space is normalised.
    pub fn length_scale(&self) -> f64 {
        self.space.as_ref().map_or(1.0, |s| s.scale)
    }

    /// Duration of the scene's times from 0 to 1; 1 if time is normalised.
    pub fn duration(&self) -> f64 {
        self.time.as_ref().map_or(1.0, |t| t.end - t.start)
    }

    /// The physical time of a scene time, or that time itself if it is normalised.
    pub fn time(&self, scene: f64) -> f64 {
        self.time.as_ref().map_or(scene, |t| t.time(scene))
    }

    /// Factor from scene units per scene time to physical speed.
    pub fn speed_scale(&self) -> f64 {
        self.length_scale() / self.duration()
    }

    /// The unit of lengths in words, [`NORMALISED`] where there is none.
    pub fn length_unit(&self) -> &str {
        self.space.as_ref().map_or(NORMALISED, PhysicalSpace::unit_name)
    }

    /// The unit of speeds in words, [`NORMALISED`] where neither lengths nor times have one.
    pub fn speed_unit(&self) -> String {
        match (&self.space, &self.time) {
            (None, None) => NORMALISED.to_owned(),
            (Some(space), Some(time)) if space.unit.is_some() && time.unit.is_some() => {
                format!("{}/{}", space.unit_name(), time.unit_name())
            }
            (space, time) => format!(
                "{} per {}",
                space.as_ref().map_or("scene unit", PhysicalSpace::unit_name),
                time.as_ref().map_or("duration of the data", PhysicalTime::unit_name)
            ),
        }
    }

    /// The unit of times in words, [`NORMALISED`] where there is none.
    pub fn time_unit(&self) -> &str {
        self.time.as_ref().map_or(NORMALISED, PhysicalTime::unit_name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::user_error::UserError;

    fn calibration() -> Calibration {
        let space = PhysicalSpace {
            centre: [1000.0, -5.0, 3.5],
            scale: 72.0,
            unit: Some("mm".into()),
            axes: Some(AxisConvention::RightAnteriorSuperior),
        };
        let time = PhysicalTime { start: 100.0, end: 350.0, unit: None };
        Calibration { space: Some(space), time: Some(time) }
    }

    #[test]
    fn positions_and_times_go_there_and_back() {
        let c = calibration();
        let (space, time) = (c.space.as_ref().unwrap(), c.time.as_ref().unwrap());
        let p = c.position([0.25, -0.5, 1.0]);
        assert_eq!(p, [1018.0, -41.0, 75.5]);
        assert_eq!(space.to_scene(p), [0.25, -0.5, 1.0]);
        assert_eq!([0.0, 0.5, 1.0].map(|t| c.time(t)), [100.0, 225.0, 350.0]);
        assert_eq!(time.to_scene(225.0), 0.5);
        assert_eq!((c.length_scale(), c.duration(), c.speed_scale()), (72.0, 250.0, 72.0 / 250.0));
        assert_eq!((c.length_unit(), c.time_unit()), ("mm", "data time units"));
        assert_eq!(c.speed_unit(), "mm per data time units");
        let per_second = PhysicalTime { unit: Some("s".into()), ..time.clone() };
        assert_eq!(Calibration { time: Some(per_second), ..c.clone() }.speed_unit(), "mm/s");
        assert_eq!(Calibration { time: None, ..c.clone() }.speed_unit(), "mm per duration of the data");
    }

    #[test]
    fn nothing_known_is_normalised() {
        let c = Calibration::default();
        assert_eq!((c.position([1.0, 2.0, 3.0]), c.time(0.3), c.speed_scale()), ([1.0, 2.0, 3.0], 0.3, 1.0));
        assert_eq!((c.length_unit(), c.time_unit(), &c.speed_unit()[..]), (NORMALISED, NORMALISED, NORMALISED));
        assert_eq!(serde_json::to_string(&c).unwrap(), "{}");
    }

    #[test]
    fn a_dataset_from_elsewhere_has_none_and_a_damaged_record_is_named() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(Calibration::of_dataset(folder.path()).unwrap(), Calibration::default());
        let path = folder.path().join(PREPARED);
        let record = serde_json::json!({ "format": 1, "calibration": calibration() });
        std::fs::write(&path, record.to_string()).unwrap();
        assert_eq!(Calibration::of_dataset(folder.path()).unwrap(), calibration());
        std::fs::write(&path, "{\"format\": 1,\n\"calibration\": 3}").unwrap();
        let error = Calibration::of_dataset(folder.path()).unwrap_err();
        assert!(error.is_input() && error.to_string().contains("prepare.json: line 2"), "{error}");
    }

    #[test]
    fn records_read_back() {
        let json = serde_json::to_string(&calibration()).unwrap();
        assert!(json.contains("\"right-anterior-superior\""));
        assert_eq!(serde_json::from_str::<Calibration>(&json).unwrap(), calibration());
    }
}
