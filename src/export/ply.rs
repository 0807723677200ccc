//! Gaussians as a PLY file in the convention of the 3D Gaussian Splatting viewers.
//!
//! Values are stored as optimised: log scales, opacity logits, quaternions (w, x, y, z).
//! Header parsing lives in `header`; nothing here knows the training code.

mod header;
#[cfg(test)]
mod tests;

use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::{Path, PathBuf};

use crate::files::{AtomicFile, ReplaceError};
use header::Header;

/// Highest degree of spherical harmonics a file may hold.
pub const MAX_SH_DEGREE: usize = 3;

/// N Gaussians with K = (sh_degree + 1)^2 colour coefficients.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PlyGaussians {
    /// Centres in world units, `[N, 3]`.
    pub means: Vec<[f32; 3]>,
    /// Natural logarithms of the standard deviations, `[N, 3]`.
    pub log_scales: Vec<[f32; 3]>,
    /// Quaternions (w, x, y, z), `[N, 4]`.
    pub rotations: Vec<[f32; 4]>,
    /// Opacities before the sigmoid, `[N]`.
    pub opacity_logits: Vec<f32>,
    /// Spherical-harmonic coefficients, `[N, K, 3]` flattened.
    pub sh: Vec<f32>,
    /// Degree of the spherical harmonics, 0 to 3.
    pub sh_degree: usize,
}

/// Why a PLY file cannot be written or read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PlyError {
    /// The file system failed.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The content is not a PLY file of Gaussians.
    #[error("{path}: {reason}")]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong and where.
        reason: String,
    },
    /// Something else stands where the file should go.
    #[error(transparent)]
    Replace(#[from] ReplaceError),
    /// The fields of the Gaussians do not fit together.
    #[error("the Gaussians cannot be written: {0}")]
    Shape(String),
}

impl PlyGaussians {
    /// Number of Gaussians N.
    #[must_use]
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Coefficients per channel, K.
    #[must_use]
    pub fn coefficients(&self) -> usize {
        (self.sh_degree + 1) * (self.sh_degree + 1)
    }

    fn check(&self) -> Result<(), PlyError> {
        if self.sh_degree > MAX_SH_DEGREE {
            let degree = self.sh_degree;
            return Err(PlyError::Shape(format!("sh_degree {degree} is above 3")));
        }
        let (n, k) = (self.len(), self.coefficients());
        let fields = [
            ("log_scales", self.log_scales.len(), n),
            ("rotations", self.rotations.len(), n),
            ("opacity_logits", self.opacity_logits.len(), n),
            ("sh", self.sh.len(), n * k * 3),
        ];
        match fields.into_iter().find(|(_, got, wanted)| got != wanted) {
            None => Ok(()),
            Some((field, got, wanted)) => Err(PlyError::Shape(format!(
                "{field} holds {got} entries but {n} means of degree {} ask for {wanted}",
                self.sh_degree
            ))),
        }
    }

    /// Writes the file, streaming and atomically; normals are zero. Only a file of this program gives way to it.
    ///
    /// # Errors
    /// [`PlyError::Shape`] if the fields differ in length, [`PlyError::Replace`] if something else stands there or the
    /// folder is missing, [`PlyError::Io`] from the file system.
    pub fn write(&self, path: &Path) -> Result<(), PlyError> {
        self.check()?;
        let io_error = |source| PlyError::Io { path: path.to_path_buf(), source };
        let mut file = AtomicFile::create_named(path)?;
        self.write_to(&mut file).and_then(|()| file.commit()).map_err(io_error)
    }

    fn write_to(&self, out: &mut impl Write) -> io::Result<()> {
        let k = self.coefficients();
        out.write_all(header::text(self.len(), k).as_bytes())?;
        let mut row: Vec<u8> = Vec::new();
        for i in 0..self.len() {
            row.clear();
            let sh = &self.sh[i * k * 3..][..k * 3];
            let rest = (0..3).flat_map(|c| (1..k).map(move |j| sh[j * 3 + c]));
            let values = self.means[i]
                .into_iter()
                .chain([0.0; 3])
                .chain(sh[..3].iter().copied())
                .chain(rest)
                .chain([self.opacity_logits[i]])
                .chain(self.log_scales[i])
                .chain(self.rotations[i]);
            row.extend(values.flat_map(f32::to_le_bytes));
            out.write_all(&row)?;
        }
        Ok(())
    }

    /// Reads a binary little-endian file. The order of the properties is free, others than ours
    /// are skipped and the normals may be missing.
    ///
    /// # Errors
    /// [`PlyError::Io`] from the file system; [`PlyError::Format`] for any other kind of file, a
    /// missing property or a file that ends early.
    pub fn read(path: &Path) -> Result<Self, PlyError> {
        let io_error = |source| PlyError::Io { path: path.to_path_buf(), source };
        let file = File::open(path).map_err(io_error)?;
        Self::read_from(&mut BufReader::with_capacity(1 << 16, file)).map_err(|error| match error {
            ReadError::Io(source) => io_error(source),
            ReadError::Format(reason) => PlyError::Format { path: path.to_path_buf(), reason },
        })
    }

    fn read_from(input: &mut impl io::BufRead) -> Result<Self, ReadError> {
        let header = Header::read(input)?;
        let k = header.coefficients();
        let mut out = Self { sh_degree: k.isqrt() - 1, ..Self::default() };
        let mut row = vec![0; header.stride];
        for i in 0..header.count {
            read_row(input, &mut row, i, header.count)?;
            let at = |property: &header::Slot| property.value(&row);
            out.means.push(header.mean.map(|p| at(&p)));
            out.log_scales.push(header.scale.map(|p| at(&p)));
            out.rotations.push(header.rotation.map(|p| at(&p)));
            out.opacity_logits.push(at(&header.opacity));
            out.sh.extend(header.dc.iter().map(at));
            for j in 0..k - 1 {
                out.sh.extend((0..3).map(|c| at(&header.rest[c * (k - 1) + j])));
            }
        }
        Ok(out)
    }
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
