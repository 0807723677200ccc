//! Shared by the readers: checked sizes, names of scalar types, mapped files. No file format here.

use crate::files::open_regular;
use crate::memory::{MemoryBudget, product};
use crate::volume::directions::Directions;
use crate::volume::error::VolumeError;
use crate::volume::grid::{Grid, ScalarType};
use crate::volume::source::{PhysicalMetadata, VOXELS};
use memmap2::{Mmap, MmapOptions};
use std::fs::File;
use std::path::Path;

/// Maximum distance accepted: products of a few such numbers are still finite.
const MAX_DISTANCE: f64 = 1e30;

/// Checked sizes of the values of a file: nothing computed from them overflows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VolumeShape {
    /// Voxels along x, y, z.
    pub dims: [usize; 3],
    /// Time steps, at least 1.
    pub steps: usize,
    /// Voxels of one step.
    pub voxels: usize,
    /// Bytes of one step.
    pub step_bytes: u64,
    /// Bytes of all steps.
    pub total_bytes: u64,
}

impl VolumeShape {
    /// Checks `dims` (x, y, z) and `steps`, read from the named field of the file.
    ///
    /// # Errors
    /// A zero, or more voxels than this machine can address.
    pub fn new(path: &Path, field: &str, dims: [u64; 3], steps: u64, scalar: ScalarType) -> Result<Self, VolumeError> {
        if steps == 0 || dims.contains(&0) {
            let problem = format!("{dims:?} voxels in {steps} steps hold no values");
            return Err(VolumeError::invalid(path, field, problem, "make every size at least 1"));
        }
        Self::checked(dims, steps, scalar).ok_or_else(|| {
            let problem =
                format!("{dims:?} voxels of {} in {steps} steps are more than can be addressed", scalar.name());
            VolumeError::invalid(path, field, problem, "correct the sizes")
        })
    }

    fn checked(dims: [u64; 3], steps: u64, scalar: ScalarType) -> Option<Self> {
        let voxels = dims[0].checked_mul(dims[1])?.checked_mul(dims[2])?;
        let step_bytes = voxels.checked_mul(scalar.bytes() as u64)?;
        let total_bytes = step_bytes.checked_mul(steps).filter(|&n| n <= i64::MAX as u64)?;
        // one step becomes four bytes per voxel in memory
        voxels.checked_mul(4).filter(|&n| isize::try_from(n).is_ok())?;
        Some(Self {
            dims: [usize::try_from(dims[0]).ok()?, usize::try_from(dims[1]).ok()?, usize::try_from(dims[2]).ok()?],
            steps: usize::try_from(steps).ok()?,
            voxels: usize::try_from(voxels).ok()?,
            step_bytes,
            total_bytes,
        })
    }
}

/// The scalar type of a name: `u8`, `uint8`, `unsigned char`, `float`, ...; case and extra spaces do not matter.
pub fn scalar_from_name(name: &str) -> Option<ScalarType> {
    ScalarType::of_name(&name.split_whitespace().collect::<Vec<_>>().join(" ").to_ascii_lowercase())
}

/// Checks a spacing.
///
/// # Errors
/// A value that is not a number above 0, or outside the range of computation.
pub fn check_spacing(path: &Path, field: &str, spacing: [f64; 3]) -> Result<[f64; 3], VolumeError> {
    if spacing.iter().all(|s| (1.0 / MAX_DISTANCE..=MAX_DISTANCE).contains(s)) {
        return Ok(spacing);
    }
    let hint = "give three numbers above 0, from 1e-30 to 1e30";
    Err(VolumeError::invalid(path, field, format!("{spacing:?} is not a valid spacing"), hint))
}

/// Checks an origin.
///
/// # Errors
/// A value that is not finite, or too large.
pub fn check_origin(path: &Path, field: &str, origin: [f64; 3]) -> Result<[f64; 3], VolumeError> {
    if origin.iter().all(|s| s.abs() <= MAX_DISTANCE) {
        return Ok(origin);
    }
    let hint = "give three finite numbers, up to 1e30";
    Err(VolumeError::invalid(path, field, format!("{origin:?} is not a valid position"), hint))
}

/// The grid of a file with or without a spacing and an origin in the file `from`, and what its positions are in.
///
/// # Errors
/// As for [`check_spacing`] and [`check_origin`].
pub fn placed(
    from: &Path,
    dims: [usize; 3],
    spacing: Option<[f64; 3]>,
    origin: Option<[f64; 3]>,
) -> Result<(Grid, PhysicalMetadata), VolumeError> {
    let length_unit = spacing.is_none().then(|| VOXELS.to_owned());
    let spacing = check_spacing(from, "spacing", spacing.unwrap_or([1.0; 3]))?;
    let origin = check_origin(from, "origin", origin.unwrap_or([0.0; 3]))?;
    Ok((Grid::aligned(dims, spacing, origin), PhysicalMetadata { length_unit, ..PhysicalMetadata::default() }))
}

