//! Writes the PNG files of a dataset in the making. Plain writes: the folder is published as a whole.

use super::PrepareError;
use crate::volume::raycast::RaycastPicture;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, RgbImage};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

fn encode(path: &Path, [width, height]: [u32; 2], kind: ExtendedColorType, bytes: &[u8]) -> Result<(), PrepareError> {
    let error = |e: &dyn std::fmt::Display| PrepareError::Write { path: path.to_owned(), reason: e.to_string() };
    let mut file = BufWriter::new(File::create(path).map_err(|e| error(&e))?);
    PngEncoder::new_with_quality(&mut file, CompressionType::Default, FilterType::Adaptive)
        .write_image(bytes, width, height, kind)
        .map_err(|e| error(&e))?;
    file.flush().map_err(|e| error(&e))
}

/// Writes an image with straight alpha.
pub(super) fn write_picture(path: &Path, picture: &RaycastPicture) -> Result<(), PrepareError> {
    let image = picture.to_rgba8();
    encode(path, [image.width(), image.height()], ExtendedColorType::Rgba8, image.as_raw())
}

/// Writes segment ids as grey levels, `[H, W]`; ids above 255 need 16 bits.
pub(super) fn write_gray(path: &Path, size: [u32; 2], ids: &[u16]) -> Result<(), PrepareError> {
    if ids.iter().all(|id| *id < 256) {
        let bytes: Vec<u8> = ids.iter().map(|id| *id as u8).collect();
        encode(path, size, ExtendedColorType::L8, &bytes)
    } else {
        // `image` expects 16-bit samples in native byte order
        let bytes: Vec<u8> = ids.iter().flat_map(|id| id.to_ne_bytes()).collect();
        encode(path, size, ExtendedColorType::L16, &bytes)
    }
}

/// Writes a binary mask, `[H, W]`, 0 or 255.
pub(super) fn write_mask(path: &Path, size: [u32; 2], mask: &[u8]) -> Result<(), PrepareError> {
    encode(path, size, ExtendedColorType::L8, mask)
}

/// Writes a sheet of pictures.
pub(super) fn write_sheet(path: &Path, sheet: &RgbImage) -> Result<(), PrepareError> {
    encode(path, [sheet.width(), sheet.height()], ExtendedColorType::Rgb8, sheet.as_raw())
}
