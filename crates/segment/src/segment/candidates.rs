//! The Gaussians that a click may select, with the results that all clicks on them need: computed on first use and
//! cached, so that the next click and each move of a slider are answered at once.

use super::fine::AffinityField;
use super::fine::extract::cosines;
use super::fine::network::PositionBox;
use super::necks;
use super::objects::objects;
use super::pick::PickError;
use super::pieces::{TouchRule, pieces};
use crate::config::types::SegmentConfig;
use crate::model::HostGaussians;
use crate::points::PointsError;
use crate::points::components::Components;
use rayon::prelude::*;
use std::cell::{OnceCell, RefCell};
use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};
use volseggs_kernels::activation::sigmoid_f64;
use volseggs_kernels::contrast::FEATURES;

/// Number of scales whose features are cached besides those at which levels are sought: that of wholes, and that of a
/// slider.
const MORE_CACHED: usize = 2;

/// Cached results about candidates, see [`ClickCandidates::with_found`].
#[derive(Debug, Default)]
pub struct CandidateCache {
    /// Encoded positions `[M, 24]`.
    encoded: OnceCell<Vec<f32>>,
    /// Unit features `[M, 16]` by scale, the most recently used last.
    features: RefCell<Vec<(f32, Arc<Vec<f32>>)>>,
    pieces: OnceCell<Components>,
    /// The part of each Gaussian, by piece.
    parts: RefCell<BTreeMap<u32, Arc<Vec<u32>>>>,
}

impl CandidateCache {
    /// Keeps what also holds for the same candidates at another time: encoded positions and features.
    #[must_use]
    pub fn at_another_time(self) -> Self {
        Self { encoded: self.encoded, features: self.features, ..Self::default() }
    }
}

/// Cached results about all Gaussians at one time, whatever is searched, see [`ClickCandidates::with_surroundings`].
#[derive(Debug, Default)]
pub struct SceneCache {
    pieces: OnceLock<Components>,
    /// What each Gaussian shows, `[N]`, see [`ClickCandidates::shown`].
    shown: OnceLock<Vec<f64>>,
    /// Its sum.
    total: OnceLock<f64>,
    /// See [`Self::know_objects`].
    objects: OnceLock<Vec<u32>>,
}

impl SceneCache {
    /// Makes the objects known, `[N]`, that parts of several segments form, see [`super::nested`]. They are `found` if they
    /// are not known yet.
    ///
    /// # Errors
    /// As `found`.
    pub fn know_objects(&self, found: impl FnOnce() -> Result<Vec<u32>, PickError>) -> Result<(), PickError> {
        if self.objects.get().is_none() {
            let _ = self.objects.set(found()?);
        }
        Ok(())
    }
}

/// The Gaussians that a click may select.
#[derive(Debug)]
pub struct ClickCandidates<'a> {
    field: &'a AffinityField,
    frame: &'a PositionBox,
    /// `[N, 3]`
    places: &'a [f32],
    /// All Gaussians `[N]` at the current time.
    pub at: &'a HostGaussians,
    /// Indices of the candidates `[M]`, ascending.
    pub within: &'a [u32],
    /// Whether they are the whole scene, where objects touch each other, so that connected pieces are no levels.
    pub whole: bool,
    /// The options of all rules.
    pub config: &'a SegmentConfig,
    found: CandidateCache,
    around: Arc<SceneCache>,
}

impl<'a> ClickCandidates<'a> {
    /// Candidates among the Gaussians `at` (`[N]`, at the current time): `within` lists their indices `[M]`, ascending,
    /// below N. The `field` is evaluated at `places` `[N, 3]`, scene units, the positions at the time that it was
    /// trained at; `frame` is its box. Candidates that are all Gaussians are taken for the whole scene, see
    /// [`Self::of_segment`].
    pub fn new(
        field: &'a AffinityField,
        frame: &'a PositionBox,
        places: &'a [f32],
        at: &'a HostGaussians,
        within: &'a [u32],
        config: &'a SegmentConfig,
    ) -> Self {
        let whole = within.len() == at.len();
        Self {
            field,
            frame,
            places,
            at,
            within,
            whole,
            config,
            found: CandidateCache::default(),
            around: Arc::default(),
        }
    }

    /// Sets whether the candidates are a segment, which may hold every Gaussian, or the whole scene.
    #[must_use]
    pub fn of_segment(mut self, segment: bool) -> Self {
        self.whole = !segment;
        self
    }

    /// Reuses what [`Self::into_found`] returned for exactly the same arguments.
    #[must_use]
    pub fn with_found(mut self, found: CandidateCache) -> Self {
        self.found = found;
        self
    }

    /// Shares the results about all Gaussians with other candidates among the same Gaussians `at`.
    #[must_use]
    pub fn with_surroundings(mut self, around: Arc<SceneCache>) -> Self {
        self.around = around;
        self
    }

