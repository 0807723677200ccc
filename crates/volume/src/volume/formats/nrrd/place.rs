//! Where the grid of an NRRD file lies in space and its steps in time, and in which units.

use super::super::common;
use super::axes::{NrrdAxes, vectors};
use super::text::NrrdText;
use crate::data::calibration::AxisConvention;
use crate::volume::directions::Directions;
use crate::volume::error::VolumeError;
use crate::volume::grid::Grid;
use crate::volume::source::{PhysicalMetadata, TimeAxis, VOXELS};
use std::path::Path;

/// The longest name of a unit; longer ones are something else.
const MAX_UNIT: usize = 32;

/// The place of the voxels and steps of a file.
#[derive(Debug)]
pub struct NrrdPlacement {
    /// The grid, but for its number of voxels.
    pub grid: Grid,
    /// What it is in.
    pub physical: PhysicalMetadata,
    /// What was assumed or converted.
    pub notes: Vec<String>,
}

/// The meaning of a `space`: the convention, and the coordinates that change their sign for a right-handed one.
#[derive(Debug, Default, PartialEq)]
struct NrrdSpace {
    axes: Option<AxisConvention>,
    negated: [bool; 3],
}

impl NrrdPlacement {
    /// Reads `space`, `spacings`, `space directions`, `space origin`, `axis mins` and the units.
    ///
    /// # Errors
    /// A malformed field, or axes that are not perpendicular.
    pub fn read(path: &Path, text: &NrrdText, axes: &NrrdAxes) -> Result<Self, VolumeError> {
        let bad = |field: &str, problem: String, hint: &str| VolumeError::invalid(path, field, problem, hint);
        let mut notes = Vec::new();
        let space = space_of(text, &mut notes);
        let signed = |v: [f64; 3]| -> [f64; 3] { std::array::from_fn(|c| if space.negated[c] { -v[c] } else { v[c] }) };
        let spacings = numbers(path, text, "spacings", axes)?;
        let given = |values: &Option<Vec<f64>>, axis: usize| values.as_ref().map_or(f64::NAN, |v| v[axis]);
        let mut unplaced = false;
        let steps = match &axes.directions {
            Some(all) => {
                let mut steps = [[0.0; 3]; 3];
                for (a, (step, vector)) in steps.iter_mut().zip(&all[axes.first..]).enumerate() {
                    *step = match vector.as_deref() {
                        Some(&[x, y, z, ref rest @ ..]) if rest.iter().all(|t| *t == 0.0 || t.is_nan()) => {
                            signed([x, y, z])
                        }
                        Some(_) => {
                            let problem = format!("the vector of axis {a} does not have three components of space");
                            return Err(bad(
                                "space directions",
                                problem,
                                "write three vectors of three, as in (1,0,0)",
                            ));
                        }
                        None => {
                            let problem = format!("there is no vector for axis {a}");
                            return Err(bad("space directions", problem, "give one for each axis of space"));
                        }
                    };
                }
                steps
            }
            None => {
                let along = [0, 1, 2].map(|a| given(&spacings, axes.first + a));
                unplaced = along.iter().all(|s| s.is_nan());
                if along.iter().any(|s| s.is_nan()) {
                    notes.push("spacing is not given on every axis: 1 is used".into());
                }
                let mut steps = [[0.0; 3]; 3];
                (0..3).for_each(|a| steps[a][a] = if along[a].is_nan() { 1.0 } else { along[a] });
                steps.map(signed)
            }
        };
        let field = if axes.directions.is_some() { "space directions" } else { "spacings" };
        // a spacing of 0 or beyond computation is named as such
        common::check_spacing(path, field, steps.map(|s| s.iter().fold(0.0, |m: f64, c| m.max(c.abs()))))?;
        let (directions, spacing): (Directions, _) = common::directions(path, field, steps)?;
        let place = match text.get("spaceorigin") {
            None => Vec::new(),
            Some(o) => match vectors(o).as_deref() {
                Some([Some(v)]) if v.len() >= 3 => v.clone(),
                _ => return Err(bad("space origin", format!("\"{o}\" is not a position"), "write it as (0,0,0)")),
            },
        };
        let origin = match place[..] {
            [x, y, z, ..] => signed([x, y, z]).map(|v| v + 0.0),
            _ => [0.0; 3],
        };
        let grid =
            Grid { dims: [1; 3], spacing, origin: common::check_origin(path, "space origin", origin)?, directions };
        let units = NrrdUnits::read(text);
        let length_unit = match units.length(axes.first) {
            Ok(None) if unplaced => Some(VOXELS.to_owned()),
            Ok(unit) => unit,
            Err(several) => {
                notes.push(format!("the units {several} differ along the axes of space: none is used"));
                None
            }
        };
        let time = axes.other.filter(|_| axes.steps > 1).and_then(|axis| {
            let vector = axes.directions.as_ref().and_then(|all| all[axis].as_ref());
            let fourth = vector.and_then(|v| v.get(3).copied()).filter(|t| *t > 0.0);
            let step = fourth.unwrap_or_else(|| given(&spacings, axis));
            let start = match fourth {
                Some(_) => place.get(3).copied(),
                None => numbers(path, text, "axismins", axes).ok().flatten().map(|mins| mins[axis]),
            };
            let start = start.filter(|t| t.is_finite()).unwrap_or(0.0);
            (step.is_finite() && step > 0.0).then(|| TimeAxis { start, step, unit: units.time(axis) })
        });
        Ok(Self { grid, physical: PhysicalMetadata { length_unit, axes: space.axes, time }, notes })
    }
}

