//! What a single click selects with default settings: the likeliest of the available levels, see [`super::levels`].
//!
//! `volseggs segment pick` and the evaluation against known segments call the same functions with the same defaults, so
//! the evaluation measures what a user gets.

use super::baselines::saga::SagaModel;
use super::candidates::ClickCandidates;
use super::click::heaviest;
use super::levels::{Level, LevelKind, levels, likeliest};
use super::pieces::without_strays;
use super::place::PlaceError;
use crate::points::PointsError;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// How much of the surroundings of a click is meant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Granularity {
    /// The likeliest of the available levels, see [`levels`].
    #[default]
    Likeliest,
    /// The level at this index, from 0, the smallest; the largest if there are fewer.
    Level(usize),
    /// The level of this kind, the largest of several.
    OfKind(LevelKind),
    /// Set by the user.
    By {
        /// Mask scale in [0, 1], from small parts to large ones.
        scale: f32,
        /// Minimum cosine of the affinity features for a Gaussian to be selected, in [-1, 1].
        threshold: f32,
    },
}

impl Granularity {
    /// Refuses numbers that mean nothing.
    fn check(self) -> Result<(), PickError> {
        let Self::By { scale, threshold } = self else { return Ok(()) };
        let outside = |what, value, range: RangeInclusive<f32>| {
            let (from, to) = (*range.start(), *range.end());
            if range.contains(&value) { Ok(()) } else { Err(PickError::Number { what, value, from, to }) }
        };
        outside("scale", scale, 0.0..=1.0)?;
        outside("threshold", threshold, -1.0..=1.0)
    }
}

/// Options of [`pick`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PickOptions {
    /// How much is selected.
    pub meaning: Granularity,
    /// Whether to find all levels, even if the selection does not need them.
    pub list: bool,
}

/// What a click selected.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PickedGaussians {
    /// The Gaussians, ascending; empty where only strays are similar to the clicked one.
    pub members: Vec<u32>,
    /// The mask scale that was used.
    pub scale: f32,
    /// The threshold that was used.
    pub threshold: f32,
    /// What makes the members one.
    pub kind: LevelKind,
    /// The available levels, from small to large, if they were computed.
    pub levels: Vec<Level>,
    /// Index of the level that was used.
    pub level: Option<usize>,
}

impl From<Level> for PickedGaussians {
    /// The level alone, including its strays.
    fn from(level: Level) -> Self {
        let Level { members, scale, threshold, kind, .. } = level;
        Self { members, scale, threshold, kind, levels: Vec::new(), level: None }
    }
}

/// Why nothing can be selected.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PickError {
    /// The clicked Gaussian is not a candidate.
    #[error("Gaussian {clicked} was clicked, but is not among the {count} candidates; click on one of them")]
    Outside {
        /// The clicked Gaussian.
        clicked: u32,
        /// Number of candidates.
        count: usize,
    },
    /// A number is out of range.
    #[error("{what}: {value} is not between {from} and {to}")]
    Number {
        /// Which number.
        what: &'static str,
        /// The number.
        value: f32,
        /// The smallest that is allowed.
        from: f32,
        /// The largest.
        to: f32,
    },
    /// There is no level of a kind.
    #[error("there is no {} at this click, only {}", .kind.name(), words(.has))]
    NoLevel {
        /// The kind.
        kind: LevelKind,
        /// Those that there are, from small to large.
        has: Vec<LevelKind>,
    },
    /// The connected pieces cannot be found.
    #[error(transparent)]
    Points(#[from] PointsError),
    /// The parts of a piece cannot be found.
    #[error(transparent)]
    Parts(#[from] PlaceError),
}

/// Each of `kinds` once.
fn words(kinds: &[LevelKind]) -> String {
    let mut words: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
    words.dedup();
    words.join(", ")
}

/// Returns the Gaussian that a click on a pixel means, `None` if the pixel is empty. `under` holds the Gaussians of the
/// pixel (indices and weights, nearest first), and `segment` gives the segment of a Gaussian. The result is the
/// heaviest Gaussian of the segment that makes up most of the pixel, whatever the heaviest Gaussian overall belongs to;
/// haze in no segment is ignored. If no segment holds any of them, it is the heaviest of all. Without a `majority`, it is
/// the heaviest Gaussian in any segment.
pub fn meant(under: &[(u32, f32)], majority: bool, segment: impl Fn(u32) -> Option<u32>) -> Option<u32> {
    if !majority {
        return heaviest(under, |i| segment(i).is_some()).or_else(|| heaviest(under, |_| true));
    }
    let mut sums: BTreeMap<u32, f32> = BTreeMap::new();
    for &(i, weight) in under {
        if let Some(segment) = segment(i) {
            *sums.entry(segment).or_default() += weight;
        }
    }
    let most = sums.into_iter().reduce(|best, next| if next.1 > best.1 { next } else { best });
    match most {
        Some((most, _)) => heaviest(under, |i| segment(i) == Some(most)),
        None => heaviest(under, |_| true),
    }
}

/// Selects the candidates that a click on the Gaussian `clicked` means.
///
/// # Errors
/// If it is not among them, a number is out of range, there is no level of the requested kind, or the arrays of the Gaussians disagree.
///
/// # Panics
/// If an index of a candidate is not below N.
pub fn pick(of: &ClickCandidates<'_>, clicked: u32, options: &PickOptions) -> Result<PickedGaussians, PickError> {
    options.meaning.check()?;
    let position = of.position(clicked)?;
    let by_hand = |(scale, threshold): (f32, f32)| {
        let like = of.alike(position, scale, threshold);
        let members = of.within.iter().zip(like).filter(|(_, like)| *like).map(|(m, _)| *m).collect();
        PickedGaussians { members, scale, threshold, ..PickedGaussians::default() }
    };
    let mut picked = match options.meaning {
        Granularity::By { scale, threshold } => {
            let found = if options.list { levels(of, clicked)?.0 } else { Vec::new() };
            PickedGaussians { levels: found, ..by_hand((scale, threshold)) }
        }
        Granularity::Likeliest if !options.list => likeliest(of, clicked)?.into(),
        Granularity::Likeliest | Granularity::Level(_) | Granularity::OfKind(_) => {
            let (found, likeliest) = levels(of, clicked)?;
            let level = match options.meaning {
                Granularity::Level(n) => n.min(found.len() - 1),
                Granularity::OfKind(kind) => {
                    let has = || found.iter().map(|level| level.kind).collect();
                    let place = found.iter().rposition(|level| level.kind == kind);
                    place.ok_or_else(|| PickError::NoLevel { kind, has: has() })?
                }
                _ => likeliest,
            };
            let taken = PickedGaussians::from(found[level].clone());
            PickedGaussians { levels: found, level: Some(level), ..taken }
        }
    };
    // only the affinity can select what does not touch the rest by mistake
    let pieces = &of.config.pieces;
    if pieces.strays && picked.kind == LevelKind::Similar {
        picked.members = without_strays(of.at, &picked.members, Some(clicked), pieces)?;
    }
    Ok(picked)
}

/// How similar to the clicked Gaussian the selection of SAGA is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SagaPick {
    /// Mask scale in [0, 1], from small parts to large ones.
    pub scale: f32,
    /// Similarity above which a Gaussian is selected, in [0, 1]: `(cosine + 1) / 2`.
    pub threshold: f32,
}

