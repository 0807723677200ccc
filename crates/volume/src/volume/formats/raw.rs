//! Plain values in a `.raw`, `.bin` or `.dat` file, described by a sidecar `NAME.raw.toml`, `NAME.toml`,
//! `NAME.raw.json` or `NAME.json`, or, for all files of a folder, `volume.toml` or `volume.json`.

use super::common::{self, VolumeShape};
use super::decode::Endian;
use super::npy::ArrayFile;
use super::sidecar::{self, RawSidecar};
use crate::volume::error::VolumeError;
use crate::volume::source::{VolumeFile, VolumeHeader};
use std::path::{Path, PathBuf};

/// The sidecar of a raw file, if any: its own takes precedence over that of the folder.
///
/// # Errors
/// Two of the same kind exist.
pub fn sidecar_of(path: &Path) -> Result<Option<PathBuf>, VolumeError> {
    let bare = path.with_extension("");
    let own = [".toml", ".json"].map(|s| [sidecar::with_suffix(path, s), sidecar::with_suffix(&bare, s)]);
    if let Some(found) = sidecar::only(path, own.as_flattened())? {
        return Ok(Some(found));
    }
    sidecar::only(path, &[path.with_file_name("volume.toml"), path.with_file_name("volume.json")])
}

/// Opens a raw file: reads its sidecar and checks the size of the file.
///
/// # Errors
/// No sidecar or two, an invalid field in it, or a file size that does not match it.
pub fn open(path: &Path) -> Result<Box<dyn VolumeFile>, VolumeError> {
    let (_, found) = common::open_file(path)?;
    let Some(side) = sidecar_of(path)? else {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let hint = format!(
            "write {name}.toml beside it (or volume.toml for the whole folder), for example: \
             dims = [256, 256, 128]  # x, y, z\ntype = \"u8\"\nendian = \"little\"\nspacing = [1.0, 1.0, 1.0]"
        );
        return Err(VolumeError::invalid(path, "sidecar", "is missing, so the sizes are unknown", hint));
    };
    let fields: RawSidecar = sidecar::read(&side)?;
    let scalar = common::scalar_from_name(&fields.scalar).ok_or_else(|| {
        let problem = format!("\"{}\" is not a scalar type", fields.scalar);
        VolumeError::invalid(&side, "type", problem, "use u8, i8, u16, i16, u32, i32, u64, i64, f16, f32 or f64")
    })?;
    let endian = match fields.endian.as_deref().map(str::to_ascii_lowercase).as_deref() {
        None | Some("little") => Endian::Little,
        Some("big") => Endian::Big,
        Some(other) => {
            let problem = format!("\"{other}\" is not a byte order");
            return Err(VolumeError::invalid(&side, "endian", problem, "use \"little\" or \"big\""));
        }
    };
    let (dims, steps) = match (fields.dims.as_slice(), fields.steps) {
        (&[x, y, z], steps) => ([x, y, z], steps.unwrap_or(1)),
        (&[x, y, z, t], None) => ([x, y, z], t),
        (&[x, y, z, t], Some(steps)) if t == steps => ([x, y, z], t),
        (&[_, _, _, t], Some(steps)) => {
            let problem = format!("{steps} differs from the fourth size in dims, {t}");
            return Err(VolumeError::invalid(&side, "steps", problem, "remove steps"));
        }
        (other, _) => {
            let problem = format!("has {} entries", other.len());
            return Err(VolumeError::invalid(&side, "dims", problem, "give [x, y, z] or [x, y, z, steps]"));
        }
    };
    let shape = VolumeShape::new(&side, "dims", dims, steps, scalar)?;
    let offset = fields.offset.unwrap_or(0);
    let expected = offset.checked_add(shape.total_bytes).ok_or_else(|| {
        let hint = "give the number of bytes before the values";
        VolumeError::invalid(&side, "offset", format!("{offset} is too large"), hint)
    })?;
    if expected != found {
        let problem = format!(
            "expected {expected} bytes (offset {offset} + {} x {} x {} voxels x {steps} steps x {} bytes of {}), \
             found {found}",
            dims[0],
            dims[1],
            dims[2],
            scalar.bytes(),
            scalar.name()
        );
        return Err(VolumeError::invalid(
            path,
            "size",
            problem,
            format!("correct dims, type or offset in {}", side.display()),
        ));
    }
    let (grid, physical) = common::placed(&side, shape.dims, fields.spacing, fields.origin)?;
    let header = VolumeHeader { grid, scalar, steps: shape.steps, physical, notes: Vec::new() };
    Ok(Box::new(ArrayFile { path: path.to_owned(), header, shape, endian, offset, fortran: false }))
}
