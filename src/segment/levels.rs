//! The levels of parts and wholes that exist at a click, and the one that is likeliest meant: no label is seen, only the
//! 2D masks that the field was trained on.
//!
//! Each view that shows the clicked Gaussian says which masks lie over it, from small to large, and the 3D scale of each.
//! Where these scales gather there is a level. At the scale of a level, what is like the click is held against the masks of
//! that level in all of these views; the threshold that agrees best is taken. So neither scale nor threshold is a number
//! that fits one scene and not the next.

use super::fine::evidence::Evidence;
use super::fine::network::FEATURES;
use super::pick::{Asked, PickError};

/// Cosines that are tried as thresholds, descending.
const THRESHOLDS: [f32; 11] = [0.95, 0.9, 0.85, 0.8, 0.75, 0.7, 0.65, 0.6, 0.55, 0.5, 0.4];
/// Fits so near to the best one count as equal; the middle of them is taken.
const EQUAL: f64 = 0.01;
/// Part of a pixel's colour from which the clicked Gaussian is seen there ...
const SEEN: f32 = 0.05;
/// ... in at least so many views; else what is nearly the same as it counts too, ...
const VIEWS: usize = 5;
/// ... from this cosine at the smallest scale.
const SAME: f32 = 0.97;
/// Width of the kernel by which scales gather.
const WIDTH: f32 = 0.05;
/// A gathering with fewer of the views than this part is none.
const LEAST: f32 = 0.15;
/// Levels, at most.
const LEVELS: usize = 5;
/// Selections that have this part of their union in common are one level.
const ALIKE: f64 = 0.85;
/// A level whose fit is below this part of the best one's is not the likeliest.
const WORTH: f64 = 0.9;
/// A level that holds more than this part of what is looked at says nothing, if there is a smaller one.
const ALL: f64 = 0.95;

/// A part or whole that a click can mean.
#[derive(Clone, Debug, PartialEq)]
pub struct Level {
    /// Mask scale in [0, 1].
    pub scale: f32,
    /// Cosine from which a Gaussian is like the clicked one.
    pub threshold: f32,
    /// Mean intersection over union with the masks of this level, over the views that have one.
    pub agreement: f64,
    /// Views that have one.
    pub views: usize,
    /// Which of those looked at are like the clicked one, ascending.
    pub members: Vec<u32>,
}

/// The levels at a click, from small to large, and the position of the likeliest; empty where no view shows it.
///
/// # Errors
/// If `clicked` is not among `within` (indices, ascending).
///
/// # Panics
/// If a member of `within`, or a Gaussian of the evidence, is not below N.
pub fn levels(asked: &Asked<'_>, within: &[u32], clicked: u32) -> Result<(Vec<Level>, usize), PickError> {
    let outside = |_| PickError::Outside { clicked, count: within.len() };
    let position = within.binary_search(&clicked).map_err(outside)?;
    let (evidence, count) = (asked.evidence, asked.places.len() / 3);
    let means: Vec<f32> = within.iter().flat_map(|&i| &asked.places[3 * i as usize..][..3]).copied().collect();
    let encoded = asked.frame.encode(&means);
    let cosines = |scale: f32| -> Vec<f32> {
        let features = asked.field.features(&encoded, scale);
        let of = &features[position * FEATURES..][..FEATURES];
        features.chunks_exact(FEATURES).map(|row| row.iter().zip(of).map(|(a, b)| a * b).sum()).collect()
    };
    let mut mark = vec![0.0; count];
    mark[clicked as usize] = 1.0;
    let mut voters = voters(evidence, &mark);
    if voters.len() < VIEWS {
        for (&i, cosine) in within.iter().zip(cosines(0.0)) {
            mark[i as usize] = f32::from(u8::from(cosine >= SAME || i == clicked));
        }
        voters = self::voters(evidence, &mark);
    }
    let mut found: Vec<Level> = Vec::new();
    let mut selected = vec![false; count];
    for scale in gatherings(evidence, &voters) {
        let cosines = cosines(scale);
        let masks: Vec<Target> = voters.iter().filter_map(|&p| Target::of(evidence, p, scale)).collect();
        let fits: Vec<f64> = THRESHOLDS
            .iter()
            .map(|&threshold| {
                within.iter().zip(&cosines).for_each(|(&i, &c)| selected[i as usize] = c >= threshold);
                masks.iter().map(|m| m.fit(evidence, &selected)).sum::<f64>() / masks.len().max(1) as f64
            })
            .collect();
        let (threshold, agreement) = middle_of_best(&fits);
        let mut members: Vec<u32> =
            within.iter().zip(&cosines).filter(|(_, c)| **c >= threshold).map(|(&i, _)| i).collect();
        // rounding must not part the clicked one from itself
        if let Err(place) = members.binary_search(&clicked) {
            members.insert(place, clicked);
        }
        let level = Level { scale, threshold, agreement, views: masks.len(), members };
        match found.iter_mut().find(|l| overlap(&l.members, &level.members) >= ALIKE) {
            Some(same) if same.agreement < level.agreement => *same = level,
            Some(_) => {}
            None => found.push(level),
        }
        within.iter().for_each(|&i| selected[i as usize] = false);
    }
    found.sort_by(|a, b| a.members.len().cmp(&b.members.len()).then(a.scale.total_cmp(&b.scale)));
    let likeliest = likeliest(&found, within.len());
    Ok((found, likeliest))
}

