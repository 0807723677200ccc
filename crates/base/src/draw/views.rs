//! Sheets of pictures in a grid, each with a label: rendered images at a glance.

use super::font::{GLYPH_HEIGHT, draw_text, text_width};
use image::imageops::{FilterType, resize};
use image::{Rgb, RgbImage};

const MARGIN: u32 = 6;
const LABEL: u32 = GLYPH_HEIGHT + 8;
const PAPER: [u8; 3] = [24, 24, 28];
const INK: [u8; 3] = [230, 230, 230];

/// Lays out pictures of one size in rows of `columns`, each no wider than `cell` pixels, its label above.
pub fn view_sheet(pictures: &[(String, RgbImage)], columns: usize, cell: u32) -> RgbImage {
    let columns = columns.clamp(1, pictures.len().max(1));
    let (w, h) = pictures.first().map_or((1, 1), |(_, p)| p.dimensions());
    let (cw, ch) = if w > cell { (cell, (h * cell / w).max(1)) } else { (w, h) };
    let rows = pictures.len().div_ceil(columns) as u32;
    let size = (MARGIN + columns as u32 * (cw + MARGIN), MARGIN + rows * (ch + LABEL + MARGIN));
    let mut sheet = RgbImage::from_pixel(size.0, size.1, Rgb(PAPER));
    for (i, (label, picture)) in pictures.iter().enumerate() {
        let x = MARGIN + (i % columns) as u32 * (cw + MARGIN);
        let y = MARGIN + (i / columns) as u32 * (ch + LABEL + MARGIN);
        draw_text(&mut sheet, x, y + 3, 1, INK, label);
        let small;
        let shown = if (cw, ch) == picture.dimensions() {
            picture
        } else {
            small = resize(picture, cw, ch, FilterType::Triangle);
            &small
        };
        image::imageops::replace(&mut sheet, shown, i64::from(x), i64::from(y + LABEL));
    }
    sheet
}

/// A picture of a [`pair_sheet`], with another one of the same size below it.
#[derive(Clone, Debug, Default)]
pub struct PicturePair {
    /// First line above it.
    pub name: String,
    /// Second line above it.
    pub note: String,
    /// The picture.
    pub picture: RgbImage,
    /// The picture below it; the background shows where there is none.
    pub below: Option<RgbImage>,
}

/// Lays out pairs in rows of `columns`, each no wider than `cell` pixels. As labels need room, small pictures are
/// enlarged by an integer factor to at least half of that.
pub fn pair_sheet(pairs: &[PicturePair], columns: usize, cell: u32) -> RgbImage {
    let (columns, cell) = (columns.clamp(1, pairs.len().max(1)), cell.max(1));
    let (w, h) = pairs.first().map_or((1, 1), |p| (p.picture.width().max(1), p.picture.height().max(1)));
    let (cw, ch) = if w > cell {
        (cell, (u64::from(h) * u64::from(cell) / u64::from(w)).max(1) as u32)
    } else {
        let times = (cell / 2).div_ceil(w).clamp(1, cell / w);
        (w * times, h * times)
    };
    let scale = if cw >= 240 { 2 } else { 1 };
    let line = (GLYPH_HEIGHT + 3) * scale;
    let row = 2 * line + 2 * ch + 3 + 2 * MARGIN;
    let size = (MARGIN + columns as u32 * (cw + MARGIN), MARGIN + pairs.len().div_ceil(columns) as u32 * row);
    let mut sheet = RgbImage::from_pixel(size.0, size.1, Rgb(PAPER));
    for (i, pair) in pairs.iter().enumerate() {
        let x = MARGIN + (i % columns) as u32 * (cw + MARGIN);
        let y = MARGIN + (i / columns) as u32 * row;
        for (k, label) in (0u32..).zip([&pair.name, &pair.note]) {
            // a long name is drawn smaller rather than cut
            let (label, scale) = fitting(label, cw, scale);
            draw_text(&mut sheet, x, y + k * line, scale, INK, &label);
        }
        for (k, picture) in (0u32..).zip([Some(&pair.picture), pair.below.as_ref()]) {
            let Some(picture) = picture else { continue };
            let filter = if cw > w { FilterType::Nearest } else { FilterType::Triangle };
            let shown = resize(picture, cw, ch, filter);
            image::imageops::replace(&mut sheet, &shown, i64::from(x), i64::from(y + 2 * line + k * (ch + 3)));
        }
    }
    sheet
}

/// `label` at `scale` or smaller, cut if it is still wider than `width`.
fn fitting(label: &str, width: u32, scale: u32) -> (String, u32) {
    let scale = (1..=scale).rev().find(|s| text_width(label, *s) <= width).unwrap_or(1);
    let mut label = label.to_owned();
    if text_width(&label, scale) > width {
        while text_width(&label, scale) + text_width("...", scale) > width && label.pop().is_some() {}
        label += "..";
    }
    (label, scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_lie_one_over_the_other_under_two_lines() {
        let picture = |size: u32, shade: u8| RgbImage::from_pixel(size, size, Rgb([shade; 3]));
        let pair = |size: u32| PicturePair {
            name: "a name too long for the picture under it".to_owned(),
            note: "30 dB".to_owned(),
            picture: picture(size, 200),
            below: Some(picture(size, 99)),
        };
        for (size, shown, scale) in [(400, 100, 1), (10, 50, 1), (90, 90, 1), (600, 300, 2)] {
            let cell = if size == 600 { 300 } else { 100 };
            let line = (GLYPH_HEIGHT + 3) * scale;
            let row = 2 * line + 2 * shown + 3 + 2 * MARGIN;
            let sheet = pair_sheet(&[pair(size), PicturePair { below: None, ..pair(size) }, pair(size)], 2, cell);
            assert_eq!(sheet.dimensions(), (MARGIN + 2 * (shown + MARGIN), MARGIN + 2 * row), "{size}");
            let top = MARGIN + 2 * line;
            assert_eq!(sheet.get_pixel(MARGIN, top).0, [200; 3]);
            assert_eq!(sheet.get_pixel(MARGIN, top + shown + 3).0, [99; 3]);
            assert_eq!(sheet.get_pixel(2 * MARGIN + shown, top + shown + 3).0, PAPER);
            assert_eq!(sheet.get_pixel(MARGIN + shown + 1, MARGIN + 3).0, PAPER, "labels end with their picture");
        }
        assert_eq!(pair_sheet(&[], 3, 100).height(), MARGIN);
        assert_eq!(fitting("", 0, 2), (String::new(), 2));
        assert_eq!(pair_sheet(&[PicturePair::default()], 0, 0).width(), 2 * MARGIN + 1);
    }

    #[test]
    fn pictures_are_shrunk_into_rows() {
        let one = ("a".to_owned(), RgbImage::from_pixel(40, 20, Rgb([9; 3])));
        let sheet = view_sheet(&[one.clone(), one.clone(), one], 2, 20);
        assert_eq!(sheet.dimensions(), (6 + 2 * 26, 6 + 2 * (10 + LABEL + 6)));
        assert_eq!(sheet.get_pixel(7, 6 + LABEL + 1).0, [9; 3]);
        assert_eq!(view_sheet(&[], 4, 100).height(), 6);
    }
}
