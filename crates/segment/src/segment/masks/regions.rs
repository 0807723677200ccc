//! Masks of one rendered coarse segment from its picture alone: no network, no training.
//!
//! Background is where alpha is low. Each connected piece of the rest is a mask; inside a piece, jumps in colour, alpha
//! and (where given) depth cut it into basins, which join again over the weakest boundary first. Regions of that merge
//! tree that stay as they are over a range of boundary strengths become masks, from small to large and nested.
//! Smooth shading alone makes no boundary, so a lone blob stays whole.
//!
//! The steps are in `edges`, `watershed` and `merge`; here is the order of steps and the choice of regions.

use crate::config::types::segment::{MasksConfig, OutOfRange};
use thiserror::Error;

use super::{
    edges::{Channel, ForegroundWindow, close_gaps, jumps},
    filter::{fill_holes_rows, majority_rows, suppress},
    mask::{Mask, MaskError},
    merge::{Full, MergeNode, ranges, tree},
    watershed::{NONE, basins},
};

/// A rendered picture in the form that [`find_regions`] takes.
#[derive(Debug, Clone, PartialEq)]
pub struct RegionImage {
    width: u32,
    height: u32,
    /// Straight colour and alpha, `[height, width, 4]`, in [0, 1].
    rgba: Vec<f32>,
    /// `[height, width]`.
    depth: Option<Vec<f32>>,
}

