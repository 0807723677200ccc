//! The numbers of a `.vti` array: ascii, base64 or raw, plain or in compressed blocks. Where the array lies and how
//! many values it must hold is decided by the caller; nothing here is allocated because of a block header alone.

use crate::memory::MemoryBudget;
use crate::volume::formats::decode::{Endian, parse};
use crate::volume::formats::stream::{damaged, read_values, reserve};
use crate::volume::grid::ScalarType;
use flate2::read::ZlibDecoder;
use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read, Seek, SeekFrom};

/// How bytes are encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum VtiEncoding {
    Ascii,
    Base64,
    Raw,
}

/// How bytes are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Packing {
    Plain,
    Zlib,
    Lz4,
}

/// Where the values of one array lie and how to read them.
#[derive(Clone, Debug)]
pub(super) struct ArrayLayout {
    /// First byte of the array in the file.
    pub start: u64,
    /// Bytes that may belong to it, as encoded in the file.
    pub len: u64,
    pub encoding: VtiEncoding,
    pub packing: Packing,
    /// Block headers are 64-bit words, else 32-bit.
    pub wide: bool,
    pub endian: Endian,
    pub kind: ScalarType,
    /// Number of values required by the extent.
    pub count: usize,
}

/// Appends the values to `out`.
pub(super) fn read(file: File, layout: &ArrayLayout, out: &mut Vec<f32>) -> io::Result<()> {
    let mut file = BufReader::with_capacity(64 * 1024, file);
    file.seek(SeekFrom::Start(layout.start))?;
    let src = file.take(layout.len);
    match layout.encoding {
        VtiEncoding::Ascii => ascii(src, layout, out),
        VtiEncoding::Base64 => binary(Base64::new(src), layout, out),
        VtiEncoding::Raw => binary(src, layout, out),
    }
}

fn ascii(mut src: impl BufRead, layout: &ArrayLayout, out: &mut Vec<f32>) -> io::Result<()> {
    reserve(out, layout.count)?;
    let mut token = Vec::new();
    loop {
        let bytes = src.fill_buf()?;
        let end = bytes.is_empty();
        for b in bytes {
            if b.is_ascii_whitespace() {
                number(&mut token, layout, out)?;
            } else if token.len() < 64 {
                token.push(*b);
            } else {
                return Err(damaged(format!("value {}: longer than any number", out.len())));
            }
        }
        let n = bytes.len();
        src.consume(n);
        if end {
            number(&mut token, layout, out)?;
            break;
        }
    }
    if out.len() < layout.count {
        return Err(ErrorKind::UnexpectedEof.into());
    }
    Ok(())
}

/// Ends a token: nothing, or one value of the array's type.
fn number(token: &mut Vec<u8>, layout: &ArrayLayout, out: &mut Vec<f32>) -> io::Result<()> {
    if token.is_empty() {
        return Ok(());
    }
    if out.len() == layout.count {
        return Err(damaged(format!("more values than the {} of the extent", layout.count)));
    }
    let text = String::from_utf8_lossy(token);
    let value = parse(&text, layout.kind);
    out.push(
        value.ok_or_else(|| damaged(format!("value {}: \"{text}\" is not a valid {:?}", out.len(), layout.kind)))?,
    );
    token.clear();
    Ok(())
}

fn binary(mut src: impl Read, layout: &ArrayLayout, out: &mut Vec<f32>) -> io::Result<()> {
    let ArrayLayout { kind, endian, count, .. } = *layout;
    let needed = (count * kind.bytes()) as u64;
    if layout.packing == Packing::Plain {
        let size = word(&mut src, layout)?;
        if size != needed {
            return Err(damaged(format!("the array holds {size} bytes, its extent needs {needed}")));
        }
        return read_values(&mut src, kind, endian, count, None, out);
    }
    read_values(&mut Blocks::new(src, layout, needed)?, kind, endian, count, None, out)
}

/// One word of a block header.
fn word(src: &mut impl Read, layout: &ArrayLayout) -> io::Result<u64> {
    let mut bytes = [0u8; 8];
    let n = if layout.wide { 8 } else { 4 };
    src.read_exact(&mut bytes[..n])?;
    Ok(match (layout.wide, layout.endian) {
        (_, Endian::Little) => u64::from_le_bytes(bytes),
        (true, Endian::Big) => u64::from_be_bytes(bytes),
        (false, Endian::Big) => u64::from_be_bytes(bytes) >> 32,
    })
}

/// Decompresses blocks one after the other.
struct Blocks<R> {
    src: R,
    packing: Packing,
    /// Compressed bytes of each block.
    packed: Vec<u64>,
    next: usize,
    /// Decompressed bytes of a block, and of the last.
    full: usize,
    last: usize,
    /// The current block and how much of it has been read.
    block: Vec<u8>,
    pos: usize,
}