    /// Returns the results computed so far.
    pub fn into_found(self) -> CandidateCache {
        self.found
    }

    /// Returns the position of the Gaussian `clicked` among the candidates.
    ///
    /// # Errors
    /// If it is not among them.
    pub fn position(&self, clicked: u32) -> Result<usize, PickError> {
        self.within.binary_search(&clicked).map_err(|_| PickError::Outside { clicked, count: self.within.len() })
    }

    /// Returns the cosines `[M]` of the features with that of the candidate at `position`, at the mask `scale` in
    /// [0, 1].
    ///
    /// # Panics
    /// If `position` is not below M, or an index not below N.
    pub fn cosines(&self, position: usize, scale: f32) -> Vec<f32> {
        cosines(&self.features(scale), position)
    }

    /// Returns which candidates `[M]` have a feature whose cosine with that at `position` is at least `threshold`. The
    /// candidate at `position` is always among them, whatever the rounding.
    ///
    /// # Panics
    /// As [`Self::cosines`].
    pub fn alike(&self, position: usize, scale: f32, threshold: f32) -> Vec<bool> {
        let mut like: Vec<bool> = self.cosines(position, scale).into_iter().map(|cosine| cosine >= threshold).collect();
        like[position] = true;
        like
    }

    /// What each Gaussian shows, candidate or not, `[N]`: opacity times the product of its two larger standard
    /// deviations; 0 if not finite.
    pub fn shown(&self) -> &[f64] {
        self.around.shown.get_or_init(|| (0..self.at.len()).into_par_iter().map(|i| shown(self.at, i)).collect())
    }

    /// Returns the connected pieces of the visible candidates; labels `[M]` from 1, 0 for those without a finite
    /// position or not visible at the current time.
    ///
    /// # Errors
    /// If the arrays of `at` disagree, or points are too far apart.
    pub fn pieces(&self) -> Result<&Components, PointsError> {
        if let Some(pieces) = self.found.pieces.get() {
            return Ok(pieces);
        }
        let pieces = pieces(self.at, self.within, TouchRule::seen(&self.config.pieces))?;
        Ok(self.found.pieces.get_or_init(|| pieces))
    }

    /// Returns all Gaussians, candidates or not, ascending, that are one object with the Gaussian `clicked`: those of its
    /// parts in all segments, if these are [known](SceneCache::know_objects), or else everything visible that is
    /// connected with it. None if `clicked` is not visible.
    ///
    /// # Errors
    /// If the arrays of `at` disagree, or points are too far apart.
    pub fn object(&self, clicked: u32) -> Result<Vec<u32>, PointsError> {
        let around = &self.around;
        if around.objects.get().is_none() && around.pieces.get().is_none() {
            let all: Vec<u32> = (0..self.at.len() as u32).collect();
            let _ = around.pieces.set(pieces(self.at, &all, TouchRule::seen(&self.config.pieces))?);
        }
        let labels = around.objects.get().or_else(|| around.pieces.get().map(|pieces| &pieces.labels));
        let labels = labels.map_or(&[][..], Vec::as_slice);
        let own = labels.get(clicked as usize).copied().filter(|label| *label > 0);
        Ok((0..).zip(labels).filter(|(_, label)| Some(**label) == own).map(|(i, _)| i).collect())
    }

    /// Returns the part of each candidate, `[M]` from 1, see [`Self::parts`]; small pieces are one part. 0 for those in no
    /// piece.
    ///
    /// # Errors
    /// As [`Self::parts`].
    pub fn all_parts(&self) -> Result<Vec<u32>, PickError> {
        let pieces = self.pieces()?;
        let mut rows: Vec<Vec<usize>> = vec![Vec::new(); pieces.counts.len()];
        for (n, &label) in pieces.labels.iter().enumerate().filter(|(_, label)| **label > 0) {
            rows[label as usize - 1].push(n);
        }
        let (mut of, mut last) = (vec![0; self.within.len()], 0);
        for (piece, rows) in (1..).zip(rows) {
            let first = last;
            if rows.len() * self.config.levels.one_in < self.within.len() {
                rows.iter().for_each(|&n| of[n] = first + 1);
                last += 1;
                continue;
            }
            let members: Vec<u32> = rows.iter().map(|&n| self.within[n]).collect();
            for (&n, part) in rows.iter().zip(self.parts(piece, &members)?.iter()) {
                of[n] = first + part;
                last = last.max(of[n]);
            }
        }
        Ok(of)
    }

    /// Returns the fraction of what all Gaussians show, in [0, 1], that Gaussians which show `weight` in all are.
    pub fn share(&self, weight: f64) -> f64 {
        (weight / self.around.total.get_or_init(|| total(self.shown()))).min(1.0)
    }

