//! Selections of one click by each method, for every setting that a user could try.

use super::prompt::{Click, Prompt};
use crate::model::GaussiansAt;
use crate::segment::baselines::saga::SagaModel;
use crate::segment::baselines::sagd::{self, MaskChoice, SagdOptions, SagdView};
use crate::segment::fine::extract::{Clustering, cluster, without_strays};
use crate::segment::fine::network::{AffinityField, FEATURES, Frame};
use serde::Serialize;
use std::fmt;
use std::str::FromStr;
use std::time::Instant;

/// Cosines, or shares, from which a Gaussian is selected.
const THRESHOLDS: [f32; 8] = [0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98];
/// Scales that are tried, from large to small.
const SCALES: usize = 6;
/// What a further click has to add to the fit.
const WORTH: f64 = 0.005;

/// A way to turn a click into a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub enum Method {
    /// All of the clicked colour.
    #[serde(rename = "coarse")]
    Coarse,
    /// The affinity field alone, trained on masks of the whole scene.
    #[serde(rename = "fine")]
    Fine,
    /// The affinity field within the clicked colour.
    #[serde(rename = "coarse+fine")]
    CoarseFine,
    /// Affinity features of each Gaussian, gated by scale.
    #[serde(rename = "saga")]
    Saga,
    /// Votes of the masks, without training.
    #[serde(rename = "sagd")]
    Sagd,
}

impl Method {
    /// All, in the order of the tables.
    pub const ALL: [Self; 5] = [Self::Sagd, Self::Saga, Self::Coarse, Self::Fine, Self::CoarseFine];

    /// Its name on the command line and in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Coarse => "coarse",
            Self::Fine => "fine",
            Self::CoarseFine => "coarse+fine",
            Self::Saga => "saga",
            Self::Sagd => "sagd",
        }
    }
}

impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Method {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|m| m.name() == text);
        found.ok_or_else(|| format!("no method \"{text}\"; there is {}", Self::ALL.map(Self::name).join(", ")))
    }
}

/// Gaussians that a method selects.
#[derive(Clone, Debug, Default)]
pub struct Selected {
    /// Their indices, ascending.
    pub members: Vec<u32>,
    /// What to add to each one's mean, `[M, 3]`, and log-scales, `[M, 3]`; empty for nothing.
    pub moved: (Vec<f32>, Vec<f32>),
    /// The setting, in words.
    pub setting: String,
}

impl Selected {
    /// The selected of the scene's Gaussians at any time.
    #[must_use]
    pub fn of(&self, at: &GaussiansAt) -> GaussiansAt {
        let mut alone = at.subset(&self.members);
        alone.means.iter_mut().zip(&self.moved.0).for_each(|(m, d)| *m += d);
        alone.log_scales.iter_mut().zip(&self.moved.1).for_each(|(s, d)| *s += d);
        alone
    }

    /// All of both; where both have a Gaussian, as this one has it.
    fn with(&self, other: &Self) -> Self {
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
            setting: format!("{}; {}", self.setting, other.setting),
            members: rows.iter().map(|row| row.0).collect(),
        }
    }
}

/// The best of many selections by how they fit where they were clicked, the first of equals; each is taken together with
/// what earlier clicks selected.
pub struct Best<'a> {
    prompt: &'a Prompt,
    flags: Vec<bool>,
    before: Option<Selected>,
    /// The best so far, with what was selected before.
    pub selected: Option<Selected>,
    /// Its fit in the clicked view.
    pub fit: f64,
    /// Seconds from a click to a selection, the least of all.
    pub seconds: f64,
}

impl<'a> Best<'a> {
    /// None yet, of `gaussians`.
    pub fn new(prompt: &'a Prompt, gaussians: usize) -> Self {
        let flags = vec![false; gaussians];
        Self { prompt, flags, before: None, selected: None, fit: -1.0, seconds: f64::INFINITY }
    }

    /// The next click: on what the best so far leaves out. `None` where nothing is left out, or nothing is selected.
    pub fn next_click(&mut self) -> Option<Click> {
        let selected = self.selected.as_ref()?;
        self.flags.fill(false);
        selected.members.iter().for_each(|&i| self.flags[i as usize] = true);
        let click = self.prompt.next(&self.flags)?;
        self.before.clone_from(&self.selected);
        Some(click)
    }

    /// Tries a selection that took `seconds` to make.
    pub fn offer(&mut self, selected: Selected, seconds: f64) {
        self.flags.fill(false);
        let before = self.before.iter().flat_map(|s| &s.members);
        selected.members.iter().chain(before).for_each(|&i| self.flags[i as usize] = true);
        self.seconds = self.seconds.min(seconds);
        let fit = self.prompt.fit(&self.flags);
        // a further click must be worth its while
        let least = if self.before.is_some() { WORTH } else { 0.0 };
        if fit > self.fit + least {
            let selected = match &self.before {
                Some(before) => before.with(&selected),
                None => selected,
            };
            (self.fit, self.selected) = (fit, Some(selected));
        }
    }
}

