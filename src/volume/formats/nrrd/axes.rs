//! Decides which axes of an NRRD file are space and which is time, and where the grid lies. No data are read here.

use super::super::common;
use super::text::Text;
use crate::volume::error::VolumeError;
use std::path::Path;

/// The axes of a file.
#[derive(Debug)]
pub struct Axes {
    /// Voxels along x, y, z.
    pub dims: [u64; 3],
    /// Time steps.
    pub steps: u64,
    /// True where time is the fastest axis in memory, before x.
    pub time_first: bool,
    /// Distance between voxels.
    pub spacing: [f64; 3],
    /// Centre of the first voxel.
    pub origin: [f64; 3],
    /// What was assumed or ignored.
    pub notes: Vec<String>,
}

#[derive(Clone, Copy, PartialEq)]
enum Role {
    Space,
    Time,
    Component,
    Unknown,
}

fn role(kind: &str) -> Role {
    match kind.to_ascii_lowercase().as_str() {
        "domain" | "space" => Role::Space,
        "time" | "list" => Role::Time,
        "???" | "none" => Role::Unknown,
        _ => Role::Component,
    }
}

impl Axes {
    /// Reads `dimension`, `sizes`, `kinds`, `spacings`, `space directions` and `space origin`.
    ///
    /// # Errors
    /// Not three axes of space and at most one of time, several components per voxel, or a malformed field.
    pub fn read(path: &Path, text: &Text) -> Result<Self, VolumeError> {
        let bad = |field: &str, problem: String, hint: &str| VolumeError::invalid(path, field, problem, hint);
        let dimension = text.need(path, "dimension")?;
        let Some(n) = dimension.parse::<usize>().ok().filter(|n| matches!(n, 3 | 4)) else {
            let hint = "save three axes of space, or those and one of time";
            return Err(bad("dimension", format!("\"{dimension}\" is neither 3 nor 4"), hint));
        };
        let sizes: Result<Vec<u64>, _> = text.need(path, "sizes")?.split_whitespace().map(str::parse).collect();
        let sizes = sizes.ok().filter(|s| s.len() == n);
        let sizes = sizes.ok_or_else(|| bad("sizes", format!("is not {n} whole numbers"), "correct the header"))?;
        let directions = text.get("spacedirections").map(|d| vectors(d).filter(|v| v.len() == n));
        let directions = match directions {
            Some(None) => {
                return Err(bad("space directions", format!("is not {n} vectors"), "write them as in (1,0,0) none"));
            }
            Some(given) => given,
            None => None,
        };
        let kinds = text.get("kinds").map(|k| k.split_whitespace().map(role).collect::<Vec<_>>());
        if let Some(kinds) = kinds.as_ref().filter(|k| k.len() != n) {
            return Err(bad("kinds", format!("{} are given for {n} axes", kinds.len()), "give one for each axis"));
        }
        let mut notes = Vec::new();
        let other = other_axis(path, &sizes, kinds.as_deref(), directions.as_deref(), &mut notes)?;
        let from = usize::from(other == Some(0));
        let dims = [sizes[from], sizes[from + 1], sizes[from + 2]];
        let steps = other.map_or(1, |axis| sizes[axis]);
        let spacing = spacing(path, text, n, from, directions.as_deref(), &mut notes)?;
        let origin = match text.get("spaceorigin") {
            None => [0.0; 3],
            Some(o) => match vectors(o).as_deref() {
                Some([Some(v)]) if v.len() >= 3 => common::check_origin(path, "space origin", [v[0], v[1], v[2]])?,
                _ => return Err(bad("space origin", format!("\"{o}\" is not a position"), "write it as (0,0,0)")),
            },
        };
        Ok(Self { dims, steps, time_first: other == Some(0), spacing, origin, notes })
    }
}

