//! An edit as pure data: its meaning, its checks and its line in a list. How it changes Gaussians is in `apply`.

use super::error::EditError;
use crate::data::Calibration;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::RangeInclusive;

/// Coordinates of points and movements are below this, scene units: their squares are finite in single precision, in
/// which files and the drawing keep them.
pub const MAX_LENGTH: f32 = 1e15;
/// Factors by which segments may be scaled: positions stay finite and sizes above 0 after several of them.
pub const SCALES: RangeInclusive<f32> = 1e-6..=1e6;

/// What is done to the named segments.
///
/// In JSON a variant is written as `{"opacity": {"factor": 0.5}}`, one without values as `"hide"`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Operation {
    /// Gives each segment a colour.
    Recolour {
        /// Red, green, blue in `[0, 1]`.
        rgb: [f32; 3],
        /// True: the constant terms of a segment are all shifted by the same amount, which makes the opacity-weighted
        /// mean of its colours `rgb`; the differences among its Gaussians and everything view-dependent stay. False:
        /// every Gaussian gets the colour `rgb` from every direction; in a scene with a headlight, as the colour that
        /// it shades.
        keep_shading: bool,
    },
    /// Multiplies the linear opacity. The result is at most 0.99, as in drawing. 0 is the same as `Hide`.
    Opacity {
        /// At least 0.
        factor: f32,
        /// Whether hidden segments are shown again.
        #[serde(default, skip_serializing_if = "is_false")]
        show: bool,
    },
    /// Makes the segments invisible until a later `Show`.
    Hide,
    /// Makes the segments visible again, with the opacity they would have had.
    Show,
    /// Hides every Gaussian that is in none of the named segments; the others stay as they are, visible or hidden.
    Isolate,
    /// Moves the segments.
    Translate {
        /// Along x, y, z, scene units.
        by: [f32; 3],
    },
    /// Rotates the segments, including the orientation and the view-dependent colour of their Gaussians.
    Rotate {
        /// Axis, of any length but 0.
        axis: [f32; 3],
        /// Angle, right-handed about the axis.
        degrees: f32,
        /// A fixed point, scene units; without one, each segment rotates about its own opacity-weighted centre at the
        /// time being drawn, so that a moving segment rotates about itself at every time.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        about: Option<[f32; 3]>,
    },
    /// Scales the segments, including their Gaussians.
    Scale {
        /// From 1e-6 to 1e6.
        factor: f32,
        /// As in `Rotate`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        about: Option<[f32; 3]>,
    },
}

/// One operation on named segments, undone as one step.
///
/// A Gaussian in several of the named segments is edited once, as part of the first that contains it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Edit {
    /// Names of segments, at least one.
    pub segments: Vec<String>,
    /// What is done to them.
    pub operation: Operation,
}

/// Returns whether a key is omitted from the file.
fn is_false(value: &bool) -> bool {
    !value
}

impl Operation {
    /// Returns the name in JSON.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Recolour { .. } => "recolour",
            Self::Opacity { .. } => "opacity",
            Self::Hide => "hide",
            Self::Show => "show",
            Self::Isolate => "isolate",
            Self::Translate { .. } => "translate",
            Self::Rotate { .. } => "rotate",
            Self::Scale { .. } => "scale",
        }
    }

    /// Returns whether it may move the centre of a segment.
    pub fn moves(&self) -> bool {
        matches!(
            self,
            Self::Translate { .. } | Self::Rotate { about: Some(_), .. } | Self::Scale { about: Some(_), .. }
        )
    }

    /// Checks the values.
    ///
    /// # Errors
    /// [`EditError::Value`]: a number that is not finite or out of range, or an axis without direction.
    pub fn validate(&self) -> Result<(), EditError> {
        let check = |field: &str, fine: bool, problem: String| {
            let field = || format!("operation.{}.{field}", self.name());
            if fine { Ok(()) } else { Err(EditError::Value { field: field(), problem }) }
        };
        let point = |field: &str, p: &[f32; 3]| {
            let fine = p.iter().all(|c| c.abs() < MAX_LENGTH);
            check(
                field,
                fine,
                format!("{p:?} is too far; give three numbers between -{MAX_LENGTH:e} and {MAX_LENGTH:e}"),
            )
        };
        match self {
            Self::Recolour { rgb, .. } => check(
                "rgb",
                rgb.iter().all(|c| (0.0..=1.0).contains(c)),
                format!("{rgb:?} is not a colour; give red, green and blue from 0 to 1"),
            ),
            Self::Opacity { factor, .. } => check(
                "factor",
                factor.is_finite() && *factor >= 0.0,
                format!("{factor} cannot multiply an opacity; give a finite number of at least 0"),
            ),
            Self::Hide | Self::Show | Self::Isolate => Ok(()),
            Self::Translate { by } => point("by", by),
            Self::Rotate { axis, degrees, about } => {
                point("axis", axis)?;
                check(
                    "axis",
                    axis.iter().any(|c| *c != 0.0),
                    "has no direction; give one component that is not 0".into(),
                )?;
                check("degrees", degrees.is_finite(), format!("{degrees} is not finite; give an angle in degrees"))?;
                about.as_ref().map_or(Ok(()), |p| point("about", p))
            }
            Self::Scale { factor, about } => {
                check(
                    "factor",
                    SCALES.contains(factor),
                    format!("{factor} is not a scale; give a number from {:e} to {:e}", SCALES.start(), SCALES.end()),
                )?;
                about.as_ref().map_or(Ok(()), |p| point("about", p))
            }
        }
    }
}

