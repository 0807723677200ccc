//! A 5x7 bitmap font for labels on pictures: digits, letters and `. , : - + / % _ = ( )`.

use image::{Rgb, RgbImage};

/// Width of a glyph in font pixels.
pub const GLYPH_WIDTH: u32 = 5;
/// Height of a glyph in font pixels.
pub const GLYPH_HEIGHT: u32 = 7;
/// Font pixels from one glyph to the next.
const ADVANCE: u32 = GLYPH_WIDTH + 1;

/// Rows from the top, the left-most pixel in bit 4. Lower-case letters are drawn as capitals and unknown characters as
/// an empty box.
fn glyph(c: char) -> [u8; 7] {
    match c.to_ascii_uppercase() {
        ' ' => [0; 7],
        '0' => [14, 17, 19, 21, 25, 17, 14],
        '1' => [4, 12, 4, 4, 4, 4, 14],
        '2' => [14, 17, 1, 2, 4, 8, 31],
        '3' => [31, 2, 4, 2, 1, 17, 14],
        '4' => [2, 6, 10, 18, 31, 2, 2],
        '5' => [31, 16, 30, 1, 1, 17, 14],
        '6' => [6, 8, 16, 30, 17, 17, 14],
        '7' => [31, 1, 2, 4, 8, 8, 8],
        '8' => [14, 17, 17, 14, 17, 17, 14],
        '9' => [14, 17, 17, 15, 1, 2, 12],
        'A' => [14, 17, 17, 31, 17, 17, 17],
        'B' => [30, 17, 17, 30, 17, 17, 30],
        'C' => [14, 17, 16, 16, 16, 17, 14],
        'D' => [30, 17, 17, 17, 17, 17, 30],
        'E' => [31, 16, 16, 30, 16, 16, 31],
        'F' => [31, 16, 16, 30, 16, 16, 16],
        'G' => [14, 17, 16, 23, 17, 17, 15],
        'H' => [17, 17, 17, 31, 17, 17, 17],
        'I' => [14, 4, 4, 4, 4, 4, 14],
        'J' => [7, 2, 2, 2, 2, 18, 12],
        'K' => [17, 18, 20, 24, 20, 18, 17],
        'L' => [16, 16, 16, 16, 16, 16, 31],
        'M' => [17, 27, 21, 21, 17, 17, 17],
        'N' => [17, 25, 21, 19, 17, 17, 17],
        'O' => [14, 17, 17, 17, 17, 17, 14],
        'P' => [30, 17, 17, 30, 16, 16, 16],
        'Q' => [14, 17, 17, 17, 21, 18, 13],
        'R' => [30, 17, 17, 30, 20, 18, 17],
        'S' => [15, 16, 16, 14, 1, 1, 30],
        'T' => [31, 4, 4, 4, 4, 4, 4],
        'U' => [17, 17, 17, 17, 17, 17, 14],
        'V' => [17, 17, 17, 17, 17, 10, 4],
        'W' => [17, 17, 17, 21, 21, 27, 17],
        'X' => [17, 17, 10, 4, 10, 17, 17],
        'Y' => [17, 17, 10, 4, 4, 4, 4],
        'Z' => [31, 1, 2, 4, 8, 16, 31],
        '.' => [0, 0, 0, 0, 0, 12, 12],
        ',' => [0, 0, 0, 0, 12, 4, 8],
        '+' => [0, 4, 4, 31, 4, 4, 0],
        '=' => [0, 0, 31, 0, 31, 0, 0],
        '(' => [2, 4, 8, 8, 8, 4, 2],
        ')' => [8, 4, 2, 2, 2, 4, 8],
        ':' => [0, 12, 12, 0, 12, 12, 0],
        '-' => [0, 0, 0, 31, 0, 0, 0],
        '_' => [0, 0, 0, 0, 0, 0, 31],
        '/' => [1, 1, 2, 4, 8, 16, 16],
        '%' => [24, 25, 2, 4, 8, 19, 3],
        _ => [31, 17, 17, 17, 17, 17, 31],
    }
}

/// Width of `text` in pixels, each font pixel `scale` pixels wide.
pub fn text_width(text: &str, scale: u32) -> u32 {
    (text.chars().count() as u32 * ADVANCE * scale).saturating_sub(scale)
}

/// Draws `text` with its top left corner at (`x`, `y`), each font pixel `scale` pixels wide;
/// what falls outside the image is cut off.
pub fn draw_text(image: &mut RgbImage, x: u32, y: u32, scale: u32, color: [u8; 3], text: &str) {
    for (at, c) in (0u32..).zip(text.chars()) {
        let left = x.saturating_add(at.saturating_mul(ADVANCE * scale));
        if left >= image.width() {
            return;
        }
        let rows = glyph(c);
        for dy in 0..GLYPH_HEIGHT * scale {
            for dx in 0..GLYPH_WIDTH * scale {
                let bits = rows[(dy / scale) as usize];
                let lit = bits >> (GLYPH_WIDTH - 1 - dx / scale) & 1 == 1;
                let pixel = image.get_pixel_mut_checked(left + dx, y.saturating_add(dy));
                if let (true, Some(pixel)) = (lit, pixel) {
                    *pixel = Rgb(color);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_promised_character_has_a_glyph_of_its_own() {
        let text = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ.,:-+/%_=() ";
        let mut glyphs: Vec<_> = text.chars().map(glyph).collect();
        glyphs.push(glyph('?'));
        assert!(glyphs.iter().flatten().all(|row| *row < 32));
        glyphs.sort();
        glyphs.dedup();
        assert_eq!(glyphs.len(), text.len() + 1);
        assert_eq!(glyph('q'), glyph('Q'));
        assert_eq!((text_width("AB", 2), text_width("", 2)), (22, 0));
    }

    #[test]
    fn text_is_cut_at_the_border() {
        let mut image = RgbImage::new(9, 5);
        draw_text(&mut image, 1, 1, 1, [255; 3], "T8 long");
        assert_eq!(image.get_pixel(1, 1).0, [255; 3]);
        assert_eq!(image.get_pixel(1, 2).0, [0; 3]);
        draw_text(&mut image, u32::MAX, u32::MAX, 2, [255; 3], "x");
    }
}
