//! Clicks: what is under a pixel of a picture, and the segment that a click there selects.
//!
//! A viewer opens a [`Clicking`] once per time, asks it for the [`ClickHit`] of each click and, as often as its sliders
//! move, for what that selects, and commits one selection; `volseggs segment pick` does the same once.

use super::segments::RunSegments;
use super::{OpenRun, RunError};
use crate::config::types::SegmentConfig;
use crate::config::types::segment::ClickConfig;
use crate::data::Camera;
use crate::model::params::to_vec;
use crate::model::{HostGaussians, Rendering, ToKernel};
use crate::name::Name;
use crate::segment::candidates::{CandidateCache, ClickCandidates, SceneCache};
use crate::segment::click::{heaviest, under};
use crate::segment::fine::AffinityField;
use crate::segment::fine::file::AffinitySpec;
use crate::segment::levels::prepare;
use crate::segment::nested::objects;
use crate::segment::pick::{Granularity, PickError, PickOptions, PickedGaussians, meant, pick};
use crate::segment::propagate::propagate;
use crate::segment::segmentation::{Segment, SegmentOrigin, Segmentation};
use burn::tensor::Device;
use glam::{DVec2, DVec3};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Number of segments whose findings are kept.
const KNOWN: usize = 32;

/// Why a click selects nothing.
#[derive(Debug, thiserror::Error)]
pub enum ClickError {
    /// The pixel is outside the picture.
    #[error("the picture has {width}x{height} pixels")]
    Outside {
        /// Width of the picture in pixels.
        width: u32,
        /// Its height.
        height: u32,
    },
    /// The pixel shows the background.
    #[error("nothing is there at time {time}")]
    Nothing {
        /// The time.
        time: f64,
    },
    /// There are fewer levels.
    #[error("level {level}: there are {count} levels at this click")]
    Level {
        /// The level that was requested, from 1.
        level: usize,
        /// Number of levels.
        count: usize,
    },
    /// There is no affinity field.
    #[error(
        "the run has no affinity field; run `volseggs segment masks`, if it has no masks yet, and `volseggs segment fine`"
    )]
    NoField,
    /// Any other error.
    #[error(transparent)]
    Run(#[from] RunError),
}

/// The scene at one time, ready to be clicked on.
#[derive(Debug)]
pub struct Clicking {
    /// All Gaussians `[N]` at the time.
    at: HostGaussians,
    rendering: Rendering,
    time: f64,
    segments: Segmentation,
    field: Option<(AffinityField, AffinitySpec)>,
    config: SegmentConfig,
    /// Positions `[N, 3]` at the time that the field was trained at.
    places: Vec<f32>,
    /// What was found out about the segments searched so far.
    known: RefCell<BTreeMap<Option<Name>, CandidateCache>>,
    /// What was found out about the whole scene.
    around: Arc<SceneCache>,
    device: Device,
}

/// What a click hit.
#[derive(Clone, Debug, PartialEq)]
pub struct ClickHit {
    /// Index of the Gaussian.
    pub gaussian: u32,
    /// Its share of the pixel's colour.
    pub weight: f32,
    /// Its position, scene units.
    pub mean: [f32; 3],
    /// Segments that contain it, wholes before their parts.
    pub segments: Vec<Name>,
    /// The segment to search: the one that was named, or else the whole that contains the Gaussian.
    pub within: Option<Name>,
}

impl Clicking {
    /// Prepares the scene at `time`. Clicks can select only if there is a `field`.
    pub fn new(
        run: &OpenRun,
        segments: &Segmentation,
        field: Option<&(AffinityField, AffinitySpec)>,
        time: f64,
    ) -> Self {
        let at = run.scene.host_at(time as f32);
        // the field is evaluated at the positions of the time it was trained at
        let places = match field {
            Some((_, spec)) if spec.time != time => to_vec(run.scene.deformed(spec.time as f32).means),
            _ => at.means.clone(),
        };
        let (rendering, device) = (run.scene.spec.rendering(), run.device());
        let (segments, field, config) = (segments.clone(), field.cloned(), run.config.segment.clone());
        let (known, around) = (RefCell::default(), Arc::default());
        Self { at, rendering, time, segments, field, config, places, known, around, device }
    }

    /// Returns this with the findings of `before` that hold at any time. `before` must have the same segments and
    /// field.
    #[must_use]
    pub fn recalling(self, before: Self) -> Self {
        let known = before.known.into_inner().into_iter().map(|(name, found)| (name, found.at_another_time()));
        Self { known: RefCell::new(known.collect()), ..self }
    }