/// The axis that is not space: 0, 3, or none.
fn other_axis(
    path: &Path,
    sizes: &[u64],
    kinds: Option<&[Role]>,
    directions: Option<&[Option<Vec<f64>>]>,
    notes: &mut Vec<String>,
) -> Result<Option<usize>, VolumeError> {
    let bad = |problem: String, hint: &str| Err(VolumeError::invalid(path, "kinds", problem, hint));
    let several = "one component per voxel is needed; save one component or the magnitude";
    let roles = kinds.unwrap_or_default();
    if let Some(axis) = (0..roles.len()).find(|&a| roles[a] == Role::Component && sizes[a] > 1) {
        return bad(format!("axis {axis} holds {} components of each voxel", sizes[axis]), several);
    }
    let apart: Vec<usize> = (0..roles.len()).filter(|&a| matches!(roles[a], Role::Time | Role::Component)).collect();
    match (sizes.len(), apart.as_slice()) {
        (3, []) => return Ok(None),
        (3, _) => return bad("fewer than three axes are space".into(), "save volumes of three axes of space"),
        (_, &[axis @ (0 | 3)]) => return Ok(Some(axis)),
        (_, []) => {}
        _ => return bad("the axes are not time and space".into(), "put time first or last and space on the others"),
    }
    let none: Vec<usize> = directions.map_or_else(Vec::new, |d| (0..d.len()).filter(|&a| d[a].is_none()).collect());
    match none.as_slice() {
        [0] if sizes[0] > 1 => bad(
            "the first axis has no direction: it may be time or components".into(),
            "say which: \"kinds: time domain domain domain\" or \"kinds: vector domain domain domain\"",
        ),
        [0] => Ok(Some(0)),
        _ if kinds.is_none() && sizes[0] == 1 => {
            notes.push("first axis of size 1 dropped".into());
            Ok(Some(0))
        }
        _ => {
            notes.push("the last axis is used as time".into());
            Ok(Some(3))
        }
    }
}

fn spacing(
    path: &Path,
    text: &Text,
    n: usize,
    from: usize,
    directions: Option<&[Option<Vec<f64>>]>,
    notes: &mut Vec<String>,
) -> Result<[f64; 3], VolumeError> {
    let (field, mut spacing) = match (directions, text.get("spacings")) {
        (Some(d), _) => {
            let axes = &d[from..from + 3];
            let along =
                |a: usize, v: &[f64]| v.iter().enumerate().all(|(i, &c)| if i == a { c > 0.0 } else { c == 0.0 });
            if axes.iter().enumerate().any(|(a, v)| v.as_deref().is_some_and(|v| !along(a, v))) {
                notes.push("orientation ignored: the axes of the grid are used as x, y, z".into());
            }
            let length =
                |v: &Option<Vec<f64>>| v.as_ref().map_or(f64::NAN, |v| v.iter().map(|c| c * c).sum::<f64>().sqrt());
            ("space directions", [length(&axes[0]), length(&axes[1]), length(&axes[2])])
        }
        (None, Some(given)) => {
            let values: Result<Vec<f64>, _> = given.split_whitespace().map(str::parse).collect();
            let Some(v) = values.ok().filter(|v| v.len() == n) else {
                let problem = format!("is not {n} numbers");
                return Err(VolumeError::invalid(path, "spacings", problem, "give one for each axis"));
            };
            ("spacings", [v[from], v[from + 1], v[from + 2]])
        }
        (None, None) => ("spacings", [f64::NAN; 3]),
    };
    if spacing.iter().any(|s| s.is_nan()) {
        notes.push("spacing is not given on every axis: 1 is used".into());
    }
    if spacing.iter().any(|&s| s < 0.0) {
        notes.push("orientation ignored: a spacing is negative".into());
    }
    for s in &mut spacing {
        *s = if s.is_nan() { 1.0 } else { s.abs() };
    }
    common::check_spacing(path, field, spacing)
}

/// Vectors `(1,0,0) (0,1,0) none ...`; `none` or all NaN is no vector.
fn vectors(text: &str) -> Option<Vec<Option<Vec<f64>>>> {
    let mut rest = text.trim();
    let mut found = Vec::new();
    while !rest.is_empty() {
        if let Some(after) = rest.strip_prefix("none") {
            found.push(None);
            rest = after.trim_start();
            continue;
        }
        let (inner, after) = rest.strip_prefix('(')?.split_once(')')?;
        let numbers: Vec<f64> = inner.split(',').map(|c| c.trim().parse().ok()).collect::<Option<_>>()?;
        found.push(Some(numbers).filter(|v| !v.iter().all(|c| c.is_nan())));
        rest = after.trim_start();
    }
    Some(found)
}
