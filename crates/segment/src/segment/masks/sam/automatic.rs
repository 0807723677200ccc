//! Masks of everything in an image: a grid of points, and which of their candidate masks are kept.

use super::super::filter::suppress_by;
use super::image::Enlarger;
use super::{Embedding, Mask, Sam, SamError, SamPrompt};
use rayon::prelude::*;
use std::convert::Infallible;

/// Which of a point's candidates are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum KeptCandidates {
    /// The one of the highest predicted quality.
    MostConfident,
    /// All.
    All,
}

/// How masks are found and filtered.
#[derive(Debug, Clone, PartialEq)]
pub struct AutomaticOptions {
    /// Points along a side of the grid.
    pub points_per_side: usize,
    /// Points that go through the mask decoder together, several such batches at once; affects time and memory (some 30
    /// MB per point), not the result.
    pub points_per_batch: usize,
    /// Which of a point's candidates are kept.
    pub keep: KeptCandidates,
    /// Masks are kept above this predicted intersection over union.
    pub predicted_iou: f32,
    /// Minimum stability of the masks that are kept, see [`stability_score`].
    pub stability: f32,
    /// How far the logits' threshold is moved up and down for the stability.
    pub stability_offset: f32,
    /// Of two masks whose boxes' intersection over union is above this, the one of lower predicted quality is dropped.
    pub box_overlap: f32,
}

impl Default for AutomaticOptions {
    fn default() -> Self {
        Self {
            points_per_side: 32,
            points_per_batch: 4,
            keep: KeptCandidates::MostConfident,
            predicted_iou: 0.88,
            stability: 0.95,
            stability_offset: 1.0,
            box_overlap: 0.7,
        }
    }
}

/// A mask of the automatic mode.
#[derive(Debug, Clone, PartialEq)]
pub struct SamMask {
    /// At the image's size.
    pub mask: Mask,
    /// The network's guess of the intersection over union with the true mask.
    pub predicted_iou: f32,
    /// See [`stability_score`].
    pub stability: f32,
    /// The point that prompted it, x and y in pixels.
    pub point: [f32; 2],
    /// Left, top, right, bottom of the set pixels, inclusive.
    pub bounds: [u32; 4],
}

/// Centres of `n` by `n` equal cells of a `width` by `height` image, row by row, `[x, y]` in pixels.
pub fn point_grid(n: usize, width: usize, height: usize) -> Vec<[f32; 2]> {
    let at = |i: usize, size: usize| ((i as f64 + 0.5) / n as f64 * size as f64) as f32;
    (0..n * n).map(|i| [at(i % n, width), at(i / n, height)]).collect()
}

/// Indices of the candidates to keep, by one point's predicted qualities: those above `threshold`; NaN never is.
pub fn select_candidates(iou: &[f32], keep: KeptCandidates, threshold: f32) -> Vec<usize> {
    let above = (0..iou.len()).filter(|&i| iou[i] > threshold);
    match keep {
        KeptCandidates::All => above.collect(),
        // the first of equals
        KeptCandidates::MostConfident => above.rev().max_by(|&a, &b| iou[a].total_cmp(&iou[b])).into_iter().collect(),
    }
}

/// Intersection over union of the masks above `offset` and above `-offset`: how little the edge moves with the
/// threshold. 0 if nothing is set.
pub fn stability_score(logits: &[f32], offset: f32) -> f32 {
    let above = |limit: f32| logits.iter().filter(|&&v| v > limit).count();
    let (inner, outer) = (above(offset), above(-offset));
    if outer == 0 { 0.0 } else { (inner as f64 / outer as f64) as f32 }
}

/// Left, top, right, bottom of the set pixels, inclusive; `None` if nothing is set.
pub fn pixel_bounds(mask: &Mask) -> Option<[u32; 4]> {
    let [left, top, width, height] = mask.bbox();
    (width > 0).then(|| [left, top, left + width - 1, top + height - 1])
}

/// Intersection over union of boxes as left, top, right, bottom; 0 for boxes without area.
fn box_iou(a: [u32; 4], b: [u32; 4]) -> f32 {
    let side = |low: u32, high: u32| u64::from(high.saturating_sub(low));
    let area = |b: [u32; 4]| side(b[0], b[2]) * side(b[1], b[3]);
    let both = [a[0].max(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].min(b[3])];
    let shared = area(both);
    if shared == 0 { 0.0 } else { (shared as f64 / (area(a) + area(b) - shared) as f64) as f32 }
}

