//! Converts pixels to the network's input, and logits back to the image's size, on the host.

use super::SamError;
use rayon::prelude::*;

/// Mean and standard deviation of the training images' red, green and blue, 0 to 255.
const MEAN: [f32; 3] = [123.675, 116.28, 103.53];
const DEVIATION: [f32; 3] = [58.395, 57.12, 57.375];

/// How an image lies in the network's square input: scaled to its longest side, from the top left, zeros elsewhere.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ImageFit {
    /// Width and height of the image, pixels.
    pub original: [usize; 2],
    /// Width and height of the scaled image, pixels.
    pub resized: [usize; 2],
    /// Width and height of the network's input, pixels.
    pub input: usize,
}

impl ImageFit {
    /// The frame of an image of `width` by `height` pixels.
    ///
    /// # Errors
    /// [`SamError::ImageShape`] if nothing would be left of a side.
    pub fn new(width: usize, height: usize, input: usize) -> Result<Self, SamError> {
        let longest = width.max(height).max(1) as f64;
        let scale = input as f64 / longest;
        let resized = [width, height].map(|side| (side as f64 * scale + 0.5) as usize);
        if resized.contains(&0) {
            return Err(SamError::ImageShape { width, height, side: input });
        }
        Ok(Self { original: [width, height], resized, input })
    }

    /// Converts pixels of the image to a position in the network's input, `[0, 1]^2`.
    pub(super) fn position(&self, at: [f32; 2]) -> [f32; 2] {
        [0, 1].map(|axis| {
            let scale = self.resized[axis] as f64 / self.original[axis] as f64;
            ((f64::from(at[axis]) * scale + 0.5) / self.input as f64) as f32
        })
    }
}

/// Converts RGB bytes `[H, W, 3]` to the network's input `[3, I, I]`: resized, normalised, padded with zeros.
///
/// # Errors
/// [`SamError::ImageSize`] if `rgb` does not hold the frame's original size.
pub fn network_input(rgb: &[u8], frame: &ImageFit) -> Result<Vec<f32>, SamError> {
    let [width, height] = frame.original;
    if width.checked_mul(height).and_then(|n| n.checked_mul(3)) != Some(rgb.len()) {
        return Err(SamError::ImageSize { width, height, found: rgb.len() });
    }
    let pixels = resize_rgb(rgb, frame.original, frame.resized);
    let (side, [across, _]) = (frame.input, frame.resized);
    let mut input = vec![0.0; 3 * side * side];
    for (channel, plane) in input.chunks_exact_mut(side * side).enumerate() {
        for (row, line) in plane.chunks_exact_mut(side).zip(pixels.chunks_exact(across * 3)) {
            for (value, pixel) in row.iter_mut().zip(line.chunks_exact(3)) {
                *value = (f32::from(pixel[channel]) - MEAN[channel]) / DEVIATION[channel];
            }
        }
    }
    Ok(input)
}

/// Bits after the binary point of a resizing weight.
const FRACTION: u32 = 22;

/// The input pixels that make an output pixel, from `start`, with weights that sum to `2^FRACTION`.
struct ResampleWindow {
    start: usize,
    weights: Vec<i32>,
}

/// Linear interpolation, widened to an average when shrinking, as imaging libraries do it in fixed point.
fn windows(from: usize, to: usize) -> Vec<ResampleWindow> {
    let step = from as f64 / to as f64;
    let reach = step.max(1.0);
    let window = |i: usize| {
        let centre = (i as f64 + 0.5) * step;
        let start = (centre - reach + 0.5).max(0.0) as usize;
        let end = ((centre + reach + 0.5) as usize).min(from);
        let tent = |j: usize| (1.0 - ((j as f64 + 0.5 - centre) / reach).abs()).max(0.0);
        let sum: f64 = (start..end).map(tent).sum();
        let fixed = |j: usize| (tent(j) / sum * f64::from(1 << FRACTION) + 0.5) as i32;
        ResampleWindow { start, weights: (start..end).map(fixed).collect() }
    };
    (0..to).map(window).collect()
}

fn round(sum: i32) -> u8 {
    ((sum + (1 << (FRACTION - 1))) >> FRACTION).clamp(0, 255) as u8
}

/// Resizes RGB bytes from size `from` to size `to`, both `[width, height]`, rows first, rounding in between.
pub fn resize_rgb(rgb: &[u8], from: [usize; 2], to: [usize; 2]) -> Vec<u8> {
    let mut wide = vec![0; to[0] * from[1] * 3];
    if from[0] == to[0] {
        wide.copy_from_slice(rgb);
    } else {
        let across = windows(from[0], to[0]);
        wide.par_chunks_exact_mut(to[0] * 3).zip(rgb.par_chunks_exact(from[0] * 3)).for_each(|(out, row)| {
            for (pixel, window) in out.chunks_exact_mut(3).zip(&across) {
                for (channel, value) in pixel.iter_mut().enumerate() {
                    let inputs = row[window.start * 3 + channel..].iter().step_by(3);
                    *value = round(inputs.zip(&window.weights).map(|(&v, w)| i32::from(v) * w).sum());
                }
            }
        });
    }
    if from[1] == to[1] {
        return wide;
    }
    let down = windows(from[1], to[1]);
    let line = to[0] * 3;
    let mut out = vec![0; line * to[1]];
    out.par_chunks_exact_mut(line).zip(&down).for_each(|(out, window)| {
        for (x, value) in out.iter_mut().enumerate() {
            let inputs = wide[window.start * line + x..].iter().step_by(line);
            *value = round(inputs.zip(&window.weights).map(|(&v, w)| i32::from(v) * w).sum());
        }
    });
    out
}