    /// Computes what the first click on any of the wholes, or on the scene if there are none, would have to compute, so
    /// that the click is answered at once. What fails is left to the click, which reports why.
    pub fn prepare(&self) {
        let Some(field) = &self.field else { return };
        for whole in self.segments.wholes().take(KNOWN) {
            let _ = self.with_candidates(field, Some(&whole.name), &whole.members, prepare);
        }
        if self.segments.segments.is_empty() {
            let all: Vec<u32> = (0..self.at.len() as u32).collect();
            let _ = self.with_candidates(field, None, &all, prepare);
        } else {
            let _ = self.know_objects(field);
        }
    }

    /// Calls `work` with the candidates `members`: those of the segment `name`, or the whole scene. What was computed
    /// about them before is reused, and what is computed now is kept.
    fn with_candidates<T>(
        &self,
        (field, spec): &(AffinityField, AffinitySpec),
        name: Option<&Name>,
        members: &[u32],
        work: impl FnOnce(&ClickCandidates<'_>) -> T,
    ) -> T {
        let name = name.cloned();
        let known = self.known.borrow_mut().remove(&name).unwrap_or_default();
        let of = ClickCandidates::new(field, &spec.frame, &self.places, &self.at, members, &self.config)
            .of_segment(name.is_some())
            .with_found(known)
            .with_surroundings(self.around.clone());
        let result = work(&of);
        let mut known = self.known.borrow_mut();
        if known.len() >= KNOWN {
            known.clear();
        }
        known.insert(name, of.into_found());
        result
    }

    /// Returns what the pixel (column, row) of the camera's picture shows. If a segment `within` is named, only this
    /// segment is visible, and the Gaussian that contributes most to the pixel is hit. Otherwise, if there is a field,
    /// so that a click can become a segment, it is a Gaussian of the segment that covers most of the pixel, see
    /// [`meant`]; without a field, the Gaussian that contributes most.
    ///
    /// # Errors
    /// [`ClickError::Outside`], [`ClickError::Nothing`], or an unknown name.
    pub fn hit(&self, camera: &Camera, pixel: [u32; 2], within: Option<&str>) -> Result<ClickHit, ClickError> {
        let within = within.map(|name| self.segments.get(name)).transpose().map_err(RunError::input)?;
        let shown = within.map(|s| self.at.subset(&s.members));
        let (width, height) = (camera.width, camera.height);
        let settings = self.rendering.seen_by(camera.to_kernel());
        let beneath = under(shown.as_ref().unwrap_or(&self.at), settings, pixel, &self.config.click, &self.device)
            .map_err(|_| ClickError::Outside { width, height })?;
        let holds = |s: &Segment, i: u32| s.holds(&[i]);
        // wholes come before their parts
        let whole_of = |i: u32| (0..).zip(&self.segments.segments).find(|(_, s)| holds(s, i)).map(|(n, _)| n);
        let hit = match within {
            None if self.field.is_some() => meant(&beneath, self.config.click.majority, whole_of),
            _ => heaviest(&beneath, |_| true),
        };
        let hit = hit.ok_or(ClickError::Nothing { time: self.time })?;
        let weight = beneath.iter().find(|(i, _)| *i == hit).map_or(0.0, |(_, w)| *w);
        let gaussian = within.map_or(hit, |s| s.members[hit as usize]);
        let segments = self.segments.segments.iter().filter(|s| holds(s, gaussian)).map(|s| s.name.clone());
        let segments: Vec<Name> = segments.collect();
        let within = within.map(|s| s.name.clone()).or_else(|| segments.first().cloned());
        let mean = [0, 1, 2].map(|k| self.at.means[3 * gaussian as usize + k]);
        Ok(ClickHit { gaussian, weight, mean, segments, within })
    }

    /// Finds the objects of parts of several segments, if these are joined.
    fn know_objects(&self, field: &(AffinityField, AffinitySpec)) -> Result<(), PickError> {
        if self.config.nested.join { self.around.know_objects(|| self.objects(field)) } else { Ok(()) }
    }

    /// Returns the object of each Gaussian, `[N]`, among the parts of all wholes, see [`objects`].
    fn objects(&self, field: &(AffinityField, AffinitySpec)) -> Result<Vec<u32>, PickError> {
        let count = self.at.len();
        let (mut part, mut segment, mut last) = (vec![0; count], vec![0; count], 0);
        for (number, whole) in (1..).zip(self.segments.wholes()) {
            let parts = self.with_candidates(field, Some(&whole.name), &whole.members, |of| of.all_parts())?;
            // what was picked from several wholes, or grouped, holds Gaussians of those again
            for (&i, &own) in whole.members.iter().zip(&parts) {
                let i = i as usize;
                if own > 0 && part[i] == 0 {
                    (part[i], segment[i]) = (last + own, number);
                }
            }
            last += parts.iter().max().copied().unwrap_or(0);
        }
        Ok(objects(&self.at, &part, &segment, &self.config)?)
    }

    /// Returns what a click on `hit` selects in the segment to search, or in the whole scene.
    ///
    /// # Errors
    /// [`ClickError::NoField`], or a segment that no longer exists.
    pub fn select(&self, hit: &ClickHit, options: &PickOptions) -> Result<PickedGaussians, ClickError> {
        let Some(field) = &self.field else { return Err(ClickError::NoField) };
        let candidates = match &hit.within {
            Some(name) => self.segments.get(name).map_err(RunError::input)?.members.clone(),
            None => (0..self.at.len() as u32).collect(),
        };
        if hit.within.is_some()
            && (options.list || matches!(options.meaning, Granularity::Level(_) | Granularity::OfKind(_)))
        {
            self.know_objects(field).map_err(RunError::failure)?;
        }
        let pick = |of: &ClickCandidates<'_>| pick(of, hit.gaussian, options);
        let picked = self.with_candidates(field, hit.within.as_ref(), &candidates, pick);
        let picked = picked.map_err(|e| match e {
            PickError::NoLevel { .. } | PickError::Number { .. } => RunError::input(e),
            other => RunError::failure(other),
        })?;
        match (options.meaning, picked.levels.len()) {
            (Granularity::Level(n), count) if n >= count => {
                Err(ClickError::Level { level: n.saturating_add(1), count })
            }
            _ => Ok(picked),
        }
    }
}

/// Returns the point, in scene units, of the surface that a pixel (column, row) of the camera's picture shows of the
/// Gaussians at a `time`: on the pixel's ray, at the depth of the Gaussian that contributes most to the pixel.
///
/// # Errors
/// [`ClickError::Outside`] or [`ClickError::Nothing`].
pub fn surface_point(
    (at, rendering): (&HostGaussians, Rendering),
    camera: &Camera,
    pixel: [u32; 2],
    click: &ClickConfig,
    time: f64,
    device: &Device,
) -> Result<[f64; 3], ClickError> {
    let (width, height) = (camera.width, camera.height);
    // not every backend can hold an empty tensor
    let beneath = if at.is_empty() {
        Ok(Vec::new())
    } else {
        under(at, rendering.seen_by(camera.to_kernel()), pixel, click, device)
    };
    let beneath = beneath.map_err(|_| ClickError::Outside { width, height })?;
    let nothing = ClickError::Nothing { time };
    let Some(hit) = heaviest(&beneath, |_| true) else { return Err(nothing) };
    let mean = DVec3::from_array([0, 1, 2].map(|k| at.means[3 * hit as usize + k].into()));
    let Some((_, depth)) = camera.project(mean) else { return Err(nothing) };
    let middle = DVec2::new(f64::from(pixel[0]) + 0.5, f64::from(pixel[1]) + 0.5);
    Ok(camera.unproject(middle, depth).to_array())
}

/// A segment made by a click.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MadeSegment {
    /// Number of its Gaussians.
    pub gaussians: usize,
    /// Number of those that the click did not select, as they are visible at other times.
    pub from_other_times: usize,
}