/// Non-maximum suppression: goes through the boxes by descending score and keeps those that overlap none kept before
/// by more than `threshold`. Returns their indices in that order; of equal scores the first comes first.
pub fn suppress_boxes(boxes: &[[u32; 4]], scores: &[f32], threshold: f32) -> Vec<usize> {
    let duplicates = |index: usize, other: usize| Ok::<_, Infallible>(box_iou(boxes[other], boxes[index]) > threshold);
    let Ok(kept) = suppress_by(boxes.len().min(scores.len()), scores, duplicates);
    kept
}

/// The mask of full-size logits `[height, width]`, unless it is unstable or empty.
fn judge(
    logits: &[f32],
    size: [usize; 2],
    iou: f32,
    point: [f32; 2],
    options: &AutomaticOptions,
) -> Result<Option<SamMask>, SamError> {
    let stability = stability_score(logits, options.stability_offset);
    let set: Vec<bool> = logits.iter().map(|&v| v > 0.0).collect();
    let mask = Mask::from_rows(size[0] as u32, size[1] as u32, &set)?;
    let bounds = pixel_bounds(&mask).filter(|_| stability >= options.stability);
    Ok(bounds.map(|bounds| SamMask { mask, predicted_iou: iou, stability, point, bounds }))
}

/// The masks that a batch of points finds, before duplicates are removed.
fn of_points(
    sam: &Sam,
    image: &Embedding,
    points: &[[f32; 2]],
    options: &AutomaticOptions,
) -> Result<Vec<SamMask>, SamError> {
    let prompts: Vec<SamPrompt> = points.iter().map(|&p| SamPrompt::point(p)).collect();
    let prediction = sam.predict(image, &prompts, true)?;
    let enlarger = Enlarger::new(prediction.side, image.frame());
    let mut found = Vec::new();
    for (i, iou) in prediction.iou.chunks_exact(prediction.candidates).enumerate() {
        for candidate in select_candidates(iou, options.keep, options.predicted_iou) {
            let logits = enlarger.enlarge(prediction.candidate(i, candidate));
            found.extend(judge(&logits, image.frame().original, iou[candidate], points[i], options)?);
        }
    }
    Ok(found)
}