/// For each view the pixel in which what is marked (`[N]`, weights) has the largest part, if it is seen there.
fn voters(evidence: &Evidence, mark: &[f32]) -> Vec<usize> {
    let mut best: Vec<(u32, usize, f32)> = Vec::new();
    for p in 0..evidence.len() {
        let (indices, weights) = evidence.pixels.row(p);
        let part: f32 = indices.iter().zip(weights).map(|(&i, w)| mark[i as usize] * w).sum();
        if part < SEEN {
            continue;
        }
        match best.last_mut() {
            Some((view, at, most)) if *view == evidence.views[p] => {
                if part > *most {
                    (*at, *most) = (p, part);
                }
            }
            _ => best.push((evidence.views[p], p, part)),
        }
    }
    best.into_iter().map(|(_, p, _)| p).collect()
}

/// Scales just below those where the scales of the masks over the voting pixels gather, which are the strongest maxima of
/// their density; ascending. A scale means the masks that are not below it.
fn gatherings(evidence: &Evidence, voters: &[usize]) -> Vec<f32> {
    const STEPS: usize = 200;
    let scales: Vec<f32> = voters.iter().flat_map(|&p| evidence.covering(p).1).copied().collect();
    let at = |step: usize| step as f32 / STEPS as f32;
    let density: Vec<f32> =
        (0..=STEPS).map(|step| scales.iter().map(|s| (-0.5 * ((at(step) - s) / WIDTH).powi(2)).exp()).sum()).collect();
    let least = (LEAST * voters.len() as f32).max(1.0);
    let mut peaks: Vec<(f32, f32)> = (0..=STEPS)
        .filter(|&k| {
            let (before, after) =
                (k.checked_sub(1).map_or(0.0, |b| density[b]), density.get(k + 1).copied().unwrap_or(0.0));
            density[k] >= least && density[k] > before && density[k] >= after
        })
        .map(|k| (at(k), density[k]))
        .collect();
    peaks.sort_by(|a, b| b.1.total_cmp(&a.1));
    peaks.truncate(LEVELS);
    peaks.sort_by(|a, b| a.0.total_cmp(&b.0));
    peaks.into_iter().map(|(scale, _)| (scale - WIDTH).max(0.0)).collect()
}

/// The pixels of a view, and which of them one mask covers.
struct Target {
    pixels: std::ops::Range<usize>,
    covered: Vec<bool>,
}

impl Target {
    /// The mask of pixel `p` at `scale`, as training chooses it: the smallest one not below it, or else the largest.
    fn of(evidence: &Evidence, p: usize, scale: f32) -> Option<Self> {
        let (masks, scales) = evidence.covering(p);
        let mask = masks.iter().zip(scales).find(|(_, s)| **s >= scale).map(|(m, _)| *m).or(masks.last().copied())?;
        let view = evidence.views[p];
        let start = evidence.views.partition_point(|v| *v < view);
        let end = evidence.views.partition_point(|v| *v <= view);
        let covered = (start..end).map(|p| evidence.covering(p).0.contains(&mask)).collect();
        Some(Self { pixels: start..end, covered })
    }

    /// Intersection over union of the mask and of the pixels of which what is `selected` makes up most.
    fn fit(&self, evidence: &Evidence, selected: &[bool]) -> f64 {
        let (mut both, mut either) = (0u32, 0u32);
        for (p, &covered) in self.pixels.clone().zip(&self.covered) {
            let (indices, weights) = evidence.pixels.row(p);
            let (mut part, mut whole) = (0.0, 0.0);
            for (&i, &w) in indices.iter().zip(weights) {
                whole += w;
                part += if selected[i as usize] { w } else { 0.0 };
            }
            let shown = part > 0.5 * whole;
            both += u32::from(shown && covered);
            either += u32::from(shown || covered);
        }
        if either == 0 { 0.0 } else { f64::from(both) / f64::from(either) }
    }
}

/// The threshold in the middle of the run of nearly best fits around the best one, and the best fit.
fn middle_of_best(fits: &[f64]) -> (f32, f64) {
    let mut best = 0;
    for (k, fit) in fits.iter().enumerate() {
        if *fit > fits[best] {
            best = k;
        }
    }
    let near = |k: &usize| fits[*k] >= fits[best] - EQUAL;
    let first = (0..=best).rev().take_while(near).last().unwrap_or(best);
    let last = (best..fits.len()).take_while(near).last().unwrap_or(best);
    (THRESHOLDS[(first + last) / 2], fits[best])
}

