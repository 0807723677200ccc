//! Clean-up of masks: duplicates, specks, ragged outlines and holes.
//!
//! Works on lists of masks of one image and on buffers of pixels; where they come from does not matter.

use super::mask::{Mask, MaskError};
use super::watershed::sides;

/// Drops masks that nearly equal one of a higher score (non-maximum suppression by mask IoU).
///
/// Goes down the list by score (ties: the earlier first; NaN counts lowest) and keeps a mask if its IoU with every mask
/// kept so far is at most `threshold`. Returns the indices kept, ascending. Scores missing at the end count lowest.
///
/// # Errors
/// [`MaskError::SizeMismatch`] if the masks differ in size.
pub fn suppress(masks: &[Mask], scores: &[f32], threshold: f64) -> Result<Vec<usize>, MaskError> {
    let score = |index: usize| scores.get(index).copied().filter(|score| !score.is_nan()).unwrap_or(f32::NEG_INFINITY);
    let mut order: Vec<usize> = (0..masks.len()).collect();
    order.sort_by(|&a, &b| score(b).total_cmp(&score(a)).then(a.cmp(&b)));
    let sizes: Vec<(u64, [u32; 4])> = masks.iter().map(|mask| (mask.area(), mask.bbox())).collect();
    let mut kept: Vec<usize> = Vec::new();
    'masks: for index in order {
        let (area, bounds) = sizes[index];
        for &other in &kept {
            let (other_area, other_bounds) = sizes[other];
            // the overlap is at most the smaller mask and that of the boxes, so most pairs need no look at runs
            let most = area.min(other_area).min(overlap(bounds, other_bounds));
            let same_size = masks[index].width == masks[other].width && masks[index].height == masks[other].height;
            let hopeless = most as f64 <= threshold * (area + other_area - most) as f64;
            if (!same_size || !hopeless) && masks[index].iou(&masks[other])? > threshold {
                continue 'masks;
            }
        }
        kept.push(index);
    }
    kept.sort_unstable();
    Ok(kept)
}

/// Smooths the outline in a row-major buffer `[height, width]`: a pixel is set if most of the 3x3 pixels around it are.
/// Pixels outside the buffer count as clear. The box of a mask is therefore enough: no pixel outside it can be set, as
/// at most 3 of its 9 are in the box.
pub(super) fn majority_rows(width: usize, height: usize, set: &[bool]) -> Vec<bool> {
    // a border of clear pixels saves the tests at the sides
    let wide = width + 2;
    let mut across = vec![0_u8; wide * (height + 2)];
    for y in 0..height {
        let row = &set[y * width..(y + 1) * width];
        let sums = &mut across[(y + 1) * wide..(y + 2) * wide];
        for (x, &set) in row.iter().enumerate() {
            let value = u8::from(set);
            sums[x] += value;
            sums[x + 1] += value;
            sums[x + 2] += value;
        }
    }
    let at =
        |x: usize, y: usize| across[y * wide + x + 1] + across[(y + 1) * wide + x + 1] + across[(y + 2) * wide + x + 1];
    (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| at(x, y) >= 5).collect()
}

/// Fills the holes of at most `max_area` pixels in a row-major buffer `[height, width]`: clear areas, connected by
/// sides, that do not touch the border. The box of a mask is therefore enough: a clear area that touches its sides is
/// open to the outside.
pub(super) fn fill_holes_rows(width: usize, height: usize, set: &mut [bool], max_area: u64) {
    let mut seen = set.to_vec();
    let mut area = Vec::new();
    for start in 0..set.len() {
        if seen[start] {
            continue;
        }
        seen[start] = true;
        area.clear();
        area.push(start);
        let (mut next, mut open) = (0, false);
        while let Some(&pixel) = area.get(next) {
            next += 1;
            let sides = sides(pixel, width, width * height);
            open |= sides.contains(&None);
            for other in sides.into_iter().flatten() {
                if !seen[other] {
                    seen[other] = true;
                    area.push(other);
                }
            }
        }
        if !open && area.len() as u64 <= max_area {
            area.iter().for_each(|&pixel| set[pixel] = true);
        }
    }
}