/// Offers what an affinity field makes of a click on the Gaussian `clicked`, among the Gaussians `within`: all that is
/// like it from several thresholds on, and its cluster by density and into several numbers, at each scale.
///
/// # Errors
/// If clustering fails.
pub fn offer_field(
    best: &mut Best<'_>,
    (field, frame): (&AffinityField, &Frame),
    at: &GaussiansAt,
    within: &[u32],
    clicked: u32,
    seed: u64,
) -> Result<(), String> {
    let Ok(position) = within.binary_search(&clicked) else { return Ok(()) };
    let means = at.subset(within).means;
    let encoded = frame.encode(&means);
    let chosen = |keep: &dyn Fn(usize) -> bool| -> Vec<u32> {
        within.iter().enumerate().filter(|(i, _)| keep(*i)).map(|(_, &m)| m).collect()
    };
    for step in (0..SCALES).rev() {
        let scale = step as f32 / (SCALES - 1) as f32;
        let started = Instant::now();
        let features = field.features(&encoded, scale);
        let of = &features[position * FEATURES..][..FEATURES];
        let cosines: Vec<f32> =
            features.chunks_exact(FEATURES).map(|row| row.iter().zip(of).map(|(a, b)| a * b).sum()).collect();
        let seconds = started.elapsed().as_secs_f64();
        for threshold in THRESHOLDS {
            let started = Instant::now();
            let members = chosen(&|i| cosines[i] >= threshold);
            let setting = format!("scale {scale:.1}, cosine {threshold}");
            offer_both(best, at, members, setting, seconds, started)?;
        }
        let kinds = [Clustering::Density].into_iter().chain([2, 4, 8].map(Clustering::KMeans));
        for kind in kinds.filter(|k| !matches!(k, Clustering::KMeans(k) if *k > within.len())) {
            let started = Instant::now();
            let labels = cluster(field, frame, &means, scale, kind, seed).map_err(|e| e.to_string())?;
            let mine = labels[position];
            if mine == 0 {
                continue;
            }
            let members = chosen(&|i| labels[i] == mine);
            let setting = match kind {
                Clustering::Density => format!("scale {scale:.1}, clusters by density"),
                Clustering::KMeans(k) => format!("scale {scale:.1}, {k} clusters"),
            };
            offer_both(best, at, members, setting, 0.0, started)?;
        }
    }
    Ok(())
}

/// Offers the members without strays, as `segment split` and `pick` take them, and then all of them.
fn offer_both(
    best: &mut Best<'_>,
    at: &GaussiansAt,
    members: Vec<u32>,
    setting: String,
    seconds: f64,
    started: Instant,
) -> Result<(), String> {
    let kept = without_strays(at, &members).map_err(|e| e.to_string())?;
    let seconds = seconds + started.elapsed().as_secs_f64();
    best.offer(Selected { members: kept, setting: setting.clone(), ..Selected::default() }, seconds);
    let setting = format!("{setting}, with strays");
    best.offer(Selected { members, setting, ..Selected::default() }, seconds);
    Ok(())
}

/// Offers what SAGA makes of a click on the Gaussian `clicked`.
pub fn offer_saga(best: &mut Best<'_>, model: &SagaModel, clicked: u32) {
    for step in (0..SCALES).rev() {
        let scale = step as f32 / (SCALES - 1) as f32;
        for threshold in THRESHOLDS {
            let started = Instant::now();
            let selected = model.select(clicked, scale, threshold);
            let members = (0..selected.len() as u32).filter(|&i| selected[i as usize]).collect();
            let setting = format!("scale {scale:.1}, threshold {threshold}");
            best.offer(Selected { members, setting, ..Selected::default() }, started.elapsed().as_secs_f64());
        }
    }
}

/// Offers what SAGD makes of a click on the Gaussian `clicked`, by each mask that it could mean.
///
/// # Errors
/// If a mask does not fit its camera.
pub fn offer_sagd(best: &mut Best<'_>, at: &GaussiansAt, views: &[SagdView], clicked: u32) -> Result<(), String> {
    for (choice, name) in
        [(MaskChoice::Largest, "largest"), (MaskChoice::Middle, "middle"), (MaskChoice::Smallest, "smallest")]
    {
        let started = Instant::now();
        let options = SagdOptions { choice, ..SagdOptions::default() };
        let found = sagd::segment(at, views, clicked, &options).map_err(|e| e.to_string())?;
        let seconds = started.elapsed().as_secs_f64();
        let before = at.subset(&found.members);
        let change = |new: &[f32], old: &[f32]| new.iter().zip(old).map(|(a, b)| a - b).collect();
        let moved =
            (change(&found.gaussians.means, &before.means), change(&found.gaussians.log_scales, &before.log_scales));
        best.offer(Selected { members: found.members, moved, setting: format!("{name} mask") }, seconds);
    }
    Ok(())
}
