//! Sets of equally large RGBA images in one block of bytes: decoding PNGs and JPEGs, area downscaling, compositing. Knows
//! nothing of cameras.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use image::{ImageError, ImageFormat, ImageReader, RgbaImage};
use rayon::prelude::*;

use super::error::DataError;
use super::png::{START, check_claim};
use crate::files::open_regular;
use crate::memory::{MemoryBudget, product};

/// All images of a split, `[frames, height, width, 4]` bytes, rows from the top, straight (not premultiplied)
/// alpha.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ImageSet {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// RGBA bytes, all frames contiguous.
    pub pixels: Vec<u8>,
}

impl ImageSet {
    /// Channels of a pixel: red, green, blue, alpha.
    pub const CHANNELS: usize = 4;

    /// Decodes `paths` in parallel, each reduced by the integer `downscale`. `json` is the file that lists them, in
    /// this order; it is used in messages only.
    ///
    /// PNGs of 8 or 16 bits, in colour or grey, with or without alpha, and JPEGs are accepted; without alpha they are
    /// opaque.
    ///
    /// # Errors
    /// The first image that is missing, broken or differs in size, or in whether it has an alpha channel; a `downscale`
    /// that does not divide the size; too little memory.
    pub fn load(json: &Path, paths: &[PathBuf], downscale: u32) -> Result<Self, DataError> {
        let (full_width, full_height) = common_size(json, paths)?;
        let (width, height) = downscaled_size(json, (full_width, full_height), downscale)?;
        check_memory(json, paths.len(), (full_width, full_height), downscale, MemoryBudget::now())?;
        let frame = width as usize * height as usize * Self::CHANNELS;
        let mut pixels = vec![0; frame * paths.len()];
        let results: Vec<Result<bool, DataError>> = pixels
            .par_chunks_mut(frame.max(1))
            .zip(paths)
            .enumerate()
            .map(|(i, (out, path))| {
                let (image, alpha) = decode(path).map_err(|problem| image_error(json, path, i, problem))?;
                if image.dimensions() != (full_width, full_height) {
                    return Err(image_error(json, path, i, "its header and its content differ in size".to_owned()));
                }
                shrink(image.as_raw(), full_width as usize, downscale as usize, out, width as usize);
                Ok(alpha)
            })
            .collect();
        let alpha = results.into_iter().collect::<Result<Vec<bool>, _>>()?;
        refuse_mixed_alpha(json, paths, &alpha)?;
        Ok(Self { width, height, pixels })
    }

    /// Number of images.
    pub fn len(&self) -> usize {
        self.pixels.len() / self.frame_len().max(1)
    }

    /// Whether there are no images.
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }

    fn frame_len(&self) -> usize {
        self.width as usize * self.height as usize * Self::CHANNELS
    }

    /// The bytes of image `frame`, `[height, width, 4]`.
    ///
    /// # Panics
    /// If `frame` is not below `len()`.
    pub fn frame(&self, frame: usize) -> &[u8] {
        let n = self.frame_len();
        &self.pixels[frame * n..(frame + 1) * n]
    }

    /// A copy reduced by the integer `factor`: each pixel is the mean of `factor` x `factor` pixels, colours weighted
    /// by alpha, rounded to nearest.
    ///
    /// # Errors
    /// If `factor` is 0 or does not divide width and height.
    pub fn downscale(&self, factor: u32) -> Result<Self, DataError> {
        let (width, height) = downscaled_size(Path::new("image set"), (self.width, self.height), factor)?;
        let bytes = product(&[self.len(), width as usize, height as usize, Self::CHANNELS]);
        MemoryBudget::now()
            .check(format!("images reduced by {factor}"), bytes)
            .map_err(|e| DataError::option(Path::new("image set"), "downscale", e, FEWER))?;
        let mut out = vec![0; width as usize * height as usize * Self::CHANNELS * self.len()];
        out.par_chunks_mut((width as usize * height as usize * Self::CHANNELS).max(1))
            .zip(self.pixels.par_chunks(self.frame_len().max(1)))
            .for_each(|(out, image)| shrink(image, self.width as usize, factor as usize, out, width as usize));
        Ok(Self { width, height, pixels: out })
    }

    /// Composites image `frame` over `background` into `out` `[height * width * 3]`: `rgb * a + background * (1 - a)`,
    /// all in [0, 1].
    ///
    /// # Panics
    /// If `frame` is not below `len()` or `out` has another length.
    pub fn composite(&self, frame: usize, background: [f32; 3], out: &mut [f32]) {
        let image = self.frame(frame);
        assert_eq!(out.len() * 4, image.len() * 3, "composite: `out` must hold height * width * 3 values");
        for (pixel, out) in image.chunks_exact(4).zip(out.chunks_exact_mut(3)) {
            let [r, g, b, _] = over(pixel, background);
            out.copy_from_slice(&[r, g, b]);
        }
    }

    /// Image `frame` over `background` with its alpha, `[height, width, 4]`, all in [0, 1].
    ///
    /// # Panics
    /// If `frame` is not below `len()`.
    pub fn composite_with_alpha(&self, frame: usize, background: [f32; 3]) -> Vec<f32> {
        const PIECE: usize = 4 * 16_384;
        let image = self.frame(frame);
        let mut out = vec![0.0; image.len()];
        out.par_chunks_mut(PIECE).zip(image.par_chunks(PIECE)).for_each(|(out, image)| {
            for (out, pixel) in out.chunks_exact_mut(4).zip(image.chunks_exact(4)) {
                out.copy_from_slice(&over(pixel, background));
            }
        });
        out
    }

    /// Pixel `at` (row-major) of image `frame` over `background`, as [`ImageSet::composite`] gives it.
    ///
    /// # Panics
    /// If there is no such image or pixel.
    pub fn pixel(&self, frame: usize, at: usize, background: [f32; 3]) -> [f32; 3] {
        let [r, g, b, _] = over(&self.frame(frame)[4 * at..4 * at + 4], background);
        [r, g, b]
    }

    /// Writes the alpha of image `frame` to `out` `[height * width]`, in [0, 1].
    ///
    /// # Panics
    /// If `frame` is not below `len()` or `out` has another length.
    pub fn alpha(&self, frame: usize, out: &mut [f32]) {
        let image = self.frame(frame);
        assert_eq!(out.len() * 4, image.len(), "alpha: `out` must hold height * width values");
        for (pixel, out) in image.chunks_exact(4).zip(out) {
            *out = f32::from(pixel[3]) / 255.0;
        }
    }
}