fn overlap(a: [u32; 4], b: [u32; 4]) -> u64 {
    let shared = |at: usize| {
        let end = (u64::from(a[at]) + u64::from(a[at + 2])).min(u64::from(b[at]) + u64::from(b[at + 2]));
        end.saturating_sub(u64::from(a[at].max(b[at])))
    };
    shared(0) * shared(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Columns, rows and pixels.
    fn rows(text: &str) -> (usize, usize, Vec<bool>) {
        let rows: Vec<&str> = text.split('/').collect();
        let set = rows.iter().flat_map(|row| row.chars().map(|c| c == '#')).collect();
        (rows[0].len(), rows.len(), set)
    }

    fn draw(text: &str) -> Mask {
        let (width, height, set) = rows(text);
        Mask::from_rows(width as u32, height as u32, &set).unwrap()
    }

    #[test]
    fn near_duplicates_are_removed_and_the_best_stays() {
        let masks = [draw("####/####"), draw("###./####"), draw("##../##.."), draw("..../...#")];
        assert_eq!(suppress(&masks, &[0.5, 0.9, 0.1, 0.2], 0.8).unwrap(), [1, 2, 3]);
        assert_eq!(suppress(&masks, &[0.5, f32::NAN, 0.1], 0.8).unwrap(), [0, 2, 3]);
        assert_eq!(suppress(&masks, &[1.0; 4], 0.3).unwrap(), [0, 3]);
        assert!(suppress(&[draw("##"), draw("##/##")], &[], 0.5).is_err());
    }

    #[test]
    fn majority_takes_specks_and_fills_pinholes() {
        let smooth = |text| {
            let (width, height, set) = rows(text);
            majority_rows(width, height, &set)
        };
        assert_eq!(smooth("...../.#.../...../....."), [false; 20]);
        assert!(smooth("#####/##.##/#####")[7]);
    }

    #[test]
    fn only_closed_small_holes_are_filled() {
        let filled = |text, max_area| {
            let (width, height, mut set) = rows(text);
            fill_holes_rows(width, height, &mut set, max_area);
            set
        };
        let ring = "......./.#####./.#...#./.#####./.......";
        assert_eq!(filled(ring, 3), rows("......./.#####./.#####./.#####./.......").2);
        assert_eq!(filled(ring, 2), rows(ring).2);
        let open = "#####/#...#/##.##";
        assert_eq!(filled(open, 100), rows(open).2);
    }

    proptest! {
        #[test]
        fn majority_and_hole_filling_match_brute_force(set in proptest::collection::vec(any::<bool>(), 63)) {
            let smooth = majority_rows(9, 7, &set);
            for y in 0..7_i32 {
                for x in 0..9_i32 {
                    let near = (-1..2).flat_map(|dy| (-1..2).map(move |dx| (x + dx, y + dy)));
                    let votes = near.filter(|&(x, y)| (0..9).contains(&x) && (0..7).contains(&y) && set[(y * 9 + x) as usize]).count();
                    prop_assert_eq!(smooth[(y * 9 + x) as usize], votes >= 5);
                }
            }
            let mut filled = set.clone();
            fill_holes_rows(9, 7, &mut filled, 63);
            // clear pixels that are joined to the border stay clear, and no others
            let mut open: Vec<bool> =
                (0..63_usize).map(|p| !set[p] && (p % 9 == 0 || p % 9 == 8 || !(9..54).contains(&p))).collect();
            for _ in 0..63 {
                for p in (9..54_usize).filter(|p| (1..8).contains(&(p % 9))) {
                    let joined = open[p - 9] || open[p - 1] || open[p + 1] || open[p + 9];
                    open[p] |= joined && !set[p];
                }
            }
            prop_assert_eq!(filled, open.iter().map(|open| !open).collect::<Vec<_>>());
        }

        #[test]
        fn the_box_of_a_mask_is_enough(set in proptest::collection::vec(any::<bool>(), 63)) {
            let mask = Mask::from_rows(9, 7, &set).unwrap();
            let bounds = mask.bbox();
            let (width, height, window) = (bounds[2] as usize, bounds[3] as usize, mask.window(bounds));
            let smooth = majority_rows(width, height, &window);
            prop_assert_eq!(Mask::from_window(9, 7, bounds, &smooth).to_rows(), majority_rows(9, 7, &set));
            let (mut part, mut whole) = (window, set);
            fill_holes_rows(width, height, &mut part, 63);
            fill_holes_rows(9, 7, &mut whole, 63);
            prop_assert_eq!(Mask::from_window(9, 7, bounds, &part).to_rows(), whole);
        }
    }
}