/// Intersection over union of two ascending lists.
fn overlap(a: &[u32], b: &[u32]) -> f64 {
    let both = a.iter().filter(|i| b.binary_search(i).is_ok()).count();
    let either = a.len() + b.len() - both;
    if either == 0 { 1.0 } else { both as f64 / either as f64 }
}

/// The largest level whose masks agree nearly as well as those of any, but not all that is looked at.
fn likeliest(levels: &[Level], looked_at: usize) -> usize {
    let all = |l: &Level| l.members.len() as f64 > ALL * looked_at as f64;
    let said = |l: &&Level| !all(l);
    let best = levels.iter().filter(said).map(|l| l.agreement).fold(0.0, f64::max);
    let fits = |l: &Level| !all(l) && l.agreement >= WORTH * best;
    levels.iter().rposition(fits).unwrap_or(levels.len().saturating_sub(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::DeviceName;
    use crate::segment::balls::{APART, COUNT};
    use crate::segment::fine::network::Frame;
    use crate::segment::fine::train::{FineOptions, train};
    use crate::segment::pick::{Meaning, PickOptions, pick};

    #[test]
    fn a_click_on_a_ball_tells_the_ball_and_both_and_means_the_ball() {
        let device = DeviceName::all()[0].open().unwrap();
        let at = APART.gaussians();
        let views = APART.prepared(&at);
        let options = FineOptions { steps: 300, pixels: 256, ..FineOptions::default() };
        let field = train(&views, &options, &device, |_, _| true).unwrap();
        let (frame, evidence) = (Frame::around(&at.means), Evidence::of(&views, 0));
        let asked = Asked { field: &field, frame: &frame, places: &at.means, evidence: &evidence };
        let all: Vec<u32> = (0..at.len() as u32).collect();
        let balls = [&all[..COUNT], &all[COUNT..]];
        for clicked in [3, 31, COUNT as u32 + 7] {
            let mine = balls[usize::from(clicked as usize >= COUNT)];
            let (found, likeliest) = levels(&asked, &all, clicked).unwrap();
            assert!((2..=3).contains(&found.len()), "{found:?}");
            assert!(overlap(&found[likeliest].members, mine) > 0.95, "{:?}", found[likeliest]);
            assert!(overlap(&found.last().unwrap().members, &all) > 0.95);
            assert!(found[likeliest].agreement > 0.9 && found[likeliest].views >= 4);
            assert!(found.iter().all(|l| l.members.binary_search(&clicked).is_ok()));
            // the same selection by its numbers
            let Level { scale, threshold, .. } = found[likeliest];
            let by_hand = PickOptions { meaning: Meaning::By { scale, threshold }, keep_strays: true };
            let picked = pick(&asked, &at, &all, clicked, &by_hand).unwrap();
            assert_eq!(picked.members, found[likeliest].members);
            let picked = pick(&asked, &at, &all, clicked, &PickOptions::default()).unwrap();
            assert_eq!((picked.level, picked.scale, picked.threshold), (Some(likeliest), scale, threshold));
            let largest = PickOptions { meaning: Meaning::Level(9), ..PickOptions::default() };
            let picked = pick(&asked, &at, &all, clicked, &largest).unwrap();
            assert_eq!(picked.level, Some(found.len() - 1));
        }
        assert!(levels(&asked, &all[1..], 0).is_err());
        let nothing = Evidence::default();
        let (none, likeliest) = levels(&Asked { evidence: &nothing, ..asked }, &all, 0).unwrap();
        assert!(none.is_empty() && likeliest == 0);
    }

    #[test]
    fn the_middle_of_equal_thresholds_is_taken() {
        let mut fits = [0.2; THRESHOLDS.len()];
        (fits[3], fits[4], fits[5]) = (0.895, 0.9, 0.893);
        assert_eq!(middle_of_best(&fits), (THRESHOLDS[4], 0.9));
        fits[8] = 0.9;
        assert_eq!(middle_of_best(&fits).0, THRESHOLDS[4], "another run counts for itself");
        assert_eq!(middle_of_best(&[f64::NAN; 11]).0, THRESHOLDS[0]);
    }

    #[test]
    fn the_largest_that_fits_is_meant_but_not_all() {
        let level = |count: u32, agreement: f64| Level {
            scale: 0.5,
            threshold: 0.8,
            agreement,
            views: 9,
            members: (0..count).collect(),
        };
        assert_eq!(likeliest(&[level(5, 0.8), level(20, 0.75), level(100, 1.0)], 100), 1);
        assert_eq!(likeliest(&[level(5, 0.9), level(20, 0.5), level(100, 1.0)], 100), 0);
        assert_eq!(likeliest(&[level(100, 1.0)], 100), 0);
        assert_eq!(likeliest(&[], 100), 0);
    }
}