impl SagaPick {
    /// The setting at which SAGA's features are compared like those of the affinity field at a scale and a cosine.
    pub fn like(scale: f32, cosine: f32) -> Self {
        Self { scale, threshold: 0.5 * (cosine + 1.0) }
    }
}

impl Default for SagaPick {
    /// Scale 0.5, a cosine of 0.8, which is a similarity of 0.9, as our field without plateaus. The published program
    /// leaves both to its user.
    fn default() -> Self {
        Self::like(0.5, 0.8)
    }
}

/// Returns the Gaussians that SAGA selects for a click on `clicked`, ascending.
///
/// # Panics
/// If `clicked` is not one of the model's Gaussians.
pub fn pick_saga(model: &SagaModel, clicked: u32, options: &SagaPick) -> Vec<u32> {
    let selected = model.select(clicked, options.scale, options.threshold);
    (0..).zip(selected).filter(|(_, selected)| *selected).map(|(i, _)| i).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::types::SegmentConfig;
    use crate::config::types::segment::PiecesConfig;
    use crate::device::DeviceName;
    use crate::segment::fine::AffinityField;
    use crate::segment::fine::network::PositionBox;
    use crate::segment::test_support::{APART, COUNT};

    #[test]
    fn a_click_means_the_segment_that_makes_up_most_of_the_pixel_and_no_haze() {
        let under = [(4, 0.6), (7, 0.3), (9, 0.1)];
        assert_eq!(meant(&under, true, |i| (i >= 7).then_some(0)), Some(7));
        assert_eq!(meant(&under, true, |_| None), Some(4));
        assert_eq!(meant(&[], true, |_| Some(0)), None);
        // the heaviest one belongs to a segment that has less of the pixel than another
        let under = [(4, 0.3), (7, 0.2), (9, 0.25)];
        assert_eq!(meant(&under, true, |i| Some(u32::from(i >= 7))), Some(9));
        assert_eq!(meant(&under, false, |i| Some(u32::from(i >= 7))), Some(4));
        assert_eq!(meant(&under, false, |i| (i >= 7).then_some(0)), Some(9));
    }

    #[test]
    fn only_candidates_are_selected_and_always_the_clicked_one() {
        let device = DeviceName::all()[0].open().unwrap();
        let (at, field) = (APART.gaussians(), AffinityField::new(3, &device));
        let frame = PositionBox::around(&at.means);
        let pieces = PiecesConfig { strays: false, ..PiecesConfig::default() };
        let config = SegmentConfig { pieces, ..SegmentConfig::default() };
        let of = |within| ClickCandidates::new(&field, &frame, &at.means, &at, within, &config);
        let within: Vec<u32> = (0..COUNT as u32).collect();
        let by = |threshold| PickOptions { meaning: Granularity::By { scale: 0.5, threshold }, list: false };
        let all = by(-1.0);
        assert_eq!(pick(&of(&within), 5, &all).unwrap().members, within);
        assert!(pick(&of(&within), 5, &by(1.0)).unwrap().members.contains(&5));
        let error = pick(&of(&within), COUNT as u32, &all).unwrap_err();
        assert_eq!(error, PickError::Outside { clicked: COUNT as u32, count: COUNT });
        assert!(pick(&of(&[]), 0, &all).is_err());
    }

    #[test]
    fn saga_uses_the_same_cosine_by_default() {
        assert_eq!(SagaPick::default(), SagaPick { scale: 0.5, threshold: 0.9 });
    }
}
