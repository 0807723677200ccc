//! Images of renders: from floats to 8 bits, to PNG.

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, GrayImage, ImageEncoder, ImageResult, RgbImage};

/// The colours of a render `[H, W, 4]` (already over its background) as 8-bit RGB, rounded and clamped.
pub fn to_rgb8(image: &[f32], width: usize, height: usize) -> RgbImage {
    RgbImage::from_fn(width as u32, height as u32, |x, y| {
        let p = &image[4 * (y as usize * width + x as usize)..][..3];
        image::Rgb(std::array::from_fn(|c| (p[c].clamp(0.0, 1.0) * 255.0).round() as u8))
    })
}

/// The PNG file of an image.
///
/// # Errors
/// If the encoder fails.
pub fn encode_png(image: &RgbImage) -> ImageResult<Vec<u8>> {
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes).write_image(image, image.width(), image.height(), ExtendedColorType::Rgb8)?;
    Ok(bytes)
}

/// The PNG file of a grey image, such as a mask.
///
/// # Errors
/// If the encoder fails.
pub fn encode_gray_png(image: &GrayImage) -> ImageResult<Vec<u8>> {
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes).write_image(image, image.width(), image.height(), ExtendedColorType::L8)?;
    Ok(bytes)
}
