//! How strongly each pixel looks like a boundary between two objects: jumps in colour, alpha and depth.
//!
//! A smooth ramp has the same gradient at every smoothing; a jump's gradient falls as one over the smoothing's width.
//! The gradient at a fine smoothing minus that at a coarse one is therefore about the jump's height, and near 0 on
//! smooth shading. Only the pixels of the foreground take part, so the silhouette makes no edge of its own.

use crate::config::types::segment::MasksConfig;

/// The foreground, cropped to its bounding box.
pub(super) struct ForegroundWindow {
    pub width: usize,
    pub height: usize,
    /// Foreground, `[height, width]`.
    pub inside: Vec<bool>,
}

/// The pixels at the four sides of a pixel, left, right, above and below, in a picture of `pixels` pixels; `None` where it
/// ends.
pub(super) fn sides(pixel: usize, width: usize, pixels: usize) -> [Option<usize>; 4] {
    let x = pixel % width;
    [
        (x > 0).then(|| pixel - 1),
        (x + 1 < width).then_some(pixel + 1),
        pixel.checked_sub(width),
        Some(pixel + width).filter(|&below| below < pixels),
    ]
}

/// One quantity to find jumps in.
pub(super) struct Channel {
    /// `[height, width]`.
    pub values: Vec<f32>,
    /// Where the values are known; all of the foreground if none.
    pub known: Option<Vec<bool>>,
    /// Weight of a jump of 1.
    pub weight: f32,
}

/// Jump heights `[height, width]`, 0 outside the foreground.
pub(super) fn jumps(window: &ForegroundWindow, channels: &[Channel], config: &MasksConfig) -> Vec<f32> {
    let (fine, coarse, ramp) = (config.fine_blur, config.coarse_blur, config.ramp);
    let pixels = window.width * window.height;
    let mut scratch = vec![0.0; pixels];
    let mut squares = [vec![0.0_f32; pixels], vec![0.0_f32; pixels]];
    for (sum, sigma) in squares.iter_mut().zip([fine, coarse]) {
        let kernel = gaussian(sigma);
        let weights = |known: &[bool], scratch: &mut Vec<f32>| {
            let mut plane: Vec<f32> = known.iter().map(|&known| f32::from(u8::from(known))).collect();
            blur(&mut plane, scratch, window.width, &kernel);
            plane
        };
        let shared = weights(&window.inside, &mut scratch);
        for channel in channels {
            let known = channel.known.as_ref().unwrap_or(&window.inside);
            let own = channel.known.as_ref().map(|known| weights(known, &mut scratch));
            let weight = own.as_ref().unwrap_or(&shared);
            let mut plane: Vec<f32> =
                channel.values.iter().zip(known).map(|(&value, &known)| if known { value } else { 0.0 }).collect();
            blur(&mut plane, &mut scratch, window.width, &kernel);
            for (value, weight) in plane.iter_mut().zip(weight) {
                *value = if *weight > 1e-4 { *value / *weight } else { f32::NAN };
            }
            add_squared_gradient(&plane, window, channel.weight, sum);
        }
    }
    // At a step of height 1 the central difference of the smoothed values is half the sum of the two middle taps.
    let response = |sigma: f32| gaussian(sigma).iter().take(2).sum::<f32>() / 2.0;
    let scale = 1.0 / (response(fine) - ramp * response(coarse));
    let [sharp, smooth] = squares;
    let height = |(&sharp, &smooth): (&f32, &f32)| (sharp.sqrt() - ramp * smooth.sqrt()).max(0.0) * scale;
    sharp.iter().zip(&smooth).map(height).collect()
}

/// Returns the relief plus a slope that falls from jumps and the silhouette inwards, so that two wide areas joined
/// through a gap in the jumps between them drain apart. It only shapes the basins; the strength of a boundary depends on
/// the jumps alone.
pub(super) fn close_gaps(window: &ForegroundWindow, relief: &[f32], config: &MasksConfig) -> Vec<f32> {
    let (edge, reach, height) = (config.gap_edge, config.gap_reach, config.gap_height);
    let (width, rows) = (window.width, window.height);
    // Distances in thirds of a pixel by the 3-4 chamfer, with a border of background around.
    let wide = width + 2;
    let far = (reach * 3.0) as u32 + 4;
    let mut distance = vec![0_u32; wide * (rows + 2)];
    let at = |pixel: usize| (pixel / width.max(1) + 1) * wide + pixel % width.max(1) + 1;
    for pixel in 0..relief.len() {
        if window.inside[pixel] && relief[pixel] < edge {
            distance[at(pixel)] = far;
        }
    }
    for pixel in 0..relief.len() {
        let p = at(pixel);
        let near =
            (distance[p - 1].min(distance[p - wide]) + 3).min(distance[p - wide - 1].min(distance[p - wide + 1]) + 4);
        distance[p] = distance[p].min(near);
    }
    for pixel in (0..relief.len()).rev() {
        let p = at(pixel);
        let near =
            (distance[p + 1].min(distance[p + wide]) + 3).min(distance[p + wide + 1].min(distance[p + wide - 1]) + 4);
        distance[p] = distance[p].min(near);
    }
    let slope = |pixel: usize| height * (1.0 - distance[at(pixel)] as f32 / 3.0 / reach).max(0.0);
    (0..relief.len()).map(|pixel| relief[pixel] + slope(pixel)).collect()
}

