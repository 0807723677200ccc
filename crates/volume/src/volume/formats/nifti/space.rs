//! Where the voxels of a NIfTI image are: by its sform, else its qform, else its spacings alone; and the units.

use super::common;
use crate::data::calibration::AxisConvention;
use crate::volume::directions::Directions;
use crate::volume::error::VolumeError;
use crate::volume::grid::Grid;
use crate::volume::source::{PhysicalMetadata, TimeAxis};
use nifti::NiftiHeader;
use std::path::Path;

/// Relative difference between the spacing of `pixdim` and that of the sform up to which they are the same number in
/// single precision.
const ROUNDING: f64 = 1e-6;
/// The same, above which the difference is worth a note: some programs change only the one.
const NOTED: f64 = 1e-3;
/// The most by which the length of a quaternion's vector may exceed 1.
const UNIT: f64 = 1e-3;

/// The grid of each step of `dims` voxels, and what it is in.
pub(super) fn read(
    path: &Path,
    raw: &NiftiHeader,
    dims: [usize; 3],
    steps: usize,
    notes: &mut Vec<String>,
) -> Result<(Grid, PhysicalMetadata), VolumeError> {
    let spacing = pixdim(path, raw, notes)?;
    let (grid, axes) = if raw.sform_code > 0 {
        (sform(path, raw, dims, spacing, notes)?, Some(AxisConvention::RightAnteriorSuperior))
    } else if raw.qform_code > 0 {
        (qform(path, raw, dims, spacing)?, Some(AxisConvention::RightAnteriorSuperior))
    } else {
        (Grid::aligned(dims, spacing, [0.0; 3]), None)
    };
    common::check_spacing(path, "pixdim", grid.spacing)?;
    common::check_origin(path, "offset of the first voxel", grid.origin)?;
    let length_unit = match raw.xyzt_units & 7 {
        1 => Some("m"),
        2 => Some("mm"),
        3 => Some("um"),
        _ => None,
    };
    let length_unit = length_unit.map(str::to_owned);
    Ok((grid, PhysicalMetadata { length_unit, axes, time: time(raw).filter(|_| steps > 1) }))
}

/// The spacings of `pixdim`.
fn pixdim(path: &Path, raw: &NiftiHeader, notes: &mut Vec<String>) -> Result<[f64; 3], VolumeError> {
    let mut spacings = [1.0; 3];
    // the axes that the file has
    for axis in 0..usize::from(raw.dim[0]).min(3) {
        let spacing = f64::from(raw.pixdim[axis + 1]).abs();
        if !spacing.is_finite() {
            let problem = format!("axis {axis}: {spacing}");
            return Err(VolumeError::invalid(path, "pixdim", problem, "write finite, positive spacings"));
        }
        if spacing == 0.0 {
            notes.push(format!("pixdim: spacing 0 along axis {axis} replaced by 1"));
        } else {
            spacings[axis] = spacing;
        }
    }
    Ok(spacings)
}

fn sform(
    path: &Path,
    raw: &NiftiHeader,
    dims: [usize; 3],
    mut spacing: [f64; 3],
    notes: &mut Vec<String>,
) -> Result<Grid, VolumeError> {
    let rows = [raw.srow_x, raw.srow_y, raw.srow_z];
    let column = |c: usize| rows.map(|row| f64::from(row[c]));
    let (directions, lengths) = common::directions(path, "sform", [column(0), column(1), column(2)])?;
    for axis in 0..3 {
        let off = (lengths[axis] / spacing[axis] - 1.0).abs();
        if off > NOTED {
            let (old, new) = (spacing[axis], lengths[axis]);
            notes.push(format!("pixdim: spacing {old} along axis {axis} replaced by {new}, that of the sform"));
        }
        if off > ROUNDING {
            spacing[axis] = lengths[axis];
        }
    }
    Ok(Grid { dims, spacing, origin: column(3), directions })
}

fn qform(path: &Path, raw: &NiftiHeader, dims: [usize; 3], spacing: [f64; 3]) -> Result<Grid, VolumeError> {
    let [b, c, d] = [raw.quatern_b, raw.quatern_c, raw.quatern_d].map(f64::from);
    let square = b * b + c * c + d * d;
    if square.is_nan() || square > 1.0 + UNIT {
        let problem = format!("({b}, {c}, {d}) is not part of a unit quaternion");
        return Err(VolumeError::invalid(path, "quatern_b, quatern_c, quatern_d", problem, super::REWRITE));
    }
    let length = square.max(1.0).sqrt();
    let [b, c, d] = [b, c, d].map(|v| v / length);
    let a = (1.0 - square).max(0.0).sqrt();
    // the third axis points backwards in a left-handed grid
    let third = if raw.pixdim[0] < 0.0 { -1.0 } else { 1.0 };
    let columns = [
        [a * a + b * b - c * c - d * d, 2.0 * (b * c + a * d), 2.0 * (b * d - a * c)],
        [2.0 * (b * c - a * d), a * a + c * c - b * b - d * d, 2.0 * (c * d + a * b)],
        [2.0 * (b * d + a * c), 2.0 * (c * d - a * b), a * a + d * d - b * b - c * c].map(|v| third * v),
    ];
    let (directions, _): (Directions, _) = common::directions(path, "qform", columns)?;
    let origin = [raw.quatern_x, raw.quatern_y, raw.quatern_z].map(f64::from);
    Ok(Grid { dims, spacing, origin, directions })
}

/// The times of the steps. A spacing of 1 in no unit is what programs write that know nothing of time.
fn time(raw: &NiftiHeader) -> Option<TimeAxis> {
    let unit = match raw.xyzt_units & 0x38 {
        0 => None,
        8 => Some("s"),
        16 => Some("ms"),
        24 => Some("us"),
        // frequencies and the like
        _ => return None,
    };
    let (step, start) = (f64::from(raw.pixdim[4]), f64::from(raw.toffset));
    let known = step.is_finite() && step > 0.0 && (unit.is_some() || step != 1.0);
    known.then(|| TimeAxis { start: if start.is_finite() { start } else { 0.0 }, step, unit: unit.map(str::to_owned) })
}
