//! Pictures of masks for viewing: masks tinted and outlined over their image.

use super::mask::Mask;
use crate::segment::palette::distinct_colour;
use image::RgbImage;

/// Returns the image with each mask tinted and outlined in a colour of its own, later masks over earlier ones. Masks of
/// another size are skipped.
pub fn overlay(mut image: RgbImage, masks: &[Mask]) -> RgbImage {
    let size = image.dimensions();
    for (index, mask) in masks.iter().enumerate().filter(|(_, mask)| (mask.width, mask.height) == size) {
        let colour = distinct_colour(index);
        let bounds @ [left, top, across, down] = mask.bbox();
        let set = mask.window(bounds);
        let inside = |x: u32, y: u32| x < across && y < down && set[(y * across + x) as usize];
        for (x, y) in (0..down).flat_map(|y| (0..across).map(move |x| (x, y))).filter(|&(x, y)| inside(x, y)) {
            let near = [(x.wrapping_sub(1), y), (x + 1, y), (x, y.wrapping_sub(1)), (x, y + 1)];
            let outline = near.iter().any(|&(x, y)| !inside(x, y));
            for (under, over) in image.get_pixel_mut(left + x, top + y).0.iter_mut().zip(colour) {
                *under = blend(*under, over, if outline { 1.0 } else { 0.45 });
            }
        }
    }
    image
}

fn blend(under: u8, over: u8, alpha: f32) -> u8 {
    (f32::from(under) * (1.0 - alpha) + f32::from(over) * alpha).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn masks_are_overlaid_and_other_pixels_are_unchanged() {
        let image = RgbImage::from_pixel(5, 5, Rgb([10, 20, 30]));
        let rows: Vec<bool> = (0..25).map(|pixel| pixel % 5 < 3).collect();
        let mask = Mask::from_rows(5, 5, &rows).unwrap();
        let other_size = Mask::empty(4, 4).unwrap();
        let picture = overlay(image, &[mask, other_size]);
        assert_eq!(picture.get_pixel(4, 0).0, [10, 20, 30]);
        assert_eq!(picture.get_pixel(0, 0).0, distinct_colour(0));
        assert_ne!(picture.get_pixel(1, 2).0, distinct_colour(0));
    }
}