/// What can be wrong with a picture or the options.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum RegionError {
    /// A buffer does not fit the size.
    #[error("{what} holds {found} values, but an image of {width}x{height} pixels needs {expected}")]
    Length {
        /// Which buffer.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The length that fits.
        expected: String,
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
    },
    /// An option is not a usable number.
    #[error(transparent)]
    Option(#[from] OutOfRange),
    /// The size is past what masks can hold.
    #[error(transparent)]
    Mask(#[from] MaskError),
}

/// A mask that [`find_regions`] found.
#[derive(Debug, Clone, PartialEq)]
pub struct RegionMask {
    /// The pixels.
    pub mask: Mask,
    /// By what fraction the inner boundaries are weaker than the outer one, 0 to 1; 1 for a smooth piece.
    pub stability_score: f32,
    /// Contrast of the outer boundary, 0 to 1; 1 for a whole connected piece.
    pub contrast: f32,
    /// How many of the other masks found contain this one; 0 for a whole connected piece.
    pub level: u32,
}

impl RegionImage {
    /// Creates a picture from values in [0, 1], of which non-finite ones count as 0: `[height, width, 4]` RGBA with
    /// straight alpha. `depth`, if known, is the expected depth `[height, width]` in any unit; values that are not
    /// finite and positive count as unknown.
    ///
    /// # Errors
    /// [`RegionError::Length`] if a buffer does not fit the size.
    pub fn from_rgba(width: u32, height: u32, rgba: &[f32], depth: Option<&[f32]>) -> Result<Self, RegionError> {
        Mask::empty(width, height)?;
        let count = width as usize * height as usize;
        let fail = |what, found, expected| Err(RegionError::Length { what, found, expected, width, height });
        let tame = |value: f32| if value.is_finite() { value.clamp(0.0, 1.0) } else { 0.0 };
        if rgba.len() != 4 * count {
            return fail("rgba", rgba.len(), (4 * count).to_string());
        }
        if let Some(depth) = depth.filter(|depth| depth.len() != count) {
            return fail("depth", depth.len(), count.to_string());
        }
        Ok(Self {
            width,
            height,
            rgba: rgba.iter().map(|&value| tame(value)).collect(),
            depth: depth.map(<[f32]>::to_vec),
        })
    }
}

/// Number of steps of the relief, and the jump of the last one.
const STEPS: usize = 200;
const TOP: f32 = 0.5;

/// Finds the masks of one picture, largest first. The same picture always gives the same masks.
///
/// # Errors
/// [`RegionError::Option`] for options out of range.
pub fn find_regions(image: &RegionImage, options: &MasksConfig) -> Result<Vec<RegionMask>, RegionError> {
    options.check()?;
    let Some((window, origin)) = cut(image, options.background_alpha) else { return Ok(Vec::new()) };
    let relief = jumps(&window, &channels(image, &window, origin), options);
    let closed = options.close_gaps.then(|| close_gaps(&window, &relief, options));
    let (labels, count) = basins(&window, closed.as_ref().unwrap_or(&relief), TOP, STEPS);
    let min_area = (options.min_area * (image.width * image.height) as f32 / 160_000.0).max(1.0);
    let full = Full { area: min_area, thickness: 2.0 * options.min_thickness };
    let nodes = tree(&window, &labels, count, &relief, full);
    let chosen = choose(&nodes, options, min_area);
    let (range, place) = ranges(&nodes, count);
    let places: Vec<u32> =
        labels.iter().map(|&label| if label == NONE { NONE } else { place[label as usize] }).collect();
    let mut found: Vec<RegionMask> = chosen
        .into_iter()
        .map(|index| {
            let node = &nodes[index as usize];
            let mask = paint(image, &window, origin, &places, node, (range[index as usize], min_area, options.smooth));
            let (stability_score, contrast) = scores(&nodes, node);
            RegionMask { mask, stability_score, contrast, level: 0 }
        })
        .filter(|region| region.mask.area() as f32 >= min_area)
        .collect();
    let masks: Vec<Mask> = found.iter().map(|region| region.mask.clone()).collect();
    let ranking: Vec<f32> = found.iter().map(|region| region.stability_score * region.contrast).collect();
    let mut kept = suppress(&masks, &ranking, options.duplicate_iou)?.into_iter().peekable();
    let mut index = 0;
    found.retain(|_| {
        let keep = kept.next_if_eq(&index).is_some();
        index += 1;
        keep
    });
    found.sort_by_key(|region| std::cmp::Reverse(region.mask.area()));
    for at in 1..found.len() {
        let area = found[at].mask.area();
        let mut level = 0;
        for larger in &found[..at] {
            // smoothing may move a few pixels across the border, so containing most of the mask is enough
            if larger.mask.area() > area && larger.mask.intersection_area(&found[at].mask)? * 10 >= area * 9 {
                level += 1;
            }
        }
        found[at].level = level;
    }
    Ok(found)
}

/// The foreground in its box, and the box's corner; `None` if there is no foreground.
fn cut(image: &RegionImage, threshold: f32) -> Option<(ForegroundWindow, [usize; 2])> {
    let (across, down) = (image.width as usize, image.height as usize);
    let covered = |x: usize, y: usize| image.rgba[(y * across + x) * 4 + 3] >= threshold.max(f32::MIN_POSITIVE);
    let rows = (0..down).filter(|&y| (0..across).any(|x| covered(x, y)));
    let (top, bottom) = rows.fold((usize::MAX, 0), |(top, _), y| (top.min(y), y + 1));
    let (mut left, mut right) = (across, 0);
    for y in top..bottom {
        left = (0..left).find(|&x| covered(x, y)).unwrap_or(left);
        right = (right..across).rev().find(|&x| covered(x, y)).map_or(right, |x| x + 1);
    }
    if left >= right {
        return None;
    }
    let inside = (top..bottom).flat_map(|y| (left..right).map(move |x| (x, y))).map(|(x, y)| covered(x, y)).collect();
    Some((ForegroundWindow { width: right - left, height: bottom - top, inside }, [left, top]))
}

/// Brightness, two colour differences, alpha and, where given, depth.
fn channels(image: &RegionImage, window: &ForegroundWindow, [left, top]: [usize; 2]) -> Vec<Channel> {
    let across = image.width as usize;
    let pixels = || (0..window.height).flat_map(|y| (0..window.width).map(move |x| (top + y) * across + left + x));
    let plane = |value: &dyn Fn(&[f32]) -> f32| pixels().map(|pixel| value(&image.rgba[pixel * 4..][..4])).collect();
    let colour = |weight: f32, mix: [f32; 3], over: f32| Channel {
        // colours as seen over white: where little is covered, the straight colour means little
        values: plane(&|p| p[3] * (mix[0] * p[0] + mix[1] * p[1] + mix[2] * p[2]) + (1.0 - p[3]) * over),
        known: None,
        weight,
    };
    let seen = if image.depth.is_some() { 0.7 } else { 1.0 };
    let mut channels = vec![
        colour(seen, [0.299, 0.587, 0.114], 1.0),
        colour(seen * 0.7, [-0.299, -0.587, 0.886], 0.0),
        colour(seen * 0.7, [0.701, -0.587, -0.114], 0.0),
        Channel { values: plane(&|p| p[3]), known: None, weight: seen * 0.5 },
    ];
    if let Some(depth) = &image.depth {
        let values: Vec<f32> = pixels().map(|pixel| depth[pixel]).collect();
        let known: Vec<bool> =
            values.iter().zip(&window.inside).map(|(&d, &inside)| inside && d.is_finite() && d > 0.0).collect();
        let mut sorted: Vec<f32> = values.iter().zip(&known).filter(|(_, known)| **known).map(|(&d, _)| d).collect();
        if !sorted.is_empty() {
            sorted.sort_unstable_by(f32::total_cmp);
            let at = |part: f32| sorted[((sorted.len() - 1) as f32 * part) as usize];
            // A thin slice of a scene has a small range of depths; its noise must not pass for jumps.
            let range = (at(0.98) - at(0.02)).max(0.02 * at(0.5));
            let values = values.iter().map(|&d| (d - at(0.02)) / range).collect();
            channels.push(Channel { values, known: Some(known), weight: 1.5 });
        }
    }
    channels
}

/// Stability and contrast of a region.
fn scores(nodes: &[MergeNode], node: &MergeNode) -> (f32, f32) {
    match node.parent {
        Some(parent) => {
            let outer = nodes[parent as usize].born;
            (1.0 - node.born / outer.max(f32::MIN_POSITIVE), (outer / TOP).min(1.0))
        }
        None => (1.0 - (node.born / TOP).min(1.0), 1.0),
    }
}

/// The regions to make masks of: whole pieces, and those that persist over a range of strengths.
fn choose(nodes: &[MergeNode], options: &MasksConfig, min_area: f32) -> Vec<u32> {
    let wanted = |node: &MergeNode| {
        node.area as f32 >= min_area
            && node.parent.is_none_or(|parent| {
                let outer = nodes[parent as usize].born;
                node.thickness() >= options.min_thickness
                    && outer >= options.contrast
                    && outer - node.born >= options.persistence * outer
            })
    };
    (0..nodes.len() as u32).filter(|&index| wanted(&nodes[index as usize])).collect()
}

/// The mask of a region, with `smooth` its outline smoothed and small holes filled.
fn paint(
    image: &RegionImage,
    window: &ForegroundWindow,
    origin: [usize; 2],
    places: &[u32],
    node: &MergeNode,
    (range, min_area, smooth): ([u32; 2], f32, bool),
) -> Mask {
    let [left, top, right, bottom] = node.bounds.map(|side| side as usize);
    let (across, down) = (right - left, bottom - top);
    let mut set = Vec::with_capacity(across * down);
    for y in top..bottom {
        let row = &places[y * window.width + left..y * window.width + right];
        set.extend(row.iter().map(|&place| range[0] <= place && place < range[1]));
    }
    // A whole piece keeps its silhouette as it is, and no other region grows over it.
    if smooth && node.parent.is_some() {
        set = majority_rows(across, down, &set);
        fill_holes_rows(across, &mut set, (min_area / 4.0) as u64);
        for (row, set) in set.chunks_exact_mut(across).enumerate() {
            let start = (top + row) * window.width + left;
            set.iter_mut().zip(&window.inside[start..]).for_each(|(set, &inside)| *set &= inside);
        }
    }
    let bounds = [left + origin[0], top + origin[1], across, down].map(|side| side as u32);
    Mask::from_window(image.width, image.height, bounds, &set)
}

#[cfg(test)]
mod tests;
