//! How segmentation is measured in a sweep: the keys `segments.*` of variants, which are not keys of training.

use crate::config::types::SegmentConfig;
use crate::config::types::segment::MaskScale;
use crate::data::paths::Axis;
use crate::eval::segments::{Method, SegmentOptions};
use crate::segment::baselines::saga::SagaOptions;
use crate::segment::masks::origin::MaskKind;
use crate::segment::masks::origin::SAM_POINTS;
use crate::segment::masks::sam::checkpoint;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Maximum numbers of views with masks and of colours, above any reasonable need; with more, memory would run out.
const MAX_VIEWS: usize = 100_000;
const MAX_COLOURS: usize = 10_000;
/// Maximum numbers of pixels per step, which is how many are kept of a view, and of points along a side of the grid
/// that a network is asked at.
const MAX_PIXELS: usize = 16_384;
const MAX_POINTS: usize = 1000;

/// One measurement of segments, as `volseggs eval --segments` does it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SegmentSpec {
    /// Method: sagd, saga, coarse, fine or coarse+fine.
    pub method: String,
    /// Source of the masks: regions, labels, dir or sam.
    pub masks: String,
    /// For dir: the masks of another program, `GROUP/VIEW_NUMBER.png` or a COCO file; relative to the sweep file. All
    /// runs share them, so they suit methods whose group is the whole scene, `scene`.
    pub mask_dir: Option<PathBuf>,
    /// For sam: the weights, relative to the sweep file; looked for in the cache folder if not given.
    pub sam_weights: Option<PathBuf>,
    /// For sam: points along a side of the grid that the network is asked at.
    pub sam_points: usize,
    /// Number of views with masks.
    pub views: usize,
    /// Axis (x, y or z) near which these views are placed, instead of on the whole sphere; empty for none.
    pub bias: String,
    /// Largest angle from that axis, in degrees.
    pub bias_angle: f64,
    /// Time of the clicks in [0, 1].
    pub time: f64,
    /// Known segments to measure; all if empty.
    pub only: Vec<String>,
    /// Known segments to measure as one, each `NAME=SEGMENT+SEGMENT`.
    pub score: Vec<String>,
    /// Whether the oracle also chooses among settings, in addition to the fixed one.
    pub oracle: bool,
    /// Maximum number of clicks on a segment.
    pub clicks: usize,
    /// Number of colours; suggested from the data if not given.
    pub clusters: Option<usize>,
    /// Training steps of the affinity field; those of `segment.affinity` if not given.
    pub fine_steps: Option<usize>,
    /// Training steps of SAGA.
    pub saga_steps: usize,
    /// Pixels per step of the affinity field; those of `segment.affinity` if not given.
    pub pixels: Option<usize>,
    /// Margin of the contrastive loss; that of `segment.affinity` if not given.
    pub margin: Option<f32>,
    /// Scale that a step uses; that of `segment.affinity` if not given.
    pub mask_scale: Option<MaskScale>,
    /// The resolved options of segmentation, `segment.*`, which are not keys of this section.
    #[serde(skip_serializing_if = "SegmentConfig::is_default")]
    pub segment: SegmentConfig,
}

impl Default for SegmentSpec {
    fn default() -> Self {
        let SegmentOptions { time, clicks, oracle, views, saga, .. } = SegmentOptions::default();
        Self {
            method: "coarse+fine".into(),
            masks: "regions".into(),
            mask_dir: None,
            sam_weights: None,
            sam_points: SAM_POINTS,
            views,
            bias: String::new(),
            bias_angle: 45.0,
            time,
            only: Vec::new(),
            score: Vec::new(),
            oracle,
            clicks,
            clusters: None,
            fine_steps: None,
            saga_steps: saga.steps,
            pixels: None,
            margin: None,
            mask_scale: None,
            segment: SegmentConfig::default(),
        }
    }
}

