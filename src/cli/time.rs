//! Times as arguments: in [0, 1] from the first to the last time of the data, or in the data's own unit.

use super::CliError;
use super::values::{finite, fraction};
use crate::data::Calibration;
use std::fmt;
use std::str::FromStr;

/// What precedes a time of the data.
const DATA: &str = "data:";

/// A time as it was given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum TimeArg {
    /// In [0, 1].
    Scene(f64),
    /// In the data's unit.
    Data(f64),
}

impl FromStr for TimeArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.trim().strip_prefix(DATA) {
            Some(time) => finite(time)
                .map(Self::Data)
                .map_err(|_| "expected a time of the data after `data:`, a finite number such as data:150".to_owned()),
            None => fraction(text).map(Self::Scene).map_err(|e| format!("{e}; or a time of the data such as data:150")),
        }
    }
}

impl fmt::Display for TimeArg {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Scene(time) => write!(f, "{time}"),
            Self::Data(time) => write!(f, "{DATA}{time}"),
        }
    }
}

impl TimeArg {
    /// Returns the time in [0, 1]; `flag` is the option that gave it.
    ///
    /// # Errors
    /// If the times of the data are unknown, or it is outside of them.
    pub(super) fn to_scene_time(self, flag: &str, calibration: &Calibration) -> Result<f64, CliError> {
        let time = match self {
            Self::Scene(time) => return Ok(time),
            Self::Data(time) => time,
        };
        let Some(known) = &calibration.time else {
            return Err(CliError::input(format!(
                "{flag} {self}: the run does not know the times of its data, which `volseggs prepare --time-values` \
                 records; give a time between 0 and 1"
            )));
        };
        let scene = known.to_scene(time);
        // the last digit of a time at either end may be rounded
        let rounding = 1e-9;
        if (-rounding..=1.0 + rounding).contains(&scene) {
            return Ok(scene.clamp(0.0, 1.0));
        }
        let (start, end) = (known.start, known.end);
        Err(CliError::input(format!("{flag} {self}: the data are from {start} to {end} {}", known.unit_name())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::calibration::PhysicalTime;

    #[test]
    fn times_are_in_0_to_1_or_those_of_the_data() {
        let known =
            Calibration { time: Some(PhysicalTime { start: 100.0, end: 300.0, unit: Some("s".into()) }), space: None };
        let of = |text: &str, calibration: &Calibration| {
            text.parse::<TimeArg>().unwrap().to_scene_time("--time", calibration).map_err(|e| e.to_string())
        };
        for (text, time) in [("0.5", 0.5), ("data:150", 0.25), ("data: 300", 1.0), ("data:1e2", 0.0)] {
            assert_eq!(of(text, &known), Ok(time), "{text}");
            assert_eq!(text.replace(' ', "").replace("1e2", "100"), text.parse::<TimeArg>().unwrap().to_string());
        }
        let outside = of("data:99", &known).unwrap_err();
        assert!(outside.contains("--time data:99") && outside.contains("from 100 to 300 s"), "{outside}");
        let unknown = of("data:0.5", &Calibration::default()).unwrap_err();
        assert!(unknown.contains("between 0 and 1"), "{unknown}");
        for bad in ["1.5", "data:", "data:nan", "data:x", "150s", "-1", "nan"] {
            assert!(bad.parse::<TimeArg>().unwrap_err().contains("data:150"), "{bad}");
        }
    }
}
