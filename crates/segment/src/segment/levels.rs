//! The levels of parts and wholes at a click, and the likeliest one; no ground-truth label is used.
//!
//! Three levels are wholes: the connected piece of the segment at the click, the whole segment, such as all of one colour,
//! and the object of several colours that the clicked part belongs to, see [`super::nested`].
//!
//! Within a segment, such as a colour, the likeliest level is its connected piece that contains the clicked Gaussian: a
//! connected piece of one colour is mostly one object, unless the affinity separates objects that touch (see
//! [`super::objects`]) or the piece has a neck (see [`super::necks`]). Then the clicked part is the likeliest, and the
//! whole piece is the next level. In a whole scene, where objects touch each other, it is a plateau of the affinity.
//!
//! The set of Gaussians similar to the clicked one grows as the minimum cosine falls. When it reaches the edge of an
//! object it stops growing for a while, as features are similar within a mask and differ between masks: such a plateau
//! is a level. Plateaus are sought at several mask scales, so neither the scale nor the cosine is a number tuned to one
//! scene. (Levels of a component tree are chosen in the same way in images: maximally stable extremal regions.)

use super::candidates::{ClickCandidates, total};
use super::pick::PickError;
use crate::config::types::segment::LevelsConfig;
use schemars::JsonSchema;
use serde::Serialize;

/// Maximum number of pieces whose parts are found before a click, see [`prepare`].
const PIECES: usize = 8;

/// What makes Gaussians one level.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[schemars(rename = "LevelKind")]
pub enum LevelKind {
    /// Their affinity with the clicked one.
    #[default]
    Similar,
    /// They are the clicked part of the connected piece, where that has several.
    Part,
    /// They are the connected piece of the searched segment at the click.
    Piece,
    /// They are the searched segment.
    Segment,
    /// They are one object with the clicked part, whatever segments they are in, see [`ClickCandidates::object`].
    Object,
}

impl LevelKind {
    /// The kinds that need no affinity, from parts to wholes.
    pub const SPATIAL: [Self; 4] = [Self::Part, Self::Piece, Self::Segment, Self::Object];

    /// The word for it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Similar => "similar",
            Self::Part => "part",
            Self::Piece => "piece",
            Self::Segment => "segment",
            Self::Object => "object",
        }
    }
}

/// A part or whole that a click can mean.
#[derive(Clone, Debug, PartialEq)]
pub struct Level {
    /// What makes its Gaussians one.
    pub kind: LevelKind,
    /// Mask scale in [0, 1]; 1 unless it is [`LevelKind::Similar`].
    pub scale: f32,
    /// Minimum cosine with the clicked Gaussian; -1 unless it is [`LevelKind::Similar`].
    pub threshold: f32,
    /// Fraction of its weight, in (0, 1], that remains if the cosine rises by 0.05; 1 unless it is [`LevelKind::Similar`].
    pub stability: f64,
    /// Its fraction of what the whole scene shows, in [0, 1].
    pub share: f64,
    /// Its Gaussians, ascending.
    pub members: Vec<u32>,
}

/// Returns the levels at a click on the Gaussian `clicked`, from small to large, and the position of the likeliest.
/// There is at least one. Unless the candidates are the whole scene, the segment is among them, the piece at the click,
/// and the clicked part of that if it has several; and the object, parts of which may be no candidates.
/// Gaussians are weighted by [`ClickCandidates::shown`].
///
/// # Errors
/// If `clicked` is not among the candidates, or the arrays of the Gaussians disagree.
///
/// # Panics
/// If an index of a candidate is not below N.
pub fn levels(of: &ClickCandidates<'_>, clicked: u32) -> Result<(Vec<Level>, usize), PickError> {
    let (mut found, best) = of_affinity(of, clicked)?;
    let spatial = in_space(of, clicked)?;
    let wholes = wholes(of, clicked)?;
    let likeliest = match spatial.first() {
        Some(level) => {
            found.retain(|l| {
                spatial.iter().chain(&wholes).all(|s| overlap(&l.members, &s.members) < of.config.levels.alike)
            });
            level.kind
        }
        None => LevelKind::Similar,
    };
    let mut at = if likeliest == LevelKind::Similar { best } else { 0 };
    for level in spatial.into_iter().chain(wholes) {
        let place = found.partition_point(|l| l.members.len() <= level.members.len());
        if level.kind == likeliest {
            at = place;
        } else if place <= at {
            at += 1;
        }
        found.insert(place, level);
    }
    Ok((found, at))
}