/// The numbers of a field, one for each axis of the file.
fn numbers(path: &Path, text: &NrrdText, field: &str, axes: &NrrdAxes) -> Result<Option<Vec<f64>>, VolumeError> {
    let n = if axes.other.is_some() { 4 } else { 3 };
    let Some(given) = text.get(field) else { return Ok(None) };
    let values: Result<Vec<f64>, _> = given.split_whitespace().map(str::parse).collect();
    match values.ok().filter(|v| v.len() == n) {
        Some(values) => Ok(Some(values)),
        None => Err(VolumeError::invalid(path, field, format!("is not {n} numbers"), "give one for each axis")),
    }
}

/// The space of a header. One that is left-handed is converted to the right-handed one that differs in a sign, so that
/// nothing is mirrored.
fn space_of(text: &NrrdText, notes: &mut Vec<String>) -> NrrdSpace {
    let Some(name) = text.get("space") else { return NrrdSpace::default() };
    let Some(space) = space(name) else {
        notes.push(format!("space \"{name}\" is not known: its axes are taken as right-handed, without meaning"));
        return NrrdSpace::default();
    };
    let names = ["x", "y", "z"];
    let negated: Vec<&str> = (0..3).filter(|c| space.negated[*c]).map(|c| names[c]).collect();
    if !negated.is_empty() {
        let to = space.axes.map_or("a right-handed space", AxisConvention::name);
        notes.push(format!("space \"{name}\" is converted to {to}: {} changes its sign", negated.join(" and ")));
    }
    space
}

/// The meaning of a name of the format, in its long or short form, with time or not.
fn space(name: &str) -> Option<NrrdSpace> {
    let name = name.to_ascii_lowercase();
    let letters = match name.strip_suffix("-time").unwrap_or(&name) {
        "scanner-xyz" | "3d-right-handed" | "3dr" => return Some(NrrdSpace::default()),
        "3d-left-handed" | "3dl" => return Some(NrrdSpace { axes: None, negated: [false, false, true] }),
        short if matches!(short.len(), 3 | 4) && (short.len() == 3 || short.ends_with('t')) => short[..3].to_owned(),
        long => long.split('-').map(|word| word.get(..1).unwrap_or(" ")).collect(),
    };
    let words: Vec<&str> = name.strip_suffix("-time").unwrap_or(&name).split('-').collect();
    let whole = |word: &str| matches!(word, "right" | "left" | "anterior" | "posterior" | "superior" | "inferior");
    if words.len() > 1 && !words.iter().all(|word| whole(word)) {
        return None;
    }
    // where x, y and z lead, from the patient's right, front and head
    let signs = match letters.as_bytes() {
        [x @ (b'r' | b'l'), y @ (b'a' | b'p'), z @ (b's' | b'i')] => [*x == b'l', *y == b'p', *z == b'i'],
        _ => return None,
    };
    Some(match signs {
        [true, true, false] => NrrdSpace { axes: Some(AxisConvention::LeftPosteriorSuperior), negated: [false; 3] },
        negated => NrrdSpace { axes: Some(AxisConvention::RightAnteriorSuperior), negated },
    })
}