/// Adds `weight`² times the squared gradient of a plane at the foreground's pixels; differences over unknown values are
/// 0.
fn add_squared_gradient(plane: &[f32], window: &ForegroundWindow, weight: f32, sum: &mut [f32]) {
    let (width, height) = (window.width, window.height);
    let square = weight * weight / 4.0;
    for y in 0..height {
        let row = y * width;
        let (above, below) = (row - if y > 0 { width } else { 0 }, row + if y + 1 < height { width } else { 0 });
        for x in 0..width {
            if !window.inside[row + x] {
                continue;
            }
            let across = plane[row + (x + 1).min(width - 1)] - plane[row + x.saturating_sub(1)];
            let down = plane[below + x] - plane[above + x];
            let squared = across * across + down * down;
            if squared.is_finite() {
                sum[row + x] += square * squared;
            }
        }
    }
}

/// One half of a Gaussian's taps, from the centre out, of sum 1 over both sides.
fn gaussian(sigma: f32) -> Vec<f32> {
    let radius = (3.0 * sigma).ceil() as usize;
    let mut taps: Vec<f32> = (0..=radius).map(|at| (-0.5 * (at as f32 / sigma).powi(2)).exp()).collect();
    let sum = 2.0 * taps.iter().sum::<f32>() - taps[0];
    taps.iter_mut().for_each(|tap| *tap /= sum);
    taps
}

/// Smooths a plane in place, with zeros past its sides. Whole rows are added at a time, which the compiler vectorises.
fn blur(plane: &mut [f32], scratch: &mut [f32], width: usize, taps: &[f32]) {
    if width == 0 {
        return;
    }
    for (from, to) in plane.chunks_exact(width).zip(scratch.chunks_exact_mut(width)) {
        for (to, from) in to.iter_mut().zip(from) {
            *to = taps[0] * from;
        }
        for (at, &tap) in taps.iter().enumerate().skip(1).take_while(|(at, _)| *at < width) {
            for (to, from) in to.iter_mut().zip(&from[at..]) {
                *to += tap * from;
            }
            for (to, from) in to[at..].iter_mut().zip(from) {
                *to += tap * from;
            }
        }
    }
    let height = plane.len() / width;
    let source = |y: usize| &scratch[y * width..(y + 1) * width];
    for (y, to) in plane.chunks_exact_mut(width).enumerate() {
        for (to, from) in to.iter_mut().zip(source(y)) {
            *to = taps[0] * from;
        }
        for (at, &tap) in taps.iter().enumerate().skip(1) {
            for other in [y.checked_sub(at), Some(y + at).filter(|&other| other < height)].into_iter().flatten() {
                for (to, from) in to.iter_mut().zip(source(other)) {
                    *to += tap * from;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn jumps_of(value: impl Fn(f32, f32) -> f32, inside: impl Fn(f32, f32) -> bool) -> Vec<f32> {
        let at = |index: usize| ((index % 60) as f32, (index / 60) as f32);
        let window =
            ForegroundWindow { width: 60, height: 60, inside: (0..3600).map(|i| inside(at(i).0, at(i).1)).collect() };
        let values = (0..3600).map(|i| value(at(i).0, at(i).1)).collect();
        jumps(&window, &[Channel { values, known: None, weight: 1.0 }], &MasksConfig::default())
    }

    #[test]
    fn a_step_has_its_height_and_a_ramp_has_none() {
        let step = jumps_of(|x, _| if x < 30.0 { 0.2 } else { 0.5 }, |_, _| true);
        assert!((step[30 * 60 + 30] - 0.3).abs() < 0.02, "{}", step[30 * 60 + 30]);
        assert!(step[30 * 60 + 15] < 1e-3);
        let ramp = jumps_of(|x, y| 0.01 * x + 0.02 * y, |_, _| true);
        let worst = (12..48).map(|x| ramp[30 * 60 + x]).fold(0.0, f32::max);
        assert!(worst < 0.01, "{worst}");
    }

    #[test]
    fn the_silhouette_is_no_edge() {
        let disc = |x: f32, y: f32| (x - 30.0).hypot(y - 30.0) < 20.0;
        let flat = jumps_of(|x, y| if disc(x, y) { 0.7 } else { 0.0 }, disc);
        assert!(flat.iter().all(|&jump| jump < 1e-3));
    }

    #[test]
    fn a_gap_gets_a_saddle() {
        // A wall at column 20 with a gap of four pixels.
        let relief: Vec<f32> =
            (0..1600).map(|i| if i % 40 == 20 && !(18..22).contains(&(i / 40)) { 0.3 } else { 0.0 }).collect();
        let window = ForegroundWindow { width: 40, height: 40, inside: vec![true; 1600] };
        let gaps = MasksConfig { gap_edge: 0.1, gap_reach: 10.0, gap_height: 0.04, ..MasksConfig::default() };
        let closed = close_gaps(&window, &relief, &gaps);
        let row = &closed[20 * 40..21 * 40];
        assert!(row[20] > 0.02 && row[10] < 0.01 && row[30] < 0.01, "{row:?}");
        assert!(close_gaps(&ForegroundWindow { width: 0, height: 0, inside: Vec::new() }, &[], &gaps).is_empty());
    }

    #[test]
    fn unknown_values_make_no_edge() {
        let window = ForegroundWindow { width: 20, height: 20, inside: vec![true; 400] };
        let known: Vec<bool> = (0..400).map(|i| i % 20 < 10).collect();
        let values = known.iter().map(|&known| if known { 0.4 } else { f32::NAN }).collect();
        let found = jumps(&window, &[Channel { values, known: Some(known), weight: 1.0 }], &MasksConfig::default());
        assert!(found.iter().all(|&jump| jump < 1e-3));
    }
}
