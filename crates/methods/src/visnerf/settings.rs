//! `visnerf.*`

use crate::ranges::{above_zero, at_least_one, not_negative};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use volseggs_core::config::sections::Settings;

/// `visnerf.*`: grids, networks and training of ViSNeRF. The defaults are the published settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct VisNerfConfig {
    /// Number of voxels in the box; with the box's shape it gives the number of nodes of planes and lines along each
    /// axis.
    pub voxels: usize,
    /// Margin added around the box of the visual hull, as a fraction of its size.
    pub bounds_margin: f64,
    /// Number of planes and lines per orientation for density.
    pub density_ranks: usize,
    /// Number of planes and lines per orientation for appearance.
    pub appearance_ranks: usize,
    /// Number of values per training time, in each of the two grids.
    pub time_ranks: usize,
    /// Number of features that each network receives from its grid.
    pub features: usize,
    /// Octaves of the encoding of a network's inputs, in addition to the inputs themselves.
    pub octaves: usize,
    /// Width of the hidden layers.
    pub width: usize,
    /// Subtracted from the output of the density network, before softplus.
    pub density_shift: f64,
    /// Factor applied to distances along rays.
    pub distance_scale: f64,
    /// Samples with a smaller weight in their pixel are not coloured.
    pub least_weight: f64,
    /// Number of steps.
    pub steps: usize,
    /// Rays per step.
    pub batch: usize,
    /// Samples along the longest ray at the first step.
    pub samples_first: usize,
    /// Samples along the longest ray from step `samples_until` on; the number grows linearly until then.
    pub samples_last: usize,
    /// Step at which `samples_last` is reached.
    pub samples_until: usize,
    /// Distance between samples in rendered images, in voxels.
    pub render_step: f64,
    /// Learning rate of planes, lines and vectors.
    pub rate_grid: f64,
    /// Learning rate of the networks.
    pub rate_network: f64,
    /// Final value of both rates, and of the weights `tv` and `tv_time`, as a fraction of the initial value.
    pub decay: f64,
    /// Steps at which Adam restarts with the initial rates; empty for never.
    pub restarts: Vec<usize>,
    /// Weight of the mean absolute values of density planes and lines, and of the deviation of density time vectors
    /// from 1.
    pub sparsity: f64,
    /// Weight of the total variation of appearance planes.
    pub tv: f64,
    /// Weight of the total variation of the time vectors.
    pub tv_time: f64,
    /// Cells along each axis of a grid that marks the places empty at each time, which are skipped; 0 for none.
    pub occupancy: usize,
    /// Steps between updates of this grid.
    pub occupancy_every: usize,
    /// A cell with a smaller opacity over one `render_step` counts as empty.
    pub occupancy_threshold: f64,
}

impl Settings for VisNerfConfig {
    const SECTION: &'static str = "visnerf";
}

impl Default for VisNerfConfig {
    fn default() -> Self {
        Self {
            voxels: 128 * 128 * 128,
            bounds_margin: 0.05,
            density_ranks: 16,
            appearance_ranks: 48,
            time_ranks: 4,
            features: 27,
            octaves: 2,
            width: 128,
            density_shift: 10.0,
            distance_scale: 25.0,
            least_weight: 1e-4,
            steps: 90_000,
            batch: 4096,
            samples_first: 64,
            samples_last: 196,
            samples_until: 60_000,
            render_step: 0.5,
            rate_grid: 0.02,
            rate_network: 1e-3,
            decay: 0.1,
            restarts: Vec::new(),
            sparsity: 8e-5,
            tv: 1e-2,
            tv_time: 1e-3,
            occupancy: 0,
            occupancy_every: 2000,
            occupancy_threshold: 1e-4,
        }
    }
}

impl VisNerfConfig {
    /// Rejects settings that no training can start with.
    ///
    /// # Errors
    /// The first invalid key with its value, and the values allowed.
    pub fn check(&self) -> Result<(), String> {
        at_least_one(&[
            ("visnerf.voxels", self.voxels),
            ("visnerf.density_ranks", self.density_ranks),
            ("visnerf.appearance_ranks", self.appearance_ranks),
            ("visnerf.time_ranks", self.time_ranks),
            ("visnerf.features", self.features),
            ("visnerf.width", self.width),
            ("visnerf.steps", self.steps),
            ("visnerf.batch", self.batch),
            ("visnerf.samples_first", self.samples_first),
            ("visnerf.samples_last", self.samples_last),
            ("visnerf.occupancy_every", self.occupancy_every),
        ])?;
        above_zero(&[
            ("visnerf.distance_scale", self.distance_scale),
            ("visnerf.rate_grid", self.rate_grid),
            ("visnerf.rate_network", self.rate_network),
            ("visnerf.decay", self.decay),
        ])?;
        not_negative(&[
            ("visnerf.bounds_margin", self.bounds_margin),
            ("visnerf.least_weight", self.least_weight),
            ("visnerf.sparsity", self.sparsity),
            ("visnerf.tv", self.tv),
            ("visnerf.tv_time", self.tv_time),
            ("visnerf.occupancy_threshold", self.occupancy_threshold),
        ])?;
        // with much smaller steps a ray would never reach its end
        if !(0.01..=100.0).contains(&self.render_step) {
            return Err(format!("visnerf.render_step = {:?}: between 0.01 and 100", self.render_step));
        }
        // `f32` counts exactly up to 2^24
        if self.octaves > 24 {
            return Err(format!("visnerf.octaves = {}: at most 24", self.octaves));
        }
        if self.occupancy > 1024 {
            return Err(format!("visnerf.occupancy = {}: at most 1024", self.occupancy));
        }
        Ok(())
    }
}