/// Creates a segment `name` from what a click at `time` selected, propagated to the other times, see [`propagate`]. It
/// becomes a part of the segment that was searched if that still holds all of it.
///
/// # Errors
/// If nothing was selected, or the name is taken.
pub fn commit(
    run: &OpenRun,
    segments: &mut RunSegments,
    name: &Name,
    hit: &ClickHit,
    picked: &PickedGaussians,
    time: f64,
) -> Result<MadeSegment, RunError> {
    let PickedGaussians { members, scale, threshold, .. } = picked;
    if members.is_empty() {
        return Err(RunError::input(format!(
            "{name}: only strays are similar to the clicked Gaussian; choose another pixel, another --level or a lower \
             --threshold, or pass --keep-strays"
        )));
    }
    let mut all = segments.now().clone();
    let whole = hit.within.as_ref().and_then(|whole| all.get(whole).ok());
    let whole = whole.filter(|whole| whole.holds(members));
    let parent = whole.map(|whole| whole.name.clone());
    let within = whole.map_or_else(|| (0..run.scene.gaussians.count() as u32).collect(), |whole| whole.members.clone());
    let members = propagate(&run.scene, members, &within, time, &run.config.segment).map_err(RunError::failure)?;
    let from_other_times = members.iter().filter(|i| picked.members.binary_search(i).is_err()).count();
    let made = MadeSegment { gaussians: members.len(), from_other_times };
    let colour = all.free_colour();
    let origin = SegmentOrigin::Pick { scale: *scale, threshold: *threshold };
    let segment = Segment { name: name.clone(), parent, colour, time, origin, members };
    all.add(segment).map_err(RunError::input)?;
    segments.change(format!("pick {name}"), all.segments);
    Ok(made)
}
