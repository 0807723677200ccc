//! A 3 x 5 pixel alphabet (capitals, digits, a little punctuation) for the labels of `layout`.

use image::{Rgba, RgbaImage};

/// Rows of three bits, top first, highest bit left.
fn glyph(c: char) -> [u8; 5] {
    match c {
        'A' => [2, 5, 7, 5, 5],
        'B' => [6, 5, 6, 5, 6],
        'C' => [3, 4, 4, 4, 3],
        'D' => [6, 5, 5, 5, 6],
        'E' => [7, 4, 6, 4, 7],
        'F' => [7, 4, 6, 4, 4],
        'G' => [3, 4, 5, 5, 3],
        'H' => [5, 5, 7, 5, 5],
        'I' => [7, 2, 2, 2, 7],
        'J' => [1, 1, 1, 5, 2],
        'K' => [5, 5, 6, 5, 5],
        'L' => [4, 4, 4, 4, 7],
        'M' => [5, 7, 7, 5, 5],
        'N' => [6, 5, 5, 5, 5],
        'O' => [2, 5, 5, 5, 2],
        'P' => [6, 5, 6, 4, 4],
        'Q' => [2, 5, 5, 6, 3],
        'R' => [6, 5, 6, 5, 5],
        'S' => [3, 4, 2, 1, 6],
        'T' => [7, 2, 2, 2, 2],
        'U' => [5, 5, 5, 5, 7],
        'V' => [5, 5, 5, 5, 2],
        'W' => [5, 5, 7, 7, 5],
        'X' => [5, 5, 2, 5, 5],
        'Y' => [5, 5, 2, 2, 2],
        'Z' => [7, 1, 2, 4, 7],
        '0' => [7, 5, 5, 5, 7],
        '1' => [2, 6, 2, 2, 7],
        '2' => [7, 1, 7, 4, 7],
        '3' => [7, 1, 7, 1, 7],
        '4' => [5, 5, 7, 1, 1],
        '5' => [7, 4, 7, 1, 7],
        '6' => [7, 4, 7, 5, 7],
        '7' => [7, 1, 1, 1, 1],
        '8' => [7, 5, 7, 5, 7],
        '9' => [7, 5, 7, 1, 7],
        '.' => [0, 0, 0, 0, 2],
        ',' => [0, 0, 0, 2, 4],
        ':' => [0, 2, 0, 2, 0],
        '-' => [0, 0, 7, 0, 0],
        _ => [0; 5],
    }
}

/// Width of `text` in pixels, each glyph pixel `scale` wide.
pub(super) fn text_width(text: &str, scale: u32) -> u32 {
    (4 * scale * text.chars().count() as u32).saturating_sub(scale)
}

/// Draws `text` with its top left corner at `(x, y)`; what falls outside is cut, unknown characters are blank.
pub(super) fn draw_text(image: &mut RgbaImage, x: i64, y: i64, scale: u32, text: &str, [r, g, b]: [u8; 3]) {
    let scale = i64::from(scale);
    for (i, c) in text.chars().enumerate() {
        for (row, bits) in glyph(c).into_iter().enumerate() {
            for column in (0..3).filter(|k| bits >> (2 - k) & 1 == 1) {
                let left = x + scale * (4 * i as i64 + column);
                let top = y + scale * row as i64;
                for (dx, dy) in (0..scale * scale).map(|k| (k % scale, k / scale)) {
                    if let (Ok(px), Ok(py)) = (u32::try_from(left + dx), u32::try_from(top + dy))
                        && let Some(pixel) = image.get_pixel_mut_checked(px, py)
                    {
                        *pixel = Rgba([r, g, b, 255]);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_drawn_and_cut() {
        let mut image = RgbaImage::new(8, 8);
        draw_text(&mut image, 0, 0, 1, "I:", [9, 9, 9]);
        assert_eq!(image.pixels().filter(|p| p.0[3] > 0).count(), 9 + 2);
        assert_eq!((text_width("AB", 2), text_width("", 2)), (14, 0));
        draw_text(&mut image, -5, 6, 3, "AAAAAAAAA?é", [9, 9, 9]);
    }
}
