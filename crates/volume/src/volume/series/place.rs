//! Whether the files of a series, or a volume and its labels, are at the same place.

use super::{FileNotes, Series};
use crate::data::calibration::AxisConvention;
use crate::volume::error::VolumeError;
use crate::volume::grid::Grid;
use crate::volume::source::{PhysicalMetadata, VOXELS, VolumeHeader};
use glam::DVec3;
use std::path::Path;

/// Maximum relative difference between the spacings of two files.
const SPACING_TOLERANCE: f64 = 1e-6;
/// Maximum difference between the components of the directions of two files, and between their first voxels, in voxels.
const PLACE_TOLERANCE: f64 = 1e-3;

/// The same of a volume and its labels, whose headers often differ by rounding of other programs: components of
/// directions, relative spacing, and voxels between the first voxels. Beyond half a voxel, labels are of other voxels.
const SAME_DIRECTION: f64 = 0.02;
const SAME_SPACING: f64 = 0.01;
const SAME_VOXEL: f64 = 0.5;

impl Series {
    /// Whether voxel `i` of this series is where voxel `i` of another grid is, as far as the files say.
    ///
    /// # Errors
    /// How they differ, in words.
    pub fn lies_on(&self, grid: &Grid, axes: Option<AxisConvention>) -> Result<(), String> {
        let own = match (self.header.physical.axes, axes) {
            (Some(own), Some(axes)) => self.header.grid.converted(own, axes),
            _ => self.header.grid,
        };
        // a file that says nothing is taken at its indices
        if own.is_unit() || grid.is_unit() {
            return Ok(());
        }
        if !own.directions.agree(&grid.directions, SAME_DIRECTION) {
            let [ours, theirs] = [own, *grid].map(|g| g.directions.code(axes));
            return Err(format!("axes that lead to {ours}, not to {theirs}"));
        }
        if (0..3).any(|a| (own.spacing[a] / grid.spacing[a] - 1.0).abs() > SAME_SPACING) {
            return Err(format!("a spacing of {:?}, not {:?}", own.spacing, grid.spacing));
        }
        let off = grid.index(DVec3::from_array(own.origin));
        if off.abs().max_element() > SAME_VOXEL {
            return Err(format!("the first voxel at {:?}, not at {:?}", own.origin, grid.origin));
        }
        Ok(())
    }
}

/// Compares the header of a file with that of the first of its series, and adds its notes.
///
/// # Errors
/// They differ in steps, grid, space or unit; or in their origin, unless that is ignored.
pub(super) fn compare(
    first: &Path,
    header: &VolumeHeader,
    path: &Path,
    other: &VolumeHeader,
    ignore_origin: bool,
    notes: &mut FileNotes,
) -> Result<(), VolumeError> {
    let (a, b) = (&header.grid, &other.grid);
    let differ = |field: &str, ours: String, theirs: String| {
        let problem = format!("is {ours}, but {theirs} in {}", first.display());
        let hint = "a series needs one grid: resample the files or omit those that differ";
        Err(VolumeError::invalid(path, field, problem, hint))
    };
    if let Some(steps) = [header.steps, other.steps].into_iter().find(|&s| s > 1) {
        let problem = format!("of the files {} and {}, one has {steps} steps", first.display(), path.display());
        return Err(VolumeError::invalid(path, "steps", problem, "give one 4D file alone, or files of one step each"));
    }
    if a.dims != b.dims {
        return differ("dims", format!("{:?}", b.dims), format!("{:?}", a.dims));
    }
    if (0..3).any(|i| (a.spacing[i] - b.spacing[i]).abs() > SPACING_TOLERANCE * a.spacing[i].abs()) {
        return differ("spacing", format!("{:?}", b.spacing), format!("{:?}", a.spacing));
    }
    if !a.directions.agree(&b.directions, PLACE_TOLERANCE) {
        return differ("directions", b.directions.to_string(), a.directions.to_string());
    }
    let (ours, theirs) = (&other.physical, &header.physical);
    if let (Some(a), Some(b)) = (theirs.axes, ours.axes)
        && a != b
    {
        return differ("space", b.to_string(), a.to_string());
    }
    let named = |p: &PhysicalMetadata| p.length_unit.clone().filter(|unit| unit != VOXELS);
    if let (Some(a), Some(b)) = (named(theirs), named(ours))
        && a != b
    {
        return differ("unit of length", b, a);
    }
    if a.index(DVec3::from_array(b.origin)).abs().max_element() > PLACE_TOLERANCE {
        if !ignore_origin {
            let problem = format!("is {:?}, but {:?} in {}", b.origin, a.origin, first.display());
            let hint = "the grid moves, which would be lost: resample the files to one grid, or pass --ignore-origin";
            return Err(VolumeError::invalid(path, "origin", problem, hint));
        }
        notes.add(path, &["the origin differs from that of the first file, which is used".to_owned()]);
    }
    notes.add(path, &other.notes);
    Ok(())
}
