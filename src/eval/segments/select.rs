//! From clicks to a selection, by a setting. Nothing here has the ground truth or can judge a selection: a method
//! receives the scene, what was trained on it, clicks, and a setting.

use super::click::Click;
use super::method::SelectionMethod;
use super::setting::MethodSetting;
use super::train::{LiftedField, TrainedMethods};
use crate::config::types::SegmentConfig;
use crate::model::HostGaussians;
use crate::segment::baselines::sagd;
use crate::segment::candidates::ClickCandidates;
use crate::segment::coarse::Coarse;
use crate::segment::pick::{meant, pick, pick_saga};
use std::collections::BTreeSet;
use std::time::Instant;

/// Gaussians selected by a method.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SelectedGaussians {
    /// Their indices, ascending.
    pub members: Vec<u32>,
    /// Offsets added to each one's mean, `[M, 3]`, and log-scales, `[M, 3]`; empty for none.
    pub moved: (Vec<f32>, Vec<f32>),
    /// Mask scale and cosine that a field was queried with.
    pub asked: Option<(f32, f32)>,
}

impl SelectedGaussians {
    /// Returns whether any Gaussian is changed.
    pub fn moves(&self) -> bool {
        !self.moved.0.is_empty() || !self.moved.1.is_empty()
    }

    /// Returns the selected ones of the scene's Gaussians at any time.
    pub fn gaussians(&self, at: &HostGaussians) -> HostGaussians {
        let mut alone = at.subset(&self.members);
        alone.means.iter_mut().zip(&self.moved.0).for_each(|(m, d)| *m += d);
        alone.log_scales.iter_mut().zip(&self.moved.1).for_each(|(s, d)| *s += d);
        alone
    }

    /// Returns all of the scene's Gaussians, the selected ones as they are in the selection.
    pub fn within(&self, at: &HostGaussians) -> HostGaussians {
        let mut all = at.clone();
        for (to, by) in [(&mut all.means, &self.moved.0), (&mut all.log_scales, &self.moved.1)] {
            for (&i, by) in self.members.iter().zip(by.chunks_exact(3)) {
                to[3 * i as usize..][..3].iter_mut().zip(by).for_each(|(v, d)| *v += d);
            }
        }
        all
    }

    /// Returns the Gaussians of both; those in both are as in this one, and so are the scale and cosine.
    pub fn with(&self, other: &Self) -> Self {
        let mut rows: Vec<(u32, bool, usize)> = self.members.iter().enumerate().map(|(r, &m)| (m, false, r)).collect();
        rows.extend(other.members.iter().enumerate().map(|(r, &m)| (m, true, r)));
        rows.sort_unstable();
        rows.dedup_by_key(|row| row.0);
        let joined = |of: &dyn Fn(&Self) -> &[f32]| -> Vec<f32> {
            if of(self).is_empty() && of(other).is_empty() {
                return Vec::new();
            }
            let row = |(_, second, r): &(u32, bool, usize)| {
                let from = of(if *second { other } else { self });
                [0, 1, 2].map(|k| from.get(3 * r + k).copied().unwrap_or(0.0))
            };
            rows.iter().flat_map(row).collect()
        };
        Self {
            moved: (joined(&|s| &s.moved.0), joined(&|s| &s.moved.1)),
            asked: self.asked,
            members: rows.iter().map(|row| row.0).collect(),
        }
    }
}

/// What clicks are applied to.
#[derive(Clone, Copy)]
pub struct Scenery<'a> {
    /// The Gaussians at the time of the clicks.
    pub at: &'a HostGaussians,
    /// What the methods have learnt about them.
    pub trained: &'a TrainedMethods,
    /// The options of all rules.
    pub config: &'a SegmentConfig,
}

