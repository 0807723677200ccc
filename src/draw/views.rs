//! A sheet of pictures in a grid, each with a label: what was rendered, at a glance.

use super::font::{GLYPH_HEIGHT, draw_text};
use image::imageops::{FilterType, resize};
use image::{Rgb, RgbImage};

const MARGIN: u32 = 6;
const LABEL: u32 = GLYPH_HEIGHT + 8;
const PAPER: [u8; 3] = [24, 24, 28];
const INK: [u8; 3] = [230, 230, 230];

/// Lays out pictures of one size in rows of `columns`, each no wider than `cell` pixels, its label above.
#[must_use]
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_shrunk_into_rows() {
        let one = ("a".to_owned(), RgbImage::from_pixel(40, 20, Rgb([9; 3])));
        let sheet = view_sheet(&[one.clone(), one.clone(), one], 2, 20);
        assert_eq!(sheet.dimensions(), (6 + 2 * 26, 6 + 2 * (10 + LABEL + 6)));
        assert_eq!(sheet.get_pixel(7, 6 + LABEL + 1).0, [9; 3]);
        assert_eq!(view_sheet(&[], 4, 100).height(), 6);
    }
}
