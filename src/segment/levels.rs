//! The levels of parts and wholes at a click, and the one that is likeliest meant; no label is seen.
//!
//! Within a segment, such as a colour, the likeliest is all of it that hangs together with the click: what has one
//! colour and is in one piece mostly is one thing, unless the affinity tells things apart that touch (see
//! [`super::things`]) or it has a neck (see [`super::necks`]): then the one is meant that was clicked, and the whole piece is the next
//! level. In a whole scene, whose things touch each other, it is a plateau of
//! the affinity.
//!
//! What is like the clicked Gaussian grows as the cosine that is asked for falls. Where it has reached the edge of a
//! thing it stops growing for a while, as what belongs to one mask has like features and what belongs to another does
//! not: such a plateau is a level. It is looked for at several mask scales, so neither scale nor cosine is a number
//! that fits one scene and not the next. (Levels of a component tree are chosen so in images: maximally stable extremal
//! regions.)

use super::candidates::Candidates;
use super::pick::PickError;

/// Mask scales that are looked at.
const SCALES: [f32; 5] = [0.1, 0.3, 0.5, 0.7, 0.9];
/// The lowest cosine; those of other masks were trained to be below 0.5.
const LOWEST: f32 = 0.45;
/// Step between cosines.
const STEP: f32 = 0.025;
/// Cosines from [`LOWEST`] on.
const COSINES: usize = 22;
/// Steps to either side over which growth is looked at.
const REACH: usize = 1;
/// What shrinks to less than this part over that way is no level.
const STABLE: f64 = 0.5;
/// Selections that have this part of their union in common are one level.
const ALIKE: f64 = 0.85;
/// How much a larger level is preferred to a more stable one: power of its share of what is looked at ...
const LARGE: f64 = 0.1;
/// ... and how much one that leaves something out is to one that takes all: power of the rest.
const NOT_ALL: f64 = 0.3;

/// Pieces whose parts are found before a click, see [`prepare`] ...
const PIECES: usize = 8;
/// ... if they hold a Gaussian of so many at least.
const SMALL: usize = 50;

/// A part or whole that a click can mean.
#[derive(Clone, Debug, PartialEq)]
pub struct Level {
    /// Mask scale in [0, 1].
    pub scale: f32,
    /// Cosine from which a Gaussian is like the clicked one; -1 where none is asked for.
    pub threshold: f32,
    /// Whether it is what hangs together with the click, or the part of that which is one thing, whatever the cosine.
    pub piece: bool,
    /// What stays of it if the cosine rises by 0.05, part of its weight in (0, 1].
    pub stability: f64,
    /// Its part of the weight of what is looked at, in (0, 1].
    pub share: f64,
    /// Its Gaussians, ascending.
    pub members: Vec<u32>,
}

/// The levels at a click on the Gaussian `clicked`, from small to large, and the position of the likeliest. There is
/// one at least; the piece, and the part of it if it has several, are among them where the candidates are not the whole
/// scene. Gaussians weigh what they show,
/// see [`Candidates::shown`].
///
/// # Errors
/// If `clicked` is not among the candidates, or the arrays of the Gaussians disagree.
///
/// # Panics
/// If an index of a candidate is not below N.
pub fn levels(of: &Candidates<'_>, clicked: u32) -> Result<(Vec<Level>, usize), PickError> {
    let mut found = of_affinity(of, clicked)?;
    let spatial = in_space(of, clicked)?;
    if spatial.is_empty() {
        let likeliest = most_likely(&found);
        return Ok((found, likeliest));
    }
    found.retain(|l| spatial.iter().all(|s| overlap(&l.members, &s.members) < ALIKE));
    let mut likeliest = 0;
    for level in spatial.into_iter().rev() {
        likeliest = found.partition_point(|l| l.members.len() < level.members.len());
        found.insert(likeliest, level);
    }
    Ok((found, likeliest))
}

/// The likeliest of the [`levels`], without looking for the others where it is the piece or a part of it.
///
/// # Errors
/// As [`levels`].
///
/// # Panics
/// As [`levels`].
pub fn likeliest(of: &Candidates<'_>, clicked: u32) -> Result<Level, PickError> {
    if let Some(level) = in_space(of, clicked)?.into_iter().next() {
        return Ok(level);
    }
    let mut found = of_affinity(of, clicked)?;
    Ok(found.swap_remove(most_likely(&found)))
}

/// Finds out what a click on any of the candidates needs, so that it is answered at once: their features, and the parts of
/// the largest pieces. Small ones are left to the click.
///
/// # Errors
/// If the arrays of the Gaussians disagree.
///
/// # Panics
/// If an index of a candidate is not below N.
pub fn prepare(of: &Candidates<'_>) -> Result<(), PickError> {
    of.shown();
    SCALES.into_iter().for_each(|scale| drop(of.features(scale)));
    if is_whole(of) {
        return Ok(());
    }
    let pieces = of.pieces()?;
    let large = pieces.counts.iter().take(PIECES).take_while(|&&count| count as usize * SMALL >= of.within.len());
    for (piece, _) in (1..).zip(large) {
        let members = of.within.iter().zip(&pieces.labels).filter(|(_, label)| **label == piece).map(|(&i, _)| i);
        of.parts(piece, &members.collect::<Vec<_>>())?;
    }
    Ok(())
}