/// Returns the likeliest of the [`levels`], without computing the others where it is the piece or a part of it.
///
/// # Errors
/// As [`levels`].
///
/// # Panics
/// As [`levels`].
pub fn likeliest(of: &ClickCandidates<'_>, clicked: u32) -> Result<Level, PickError> {
    if let Some(level) = in_space(of, clicked)?.into_iter().next() {
        return Ok(level);
    }
    let (mut found, best) = of_affinity(of, clicked)?;
    Ok(found.swap_remove(best))
}

/// Computes in advance what a click on any candidate needs, so that it is answered at once: the features, and the parts
/// of the largest pieces. Those of small pieces are left to the click.
///
/// # Errors
/// If the arrays of the Gaussians disagree.
///
/// # Panics
/// If an index of a candidate is not below N.
pub fn prepare(of: &ClickCandidates<'_>) -> Result<(), PickError> {
    of.shown();
    let config = &of.config.levels;
    if config.plateaus {
        config.scales.iter().for_each(|&scale| drop(of.features(scale)));
    }
    if of.whole {
        return Ok(());
    }
    let pieces = of.pieces()?;
    let large =
        pieces.counts.iter().take(PIECES).take_while(|&&count| count as usize * config.one_in >= of.within.len());
    for (piece, _) in (1..).zip(large) {
        let members = of.within.iter().zip(&pieces.labels).filter(|(_, label)| **label == piece).map(|(&i, _)| i);
        of.parts(piece, &members.collect::<Vec<_>>())?;
    }
    Ok(())
}

/// Returns the plateaus of the affinity, from small to large, at least one, and the position of the likeliest. Without
/// plateaus, it is the selection at one scale and cosine.
fn of_affinity(of: &ClickCandidates<'_>, clicked: u32) -> Result<(Vec<Level>, usize), PickError> {
    let (within, position) = (of.within, of.position(clicked)?);
    let shown = of.shown();
    let weights: Vec<f64> = within.iter().map(|&i| shown[i as usize]).collect();
    let total = total(&weights);
    let config = &of.config.levels;
    if !config.plateaus {
        let (scale, threshold) = (config.scale, config.cosine);
        let like = of.alike(position, scale, threshold);
        let members: Vec<u32> = within.iter().zip(like).filter(|(_, like)| *like).map(|(&i, _)| i).collect();
        let share = of.share(members.iter().map(|&i| shown[i as usize]).sum());
        return Ok((vec![Level { kind: LevelKind::Similar, scale, threshold, stability: 1.0, share, members }], 0));
    }
    let mut found: Vec<Level> = Vec::new();
    for &scale in &config.scales {
        let cosines = of.cosines(position, scale);
        let sizes = sizes(&cosines, &weights, weights[position], config);
        for (k, stability) in plateaus(&sizes, config) {
            let threshold = cosine(k, config);
            let like = |(n, _): &(usize, &u32)| cosines[*n] >= threshold || *n == position;
            let members: Vec<u32> = within.iter().enumerate().filter(like).map(|(_, &i)| i).collect();
            // of the candidates, by which the likeliest is found
            let share = (sizes[k] / total).min(1.0);
            let level = Level { kind: LevelKind::Similar, scale, threshold, stability, share, members };
            match found.iter_mut().find(|l| overlap(&l.members, &level.members) >= config.alike) {
                Some(same) if same.stability < level.stability => *same = level,
                Some(_) => {}
                None => found.push(level),
            }
        }
    }
    found.sort_by(|a, b| a.members.len().cmp(&b.members.len()).then(a.scale.total_cmp(&b.scale)));
    let best = most_likely(&found, config);
    found.iter_mut().for_each(|level| level.share = of.share(level.share * total));
    Ok((found, best))
}

/// Returns a level that needs no affinity.
fn level_of(of: &ClickCandidates<'_>, kind: LevelKind, members: Vec<u32>) -> Level {
    let shown = of.shown();
    let share = of.share(members.iter().map(|&i| shown[i as usize]).sum());
    Level { kind, scale: 1.0, threshold: -1.0, stability: 1.0, share, members }
}