/// The two neighbours of output `i` of `to` among `from` values, each with its weight.
fn neighbours(i: usize, from: usize, to: usize) -> [(usize, f64); 2] {
    let at = ((i as f64 + 0.5) * from as f64 / to as f64 - 0.5).max(0.0);
    let first = (at as usize).min(from - 1);
    let part = at - first as f64;
    [(first, 1.0 - part), ((first + 1).min(from - 1), part)]
}

/// Combines two linear interpolations along an axis: from the low resolution to the network's input, cropped to the
/// scaled image, and from there to the image. Gives, for each output, the index of its first value and the weights from
/// that one on.
fn enlargement(side: usize, input: usize, resized: usize, original: usize) -> Vec<(usize, Vec<f32>)> {
    let output = |i: usize| {
        let mut parts = Vec::with_capacity(4);
        for (at, outer) in neighbours(i, resized, original) {
            parts.extend(neighbours(at, side, input).map(|(from, inner)| (from, outer * inner)));
        }
        let first = parts.iter().map(|p| p.0).min().unwrap_or(0);
        let last = parts.iter().map(|p| p.0).max().unwrap_or(0);
        let mut weights = vec![0.0; last - first + 1];
        parts.iter().for_each(|&(from, weight)| weights[from - first] += weight as f32);
        (first, weights)
    };
    (0..original).map(output).collect()
}

/// Enlarges logits of one shape to the image's size.
pub struct Enlarger {
    side: usize,
    across: Vec<(usize, Vec<f32>)>,
    down: Vec<(usize, Vec<f32>)>,
}

impl Enlarger {
    /// Creates an enlarger of logits `[side, side]` of an image that lies in the network's input as `frame` says;
    /// `side` is above 0.
    pub fn new(side: usize, frame: &ImageFit) -> Self {
        let axis = |axis: usize| enlargement(side, frame.input, frame.resized[axis], frame.original[axis]);
        Self { side, across: axis(0), down: axis(1) }
    }

    /// Enlarges logits `[side, side]` to the image's size, `[height, width]`.
    ///
    /// # Panics
    /// If there are fewer than `side * side` logits.
    pub fn enlarge(&self, logits: &[f32]) -> Vec<f32> {
        let width = self.across.len();
        let mut wide = Vec::with_capacity(self.side * width);
        for row in logits[..self.side * self.side].chunks_exact(self.side) {
            let weigh = |(first, weights): &(usize, Vec<f32>)| {
                row[*first..].iter().zip(weights).map(|(v, w)| v * w).sum::<f32>()
            };
            wide.extend(self.across.iter().map(weigh));
        }
        let mut out = vec![0.0; width * self.down.len()];
        for (line, (first, weights)) in out.chunks_exact_mut(width.max(1)).zip(&self.down) {
            for (row, weight) in wide[first * width..].chunks_exact(width).zip(weights) {
                line.iter_mut().zip(row).for_each(|(out, value)| *out += weight * value);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn frames_keep_the_aspect() {
        let frame = ImageFit::new(800, 600, 1024).unwrap();
        assert_eq!(frame.resized, [1024, 768]);
        assert_eq!(ImageFit::new(1, 2000, 1024).unwrap().resized, [1, 1024]);
        for (width, height) in [(0, 5), (5, 0), (0, 0), (3000, 1)] {
            assert!(matches!(ImageFit::new(width, height, 1024), Err(SamError::ImageShape { .. })));
        }
        let [x, y] = frame.position([400.0, 300.0]);
        assert!((x - 512.5 / 1024.0).abs() < 1e-7 && (y - 384.5 / 1024.0).abs() < 1e-7);
    }

    #[test]
    fn images_are_normalised_and_padded() {
        let frame = ImageFit::new(2, 1, 4).unwrap();
        let input = network_input(&[255, 0, 0, 255, 0, 0], &frame).unwrap();
        assert_eq!(input.len(), 48);
        assert!((input[0] - (255.0 - 123.675) / 58.395).abs() < 1e-6);
        assert_eq!(input[7], input[0]);
        assert_eq!(input[8..16], [0.0; 8]);
        assert!((input[16] + 116.28 / 57.12).abs() < 1e-6);
        let error = network_input(&[0; 8], &frame).unwrap_err();
        assert!(matches!(error, SamError::ImageSize { found: 8, .. }), "{error}");
    }

    #[test]
    fn poison_stays_where_it_is() {
        let frame = ImageFit::new(32, 32, 16).unwrap();
        let mut logits = vec![1.0; 16];
        logits[0] = f32::NAN;
        let out = Enlarger::new(4, &frame).enlarge(&logits);
        assert!(out[0].is_nan() && out[32 * 32 - 1] == 1.0);
    }

    proptest! {
        #[test]
        fn a_flat_image_stays_flat(w in 1_usize..40, h in 1_usize..40, to_w in 1_usize..40, to_h in 1_usize..40, v: u8) {
            let out = resize_rgb(&vec![v; w * h * 3], [w, h], [to_w, to_h]);
            prop_assert_eq!(out, vec![v; to_w * to_h * 3]);
        }

        #[test]
        fn a_flat_mask_stays_flat(w in 1_usize..60, h in 1_usize..60, value in -30.0_f32..30.0) {
            let frame = ImageFit::new(w, h, 64).unwrap();
            let out = Enlarger::new(16, &frame).enlarge(&[value; 256]);
            prop_assert_eq!(out.len(), w * h);
            prop_assert!(out.iter().all(|v| (v - value).abs() <= 1e-5 * value.abs()));
        }
    }
}