/// Whether the candidates are the whole scene, of which no piece is meant.
fn is_whole(of: &Candidates<'_>) -> bool {
    of.within.len() == of.at.len()
}

/// The plateaus of the affinity, from small to large; one at least.
fn of_affinity(of: &Candidates<'_>, clicked: u32) -> Result<Vec<Level>, PickError> {
    let (within, position) = (of.within, of.position(clicked)?);
    let weights = of.shown();
    let total: f64 = weights.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    let mut found: Vec<Level> = Vec::new();
    for scale in SCALES {
        let cosines = of.cosines(position, scale);
        let sizes = sizes(&cosines, weights, weights[position]);
        for (k, stability) in plateaus(&sizes) {
            let threshold = cosine(k);
            let like = |(n, _): &(usize, &u32)| cosines[*n] >= threshold || *n == position;
            let members: Vec<u32> = within.iter().enumerate().filter(like).map(|(_, &i)| i).collect();
            let level =
                Level { scale, threshold, piece: false, stability, share: (sizes[k] / total).min(1.0), members };
            match found.iter_mut().find(|l| overlap(&l.members, &level.members) >= ALIKE) {
                Some(same) if same.stability < level.stability => *same = level,
                Some(_) => {}
                None => found.push(level),
            }
        }
    }
    found.sort_by(|a, b| a.members.len().cmp(&b.members.len()).then(a.scale.total_cmp(&b.scale)));
    Ok(found)
}

/// What a click means by space: the part of the piece that is one thing if there are several, and the piece; nothing in a
/// whole scene, or if the clicked one is nowhere.
fn in_space(of: &Candidates<'_>, clicked: u32) -> Result<Vec<Level>, PickError> {
    let position = of.position(clicked)?;
    if is_whole(of) {
        return Ok(Vec::new());
    }
    let labels = &of.pieces()?.labels;
    let mine = labels[position];
    if mine == 0 {
        return Ok(Vec::new());
    }
    let weights = of.shown();
    let all = weights.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    let level = |rows: &[usize]| {
        let share = (rows.iter().map(|&n| weights[n]).sum::<f64>() / all).min(1.0);
        let members = rows.iter().map(|&n| of.within[n]).collect();
        Level { scale: 1.0, threshold: -1.0, piece: true, stability: 1.0, share, members }
    };
    let rows: Vec<usize> = (0..labels.len()).filter(|&n| labels[n] == mine).collect();
    let piece = level(&rows);
    let parts = of.parts(mine, &piece.members)?;
    let own = rows.binary_search(&position).map_or(1, |k| parts[k]);
    let part: Vec<usize> = rows.iter().zip(parts.iter()).filter(|(_, p)| **p == own).map(|(&n, _)| n).collect();
    Ok(if part.len() < rows.len() { vec![level(&part), piece] } else { vec![piece] })
}

fn cosine(k: usize) -> f32 {
    LOWEST + STEP * k as f32
}

/// The weight of what has at least each of the cosines, `[COSINES]`, falling; never below that of the clicked one.
fn sizes(cosines: &[f32], weights: &[f64], clicked: f64) -> Vec<f64> {
    let mut bins = [0.0; COSINES];
    for (&cosine, &weight) in cosines.iter().zip(weights) {
        let bin = ((cosine - LOWEST) / STEP).floor();
        if bin >= 0.0 {
            bins[(bin as usize).min(COSINES - 1)] += weight;
        }
    }
    for k in (0..COSINES - 1).rev() {
        bins[k] += bins[k + 1];
    }
    bins.iter().map(|size| size.max(clicked).max(f64::MIN_POSITIVE)).collect()
}

/// Where what is selected grows least: positions of the maxima of stability, with it; the best one if none is stable.
fn plateaus(sizes: &[f64]) -> Vec<(usize, f64)> {
    let stability = |k: usize| sizes[k + REACH] / sizes[k - REACH];
    let all: Vec<(usize, f64)> = (REACH..sizes.len() - REACH).map(|k| (k, stability(k))).collect();
    let highest = |n: &usize| {
        let near = |m: Option<&(usize, f64)>| m.is_none_or(|m| m.1 <= all[*n].1);
        all[*n].1 >= STABLE && near(n.checked_sub(1).and_then(|m| all.get(m))) && near(all.get(n + 1))
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

/// The most stable level, larger ones a little before smaller ones, but not all that is looked at if it can be helped.
fn most_likely(levels: &[Level]) -> usize {
    let score = |l: &Level| l.stability * l.share.powf(LARGE) * (1.0 - l.share).max(1e-6).powf(NOT_ALL);
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