/// The directions and spacing of a grid from the vectors that lead from a voxel to the next along x, y, z, given by the
/// named field.
///
/// # Errors
/// A vector without direction, two that are not perpendicular, or a spacing outside the range of computation.
pub fn directions(path: &Path, field: &str, steps: [[f64; 3]; 3]) -> Result<(Directions, [f64; 3]), VolumeError> {
    let (directions, spacing) = Directions::of_steps(steps).map_err(|problem| {
        let hint = "distances and lighting need three perpendicular axes: resample the volume to such a grid";
        VolumeError::invalid(path, field, problem, hint)
    })?;
    Ok((directions, check_spacing(path, field, spacing)?))
}

/// Opens a regular file for reading and returns its length in bytes.
///
/// # Errors
/// It is missing, a folder, or not readable.
pub fn open_file(path: &Path) -> Result<(File, u64), VolumeError> {
    let fail = |source| VolumeError::io(path, "open the file", source, "check the name and the permissions");
    let file = open_regular(path).map_err(fail)?;
    let len = file.metadata().map_err(fail)?.len();
    Ok((file, len))
}

/// Maps `len` bytes from `offset` on. The handle is closed before this returns.
///
/// # Errors
/// The file is missing or ends before `offset + len`.
pub fn map(path: &Path, offset: u64, len: u64) -> Result<Mmap, VolumeError> {
    let (file, found) = open_file(path)?;
    let end = offset.checked_add(len).filter(|&end| end <= found);
    let (Some(_), Ok(size)) = (end, usize::try_from(len)) else {
        let problem = format!("needs {len} bytes from byte {offset} on, but the file has {found} bytes");
        return Err(VolumeError::invalid(path, "size", problem, "write the file again, it is truncated"));
    };
    // SAFETY: the map is only read, and dropped by the caller within one call. A file truncated by another process in
    // the meantime would stop this one; volumes are not written while they are read.
    let map = unsafe { MmapOptions::new().offset(offset).len(size).map(&file) };
    map.map_err(|e| VolumeError::io(path, "map the file", e, "copy it to a local disk"))
}

/// Clears `out` and fills it with `n` zeros.
///
/// # Errors
/// Not enough memory.
pub fn prepare(path: &Path, out: &mut Vec<f32>, n: usize) -> Result<(), VolumeError> {
    reserve(path, out, n)?;
    out.resize(n, 0.0);
    Ok(())
}

/// Clears `out` and reserves room for `n` values: four bytes each, however small they are in the file.
///
/// # Errors
/// Not enough memory.
pub fn reserve(path: &Path, out: &mut Vec<f32>, n: usize) -> Result<(), VolumeError> {
    out.clear();
    let more = product(&[n.saturating_sub(out.capacity()), size_of::<f32>()]);
    let refused = |problem: String| VolumeError::invalid(path, "size", problem, "or use a coarser volume");
    MemoryBudget::now().check(format!("one step of {n} voxels"), more).map_err(|e| refused(e.to_string()))?;
    out.try_reserve_exact(n).map_err(|_| refused(format!("one step of {n} voxels does not fit into memory")))
}

/// Checks that the file has the requested step.
///
/// # Errors
/// `step` is not below `steps`.
pub fn check_step(path: &Path, step: usize, steps: usize) -> Result<(), VolumeError> {
    if step < steps {
        return Ok(());
    }
    let problem = format!("there is no step {step}, the file has {steps}");
    Err(VolumeError::invalid(path, "step", problem, "steps are counted from 0"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_that_overflow_or_hold_nothing_are_refused() {
        let p = Path::new("a.raw");
        assert!(VolumeShape::new(p, "dims", [1 << 32, 1 << 32, 2], 1, ScalarType::U8).is_err());
        assert!(VolumeShape::new(p, "dims", [1 << 20, 1 << 20, 1 << 10], 1 << 20, ScalarType::F64).is_err());
        assert!(VolumeShape::new(p, "dims", [1, 0, 1], 1, ScalarType::U8).is_err());
        assert!(VolumeShape::new(p, "dims", [1, 1, 1], 0, ScalarType::U8).is_err());
        let s = VolumeShape::new(p, "dims", [2, 3, 4], 5, ScalarType::U16).unwrap();
        assert_eq!((s.voxels, s.step_bytes, s.total_bytes), (24, 48, 240));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_step_that_does_not_fit_into_memory_is_refused_before_it_is_allocated() {
        // as f32, a volume of bytes takes four times its file size
        let message = reserve(Path::new("a.raw"), &mut Vec::new(), 1 << 44).unwrap_err().to_string();
        assert!(message.contains("one step of 17592186044416 voxels") && message.contains("--memory"), "{message}");
        let mut out = vec![1.0; 3];
        prepare(Path::new("a.raw"), &mut out, 5).unwrap();
        assert_eq!(out, [0.0; 5]);
    }

    #[test]
    fn names_of_types() {
        assert_eq!(scalar_from_name(" Unsigned   char "), Some(ScalarType::U8));
        assert_eq!(scalar_from_name("float64"), Some(ScalarType::F64));
        assert_eq!(scalar_from_name("signed  long long int"), Some(ScalarType::I64));
        assert_eq!(scalar_from_name("uint64"), Some(ScalarType::U64));
        assert_eq!(scalar_from_name("float16"), Some(ScalarType::F16));
        // of 32 or 64 bits, depending on the machine
        assert_eq!(scalar_from_name("long"), None);
    }
}