/// A straight-alpha pixel over a background, and its alpha.
fn over(pixel: &[u8], background: [f32; 3]) -> [f32; 4] {
    let a = f32::from(pixel[3]) / 255.0;
    let channel = |c: usize| f32::from(pixel[c]) / 255.0 * a + background[c] * (1.0 - a);
    [channel(0), channel(1), channel(2), a]
}

/// Refuses images of which some have an alpha channel (`alpha`) and others do not: the background is part of the data in
/// one kind and not in the other.
fn refuse_mixed_alpha(json: &Path, paths: &[PathBuf], alpha: &[bool]) -> Result<(), DataError> {
    let Some(frame) = alpha.iter().position(|a| *a != alpha[0]) else { return Ok(()) };
    let (with, without) = if alpha[0] { (0, frame) } else { (frame, 0) };
    Err(DataError::Image {
        path: paths[without].clone(),
        json: json.to_owned(),
        frame,
        problem: format!("has no alpha channel, but {} has one", paths[with].display()),
        hint: "render all images with a transparent background, or all over the same opaque one".to_owned(),
    })
}

/// Decodes one PNG or JPEG to 8-bit RGBA, and returns whether it has an alpha channel; the error says what is wrong with
/// it.
pub(crate) fn decode(path: &Path) -> Result<(RgbaImage, bool), String> {
    let (width, height) = size(path)?;
    if u64::from(width) * u64::from(height) > LARGE {
        // as many images may be decoded at a time as there are threads
        let bytes = product(&[width as usize, height as usize, DECODING, rayon::current_num_threads()]);
        MemoryBudget::now().check(format!("decoding {width}x{height} pixels"), bytes).map_err(|e| e.to_string())?;
    }
    let (mut reader, kind) = open(path)?;
    if kind == ImageFormat::Jpeg {
        check_end(path)?;
    }
    // memory was checked above; the crate's own limit is below the largest image that `prepare` writes
    reader.no_limits();
    let image = reader.decode().map_err(|e| unreadable(kind, &e))?;
    Ok((image.to_rgba8(), image.color().has_alpha()))
}

/// Width and height from the header alone.
pub(crate) fn size(path: &Path) -> Result<(u32, u32), String> {
    let (reader, kind) = open(path)?;
    reader.into_dimensions().map_err(|e| unreadable(kind, &e))
}

fn unreadable(kind: ImageFormat, error: &ImageError) -> String {
    format!("not a readable {}: {error}", if kind == ImageFormat::Jpeg { "JPEG" } else { "PNG" })
}

/// Refuses a JPEG that was cut off, of which the decoder would return a part: its end marker occurs nowhere else after
/// the beginning.
fn check_end(path: &Path) -> Result<(), String> {
    const LAST: u64 = 4096;
    let read = || -> std::io::Result<Vec<u8>> {
        let mut file = open_regular(path)?;
        let len = file.metadata()?.len();
        let mut end = Vec::new();
        file.seek(SeekFrom::Start(len.saturating_sub(LAST)))?;
        file.take(LAST).read_to_end(&mut end)?;
        Ok(end)
    };
    let end = read().map_err(|e| format!("cannot read the image: {e}"))?;
    match end.windows(2).any(|w| w == b"\xff\xd9") {
        true => Ok(()),
        false => Err("not a readable JPEG: it ends too early".to_owned()),
    }
}