    /// Returns for each of the Gaussians `members` of the piece `piece` the label, from 1, of its object among the
    /// [`objects()`] that the affinity distinguishes or, if there is only one, of its part between [`necks`].
    ///
    /// # Errors
    /// If a member is not among the candidates, or the arrays of `at` disagree.
    pub fn parts(&self, piece: u32, members: &[u32]) -> Result<Arc<Vec<u32>>, PickError> {
        if let Some(known) = self.found.parts.borrow().get(&piece) {
            return Ok(known.clone());
        }
        let body = self.at.subset(members);
        let all = self.features(self.config.objects.scale);
        let mut features = Vec::with_capacity(FEATURES * members.len());
        for &member in members {
            let position = self.position(member)?;
            features.extend_from_slice(&all[FEATURES * position..FEATURES * (position + 1)]);
        }
        let mut found = objects(&body, &features, self.config)?;
        if found.iter().all(|object| *object == 1) {
            found = necks::parts(&body, &self.config.necks)?;
        }
        let found = Arc::new(found);
        self.found.parts.borrow_mut().insert(piece, found.clone());
        Ok(found)
    }

    /// Returns the unit features `[M, 16]` at the mask `scale` in [0, 1].
    ///
    /// # Panics
    /// If an index is not below N.
    pub fn features(&self, scale: f32) -> Arc<Vec<f32>> {
        let mut kept = self.found.features.borrow_mut();
        if let Some(place) = kept.iter().position(|(s, _)| *s == scale) {
            let latest = kept.remove(place);
            kept.push(latest);
        } else {
            let encoded = self.found.encoded.get_or_init(|| {
                let means: Vec<f32> =
                    self.within.iter().flat_map(|&i| &self.places[3 * i as usize..][..3]).copied().collect();
                self.frame.encode(&means)
            });
            if kept.len() == self.config.levels.scales.len() + MORE_CACHED {
                kept.remove(0);
            }
            kept.push((scale, Arc::new(self.field.features(encoded, scale))));
        }
        kept.last().map(|(_, features)| features.clone()).unwrap_or_default()
    }
}

/// Returns the sum of what Gaussians show, never 0.
pub(super) fn total(shown: &[f64]) -> f64 {
    shown.iter().sum::<f64>().max(f64::MIN_POSITIVE)
}

/// What the Gaussian `i` shows, see [`ClickCandidates::shown`].
///
/// # Panics
/// If `i` is not below N.
fn shown(at: &HostGaussians, i: usize) -> f64 {
    let mut scales: [f64; 3] = std::array::from_fn(|k| f64::from(at.log_scales[3 * i + k]).exp());
    scales.sort_by(f64::total_cmp);
    let opacity = sigmoid_f64(at.opacity_logits[i].into());
    Some(opacity * scales[1] * scales[2]).filter(|w| w.is_finite()).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::DeviceName;
    use crate::segment::test_support::{APART, COUNT};

    #[test]
    fn cached_results_equal_recomputed_ones() {
        let device = DeviceName::all()[0].open().unwrap();
        let at = APART.gaussians();
        let field = AffinityField::new(3, &device);
        let frame = PositionBox::around(&at.means);
        let within: Vec<u32> = (0..at.len() as u32).filter(|i| i % 3 > 0).collect();
        let config = SegmentConfig::default();
        let new = || ClickCandidates::new(&field, &frame, &at.means, &at, &within, &config);
        let mut found = CandidateCache::default();
        // more scales than are cached
        for n in 0..20 {
            let scale = 0.1 * (n % 8) as f32;
            let kept = new().with_found(found);
            assert_eq!(kept.cosines(n, scale), new().cosines(n, scale), "{scale}");
            assert_eq!(kept.shown(), new().shown());
            assert_eq!(kept.pieces().unwrap(), new().pieces().unwrap());
            found = kept.into_found();
        }
        assert_eq!(found.features.borrow().len(), 7);
        // results kept for another time are those computed afresh there
        let mut later = at.clone();
        later.opacity_logits.iter_mut().step_by(2).for_each(|logit| *logit = -9.0);
        let new = || ClickCandidates::new(&field, &frame, &at.means, &later, &within, &config);
        let kept = new().with_found(found.at_another_time());
        assert_eq!(kept.found.features.borrow().len(), 7);
        assert_eq!(kept.cosines(7, 0.3), new().cosines(7, 0.3));
        assert_eq!((kept.shown(), kept.pieces().unwrap()), (new().shown(), new().pieces().unwrap()));
    }

    #[test]
    fn poison_shows_nothing() {
        let mut at = APART.gaussians();
        (at.log_scales[0], at.opacity_logits[1]) = (f32::NAN, f32::INFINITY);
        let shown: Vec<f64> = (0..COUNT).map(|i| shown(&at, i)).collect();
        assert!(shown[0] == 0.0 && shown[1] > 0.0 && shown[2] > 0.0);
    }
}