impl<R: Read> Blocks<R> {
    /// Reads the header: number of blocks, decompressed size of each, of the last if shorter (else 0), compressed
    /// sizes.
    fn new(mut src: R, layout: &ArrayLayout, needed: u64) -> io::Result<Self> {
        let [blocks, full, partial] = [word(&mut src, layout)?, word(&mut src, layout)?, word(&mut src, layout)?];
        let last = if partial == 0 { full } else { partial };
        let total = blocks.checked_sub(1).and_then(|n| n.checked_mul(full)).and_then(|n| n.checked_add(last));
        if total != Some(needed) || last > full || blocks > layout.len / 4 {
            return Err(damaged(format!(
                "{blocks} blocks of {full} bytes, the last of {last}, do not make the {needed} bytes of the extent"
            )));
        }
        // both sizes are at most `needed`, which the caller checked against the file; compressed, at most the rest of
        // the file
        let at_once = u128::from(full).saturating_add(u128::from(full.min(layout.len)));
        let free = MemoryBudget::now().check(format!("blocks of {full} bytes"), at_once);
        free.map_err(|e| io::Error::new(ErrorKind::OutOfMemory, e))?;
        let mut packed = Vec::new();
        for _ in 0..blocks {
            packed.push(word(&mut src, layout)?);
        }
        let (full, last) = (full as usize, last as usize);
        Ok(Self { src, packing: layout.packing, packed, next: 0, full, last, block: Vec::new(), pos: 0 })
    }

    /// Decompresses the next block; false after the last.
    fn refill(&mut self) -> io::Result<bool> {
        let Some(&size) = self.packed.get(self.next) else { return Ok(false) };
        self.next += 1;
        let want = if self.next == self.packed.len() { self.last } else { self.full };
        let mut packed = Vec::new();
        self.src.by_ref().take(size).read_to_end(&mut packed)?;
        if (packed.len() as u64) < size {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        self.block.clear();
        self.pos = 0;
        let got = if self.packing == Packing::Zlib {
            ZlibDecoder::new(&packed[..])
                .take(want as u64 + 1)
                .read_to_end(&mut self.block)
                .map_err(|e| damaged(format!("block {}: zlib: {e}", self.next - 1)))?
        } else {
            self.block.resize(want, 0);
            lz4_flex::block::decompress_into(&packed, &mut self.block)
                .map_err(|e| damaged(format!("block {}: lz4: {e}", self.next - 1)))?
        };
        if got != want {
            return Err(damaged(format!("block {} does not unpack to {want} bytes", self.next - 1)));
        }
        Ok(true)
    }
}

impl<R: Read> Read for Blocks<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        while self.pos == self.block.len() {
            if !self.refill()? {
                return Ok(0);
            }
        }
        let n = (&self.block[self.pos..]).read(out)?;
        self.pos += n;
        Ok(n)
    }
}

/// Decodes base64 four characters at a time. VTK pads after a block header and continues with the data, so padding ends
/// a group of four, not the stream.
struct Base64<R> {
    src: R,
    group: [u8; 4],
    letters: usize,
    bytes: Vec<u8>,
    pos: usize,
    /// A byte that is not a base64 character: an error only if more bytes are requested.
    stop: Option<u8>,
}

impl<R: BufRead> Base64<R> {
    fn new(src: R) -> Self {
        Self { src, group: [0; 4], letters: 0, bytes: Vec::new(), pos: 0, stop: None }
    }

    fn refill(&mut self) -> io::Result<()> {
        self.bytes.clear();
        self.pos = 0;
        let input = self.src.fill_buf()?;
        let n = input.len();
        for &b in input {
            if b.is_ascii_whitespace() {
                continue;
            }
            let pad = b == b'=' && self.letters >= 2;
            let after_pad = self.letters == 3 && self.group[2] == b'=';
            if !pad && (letter(b).is_none() || after_pad) {
                self.stop = Some(b);
                break;
            }
            self.group[self.letters] = b;
            self.letters += 1;
            if self.letters == 4 {
                self.letters = 0;
                let word = self.group.iter().fold(0u32, |w, &b| w << 6 | letter(b).unwrap_or(0));
                let pads = self.group.iter().filter(|&&b| b == b'=').count();
                self.bytes.extend_from_slice(&word.to_be_bytes()[1..4 - pads]);
            }
        }
        self.src.consume(n);
        if n == 0 && self.letters > 0 {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        if n == 0 {
            self.stop = Some(b'<');
        }
        Ok(())
    }
}

impl<R: BufRead> Read for Base64<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        while self.pos == self.bytes.len() {
            match self.stop {
                // a tag after the characters: the data ends here
                Some(b'<') => return Ok(0),
                Some(b) => return Err(damaged(format!("byte {b:#04x} is not base64"))),
                None => self.refill()?,
            }
        }
        let n = (&self.bytes[self.pos..]).read(out)?;
        self.pos += n;
        Ok(n)
    }
}

fn letter(b: u8) -> Option<u32> {
    Some(match b {
        b'A'..=b'Z' => u32::from(b - b'A'),
        b'a'..=b'z' => u32::from(b - b'a') + 26,
        b'0'..=b'9' => u32::from(b - b'0') + 52,
        b'+' => 62,
        b'/' => 63,
        _ => return None,
    })
}