/// The units of a header.
struct NrrdUnits {
    /// Of space, one for each of its axes.
    space: Vec<Option<String>>,
    /// Of the axes of the file.
    axes: Vec<Option<String>>,
}

impl NrrdUnits {
    fn read(text: &NrrdText) -> Self {
        let of = |field: &str| text.get(field).map_or(Vec::new(), quoted);
        Self { space: of("spaceunits"), axes: of("units") }
    }

    /// The unit of length, if it is one.
    ///
    /// # Errors
    /// Several, in words.
    fn length(&self, first: usize) -> Result<Option<String>, String> {
        let of = |units: &[Option<String>], first: usize| units.get(first..first + 3).map(<[_]>::to_vec);
        let units = of(&self.space, 0).or_else(|| of(&self.axes, first)).unwrap_or_default();
        let mut named = units.iter().flatten();
        let Some(unit) = named.next() else { return Ok(None) };
        if named.all(|other| other == unit) {
            return Ok(Some(unit.clone()));
        }
        Err(units.iter().map(|u| u.as_deref().unwrap_or("none")).collect::<Vec<_>>().join(", "))
    }

    fn time(&self, axis: usize) -> Option<String> {
        self.axes.get(axis).or_else(|| self.space.get(3)).cloned().flatten()
    }
}

/// Texts in quotes, `"mm" "mm" ""`, or words; what is empty, too long or means none is `None`.
fn quoted(text: &str) -> Vec<Option<String>> {
    let words: Vec<&str> = if text.contains('"') {
        text.split('"').skip(1).step_by(2).collect()
    } else {
        text.split_whitespace().collect()
    };
    let none = |word: &str| ["", "none", "???", "nan"].iter().any(|w| word.eq_ignore_ascii_case(w));
    let unit = |word: &str| {
        let word = word.trim();
        let plain = !none(word) && word.len() <= MAX_UNIT && !word.chars().any(char::is_control);
        plain.then(|| word.to_owned())
    };
    words.into_iter().map(unit).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spaces_have_long_and_short_names() {
        use AxisConvention::{LeftPosteriorSuperior as Lps, RightAnteriorSuperior as Ras};
        let with = |axes, negated| Some(NrrdSpace { axes, negated });
        for name in ["left-posterior-superior", "LPS", "Left-Posterior-Superior-Time", "lpst"] {
            assert_eq!(space(name), with(Some(Lps), [false; 3]), "{name}");
        }
        for name in ["right-anterior-superior", "RAS", "RAST", "right-anterior-superior-time"] {
            assert_eq!(space(name), with(Some(Ras), [false; 3]), "{name}");
        }
        assert_eq!(space("left-anterior-superior"), with(Some(Ras), [true, false, false]));
        assert_eq!(space("LAS"), with(Some(Ras), [true, false, false]));
        for name in ["scanner-xyz", "scanner-xyz-time", "3D-right-handed", "3D-right-handed-time"] {
            assert_eq!(space(name), with(None, [false; 3]), "{name}");
        }
        assert_eq!(space("3D-left-handed"), with(None, [false, false, true]));
        for name in ["", "sideways", "lasx", "left-anterior", "left-right-superior", "left-apple-superior", "l\u{e9}s"]
        {
            assert_eq!(space(name), None, "{name}");
        }
    }

    #[test]
    fn units_are_quoted_or_words() {
        let read = |text| quoted(text).into_iter().map(|u| u.unwrap_or_default()).collect::<Vec<_>>();
        assert_eq!(read(r#""mm" "micro meter" """#), ["mm", "micro meter", ""]);
        assert_eq!(read("mm none ???"), ["mm", "", ""]);
        assert!(read(&format!("\"{}\"", "x".repeat(99)))[0].is_empty());
    }
}
