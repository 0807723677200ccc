//! Images of renders: from floats to 8 bits, and to PNG. Each file carries [`MARK`], which identifies it as this
//! program's own when a user has it replaced.

use crate::files::MARK;
use image::error::{EncodingError, ImageFormatHint};
use image::{GrayImage, ImageError, ImageFormat, ImageResult, RgbImage};
use png::{BitDepth, ColorType, Encoder};
use std::io::Write;

/// Converts the colours of a render `[H, W, 4]` (already over its background) to 8-bit RGB, rounded and clamped.
pub fn to_rgb8(image: &[f32], width: usize, height: usize) -> RgbImage {
    let mut out = RgbImage::new(width as u32, height as u32);
    for (rgb, p) in out.chunks_exact_mut(3).zip(image[..4 * width * height].chunks_exact(4)) {
        for (out, p) in rgb.iter_mut().zip(p) {
            *out = to_8_bits(*p);
        }
    }
    out
}

/// Converts a render `[H, W, 4]` over the colour `background` to 8-bit RGBA with straight alpha, `[H, W, 4]`: its colours
/// as they were before they were laid over the background; black where nothing is.
pub fn to_rgba8(image: &[f32], background: [f32; 3]) -> Vec<u8> {
    let pixel = |p: &[f32]| {
        let alpha = to_8_bits(p[3]);
        let straight = |c: usize| if alpha == 0 { 0.0 } else { background[c] + (p[c] - background[c]) / p[3] };
        [to_8_bits(straight(0)), to_8_bits(straight(1)), to_8_bits(straight(2)), alpha]
    };
    image.chunks_exact(4).flat_map(pixel).collect()
}

/// Returns the nearest of 256 levels to a value in [0, 1], halves rounded up; 0 for NaN.
fn to_8_bits(value: f32) -> u8 {
    let scaled = value.clamp(0.0, 1.0) * 255.0;
    // equal to `round`, which is a call for each value if the target processor has no instruction for it
    let below = scaled as u8;
    below + u8::from(scaled - f32::from(below) >= 0.5)
}

/// Encodes an image as a PNG file.
///
/// # Errors
/// If the encoder fails.
pub fn encode_png(image: &RgbImage) -> ImageResult<Vec<u8>> {
    encode(ColorType::Rgb, image.dimensions(), image.as_raw(), None)
}

/// Encodes an image as a PNG file with the uncompressed `text` under `keyword` before the pixels.
///
/// # Errors
/// If the encoder fails.
pub fn encode_png_with(image: &RgbImage, keyword: &str, text: &str) -> ImageResult<Vec<u8>> {
    encode(ColorType::Rgb, image.dimensions(), image.as_raw(), Some((keyword, text)))
}

/// Encodes a grey image, such as a mask, as a PNG file.
///
/// # Errors
/// If the encoder fails.
pub fn encode_gray_png(image: &GrayImage) -> ImageResult<Vec<u8>> {
    encode(ColorType::Grayscale, image.dimensions(), image.as_raw(), None)
}

/// Encodes 8-bit samples of this `color` as a PNG file.
///
/// # Errors
/// If the encoder fails.
pub fn encode_samples(color: ColorType, size: (u32, u32), samples: &[u8]) -> ImageResult<Vec<u8>> {
    encode(color, size, samples, None)
}

fn encode(
    color: ColorType,
    (width, height): (u32, u32),
    pixels: &[u8],
    text: Option<(&str, &str)>,
) -> ImageResult<Vec<u8>> {
    let mut bytes = Vec::new();
    let encoded = encoder(&mut bytes, width, height, color).and_then(|mut encoder| {
        encoder.set_compression(png::Compression::Fast);
        encoder.set_filter(png::Filter::Adaptive);
        if let Some((keyword, text)) = text {
            encoder.add_itxt_chunk(keyword.into(), text.into())?;
        }
        let mut writer = encoder.write_header()?;
        writer.write_image_data(pixels)?;
        writer.finish()
    });
    let hint = || ImageFormatHint::Exact(ImageFormat::Png);
    encoded.map_err(|e| ImageError::Encoding(EncodingError::new(hint(), e)))?;
    Ok(bytes)
}

/// Creates an encoder of 8-bit samples that writes the mark.
pub(super) fn encoder<W: Write>(
    out: W,
    width: u32,
    height: u32,
    color: ColorType,
) -> Result<Encoder<'static, W>, png::EncodingError> {
    let mut encoder = Encoder::new(out, width, height);
    encoder.set_color(color);
    encoder.set_depth(BitDepth::Eight);
    encoder.add_text_chunk("Software".into(), MARK.into())?;
    Ok(encoder)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::{check_file, write_named};

    #[test]
    fn levels_are_those_of_round() {
        let near = |n: u32| {
            [-1, 0, 1].map(|ulps: i32| f32::from_bits(((n as f32 + 0.5) / 255.0).to_bits().wrapping_add_signed(ulps)))
        };
        let even = (0..=100_000).map(|k| k as f32 * 1e-5);
        for v in
            (0..255).flat_map(near).chain(even).chain([-1.0, -0.0, 2.0, f32::INFINITY, f32::NEG_INFINITY, f32::NAN])
        {
            assert_eq!(to_8_bits(v), (v.clamp(0.0, 1.0) * 255.0).round() as u8, "{v}");
        }
    }

    #[test]
    fn straight_alpha_laid_over_the_background_gives_the_render() {
        let background = [1.0, 0.5, 0.0];
        let render: Vec<f32> = (0..64)
            .flat_map(|i| {
                let (alpha, colour) = (i as f32 / 63.0, [0.2, 0.9, 0.4]);
                let over = |c: usize| alpha * colour[c] + (1.0 - alpha) * background[c];
                [over(0), over(1), over(2), alpha]
            })
            .collect();
        let rgba = to_rgba8(&render, background);
        assert_eq!((&rgba[..4], &rgba[4 * 63..]), (&[0; 4][..], &[51, 230, 102, 255][..]));
        for (pixel, straight) in render.chunks(4).zip(rgba.chunks(4)) {
            let alpha = f32::from(straight[3]) / 255.0;
            for c in 0..3 {
                let again = alpha * f32::from(straight[c]) / 255.0 + (1.0 - alpha) * background[c];
                assert!((again - pixel[c]).abs() < 1.5 / 255.0, "{pixel:?} {straight:?}");
            }
        }
    }

    #[test]
    fn a_picture_round_trips_and_is_recognised_as_ours() {
        let image = RgbImage::from_fn(300, 200, |x, y| image::Rgb([x as u8, y as u8, (x * y) as u8]));
        let mask = GrayImage::from_fn(7, 3, |x, _| image::Luma([if x > 3 { 255 } else { 0 }]));
        let bytes = encode_png(&image).unwrap();
        assert_eq!(image::load_from_memory(&bytes).unwrap().to_rgb8(), image);
        let gray = encode_gray_png(&mask).unwrap();
        assert_eq!(image::load_from_memory(&gray).unwrap().to_luma8(), mask);
        let folder = tempfile::tempdir().unwrap();
        for bytes in [bytes, gray] {
            let path = folder.path().join("x.png");
            write_named(&path, &bytes).unwrap();
            check_file(&path).unwrap();
        }
    }
}
