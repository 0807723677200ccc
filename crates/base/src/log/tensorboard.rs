//! Event files for TensorBoard: scalars and images, and the hyperparameters of a run.
//!
//! A file is a sequence of TFRecords, each a length and a payload with masked CRC-32C checksums; a payload is a
//! protobuf `Event`, encoded here by hand as only a few fields are used.

mod hparams;
#[cfg(test)]
mod tests;

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

pub use hparams::{HyperParameter, SessionEnd};
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};

static NUMBER: AtomicU64 = AtomicU64::new(0);

/// Field numbers of `Event`, `Summary.Value`, `Summary.Image` and `SessionLog`.
mod field {
    pub(super) const WALL_TIME: u32 = 1;
    pub(super) const STEP: u32 = 2;
    pub(super) const FILE_VERSION: u32 = 3;
    pub(super) const SUMMARY: u32 = 5;
    pub(super) const SESSION_LOG: u32 = 7;
    pub(super) const VALUE: u32 = 1;
    pub(super) const TAG: u32 = 1;
    pub(super) const SIMPLE_VALUE: u32 = 2;
    pub(super) const IMAGE: u32 = 4;
    pub(super) const HEIGHT: u32 = 1;
    pub(super) const WIDTH: u32 = 2;
    pub(super) const COLORSPACE: u32 = 3;
    pub(super) const ENCODED_IMAGE: u32 = 4;
    pub(super) const STATUS: u32 = 1;
}

const COLORSPACE_RGB: u64 = 3;
const SESSION_START: u64 = 1;

/// Writes one event file. Each process writes a file of its own in the run's folder.
#[derive(Debug)]
pub struct EventWriter {
    out: BufWriter<File>,
}

impl EventWriter {
    /// Creates `dir` if needed and a fresh event file in it.
    ///
    /// # Errors
    /// Any error of the file system.
    pub fn create(dir: &Path) -> io::Result<Self> {
        fs::create_dir_all(dir)?;
        let name = format!(
            "events.out.tfevents.{:010}.volseggs.{}.{}",
            now() as u64,
            std::process::id(),
            NUMBER.fetch_add(1, Ordering::Relaxed)
        );
        let out = BufWriter::new(File::create_new(dir.join(name))?);
        let mut writer = Self { out };
        writer.event(0, &Message::default().bytes(field::FILE_VERSION, b"brain.Event:2"))?;
        writer.flush()?;
        Ok(writer)
    }

    /// Like [`EventWriter::create`], and makes TensorBoard discard what earlier files in the folder say about
    /// `first_step` and later steps.
    ///
    /// # Errors
    /// Any error of the file system.
    pub fn resume(dir: &Path, first_step: u64) -> io::Result<Self> {
        let mut writer = Self::create(dir)?;
        let session = Message::default().varint(field::STATUS, SESSION_START);
        writer.event(first_step, &Message::default().bytes(field::SESSION_LOG, session))?;
        writer.flush()?;
        Ok(writer)
    }

    /// Appends a number.
    ///
    /// # Errors
    /// Any error of the file system.
    pub fn scalar(&mut self, step: u64, tag: &str, value: f32) -> io::Result<()> {
        self.summary(step, Message::default().bytes(field::TAG, tag).float(field::SIMPLE_VALUE, value))
    }

    /// Appends an image `[height, width, 3]` of 8-bit RGB.
    ///
    /// # Errors
    /// `InvalidInput` if `rgb` does not hold `width * height * 3` bytes or is empty; any error of
    /// the file system.
    pub fn image(&mut self, step: u64, tag: &str, width: u32, height: u32, rgb: &[u8]) -> io::Result<()> {
        let expected = u64::from(width) * u64::from(height) * 3;
        if rgb.is_empty() || rgb.len() as u64 != expected {
            return Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                format!("image {tag} of {width}x{height} needs {expected} bytes, got {}", rgb.len()),
            ));
        }
        let mut png = Vec::new();
        PngEncoder::new(&mut png).write_image(rgb, width, height, ExtendedColorType::Rgb8).map_err(io::Error::other)?;
        let size = Message::default().varint(field::HEIGHT, u64::from(height)).varint(field::WIDTH, u64::from(width));
        let picture = size.varint(field::COLORSPACE, COLORSPACE_RGB).bytes(field::ENCODED_IMAGE, png);
        self.summary(step, Message::default().bytes(field::TAG, tag).bytes(field::IMAGE, picture))
    }

    /// Passes everything written to the system, for a TensorBoard that watches the file.
    ///
    /// # Errors
    /// Any error of the file system.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    fn summary(&mut self, step: u64, entry: Message) -> io::Result<()> {
        let summary = Message::default().bytes(field::VALUE, entry);
        self.event(step, &Message::default().bytes(field::SUMMARY, summary))
    }

    fn event(&mut self, step: u64, content: &Message) -> io::Result<()> {
        let mut event = Message::default().double(field::WALL_TIME, now()).varint(field::STEP, step);
        event.0.extend(&content.0);
        let length = (event.0.len() as u64).to_le_bytes();
        self.out.write_all(&length)?;
        self.out.write_all(&masked(&length).to_le_bytes())?;
        self.out.write_all(&event.0)?;
        self.out.write_all(&masked(&event.0).to_le_bytes())
    }
}

/// The CRC-32C of these bytes with the mask that TFRecords put on it.
fn masked(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8)
}

/// Seconds since 1970.
fn now() -> f64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0.0, |since| since.as_secs_f64())
}

/// A protobuf message under construction.
#[derive(Debug, Default)]
struct Message(Vec<u8>);

impl AsRef<[u8]> for Message {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

impl Message {
    fn raw(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    fn key(&mut self, field: u32, wire: u32) {
        self.raw(u64::from(field << 3 | wire));
    }

    fn varint(mut self, field: u32, value: u64) -> Self {
        self.key(field, 0);
        self.raw(value);
        self
    }

    fn double(mut self, field: u32, value: f64) -> Self {
        self.key(field, 1);
        self.0.extend(value.to_le_bytes());
        self
    }

    fn bytes(mut self, field: u32, value: impl AsRef<[u8]>) -> Self {
        self.key(field, 2);
        self.raw(value.as_ref().len() as u64);
        self.0.extend(value.as_ref());
        self
    }

    fn float(mut self, field: u32, value: f32) -> Self {
        self.key(field, 5);
        self.0.extend(value.to_le_bytes());
        self
    }
}
