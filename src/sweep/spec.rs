//! How segmentation is measured in a sweep: the keys `segments.*` of variants, which are no keys of training.

use crate::data::paths::Axis;
use crate::eval::segments::{MaskKind, Method, SegmentOptions};
use crate::segment::baselines::saga::SagaOptions;
use crate::segment::coarse::CoarseOptions;
use crate::segment::fine::train::FineOptions;
use serde::{Deserialize, Serialize};
use volseggs_kernels::contrast::Repulsion;

/// Most views with masks, and most colours, that anybody can want; beyond, memory ends.
const MOST_VIEWS: usize = 100_000;
const MOST_COLOURS: usize = 10_000;

/// One measurement of segments, as `volseggs eval --segments` does it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SegmentSpec {
    /// Method: sagd, saga, coarse, fine or coarse+fine.
    pub method: String,
    /// Source of the masks: regions or labels.
    pub masks: String,
    /// Views with masks.
    pub views: usize,
    /// Take these views near an axis (x, y or z) in place of the whole sphere; empty for none.
    pub bias: String,
    /// Largest angle from that axis, degrees.
    pub bias_angle: f64,
    /// Time of the clicks in [0, 1].
    pub time: f64,
    /// Known segments to measure; all if empty.
    pub only: Vec<String>,
    /// Clicks on a segment at most.
    pub clicks: usize,
    /// Number of colours; suggested from the data if not given.
    pub clusters: Option<usize>,
    /// Steps of the affinity field.
    pub fine_steps: usize,
    /// Steps of SAGA.
    pub saga_steps: usize,
    /// Margin of the contrastive loss; -1 is the paper's loss, without one.
    pub margin: f32,
}

impl Default for SegmentSpec {
    fn default() -> Self {
        Self {
            method: "coarse+fine".into(),
            masks: "regions".into(),
            views: 30,
            bias: String::new(),
            bias_angle: 45.0,
            time: 0.5,
            only: Vec::new(),
            clicks: 1,
            clusters: None,
            fine_steps: 5000,
            saga_steps: 10_000,
            margin: 0.5,
        }
    }
}

impl SegmentSpec {
    /// The same as options of the evaluation; `seed` is the run's.
    ///
    /// # Errors
    /// A message that names the key.
    pub fn options(&self, seed: u64) -> Result<SegmentOptions, String> {
        let method: Method = self.method.parse().map_err(|e| format!("segments.method: {e}"))?;
        let masks = match self.masks.as_str() {
            "regions" => MaskKind::Regions,
            "labels" => MaskKind::Labels,
            other => return Err(format!("segments.masks: \"{other}\" is neither regions nor labels")),
        };
        let bias: Option<Axis> = match self.bias.as_str() {
            "" => None,
            axis => Some(axis.parse().map_err(|e| format!("segments.bias: {e}"))?),
        };
        if bias.is_some() && masks == MaskKind::Labels {
            return Err("segments.bias: label images have the dataset's own views; use masks = \"regions\"".into());
        }
        let counts = [
            ("views", self.views),
            ("clicks", self.clicks),
            ("fine_steps", self.fine_steps),
            ("saga_steps", self.saga_steps),
        ];
        if let Some((key, _)) = counts.into_iter().find(|(_, n)| *n == 0) {
            return Err(format!("segments.{key}: at least 1"));
        }
        let most = [("views", self.views, MOST_VIEWS), ("clicks", self.clicks, 1000)];
        if let Some((key, n, most)) = most.into_iter().find(|(_, n, most)| n > most) {
            return Err(format!("segments.{key} = {n}: at most {most}"));
        }
        if let Some(clusters) = self.clusters.filter(|n| !(1..=MOST_COLOURS).contains(n)) {
            return Err(format!("segments.clusters = {clusters}: from 1 to {MOST_COLOURS}"));
        }
        if !(self.margin.is_finite() && (-1.0..=1.0).contains(&self.margin)) {
            return Err(format!("segments.margin = {}: a cosine, from -1 to 1", self.margin));
        }
        if !(0.0..=1.0).contains(&self.time) {
            return Err(format!("segments.time: {} is not in [0, 1]", self.time));
        }
        if !(self.bias_angle > 0.0 && self.bias_angle <= 180.0) {
            return Err(format!("segments.bias_angle: {} is not in (0, 180]", self.bias_angle));
        }
        let repulsion = if self.margin <= -1.0 { Repulsion::Cosine } else { Repulsion::Margin(self.margin) };
        Ok(SegmentOptions {
            time: self.time,
            methods: vec![method],
            segments: self.only.clone(),
            clicks: self.clicks,
            masks,
            views: self.views,
            bias: bias.map(|axis| (axis, self.bias_angle.to_radians())),
            coarse: CoarseOptions { clusters: self.clusters, seed, ..CoarseOptions::default() },
            fine: FineOptions { steps: self.fine_steps, repulsion, seed, ..FineOptions::default() },
            saga: SagaOptions { steps: self.saga_steps, seed, ..SagaOptions::default() },
            mask_alpha: None,
        })
    }
}
