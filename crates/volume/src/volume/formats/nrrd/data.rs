//! The values of an NRRD file: one or many data files, raw, gzip or ASCII. Nothing is held open or in memory between
//! reads, and no header can claim more than its data files can hold.

use super::super::common;
use super::super::decode::{Endian, decode_into, parse};
use crate::volume::error::VolumeError;
use crate::volume::grid::ScalarType;
use flate2::read::MultiGzDecoder;
use std::io::{BufRead, BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Maximum expansion of deflate: 258 bytes from 2 bits.
const MAX_EXPANSION: u64 = 1032;

/// Decompressed bytes held at once; a multiple of every scalar's size.
const BLOCK: u64 = 1 << 20;

/// How values are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NrrdEncoding {
    /// Uncompressed.
    Raw,
    /// Compressed.
    Gzip,
    /// Numbers as text.
    Ascii,
}

/// Where the values are and how they are stored.
#[derive(Debug)]
pub struct NrrdData {
    /// The data files, or the one file itself.
    pub files: Vec<PathBuf>,
    /// Bytes of header before the data, in each file.
    pub base: u64,
    /// How values are stored.
    pub encoding: NrrdEncoding,
    /// Scalar type.
    pub scalar: ScalarType,
    /// Byte order.
    pub endian: Endian,
    /// Lines to skip, before decompression.
    pub line_skip: u64,
    /// Bytes to skip, after decompression; `None` counts from the end.
    pub byte_skip: Option<u64>,
    /// Values in each file.
    pub per_file: u64,
}

/// The values numbered `first + i * stride`, `i` below `count`, counted over all files.
#[derive(Clone, Copy, Debug)]
pub struct ValueSelection {
    /// Number of the first value.
    pub first: u64,
    /// Distance between the values, at least 1.
    pub stride: u64,
    /// Number of values, at least 1.
    pub count: usize,
}

impl ValueSelection {
    /// The `i` of those among the `n` values from number `from` on, and the position of the first of them there.
    fn part(&self, from: u64, n: u64) -> Option<(Range<usize>, usize)> {
        let until = |end: u64| end.saturating_sub(self.first).div_ceil(self.stride).min(self.count as u64);
        let (lo, hi) = (until(from), until(from + n));
        (lo < hi).then(|| (lo as usize..hi as usize, (self.first + lo * self.stride - from) as usize))
    }

    fn end(&self) -> u64 {
        self.first + (self.count as u64 - 1) * self.stride + 1
    }
}

impl NrrdData {
    /// Checks that each data file exists and can hold what the header claims, before anything is allocated.
    ///
    /// # Errors
    /// A data file is missing, cannot be opened or is too small.
    pub fn check(&self, header: &Path) -> Result<(), VolumeError> {
        for file in &self.files {
            if !file.is_file() {
                let problem = format!("{} does not exist", file.display());
                let hint = "names are relative to the header's folder";
                return Err(VolumeError::invalid(header, "data file", problem, hint));
            }
            let len = common::open_file(file)?.1.saturating_sub(self.base);
            let needed = self.bytes().saturating_add(self.byte_skip.unwrap_or(0));
            match self.encoding {
                NrrdEncoding::Raw if self.line_skip == 0 => self.check_raw(file, len)?,
                NrrdEncoding::Raw => self.at_most(file, needed, len, "raw")?,
                NrrdEncoding::Gzip => self.at_most(file, needed, len.saturating_mul(MAX_EXPANSION), "gzip")?,
                NrrdEncoding::Ascii => self.at_most(file, self.per_file, len / 2 + 1, "ASCII")?,
            }
        }
        Ok(())
    }

    fn bytes(&self) -> u64 {
        self.per_file * self.scalar.bytes() as u64
    }

    fn at_most(&self, file: &Path, needed: u64, limit: u64, what: &str) -> Result<(), VolumeError> {
        if needed <= limit {
            return Ok(());
        }
        let problem = format!("{} values of {} cannot fit in the {what} data", self.per_file, self.scalar.name());
        Err(VolumeError::invalid(file, "sizes", problem, "correct the header, or write the truncated file again"))
    }

    fn check_raw(&self, file: &Path, len: u64) -> Result<(), VolumeError> {
        let fits = match self.byte_skip {
            Some(skip) => self.bytes().checked_add(skip) == Some(len),
            None => self.bytes() <= len,
        };
        if fits { Ok(()) } else { Err(self.wrong(file, "data", &format!("found {len}"))) }
    }

    fn wrong(&self, file: &Path, field: &str, found: &str) -> VolumeError {
        let skip = self.byte_skip.map_or_else(String::new, |s| format!(" after {s} skipped"));
        let problem = format!(
            "expected {} bytes ({} values of {}){skip}, {found}",
            self.bytes(),
            self.per_file,
            self.scalar.name()
        );
        VolumeError::invalid(file, field, problem, "correct sizes, type or byte skip in the header, or write it again")
    }