impl Edit {
    /// Checks the values, and that at least one segment is named. Whether the segments exist is checked when edits are
    /// applied.
    ///
    /// # Errors
    /// [`EditError::Value`].
    pub fn validate(&self) -> Result<(), EditError> {
        let bad = |field: String, problem: &str| Err(EditError::Value { field, problem: problem.to_owned() });
        if self.segments.is_empty() {
            return bad("segments".to_owned(), "is empty; name at least one segment");
        }
        if let Some(i) = self.segments.iter().position(|name| name.trim().is_empty()) {
            return bad(format!("segments[{i}]"), "is blank; give the name of a segment");
        }
        self.operation.validate()
    }
}

/// Rounds a length or coordinate for display: an edit holds single precision in scene units, which are `unit` long.
fn rounded(value: f64, unit: f64) -> f64 {
    let decimals = 5.0 - value.abs().min(unit).log10().floor();
    format!("{value:.0$}", decimals.clamp(0.0, 17.0) as usize).parse().unwrap_or(value)
}

impl Edit {
    /// Returns the edit as one line, such as `rotate ring by 90° about the axis (0, 0, 1) through its centre`, with lengths
    /// and positions in the units of the data; [`fmt::Display`] gives them in scene units.
    pub fn line(&self, calibration: &Calibration) -> String {
        let names = self.segments.join(", ");
        let tuple = |p: [f64; 3]| {
            let [x, y, z] = p.map(|v| rounded(v, calibration.length_scale()));
            format!("({x}, {y}, {z})")
        };
        let unit = calibration.space.as_ref().map_or_else(String::new, |space| format!(" {}", space.unit_name()));
        let place = |about: &Option<[f32; 3]>| match about {
            Some(p) => format!("{}{unit}", tuple(calibration.position(p.map(f64::from)))),
            None if self.segments.len() == 1 => "its centre".to_owned(),
            None => "their own centres".to_owned(),
        };
        match &self.operation {
            Operation::Recolour { rgb, keep_shading } => {
                let [r, g, b] = rgb.map(|c| (c * 255.0).round() as u8);
                let kept = if *keep_shading { ", keeping the shading" } else { "" };
                format!("recolour {names} to #{r:02x}{g:02x}{b:02x}{kept}")
            }
            Operation::Opacity { factor, show } => {
                let shown = if *show { "show and " } else { "" };
                format!("{shown}multiply the opacity of {names} by {factor}")
            }
            Operation::Hide => format!("hide {names}"),
            Operation::Show => format!("show {names}"),
            Operation::Isolate => format!("hide everything but {names}"),
            Operation::Translate { by } => {
                let by = by.map(|v| calibration.length_scale() * f64::from(v));
                format!("move {names} by {}{unit}", tuple(by))
            }
            Operation::Rotate { axis, degrees, about } => {
                let [x, y, z] = axis;
                format!("rotate {names} by {degrees}° about the axis ({x}, {y}, {z}) through {}", place(about))
            }
            Operation::Scale { factor, about } => format!("scale {names} by {factor} about {}", place(about)),
        }
    }
}

/// Formats the edit as [`Edit::line`] does, with lengths and positions in scene units.
impl fmt::Display for Edit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.line(&Calibration::default()))
    }
}