/// Finds masks of everything in an RGB image `[height, width, 3]`, best predicted quality first.
///
/// # Errors
/// [`SamError::Option`] for a grid or batch of no points, and those of [`Sam::encode`] and [`Sam::predict`].
pub fn generate(
    sam: &Sam,
    rgb: &[u8],
    width: usize,
    height: usize,
    options: &AutomaticOptions,
) -> Result<Vec<SamMask>, SamError> {
    for (field, value) in [("points_per_side", options.points_per_side), ("points_per_batch", options.points_per_batch)]
    {
        if value == 0 {
            return Err(SamError::Option { field });
        }
    }
    let image = sam.encode(rgb, width, height)?;
    let of_batch = |points: &[[f32; 2]]| of_points(sam, &image, points, options);
    let points = point_grid(options.points_per_side, width, height);
    let batches = points.par_chunks(options.points_per_batch).map(of_batch);
    let found: Vec<SamMask> = batches.collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect();
    let boxes: Vec<[u32; 4]> = found.iter().map(|m| m.bounds).collect();
    let scores: Vec<f32> = found.iter().map(|m| m.predicted_iou).collect();
    let order = suppress_boxes(&boxes, &scores, options.box_overlap);
    let mut found: Vec<Option<SamMask>> = found.into_iter().map(Some).collect();
    Ok(order.into_iter().filter_map(|i| found[i].take()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_grid_lies_in_the_middle_of_cells() {
        assert_eq!(point_grid(2, 8, 4), [[2.0, 1.0], [6.0, 1.0], [2.0, 3.0], [6.0, 3.0]]);
        assert_eq!(point_grid(1, 7, 3), [[3.5, 1.5]]);
        assert_eq!(point_grid(32, 64, 64).len(), 1024);
    }

    #[test]
    fn the_most_confident_or_all() {
        let best = |iou: &[f32], limit| select_candidates(iou, KeptCandidates::MostConfident, limit);
        assert_eq!(best(&[0.5, 0.97, 0.9], 0.88), [1]);
        assert_eq!(best(&[0.9, 0.9, 0.9], 0.88), [0]);
        assert!(best(&[0.88, 0.3, 0.1], 0.88).is_empty());
        assert_eq!(best(&[f32::NAN, 0.9, 0.2], 0.88), [1]);
        assert!(best(&[], 0.0).is_empty());
        assert_eq!(select_candidates(&[0.9, f32::NAN, 0.95, 0.1], KeptCandidates::All, 0.88), [0, 2]);
    }

    #[test]
    fn stability_is_the_share_that_stays() {
        assert_eq!(stability_score(&[5.0, 0.5, -0.5, -5.0], 1.0), 1.0 / 3.0);
        assert_eq!(stability_score(&[2.0, 1.0, -1.0, -5.0], 1.0), 0.5);
        assert_eq!(stability_score(&[-5.0; 4], 1.0), 0.0);
        assert_eq!(stability_score(&[f32::NAN, 3.0], 1.0), 1.0);
        assert_eq!(stability_score(&[], 1.0), 0.0);
    }

    #[test]
    fn bounds_are_inclusive() {
        let rows = ["....", ".##.", "...#", "...."];
        let set: Vec<bool> = rows.iter().flat_map(|r| r.bytes().map(|b| b == b'#')).collect();
        let bounds = |width, height, set: &[bool]| pixel_bounds(&Mask::from_rows(width, height, set).unwrap());
        assert_eq!(bounds(4, 4, &set), Some([1, 1, 3, 2]));
        assert_eq!(bounds(3, 2, &[false; 6]), None);
        assert_eq!(bounds(0, 0, &[]), None);
    }

    #[test]
    fn the_better_of_two_overlapping_boxes_stays() {
        let boxes = [[0, 0, 10, 10], [0, 0, 10, 9], [20, 20, 30, 30], [0, 0, 10, 7]];
        assert_eq!(suppress_boxes(&boxes, &[0.9, 0.95, 0.99, 0.91], 0.7), [2, 1]);
        // 0.7 itself is not above 0.7
        assert_eq!(suppress_boxes(&[boxes[0], boxes[3]], &[0.9, 0.8], 0.7), [0, 1]);
        assert_eq!(suppress_boxes(&[boxes[0]; 3], &[0.9; 3], 0.7), [0]);
        // boxes of a single pixel have no area and overlap nothing
        assert_eq!(suppress_boxes(&[[3, 3, 3, 3]; 2], &[0.9; 2], 0.7), [0, 1]);
    }

    #[test]
    fn unstable_and_empty_masks_go() {
        let options = AutomaticOptions::default();
        let verdict = |logits: &[f32]| judge(logits, [2, 2], 0.9, [1.0, 1.0], &options).unwrap();
        assert!(verdict(&[9.0, 0.5, -9.0, -9.0]).is_none());
        assert!(verdict(&[-9.0; 4]).is_none());
        assert!(verdict(&[f32::NAN; 4]).is_none());
        let kept = verdict(&[-9.0, 9.0, -9.0, 9.0]).unwrap();
        assert_eq!((kept.mask.counts, kept.bounds, kept.stability), (vec![2, 2], [1, 0, 1, 1], 1.0));
    }

    proptest! {
        #[test]
        fn kept_boxes_overlap_little(
            boxes in prop::collection::vec((0_u32..20, 0_u32..20, 0_u32..20, 0_u32..20), 0..30),
            scores in prop::collection::vec(0.0_f32..1.0, 30),
        ) {
            let boxes: Vec<[u32; 4]> = boxes.iter().map(|&(x, y, w, h)| [x, y, x + w, y + h]).collect();
            let kept = suppress_boxes(&boxes, &scores, 0.7);
            for (n, &a) in kept.iter().enumerate() {
                for &b in &kept[..n] {
                    prop_assert!(box_iou(boxes[a], boxes[b]) <= 0.7);
                    prop_assert!(scores[b] >= scores[a]);
                }
            }
            for i in 0..boxes.len() {
                prop_assert!(kept.iter().any(|&k| k == i || box_iou(boxes[k], boxes[i]) > 0.7));
            }
        }
    }
}
