//! Decides which axes of an NRRD file are space and which is time. Where the grid lies is read in `place`.

use super::text::NrrdText;
use crate::volume::error::VolumeError;
use std::path::Path;

/// The axes of a file.
#[derive(Debug)]
pub struct NrrdAxes {
    /// Voxels along x, y, z.
    pub dims: [u64; 3],
    /// Time steps.
    pub steps: u64,
    /// The axis of x: 1 where time is the fastest axis in memory, else 0.
    pub first: usize,
    /// The axis that is not space: 0, 3, or none.
    pub other: Option<usize>,
    /// The vectors of `space directions`, one for each axis of the file.
    pub directions: Option<Vec<Option<Vec<f64>>>>,
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

impl NrrdAxes {
    /// Reads `dimension`, `sizes`, `kinds` and `space directions`.
    ///
    /// # Errors
    /// Not three axes of space and at most one of time, several components per voxel, or a malformed field.
    pub fn read(path: &Path, text: &NrrdText) -> Result<Self, VolumeError> {
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
        let first = usize::from(other == Some(0));
        let dims = [sizes[first], sizes[first + 1], sizes[first + 2]];
        let steps = other.map_or(1, |axis| sizes[axis]);
        Ok(Self { dims, steps, first, other, directions, notes })
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

/// Vectors `(1,0,0) (0,1,0) none ...`; `none` or all NaN is no vector.
pub(super) fn vectors(text: &str) -> Option<Vec<Option<Vec<f64>>>> {
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
