//! Contact sheets: a row per view with ground truth, render and error map.

use image::{Rgb, RgbImage};

use crate::draw::font::{GLYPH_HEIGHT, draw_text};

/// Longest side of a picture on the sheet, in pixels.
const MAX_SIDE: usize = 400;
const MARGIN: u32 = 6;
const LABEL: u32 = GLYPH_HEIGHT + 6;
const BACKGROUND: [u8; 3] = [24, 24, 28];
const INK: [u8; 3] = [230, 230, 230];
/// Colours of errors 0, 0.2, ..., 1, rising in lightness from black through purple to pale yellow.
const ERROR_COLORS: [[f32; 3]; 6] = [
    [0.0, 0.0, 10.0],
    [70.0, 15.0, 105.0],
    [150.0, 40.0, 95.0],
    [225.0, 90.0, 45.0],
    [250.0, 170.0, 25.0],
    [252.0, 252.0, 170.0],
];

/// One view; both images are `[H, W, 3]` with values in [0, 1].
#[derive(Debug, Clone)]
pub struct SheetRow<'a> {
    /// Text above the row.
    pub label: String,
    /// The image of the dataset.
    pub truth: &'a [f32],
    /// The render.
    pub render: &'a [f32],
}

/// An image does not hold `width * height * 3` values.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("row {row} ({label}): an image holds {got} values, expected {expected}")]
pub struct SheetError {
    /// The row, from 0.
    pub row: usize,
    /// Its label.
    pub label: String,
    /// Values in the image.
    pub got: usize,
    /// `width * height * 3`.
    pub expected: usize,
}

/// Returns the colour of an error in [0, 1]; NaN is pure green, which no error has.
pub fn error_color(error: f32) -> [u8; 3] {
    if error.is_nan() {
        return [0, 255, 0];
    }
    let at = error.clamp(0.0, 1.0) * (ERROR_COLORS.len() - 1) as f32;
    let low = (at as usize).min(ERROR_COLORS.len() - 2);
    let part = at - low as f32;
    [0, 1, 2].map(|c| {
        let (a, b) = (ERROR_COLORS[low][c], ERROR_COLORS[low + 1][c]);
        (a + (b - a) * part).round() as u8
    })
}

/// Draws `[truth | render | error map]` for each row. Pictures with a side of more than 400 pixels are averaged down by
/// an integer factor; the error is the mean |difference| over the three channels, computed before downscaling.
///
/// # Errors
/// [`SheetError`] if an image does not hold `width * height * 3` values, or this is 0.
pub fn contact_sheet(rows: &[SheetRow<'_>], width: usize, height: usize) -> Result<RgbImage, SheetError> {
    let expected = width.saturating_mul(height).saturating_mul(3);
    for (row, entry) in rows.iter().enumerate() {
        let fits = |image: &&[f32]| image.len() == expected && expected > 0;
        if let Some(image) = [entry.truth, entry.render].into_iter().find(|i| !fits(i)) {
            return Err(SheetError { row, label: entry.label.clone(), got: image.len(), expected });
        }
    }
    let factor = width.max(height).div_ceil(MAX_SIDE).max(1);
    let (cell_w, cell_h) = (width.div_ceil(factor) as u32, height.div_ceil(factor) as u32);
    let sheet_w = 3 * cell_w + 4 * MARGIN;
    let row_h = cell_h + LABEL + MARGIN;
    let sheet_h = LABEL + MARGIN + row_h * rows.len() as u32;
    let mut sheet = RgbImage::from_pixel(sheet_w, sheet_h, Rgb(BACKGROUND));
    let left = |column: u32| MARGIN + column * (cell_w + MARGIN);
    for (column, title) in (0..).zip(["truth", "render", "error"]) {
        draw_text(&mut sheet, left(column), MARGIN, 1, INK, title);
    }
    for (index, row) in (0..).zip(rows) {
        let top = LABEL + MARGIN + index * row_h;
        draw_text(&mut sheet, MARGIN, top + 3, 1, INK, &row.label);
        let difference: Vec<f32> = row
            .truth
            .chunks_exact(3)
            .zip(row.render.chunks_exact(3))
            .flat_map(|(t, r)| [(0..3).map(|c| (t[c] - r[c]).abs()).sum::<f32>() / 3.0; 3])
            .collect();
        let pictures = [row.truth, row.render, &difference];
        for (column, picture) in (0..).zip(pictures) {
            for y in 0..cell_h {
                for x in 0..cell_w {
                    let at = (x as usize * factor, y as usize * factor);
                    let mean = block_mean(picture, width, height, at, factor);
                    let color = match column {
                        2 => error_color(mean[0]),
                        _ => mean.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8),
                    };
                    sheet.put_pixel(left(column) + x, top + LABEL + y, Rgb(color));
                }
            }
        }
    }
    Ok(sheet)
}

/// Returns the mean colour of the `factor` x `factor` block at `(x, y)`, clipped at the border.
fn block_mean(image: &[f32], width: usize, height: usize, (x, y): (usize, usize), factor: usize) -> [f32; 3] {
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for row in y..(y + factor).min(height) {
        for column in x..(x + factor).min(width) {
            let pixel = &image[(row * width + column) * 3..][..3];
            sum.iter_mut().zip(pixel).for_each(|(s, v)| *s += v);
            count += 1.0;
        }
    }
    sum.map(|s| s / count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_lie_side_by_side_and_a_nan_is_green() {
        let truth = vec![1.0; 20 * 10 * 3];
        let mut render = vec![0.0; 20 * 10 * 3];
        render[0] = f32::NAN;
        let row = |label: &str| SheetRow { label: label.to_owned(), truth: &truth, render: &render };
        let sheet = contact_sheet(&[row("a"), row("b")], 20, 10).unwrap();
        assert_eq!(sheet.dimensions(), (84, 77));
        let top = LABEL + MARGIN + LABEL;
        assert_eq!(sheet.get_pixel(MARGIN, top).0, [255; 3]);
        assert_eq!(sheet.get_pixel(2 * MARGIN + 21, top).0, [0; 3]);
        assert_eq!(sheet.get_pixel(3 * MARGIN + 40, top).0, [0, 255, 0]);
        assert_eq!(sheet.get_pixel(3 * MARGIN + 41, top).0, error_color(1.0));
    }

    #[test]
    fn big_images_shrink_and_wrong_sizes_are_named() {
        let image = vec![0.5; 1001 * 30 * 3];
        let row = |render| SheetRow { label: "view 3".to_owned(), truth: &image, render };
        let sheet = contact_sheet(&[row(&image)], 1001, 30).unwrap();
        assert_eq!(sheet.width(), 3 * 334 + 4 * MARGIN);
        let error = contact_sheet(&[row(&image), row(&image[1..])], 1001, 30).unwrap_err();
        assert!(error.to_string().starts_with("row 1 (view 3)"));
        assert!(contact_sheet(&[], 0, 0).is_ok());
    }
}