impl SegmentSpec {
    /// Converts the specification into options of the evaluation; `seed` is the run's.
    ///
    /// # Errors
    /// A message that names the key.
    pub fn options(&self, seed: u64) -> Result<SegmentOptions, String> {
        let method: Method = self.method.parse().map_err(|e| format!("segments.method: {e}"))?;
        let masks = self.kind()?;
        let bias: Option<Axis> = match self.bias.as_str() {
            "" => None,
            axis => Some(axis.parse().map_err(|e| format!("segments.bias: {e}"))?),
        };
        if bias.is_some() && masks == MaskKind::Labels {
            return Err("segments.bias: label images have the dataset's own views; use other masks".into());
        }
        let config = self.config();
        let counts = [
            ("views", self.views),
            ("clicks", self.clicks),
            ("fine_steps", config.affinity.steps),
            ("pixels", config.affinity.pixels),
            ("sam_points", self.sam_points),
            ("saga_steps", self.saga_steps),
        ];
        if let Some((key, _)) = counts.into_iter().find(|(_, n)| *n == 0) {
            return Err(format!("segments.{key}: must be at least 1"));
        }
        let limits = [
            ("views", self.views, MAX_VIEWS),
            ("clicks", self.clicks, 1000),
            ("pixels", config.affinity.pixels, MAX_PIXELS),
            ("sam_points", self.sam_points, MAX_POINTS),
        ];
        if let Some((key, n, max)) = limits.into_iter().find(|(_, n, max)| n > max) {
            return Err(format!("segments.{key} = {n}: must be at most {max}"));
        }
        if let Some(clusters) = self.clusters.filter(|n| !(1..=MAX_COLOURS).contains(n)) {
            return Err(format!("segments.clusters = {clusters}: must be from 1 to {MAX_COLOURS}"));
        }
        if let Some(margin) = self.margin.filter(|margin| !(-1.0..=1.0).contains(margin)) {
            return Err(format!("segments.margin = {margin}: must be a cosine, from -1 to 1"));
        }
        if !(0.0..=1.0).contains(&self.time) {
            return Err(format!("segments.time: {} is not in [0, 1]", self.time));
        }
        if !(self.bias_angle > 0.0 && self.bias_angle <= 180.0) {
            return Err(format!("segments.bias_angle: {} is not in (0, 180]", self.bias_angle));
        }
        let unions = self.score.iter().map(|text| text.parse().map_err(|e| format!("segments.score: {e}")));
        Ok(SegmentOptions {
            time: self.time,
            methods: vec![method],
            segments: self.only.clone(),
            unions: unions.collect::<Result<_, String>>()?,
            clicks: self.clicks,
            oracle: self.oracle,
            masks,
            views: self.views,
            bias: bias.map(|axis| (axis, self.bias_angle.to_radians())),
            config,
            seed,
            saga: SagaOptions { steps: self.saga_steps, seed, ..SagaOptions::default() },
            mask_alpha: None,
        })
    }

    /// The options of segmentation, with those of this section.
    pub(super) fn config(&self) -> SegmentConfig {
        let mut config = self.segment.clone();
        config.colour.clusters = self.clusters.unwrap_or(config.colour.clusters);
        let affinity = &mut config.affinity;
        affinity.steps = self.fine_steps.unwrap_or(affinity.steps);
        affinity.pixels = self.pixels.unwrap_or(affinity.pixels);
        affinity.margin = self.margin.unwrap_or(affinity.margin);
        affinity.mask_scale = self.mask_scale.unwrap_or(affinity.mask_scale);
        config
    }

    /// Makes paths absolute that are relative to `base`, the folder of the sweep file.
    pub(super) fn place(&mut self, base: &Path) -> std::io::Result<()> {
        for path in [&mut self.mask_dir, &mut self.sam_weights].into_iter().flatten() {
            *path = std::path::absolute(base.join(&*path))?;
        }
        Ok(())
    }

    /// The source of masks, after a check that its files exist.
    fn kind(&self) -> Result<MaskKind, String> {
        let of = |key: &str, given: bool, kind: &str| match given && self.masks != kind {
            true => Err(format!("segments.{key}: applies to masks = \"{kind}\", not to \"{}\"", self.masks)),
            false => Ok(()),
        };
        of("mask_dir", self.mask_dir.is_some(), "dir")?;
        of("sam_weights", self.sam_weights.is_some(), "sam")?;
        of("sam_points", self.sam_points != SAM_POINTS, "sam")?;
        match self.masks.as_str() {
            "regions" => Ok(MaskKind::Regions),
            "labels" => Ok(MaskKind::Labels),
            "dir" => match &self.mask_dir {
                Some(path) if path.exists() => Ok(MaskKind::Dir(path.clone())),
                Some(path) => Err(format!("segments.mask_dir: {}: no such folder or file", path.display())),
                None => Err("segments.mask_dir: masks = \"dir\" needs a folder of masks or a COCO file".into()),
            },
            "sam" => {
                let weights = checkpoint::locate(self.sam_weights.as_deref());
                let weights = weights.map_err(|e| format!("segments.sam_weights: {e}"))?;
                Ok(MaskKind::Sam { weights, points: self.sam_points })
            }
            other => Err(format!("segments.masks: \"{other}\" is not one of regions, labels, dir, sam")),
        }
    }
}