/// Opens an image, whose first bytes tell whether it is a JPEG; anything else is read as a PNG.
fn open(path: &Path) -> Result<(ImageReader<BufReader<File>>, ImageFormat), String> {
    let unreadable = |e: std::io::Error| format!("cannot read the image: {e}");
    let file = open_regular(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => "the image is missing".to_owned(),
        _ => unreadable(e),
    })?;
    let len = file.metadata().map_err(unreadable)?.len();
    let (mut file, mut start) = (BufReader::new(file), Vec::new());
    file.by_ref().take(START as u64).read_to_end(&mut start).map_err(unreadable)?;
    check_claim(&start, len)?;
    file.rewind().map_err(unreadable)?;
    let kind = if start.starts_with(b"\xff\xd8\xff") { ImageFormat::Jpeg } else { ImageFormat::Png };
    Ok((ImageReader::with_format(file, kind), kind))
}

/// What to do about images that do not fit into memory.
const FEWER: &str = "use a larger factor or fewer views";
/// Number of pixels above which memory is checked before an image is decoded.
const LARGE: u64 = 1 << 24;
/// Bytes per pixel while an image is decoded: 16-bit RGBA as stored, and 8-bit RGBA.
const DECODING: usize = 12;

/// Rejects images that do not fit into memory, by their number and size: all of them as kept, plus those decoded at a
/// time in full size.
fn check_memory(
    json: &Path,
    count: usize,
    full: (u32, u32),
    downscale: u32,
    budget: MemoryBudget,
) -> Result<(), DataError> {
    let (width, height) = downscaled_size(json, full, downscale)?;
    let kept = product(&[count, width as usize, height as usize, ImageSet::CHANNELS]);
    let at_a_time = rayon::current_num_threads().min(count);
    let decoding = product(&[at_a_time, full.0 as usize, full.1 as usize, DECODING]);
    let what = format!("{downscale} keeps {count} images of {width}x{height}");
    let checked = budget.check(what, kept.saturating_add(decoding));
    checked.map_err(|e| DataError::option(json, "data.downscale", e, FEWER))
}

pub(crate) fn image_error(json: &Path, path: &Path, frame: usize, problem: String) -> DataError {
    let hint = if problem.contains("missing") {
        "check `file_path` (relative to the dataset folder; `.png`, `.jpg` or `.jpeg` may be omitted) and that all images \
         were copied"
    } else {
        "render or copy the image again; PNG and JPEG are read"
    };
    DataError::Image { path: path.to_owned(), json: json.to_owned(), frame, problem, hint: hint.to_owned() }
}

/// The size shared by all images, from their headers.
pub(crate) fn common_size(json: &Path, paths: &[PathBuf]) -> Result<(u32, u32), DataError> {
    let sizes: Vec<Result<(u32, u32), String>> = paths.par_iter().map(|p| size(p)).collect();
    let mut first = None;
    for (i, size) in sizes.into_iter().enumerate() {
        let size = size.map_err(|problem| image_error(json, &paths[i], i, problem))?;
        let expected = *first.get_or_insert(size);
        if size != expected {
            return Err(DataError::MixedResolution {
                json: json.to_owned(),
                first: paths[0].clone(),
                first_size: expected,
                second: paths[i].clone(),
                second_size: size,
                frame: i,
            });
        }
    }
    Ok(first.unwrap_or((0, 0)))
}

pub(crate) fn downscaled_size(path: &Path, (w, h): (u32, u32), factor: u32) -> Result<(u32, u32), DataError> {
    if factor == 0 || w % factor != 0 || h % factor != 0 {
        let dividing = (1..=16).filter(|k| w % k == 0 && h % k == 0).map(|k| k.to_string()).collect::<Vec<_>>();
        let problem = format!("{factor} does not divide the image size {w}x{h}");
        let hint = format!("use one of {}", dividing.join(", "));
        return Err(DataError::option(path, "downscale", problem, hint));
    }
    Ok((w / factor, h / factor))
}

/// Area filter in premultiplied alpha, one frame; `out` is `out_width` wide.
fn shrink(image: &[u8], width: usize, factor: usize, out: &mut [u8], out_width: usize) {
    if factor == 1 {
        out.copy_from_slice(image);
        return;
    }
    let area = (factor * factor) as u64;
    for (i, out) in out.chunks_exact_mut(4).enumerate() {
        let (x, y) = (i % out_width * factor, i / out_width * factor);
        let (mut colour, mut alpha) = ([0u64; 3], 0u64);
        for row in y..y + factor {
            let start = (row * width + x) * 4;
            for pixel in image[start..start + factor * 4].chunks_exact(4) {
                let a = u64::from(pixel[3]);
                alpha += a;
                for c in 0..3 {
                    colour[c] += a * u64::from(pixel[c]);
                }
            }
        }
        for c in 0..3 {
            // where alpha is 0, the colour does not matter; 0 compresses best
            out[c] = (colour[c] + alpha / 2).checked_div(alpha).unwrap_or(0) as u8;
        }
        out[3] = ((alpha + area / 2) / area) as u8;
    }
}

#[cfg(test)]
#[path = "images_tests.rs"]
mod tests;
