//! Files for the tests of all crates: a small dataset, views of a sphere, and a PNG with a false header.

use super::paths::{Lens, training_cameras};
use super::transforms::{FrameRecord, Intrinsics};
use super::{DataError, SplitName, Transforms};
use crate::files::write_atomic;
use image::{GrayImage, ImageFormat, Rgba, RgbaImage};
use std::io::{self, Cursor};
use std::path::Path;

/// Writes a split of `n` views, `size` pixels square, of a sphere of radius 0.5 at the origin that is at rest, at two times.
///
/// # Errors
/// If a file cannot be written.
pub fn write_sphere_split(root: &Path, name: SplitName, n: usize, size: u32) -> io::Result<()> {
    std::fs::create_dir_all(root.join(name.as_str()))?;
    let lens = Lens { fov_x: 0.5, width: size, height: size };
    let mut frames = Vec::new();
    for (i, camera) in training_cameras(n, 4.0, lens).into_iter().enumerate() {
        let file_path = format!("./{name}/r_{i}");
        let tan = 0.5 / (16.0f64 - 0.25).sqrt();
        let inside = |x: u32, y: u32| {
            let d = |p: u32, c: f64| (f64::from(p) + 0.5 - c) / camera.fx;
            d(x, camera.cx).hypot(d(y, camera.cy)) < tan
        };
        let image =
            RgbaImage::from_fn(size, size, |x, y| Rgba(if inside(x, y) { [200, 100, 50, 255] } else { [0; 4] }));
        let mut png = Cursor::new(Vec::new());
        image.write_to(&mut png, ImageFormat::Png).map_err(io::Error::other)?;
        write_atomic(&root.join(format!("{name}/r_{i}.png")), png.get_ref())?;
        frames.push(FrameRecord { file_path, camera_to_world: camera.camera_to_world, time: (i % 2) as f64 });
    }
    let intrinsics = Intrinsics { camera_angle_x: Some(0.5), ..Intrinsics::default() };
    let json = Transforms { path: name.json_path(root), intrinsics, frames };
    json.write(&json.path).map_err(|e: DataError| io::Error::other(e.to_string()))
}

/// Writes such a split for training and one for testing.
///
/// # Errors
/// If a file cannot be written.
pub fn write_sphere_dataset(root: &Path, n: usize, size: u32) -> io::Result<()> {
    write_sphere_split(root, SplitName::Train, n, size)?;
    write_sphere_split(root, SplitName::Test, n, size)
}

/// A grey 8-bit PNG whose header claims `width` by `height` pixels; it holds one.
///
/// # Errors
/// None in practice: the encoder writes to memory.
pub fn claims_to_be(width: u32, height: u32) -> io::Result<Vec<u8>> {
    let mut png = Cursor::new(Vec::new());
    let one = GrayImage::new(1, 1);
    one.write_to(&mut png, ImageFormat::Png).map_err(io::Error::other)?;
    let mut bytes = png.into_inner();
    bytes[16..20].copy_from_slice(&width.to_be_bytes());
    bytes[20..24].copy_from_slice(&height.to_be_bytes());
    // the checksum of type and content of the first chunk
    let mut crc = u32::MAX;
    for byte in &bytes[12..29] {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg());
        }
    }
    bytes[29..33].copy_from_slice(&(!crc).to_be_bytes());
    Ok(bytes)
}
