//! Basins of a relief: every pixel of the foreground goes to the minimum that it drains to.
//!
//! Vincent and Soille's flooding in its variant without watershed pixels, on the relief in steps. Independent of what
//! the relief means.

use super::edges::{ForegroundWindow, sides};

/// Label of pixels outside the foreground.
pub(super) const NONE: u32 = u32::MAX;

/// Basins of `relief` (`[height, width]`, values from 0 up), which is cut into `steps` equal steps up to `top`.
/// Returns a label per pixel, counted from 0 in the order of flooding, and how many there are.
/// Pixels are neighbours by their sides, so no basin spans two components of the foreground.
pub(super) fn basins(window: &ForegroundWindow, relief: &[f32], top: f32, steps: usize) -> (Vec<u32>, usize) {
    let last = steps.max(1) - 1;
    // The cast takes NaN to 0 and keeps within 0 to `last`.
    let step_of = |pixel: usize| ((relief[pixel] / top * steps as f32) as usize).min(last);
    let inside: Vec<u32> =
        (0..window.inside.len()).filter(|&pixel| window.inside[pixel]).map(|pixel| pixel as u32).collect();
    let mut starts = vec![0_usize; steps.max(1) + 1];
    for &pixel in &inside {
        starts[step_of(pixel as usize) + 1] += 1;
    }
    for step in 1..starts.len() {
        starts[step] += starts[step - 1];
    }
    let mut fill = starts.clone();
    let mut ordered = vec![0_u32; inside.len()];
    for &pixel in &inside {
        let place = &mut fill[step_of(pixel as usize)];
        ordered[*place] = pixel;
        *place += 1;
    }

    let mut labels = vec![NONE; window.inside.len()];
    let mut count = 0;
    let mut queue: Vec<u32> = Vec::new();
    for step in 0..=last {
        let level = &ordered[starts[step]..starts[step + 1]];
        // First the basins known so far grow into this step, ring by ring, so that a plateau is shared fairly.
        queue.clear();
        for &pixel in level {
            if let Some(label) =
                neighbours(window, pixel as usize).map(|next| labels[next]).find(|&label| label != NONE)
            {
                queue.push(pixel);
                // Set after the scan, so that a pixel of this ring does not feed its neighbour in it.
                queue.push(label);
            }
        }
        let mut ring = std::mem::take(&mut queue);
        while !ring.is_empty() {
            for pair in ring.chunks_exact(2) {
                if labels[pair[0] as usize] == NONE {
                    labels[pair[0] as usize] = pair[1];
                }
            }
            for pair in ring.chunks_exact(2) {
                for next in neighbours(window, pair[0] as usize) {
                    if labels[next] == NONE && step_of(next) <= step {
                        queue.extend([next as u32, labels[pair[0] as usize]]);
                    }
                }
            }
            ring.clear();
            std::mem::swap(&mut ring, &mut queue);
        }
        // What is left at this step are new minima.
        for &pixel in level {
            if labels[pixel as usize] != NONE {
                continue;
            }
            labels[pixel as usize] = count;
            queue.push(pixel);
            while let Some(pixel) = queue.pop() {
                for next in neighbours(window, pixel as usize) {
                    if labels[next] == NONE && step_of(next) <= step {
                        labels[next] = count;
                        queue.push(next as u32);
                    }
                }
            }
            count += 1;
        }
    }
    (labels, count as usize)
}

/// The foreground pixels at the four sides.
fn neighbours(window: &ForegroundWindow, pixel: usize) -> impl Iterator<Item = usize> + '_ {
    sides(pixel, window.width, window.inside.len()).into_iter().flatten().filter(|&next| window.inside[next])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_minimum_gets_its_side_of_the_ridge() {
        let relief = [0.1, 0.2, 0.9, 0.3, 0.0, 0.2].repeat(3);
        let window = ForegroundWindow { width: 6, height: 3, inside: vec![true; 18] };
        let (labels, count) = basins(&window, &relief, 1.0, 64);
        assert_eq!(count, 2);
        assert_eq!(labels[0], labels[1]);
        assert_eq!(labels[3], labels[5]);
        assert_ne!(labels[0], labels[4]);
        assert!(!labels.contains(&NONE));
    }

    #[test]
    fn a_plateau_is_shared() {
        let relief = [0.0, 0.5, 0.5, 0.5, 0.5, 0.0];
        let window = ForegroundWindow { width: 6, height: 1, inside: vec![true; 6] };
        assert_eq!(basins(&window, &relief, 1.0, 10).0, [0, 0, 0, 1, 1, 1]);
    }

    #[test]
    fn components_stay_apart_and_non_finite_values_are_accepted() {
        let inside = vec![true, true, false, true, true];
        let window = ForegroundWindow { width: 5, height: 1, inside };
        let (labels, count) = basins(&window, &[f32::NAN, 0.1, 0.0, f32::INFINITY, -1.0], 1.0, 8);
        assert_eq!((labels[2], count), (NONE, 2));
        let nothing = ForegroundWindow { width: 0, height: 0, inside: Vec::new() };
        assert_eq!(basins(&nothing, &[], 1.0, 8), (Vec::new(), 0));
    }
}
