//! NumPy arrays (`.npy`) of single precision, written piece by piece.
//!
//! [`MARK`] follows the values, where NumPy does not look: the format has no room for a comment.

use crate::files::{AtomicFile, MARK, ReplaceError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// The header's length is a multiple of this, so that the values are aligned.
const ALIGNMENT: usize = 64;

/// An array in the making. It appears at [`NpyWriter::finish`]; dropped before, nothing is left.
#[derive(Debug)]
pub struct NpyWriter {
    path: PathBuf,
    file: AtomicFile,
    /// Values that are still to be added.
    left: usize,
}

impl NpyWriter {
    /// Begins an array of `shape`, the slowest axis first. Replaces only a file of this program.
    ///
    /// # Errors
    /// If something else is there, or the file cannot be created.
    pub fn create(path: &Path, shape: &[usize]) -> Result<Self, ReplaceError> {
        let file = AtomicFile::create_named(path)?;
        let mut writer = Self { path: path.to_owned(), file, left: shape.iter().product() };
        writer.put(&header(shape))?;
        Ok(writer)
    }

    /// Adds the next values.
    ///
    /// # Errors
    /// If the file system reports an error.
    pub fn add(&mut self, values: &[f32]) -> Result<(), ReplaceError> {
        self.left = match self.left.checked_sub(values.len()) {
            Some(left) => left,
            None => return Err(self.error(io::Error::other("more values than the shape has"))),
        };
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.put(&bytes)
    }

    /// Gives the complete array its name.
    ///
    /// # Errors
    /// If values are missing, or the file system reports an error.
    pub fn finish(mut self) -> Result<(), ReplaceError> {
        if self.left > 0 {
            return Err(self.error(io::Error::other("fewer values than the shape has")));
        }
        self.put(MARK.as_bytes())?;
        let Self { path, file, .. } = self;
        file.commit().map_err(|source| ReplaceError::Io { path, source })
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), ReplaceError> {
        self.file.write_all(bytes).map_err(|e| self.error(e))
    }

    fn error(&self, source: io::Error) -> ReplaceError {
        ReplaceError::Io { path: self.path.clone(), source }
    }
}

/// Magic, version 1.0, and the dictionary of type and shape.
fn header(shape: &[usize]) -> Vec<u8> {
    let axes: String = shape.iter().map(|n| format!("{n}, ")).collect();
    let mut text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({}), }}", axes.trim_end());
    let start = b"\x93NUMPY\x01\x00";
    let before = start.len() + 2;
    let length = (before + text.len() + 1).next_multiple_of(ALIGNMENT) - before;
    text += &" ".repeat(length - text.len() - 1);
    text.push('\n');
    let mut bytes = start.to_vec();
    // a shape has a few axes
    bytes.extend((length as u16).to_le_bytes());
    bytes.extend(text.bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::check_file;
    use crate::volume::formats;

    #[test]
    fn our_reader_and_numpy_read_it_and_it_may_be_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let values: Vec<f32> = (0..24).map(|i| i as f32 - 0.5).collect();
        for _ in 0..2 {
            let mut array = NpyWriter::create(&path, &[2, 3, 4]).unwrap();
            array.add(&values[..7]).unwrap();
            array.add(&values[7..]).unwrap();
            array.finish().unwrap();
        }
        check_file(&path).unwrap();
        let file = formats::open(&path).unwrap();
        let mut read = Vec::new();
        file.read(0, &mut read).unwrap();
        assert_eq!((file.header().grid.dims, read), ([4, 3, 2], values));
        let script = "import sys, numpy; a = numpy.load(sys.argv[1]); print(a.dtype, a.shape, a[1, 2, 3], a.sum())";
        let Some(python) = volseggs_testing::python_with("vtk, numpy", volseggs_testing::Need::Vtk) else { return };
        let output = std::process::Command::new(python).args(["-c", script]).arg(&path).output().unwrap();
        assert_eq!(String::from_utf8_lossy(&output.stdout).trim(), "float32 (2, 3, 4) 22.5 264.0");
    }

    #[test]
    fn headers_are_aligned_and_incomplete_arrays_leave_nothing() {
        for shape in [&[][..], &[5], &[2, 1000], &[usize::MAX; 3]] {
            assert_eq!(header(shape).len() % ALIGNMENT, 0, "{shape:?}");
        }
        assert!(String::from_utf8_lossy(&header(&[5])).contains("'shape': (5,)"));
        let folder = tempfile::tempdir().unwrap();
        let mut array = NpyWriter::create(&folder.path().join("a.npy"), &[3]).unwrap();
        array.add(&[1.0]).unwrap();
        assert!(array.add(&[0.0; 3]).is_err() && array.finish().is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
