//! The levels of parts and wholes at a click, and the one that is likeliest meant; no label is seen.
//!
//! Within a segment, such as a colour, the likeliest is all of it that hangs together with the click: what has one
//! colour and is in one piece mostly is one thing, unless it has a neck: then it is things that touch, and the one is
//! meant that was clicked (see [`super::necks`]); the whole piece is the next level. In a whole scene, whose things touch each other, it is a plateau of
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
    /// Whether it is what hangs together with the click, or the part of that between necks, whatever the affinity.
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

/// What a click means by space alone: the part between necks if there are several, and the piece; nothing in a whole
/// scene, or if the clicked one is nowhere.
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
mod tests {
    use super::*;
    use crate::device::DeviceName;
    use crate::segment::balls::{APART, COUNT, surfaces};
    use crate::segment::fine::AffinityField;
    use crate::segment::fine::network::Frame;
    use crate::segment::fine::train::{FineOptions, train};
    use crate::segment::pick::{Meaning, PickOptions, pick};

    #[test]
    fn a_click_on_a_ball_means_the_ball_and_the_levels_are_what_pick_takes() {
        let device = DeviceName::all()[0].open().unwrap();
        let at = APART.gaussians();
        // the first few hundred steps go by before the features of the balls part
        let options = FineOptions { steps: 2000, pixels: 64, ..FineOptions::default() };
        let field = train(&APART.prepared(&at), &options, &device, |_, _| true).unwrap();
        let frame = Frame::around(&at.means);
        let of = |within| Candidates::new(&field, &frame, &at.means, &at, within);
        let all: Vec<u32> = (0..at.len() as u32).collect();
        let balls = [&all[..COUNT], &all[COUNT..]];
        for clicked in [3, 31, COUNT as u32 + 7] {
            let mine = balls[usize::from(clicked as usize >= COUNT)];
            let (found, likeliest) = levels(&of(&all), clicked).unwrap();
            assert!(overlap(&found[likeliest].members, mine) > 0.9, "{:?}", found[likeliest]);
            assert!(found.iter().all(|l| l.members.binary_search(&clicked).is_ok()));
            assert!(found.is_sorted_by_key(|l| l.members.len()));
            let Level { scale, threshold, .. } = found[likeliest];
            let take =
                |meaning, list| pick(&of(&all), clicked, &PickOptions { meaning, keep_strays: true, list }).unwrap();
            let by_hand = Meaning::By { scale, threshold };
            assert_eq!(take(by_hand, false).members, found[likeliest].members);
            assert_eq!(take(by_hand, true).levels, found);
            assert_eq!(take(Meaning::Likeliest, false).members, found[likeliest].members);
            let picked = take(Meaning::Likeliest, true);
            assert_eq!((picked.level, &picked.members), (Some(likeliest), &found[likeliest].members));
            assert_eq!(picked.levels, found);
            assert_eq!(take(Meaning::Level(likeliest), false).members, found[likeliest].members);
            assert_eq!(take(Meaning::Level(99), false).level, Some(found.len() - 1), "there are no more");
            assert_eq!(levels(&of(&all), clicked).unwrap(), (found, likeliest), "the same twice");
        }
        assert!(levels(&of(&all[1..]), 0).is_err());
        assert_eq!(levels(&of(&[5]), 5).unwrap().0[0].members, [5], "alone");
        // in a segment that holds the first ball and half of the second, the piece is the first ball
        let most = &all[..COUNT + COUNT / 2];
        let (found, likeliest) = levels(&of(most), 31).unwrap();
        assert!(
            found[likeliest].piece && overlap(&found[likeliest].members, balls[0]) > 0.95,
            "{:?}",
            found[likeliest]
        );
        let options = PickOptions { meaning: Meaning::Likeliest, keep_strays: true, list: true };
        let picked = pick(&of(most), 31, &options).unwrap();
        assert_eq!((picked.level, &picked.members), (Some(likeliest), &found[likeliest].members));
        let alone = pick(&of(most), 31, &PickOptions { list: false, ..options }).unwrap();
        assert_eq!(alone.members, picked.members, "the piece is found without the others");
    }

    #[test]
    fn a_click_on_one_of_two_beads_that_touch_means_it_and_the_next_level_is_both() {
        let device = DeviceName::all()[0].open().unwrap();
        // a third one far away, so that the beads are not the whole scene
        let (at, bead_of) = surfaces(&[(-0.9, 1.0), (0.9, 1.0), (9.0, 0.5)]);
        let (field, frame) = (AffinityField::new(1, &device), Frame::around(&at.means));
        let within: Vec<u32> = (0..at.len() as u32).filter(|&i| bead_of[i as usize] < 2).collect();
        let of = Candidates::new(&field, &frame, &at.means, &at, &within);
        for bead in 0..2 {
            let own: Vec<u32> = within.iter().copied().filter(|&i| bead_of[i as usize] == bead).collect();
            let clicked = own[own.len() / 2];
            let (found, n) = levels(&of, clicked).unwrap();
            assert!(found[n].piece && overlap(&found[n].members, &own) > 0.9, "{bead}");
            assert!(found[n + 1..].iter().any(|l| l.piece && l.members == within), "both together are a level too");
            assert_eq!(likeliest(&of, clicked).unwrap(), found[n]);
        }
    }

    #[test]
    fn a_plateau_is_found_between_two_slopes() {
        // much is like it up to 0.55, the thing itself from 0.7 to 0.9, and crumbs
        let cosines: Vec<f32> = (0..100).map(|n| 0.45 + 0.001 * n as f32).chain((0..50).map(|_| 0.92)).collect();
        let sizes = sizes(&cosines, &[1.0; 150], 1.0);
        assert_eq!((sizes[0], sizes[10], sizes[COSINES - 1]), (150.0, 50.0, 1.0));
        let found = plateaus(&sizes);
        assert!(found.iter().any(|(k, s)| *s == 1.0 && sizes[*k] == 50.0), "{found:?}");
        let steep: Vec<f64> = (0..COSINES).map(|k| 0.1f64.powi(k as i32)).collect();
        assert_eq!(plateaus(&steep).len(), 1, "the best of a bad lot");
    }

    #[test]
    fn poison_weighs_nothing_and_is_like_nothing() {
        let mut at = APART.gaussians();
        (at.log_scales[0], at.opacity_logits[1]) = (f32::NAN, f32::INFINITY);
        assert_eq!(sizes(&[f32::NAN, 2.0], &[5.0, 1.0], 0.5)[0], 1.0);
        let device = DeviceName::all()[0].open().unwrap();
        let (field, frame) = (AffinityField::new(1, &device), Frame::around(&at.means));
        at.means[30] = f32::NAN;
        let all: Vec<u32> = (0..at.len() as u32).collect();
        let of = Candidates::new(&field, &frame, &at.means, &at, &all);
        let (found, likeliest) = levels(&of, 10).unwrap();
        assert!(found[likeliest].members.contains(&10));
    }
}
