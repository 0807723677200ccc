//! Gaussians as a PLY file in the convention of 3D Gaussian Splatting viewers.
//!
//! Values are stored as optimised: log scales, opacity logits, quaternions (w, x, y, z). Headers are parsed in
//! `header`; nothing here depends on the training code.

mod header;
#[cfg(test)]
mod tests;

use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::Path;

use super::exporters::{Content, Exporter};
use super::splat_file::{self, SplatFileError, SplatFileOptions};
use crate::model::HostGaussians;
use header::PlyHeader;

/// Maximum degree of spherical harmonics in a file.
pub const MAX_SH_DEGREE: usize = 3;

/// The format of 3DGS viewers, as exact as the scene.
pub(super) const EXPORTER: Exporter = Exporter {
    extension: "ply",
    endings: &[],
    description: "Binary PLY in the 3DGS layout",
    content: Content::Gaussians { write, log_scales: f32::NEG_INFINITY..=f32::INFINITY, has_sh_degree: true },
};

/// Writes the Gaussians as they are, row by row and atomically; normals are zero. Shaded ones are written as
/// [`HostGaussians::baked`], since readers support only harmonics. Replaces only a file of this program. Viewers expect
/// quaternions of length 1: see [`HostGaussians::with_unit_rotations`].
///
/// # Errors
/// [`SplatFileError::Shape`] if the fields differ in length, or `options` ask for a degree that cannot hold their
/// colours, [`SplatFileError::Replace`] if something else is there or
/// the folder is missing, [`SplatFileError::Io`] from the file system.
pub fn write(gaussians: &HostGaussians, path: &Path, options: &SplatFileOptions) -> Result<(), SplatFileError> {
    let gaussians = splat_file::plain(gaussians)?;
    let (degree, least) = (options.sh_degree, gaussians.sh_degree());
    if !(least..=MAX_SH_DEGREE).contains(&degree) {
        return Err(SplatFileError::Shape(format!(
            "harmonics of degree {degree} cannot hold their colours; choose a degree from {least} to {MAX_SH_DEGREE}"
        )));
    }
    splat_file::write(path, |file| write_to(&gaussians, options, file))
}

fn write_to(gaussians: &HostGaussians, options: &SplatFileOptions, out: &mut impl Write) -> io::Result<()> {
    let (k, all) = (gaussians.sh_stride, (options.sh_degree + 1).pow(2));
    let [means, rotations, log_scales, opacity_logits, sh] = gaussians.common_columns();
    out.write_all(header::text(gaussians.len(), all, &options.comments).as_bytes())?;
    let mut row: Vec<u8> = Vec::new();
    for i in 0..gaussians.len() {
        row.clear();
        let sh = sh.row(i);
        let rest = (0..3).flat_map(|c| (1..all).map(move |j| if j < k { &sh[j * 3 + c] } else { &0.0 }));
        let values = (means.row(i).iter())
            .chain(&[0.0; 3])
            .chain(&sh[..3])
            .chain(rest)
            .chain(opacity_logits.row(i))
            .chain(log_scales.row(i))
            .chain(rotations.row(i));
        row.extend(values.flat_map(|v| v.to_le_bytes()));
        out.write_all(&row)?;
    }
    Ok(())
}

/// Reads a binary little-endian file. Properties may come in any order, unknown ones are skipped, and the normals may
/// be missing.
///
/// # Errors
/// [`SplatFileError::Io`] from the file system; [`SplatFileError::Format`] for any other kind of file, a missing
/// property or a file that ends early.
pub fn read(path: &Path) -> Result<HostGaussians, SplatFileError> {
    let io_error = |source| SplatFileError::Io { path: path.to_path_buf(), source };
    let file = File::open(path).map_err(io_error)?;
    read_from(&mut BufReader::with_capacity(1 << 16, file)).map_err(|error| match error {
        ReadError::Io(source) => io_error(source),
        ReadError::Format(reason) => SplatFileError::Format { path: path.to_path_buf(), reason },
    })
}

fn read_from(input: &mut impl io::BufRead) -> Result<HostGaussians, ReadError> {
    let header = PlyHeader::read(input)?;
    let k = header.coefficients();
    let mut out = HostGaussians { sh_stride: k, ..HostGaussians::default() };
    let mut row = vec![0; header.stride];
    for i in 0..header.count {
        read_row(input, &mut row, i, header.count)?;
        let at = |property: &header::PropertySlot| property.value(&row);
        out.means.extend(header.mean.iter().map(at));
        out.log_scales.extend(header.scale.iter().map(at));
        out.rotations.extend(header.rotation.iter().map(at));
        out.opacity_logits.push(at(&header.opacity));
        out.sh.extend(header.dc.iter().map(at));
        for j in 0..k - 1 {
            out.sh.extend((0..3).map(|c| at(&header.rest[c * (k - 1) + j])));
        }
    }
    Ok(out)
}

#[derive(Debug)]
enum ReadError {
    Io(io::Error),
    Format(String),
}

impl From<io::Error> for ReadError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

fn read_row(input: &mut impl Read, row: &mut [u8], i: usize, count: usize) -> Result<(), ReadError> {
    input.read_exact(row).map_err(|error| match error.kind() {
        io::ErrorKind::UnexpectedEof => {
            ReadError::Format(format!("the file ends in Gaussian {i} of {count}; it was cut short, copy it again"))
        }
        _ => ReadError::Io(error),
    })
}
