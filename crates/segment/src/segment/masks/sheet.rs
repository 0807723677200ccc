//! Pictures of masks for viewing: masks tinted and outlined over their image, and sheets of such pictures.
//!
//! Only produces pixels; the caller writes files.

use super::mask::Mask;
use crate::segment::palette::distinct_colour;

/// A picture of `[height, width]` pixels, row-major RGBA.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// RGBA bytes, `[height, width, 4]`.
    pub rgba: Vec<u8>,
}

/// The image over white with each mask tinted and outlined in a colour of its own, later masks over earlier ones.
///
/// `rgba` is `[height, width, 4]` with straight alpha; missing bytes count as clear. Masks of another size are skipped.
#[must_use]
pub fn overlay(width: u32, height: u32, rgba: &[u8], masks: &[Mask]) -> Picture {
    let pixels = width as usize * height as usize;
    let mut picture = vec![255_u8; pixels * 4];
    for (to, from) in picture.chunks_exact_mut(4).zip(rgba.chunks_exact(4)) {
        for channel in 0..3 {
            to[channel] = blend(255, from[channel], f32::from(from[3]) / 255.0);
        }
    }
    for (index, mask) in masks.iter().enumerate().filter(|(_, mask)| (mask.width, mask.height) == (width, height)) {
        let colour = distinct_colour(index);
        let bounds @ [left, top, across, down] = mask.bbox();
        let set = mask.window(bounds);
        let inside = |x: u32, y: u32| x < across && y < down && set[(y * across + x) as usize];
        for (x, y) in (0..down).flat_map(|y| (0..across).map(move |x| (x, y))).filter(|&(x, y)| inside(x, y)) {
            let near = [(x.wrapping_sub(1), y), (x + 1, y), (x, y.wrapping_sub(1)), (x, y + 1)];
            let outline = near.iter().any(|&(x, y)| !inside(x, y));
            let at = ((top + y) as usize * width as usize + (left + x) as usize) * 4;
            for channel in 0..3 {
                picture[at + channel] = blend(picture[at + channel], colour[channel], if outline { 1.0 } else { 0.45 });
            }
        }
    }
    Picture { width, height, rgba: picture }
}

/// Arranges pictures in rows of `columns`, with a thin white margin.
#[must_use]
pub fn sheet(pictures: &[Picture], columns: usize) -> Picture {
    const MARGIN: usize = 2;
    let columns = columns.clamp(1, pictures.len().max(1));
    let cell = |side: fn(&Picture) -> u32| pictures.iter().map(side).max().unwrap_or(0) as usize + MARGIN;
    let (across, down) = (cell(|picture| picture.width), cell(|picture| picture.height));
    let (width, height) = (columns * across, pictures.len().div_ceil(columns) * down);
    let mut rgba = vec![255; width * height * 4];
    for (index, picture) in pictures.iter().enumerate() {
        let row = picture.width as usize * 4;
        for (y, from) in picture.rgba.chunks_exact(row.max(1)).enumerate().take(picture.height as usize) {
            let start = ((index / columns * down + y) * width + index % columns * across) * 4;
            rgba[start..start + row].copy_from_slice(from);
        }
    }
    Picture { width: width as u32, height: height as u32, rgba }
}

fn blend(under: u8, over: u8, alpha: f32) -> u8 {
    (f32::from(under) * (1.0 - alpha) + f32::from(over) * alpha).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_are_overlaid_and_other_pixels_are_unchanged() {
        let image = [10, 20, 30, 255].repeat(25);
        let rows: Vec<bool> = (0..25).map(|pixel| pixel % 5 < 3).collect();
        let mask = Mask::from_rows(5, 5, &rows).unwrap();
        let other_size = Mask::empty(4, 4).unwrap();
        let picture = overlay(5, 5, &image, &[mask, other_size]);
        assert_eq!(picture.rgba[4 * 4..4 * 4 + 4], [10, 20, 30, 255]);
        assert_eq!(picture.rgba[..3], distinct_colour(0));
        assert_ne!(picture.rgba[(2 * 5 + 1) * 4..][..3], distinct_colour(0));
    }

    #[test]
    fn clear_or_missing_pixels_are_white() {
        assert_eq!(overlay(2, 1, &[9, 9, 9, 0], &[]).rgba, [255; 8]);
    }

    #[test]
    fn sheets_have_rows_and_columns() {
        let picture = Picture { width: 3, height: 2, rgba: vec![7; 24] };
        let found = sheet(&[picture.clone(), picture.clone(), picture], 2);
        assert_eq!((found.width, found.height), (10, 8));
        assert_eq!(found.rgba.iter().filter(|&&byte| byte == 7).count(), 72);
        assert!(sheet(&[], 3).rgba.is_empty());
    }
}