impl Scenery<'_> {
    /// Returns what `method` selects by one click at a setting; nothing if nothing is under the click, or nothing is
    /// similar to it.
    ///
    /// # Errors
    /// A message if the method failed.
    pub fn select(
        &self,
        method: SelectionMethod,
        setting: &MethodSetting,
        click: &Click,
    ) -> Result<SelectedGaussians, String> {
        let whole = |members| SelectedGaussians { members, ..SelectedGaussians::default() };
        let trained = self.trained;
        let anything = || meant(&click.under, self.config.click.majority, |_| None);
        match setting {
            MethodSetting::Coarse(colouring) => {
                let colours = trained.colours.iter().find(|(of, _)| of == colouring).map(|(_, c)| c);
                let colours = colours.ok_or("no colours were computed for this setting")?;
                Ok(whole(self.colour(colours, click).map_or_else(Vec::new, |(_, members)| members)))
            }
            MethodSetting::Field(options) => {
                let field = if method == SelectionMethod::CoarseFine { &trained.parts } else { &trained.whole };
                let LiftedField { field, frame, .. } = field.as_ref().ok_or("the affinity field was not trained")?;
                let all = || (0..self.at.len() as u32).collect::<Vec<_>>();
                let on = match method {
                    // as `segment pick` does: in the clicked colour, or in the whole scene if no colour contains what
                    // is there
                    SelectionMethod::CoarseFine => self.colour(trained.coarse(), click),
                    _ => None,
                };
                let in_colour = on.is_some();
                let Some((clicked, within)) = on.or_else(|| Some((anything()?, all()))) else {
                    return Ok(SelectedGaussians::default());
                };
                let of = ClickCandidates::new(field, frame, &self.at.means, self.at, &within, self.config)
                    .of_segment(in_colour);
                let picked = pick(&of, clicked, options).map_err(|e| e.to_string())?;
                Ok(SelectedGaussians { asked: Some((picked.scale, picked.threshold)), ..whole(picked.members) })
            }
            MethodSetting::Saga(options) => {
                let model = trained.saga.as_ref().ok_or("SAGA was not trained")?;
                Ok(whole(anything().map_or_else(Vec::new, |clicked| pick_saga(model, clicked, options))))
            }
            MethodSetting::Sagd(options) => {
                let views = trained.votes.as_ref().ok_or("SAGD has no masks")?;
                let Some(clicked) = anything() else { return Ok(SelectedGaussians::default()) };
                let found = sagd::segment(self.at, views, clicked, options).map_err(|e| e.to_string())?;
                let before = self.at.subset(&found.members);
                let change = |new: &[f32], old: &[f32]| new.iter().zip(old).map(|(a, b)| a - b).collect();
                let moved = (
                    change(&found.gaussians.means, &before.means),
                    change(&found.gaussians.log_scales, &before.log_scales),
                );
                Ok(SelectedGaussians { members: found.members, moved, asked: None })
            }
        }
    }

    /// Returns the Gaussians among which a field selected `members`: all of their colours for `coarse+fine`, if each of
    /// them has a colour, otherwise all of the scene.
    pub fn searched(&self, method: SelectionMethod, members: &[u32]) -> Vec<u32> {
        let labels = &self.trained.coarse().labels;
        let colours: BTreeSet<u32> = members.iter().map(|&i| labels[i as usize]).collect();
        let all = method != SelectionMethod::CoarseFine || colours.contains(&0);
        (0..labels.len() as u32).filter(|&i| all || colours.contains(&labels[i as usize])).collect()
    }

    /// Returns the clicked Gaussian that has a colour, and all Gaussians of that colour.
    fn colour(&self, colours: &Coarse, click: &Click) -> Option<(u32, Vec<u32>)> {
        let clicked =
            meant(&click.under, self.config.click.majority, |i| Some(colours.labels[i as usize]).filter(|l| *l > 0))?;
        let label = colours.labels[clicked as usize];
        let of = || (0..).zip(&colours.labels).filter(|(_, l)| **l == label).map(|(i, _)| i).collect();
        (label > 0).then(|| (clicked, of()))
    }
}

/// What a method makes of the clicks on a segment.
#[derive(Clone, Debug)]
pub struct MethodSelection {
    /// All that was selected.
    pub selected: SelectedGaussians,
    /// The setting in words, one for each click.
    pub setting: String,
    /// Number of clicks used.
    pub clicks: usize,
    /// Seconds from a click to a selection, the minimum over all clicks, plus those to propagate it to the other times,
    /// if this is done.
    pub seconds: f64,
    /// Intersection over union in the clicked view, if the setting was chosen by it.
    pub fit: Option<f64>,
}

/// Returns the selection at one setting that was fixed in advance: up to `clicks` clicks, each adding what it selects.
/// `next` places the next click, given what is selected so far.
///
/// # Errors
/// A message if the method failed.
pub fn fixed(
    scenery: Scenery<'_>,
    (method, setting): (SelectionMethod, &MethodSetting),
    first: Click,
    clicks: usize,
    mut next: impl FnMut(&[u32]) -> Option<Click>,
) -> Result<MethodSelection, String> {
    let (mut out, mut seconds) = (SelectedGaussians::default(), f64::INFINITY);
    let (mut click, mut count) = (Some(first), 0);
    while let Some(place) = click.take() {
        let started = Instant::now();
        let more = scenery.select(method, setting, &place)?;
        seconds = seconds.min(started.elapsed().as_secs_f64());
        let before = out.members.len();
        out = if count == 0 { more } else { out.with(&more) };
        count += 1;
        // after a click that adds nothing, the next would be at the same place
        if count < clicks && (count == 1 || out.members.len() > before) {
            click = next(&out.members);
        }
    }
    Ok(MethodSelection { selected: out, setting: setting.to_string(), clicks: count, seconds, fit: None })
}

#[cfg(test)]
#[path = "select_tests.rs"]
mod tests;