    /// Reads the selected values into `out`, which holds `chosen.count` values.
    ///
    /// # Errors
    /// Truncated or damaged data, or more of it than the header says (detected when the last values are read).
    pub fn read(&self, chosen: ValueSelection, out: &mut [f32]) -> Result<(), VolumeError> {
        for (file, i) in self.files.iter().zip(0u64..) {
            let from = i * self.per_file;
            if from + self.per_file <= chosen.first || from >= chosen.end() {
                continue;
            }
            match self.encoding {
                NrrdEncoding::Raw => self.read_raw(file, from, chosen, out)?,
                NrrdEncoding::Gzip => self.read_gzip(file, from, chosen, out)?,
                NrrdEncoding::Ascii => self.read_ascii(file, from, chosen, out)?,
            }
        }
        Ok(())
    }

    fn rest<'a>(&self, file: &Path, mut bytes: &'a [u8]) -> Result<&'a [u8], VolumeError> {
        for _ in 0..self.line_skip {
            let line = bytes.iter().position(|&b| b == b'\n').ok_or_else(|| self.few_lines(file))?;
            bytes = &bytes[line + 1..];
        }
        Ok(bytes)
    }

    fn few_lines(&self, file: &Path) -> VolumeError {
        let problem = format!("the file ends within the {} lines to skip", self.line_skip);
        VolumeError::invalid(file, "line skip", problem, "correct the header")
    }

    fn read_raw(&self, file: &Path, from: u64, chosen: ValueSelection, out: &mut [f32]) -> Result<(), VolumeError> {
        let len = common::open_file(file)?.1.saturating_sub(self.base);
        let map = common::map(file, self.base, len)?;
        let bytes = self.rest(file, &map)?;
        self.check_raw(file, bytes.len() as u64)?;
        let bytes = &bytes[bytes.len() - self.bytes() as usize..];
        if let Some((range, first)) = chosen.part(from, self.per_file) {
            decode_into(bytes, self.scalar, self.endian, first, chosen.stride as usize, &mut out[range]);
        }
        Ok(())
    }

    fn read_gzip(&self, file: &Path, from: u64, chosen: ValueSelection, out: &mut [f32]) -> Result<(), VolumeError> {
        let io = |e| VolumeError::io(file, "read the file", e, "check the disk");
        let damaged = |e: std::io::Error| {
            if e.kind() == ErrorKind::UnexpectedEof {
                self.wrong(file, "gzip", "the compressed data end early")
            } else {
                VolumeError::invalid(file, "gzip", format!("the data are damaged ({e})"), "write the file again")
            }
        };
        let (mut handle, _) = common::open_file(file)?;
        handle.seek(SeekFrom::Start(self.base)).map_err(io)?;
        let mut plain = BufReader::with_capacity(1 << 16, handle);
        for _ in 0..self.line_skip {
            if plain.skip_until(b'\n').map_err(io)? == 0 {
                return Err(self.few_lines(file));
            }
        }
        let mut stream = MultiGzDecoder::new(plain);
        let skip = self.byte_skip.unwrap_or(0);
        if std::io::copy(&mut stream.by_ref().take(skip), &mut std::io::sink()).map_err(damaged)? < skip {
            return Err(self.wrong(file, "gzip", "the data end within the bytes to skip"));
        }
        let size = self.scalar.bytes() as u64;
        let mut block = Vec::new();
        let mut at = 0;
        while at < self.per_file && from + at < chosen.end() {
            let n = (self.per_file - at).min(BLOCK / size);
            block.clear();
            stream.by_ref().take(n * size).read_to_end(&mut block).map_err(damaged)?;
            if (block.len() as u64) < n * size {
                let found = skip + at * size + block.len() as u64;
                return Err(self.wrong(file, "gzip", &format!("found {found} when decompressed")));
            }
            if let Some((range, first)) = chosen.part(from + at, n) {
                decode_into(&block, self.scalar, self.endian, first, chosen.stride as usize, &mut out[range]);
            }
            at += n;
        }
        // only the end of the stream shows that there is no more, and verifies the checksum
        if at == self.per_file && stream.read(&mut [0]).map_err(damaged)? > 0 {
            return Err(self.wrong(file, "gzip", "found more when decompressed"));
        }
        Ok(())
    }

    fn read_ascii(&self, file: &Path, from: u64, chosen: ValueSelection, out: &mut [f32]) -> Result<(), VolumeError> {
        let len = common::open_file(file)?.1.saturating_sub(self.base);
        let map = common::map(file, self.base, len)?;
        let bytes = self.rest(file, &map)?;
        let skip = usize::try_from(self.byte_skip.unwrap_or(0)).unwrap_or(usize::MAX);
        let bytes = bytes.get(skip..).unwrap_or_default();
        let mut seen = 0u64;
        let words = bytes.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty());
        for word in words {
            if seen < self.per_file
                && let Some((range, 0)) = chosen.part(from + seen, 1)
            {
                let value = std::str::from_utf8(word).ok().and_then(|word| parse(word, self.scalar));
                out[range.start] = value.ok_or_else(|| {
                    let shown = String::from_utf8_lossy(&word[..word.len().min(40)]);
                    let problem = format!("\"{shown}\" is not a valid {}", self.scalar.name());
                    VolumeError::invalid(file, format!("value {seen}"), problem, "write the file again")
                })?;
            }
            seen += 1;
        }
        if seen != self.per_file {
            let problem = format!("expected {} values, found {seen}", self.per_file);
            return Err(VolumeError::invalid(file, "data", problem, "correct sizes in the header, or write it again"));
        }
        Ok(())
    }
}