/// Returns the levels that may be more than the piece: the segment, unless the whole scene is searched, and the object.
fn wholes(of: &ClickCandidates<'_>, clicked: u32) -> Result<Vec<Level>, PickError> {
    let segment = Some(of.within.to_vec()).filter(|_| !of.whole).map(|all| (LevelKind::Segment, all));
    let object = Some(of.object(clicked)?).filter(|all| !all.is_empty()).map(|all| (LevelKind::Object, all));
    Ok(segment.into_iter().chain(object).map(|(kind, members)| level_of(of, kind, members)).collect())
}

/// Returns the spatial levels at a click: the clicked part of the piece if it has several, then the piece; none in a
/// whole scene, if pieces are no levels, or if the clicked Gaussian is in no piece.
fn in_space(of: &ClickCandidates<'_>, clicked: u32) -> Result<Vec<Level>, PickError> {
    let position = of.position(clicked)?;
    if of.whole || !of.config.levels.pieces {
        return Ok(Vec::new());
    }
    let labels = &of.pieces()?.labels;
    let mine = labels[position];
    if mine == 0 {
        return Ok(Vec::new());
    }
    let piece: Vec<u32> = of.within.iter().zip(labels).filter(|(_, label)| **label == mine).map(|(&i, _)| i).collect();
    let parts = of.parts(mine, &piece)?;
    let own = piece.binary_search(&clicked).map_or(1, |k| parts[k]);
    let part: Vec<u32> = piece.iter().zip(parts.iter()).filter(|(_, p)| **p == own).map(|(&i, _)| i).collect();
    let part = Some(part).filter(|part| part.len() < piece.len()).map(|part| level_of(of, LevelKind::Part, part));
    Ok(part.into_iter().chain([level_of(of, LevelKind::Piece, piece)]).collect())
}

fn cosine(k: usize, config: &LevelsConfig) -> f32 {
    config.lowest + config.step * k as f32
}

/// Returns the weight of the Gaussians with at least each of the cosines, falling; never below the weight
/// of the clicked one.
fn sizes(cosines: &[f32], weights: &[f64], clicked: f64, config: &LevelsConfig) -> Vec<f64> {
    // so that growth can be measured at one of them at least
    let count = config.cosines.max(2 * config.reach + 1);
    let mut bins = vec![0.0; count];
    for (&cosine, &weight) in cosines.iter().zip(weights) {
        let bin = ((cosine - config.lowest) / config.step).floor();
        if bin >= 0.0 {
            bins[(bin as usize).min(count - 1)] += weight;
        }
    }
    for k in (0..count - 1).rev() {
        bins[k] += bins[k + 1];
    }
    bins.iter().map(|size| size.max(clicked).max(f64::MIN_POSITIVE)).collect()
}

/// Finds where the selection grows least: positions of the maxima of stability, with their stability; the best one if
/// none is stable.
fn plateaus(sizes: &[f64], config: &LevelsConfig) -> Vec<(usize, f64)> {
    let reach = config.reach;
    let stability = |k: usize| sizes[k + reach] / sizes[k - reach];
    let all: Vec<(usize, f64)> = (reach..sizes.len() - reach).map(|k| (k, stability(k))).collect();
    let highest = |n: &usize| {
        let near = |m: Option<&(usize, f64)>| m.is_none_or(|m| m.1 <= all[*n].1);
        all[*n].1 >= config.stable && near(n.checked_sub(1).and_then(|m| all.get(m))) && near(all.get(n + 1))
    };
    let found: Vec<(usize, f64)> = (0..all.len()).filter(highest).map(|n| all[n]).collect();
    if !found.is_empty() {
        return found;
    }
    all.into_iter().reduce(|best, next| if next.1 > best.1 { next } else { best }).into_iter().collect()
}

/// Intersection over union of two ascending lists.
fn overlap(a: &[u32], b: &[u32]) -> f64 {
    let both = a.iter().filter(|i| b.binary_search(i).is_ok()).count();
    let either = a.len() + b.len() - both;
    if either == 0 { 1.0 } else { both as f64 / either as f64 }
}

/// Returns the position of the most stable level, with a slight preference for larger ones and against taking
/// everything.
fn most_likely(levels: &[Level], config: &LevelsConfig) -> usize {
    let (size, rest) = (config.size_exponent, config.rest_exponent);
    let score = |l: &Level| l.stability * l.share.powf(size) * (1.0 - l.share).max(1e-6).powf(rest);
    let mut best = 0;
    for (n, level) in levels.iter().enumerate() {
        if score(level) > score(&levels[best]) {
            best = n;
        }
    }
    best
}

#[cfg(test)]
#[path = "levels_tests.rs"]
mod tests;
