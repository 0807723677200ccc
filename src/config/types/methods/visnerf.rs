//! `visnerf.*`

use super::{above_zero, at_least_one, not_negative};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `visnerf.*`: the grids, networks and training of ViSNeRF. The defaults are the published settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct VisNerfConfig {
    /// Voxels of the box, from whose number and shape the nodes along each axis follow: planes and lines have so many.
    pub voxels: usize,
    /// Margin added around the box of the visual hull, as a fraction of its size.
    pub bounds_margin: f64,
    /// Planes and lines of a kind for density.
    pub density_ranks: usize,
    /// Planes and lines of a kind for appearance.
    pub appearance_ranks: usize,
    /// Numbers that each training time has for itself, in either grid.
    pub time_ranks: usize,
    /// Features that a network gets of its grid.
    pub features: usize,
    /// Octaves in which a network sees its inputs, besides as they are.
    pub octaves: usize,
    /// Width of the hidden layers.
    pub width: usize,
    /// Taken from what the density network gives, before softplus.
    pub density_shift: f64,
    /// Factor of distances along rays.
    pub distance_scale: f64,
    /// Samples with a smaller weight in their pixel have no colour.
    pub least_weight: f64,
    /// Steps.
    pub steps: usize,
    /// Rays a step.
    pub batch: usize,
    /// Samples along the longest ray at the first step.
    pub samples_first: usize,
    /// The same from step `samples_until` on; in between their number rises evenly.
    pub samples_last: usize,
    /// When that is reached.
    pub samples_until: usize,
    /// Distance of samples in pictures, in voxels.
    pub render_step: f64,
    /// Learning rate of planes, lines and vectors.
    pub rate_grid: f64,
    /// Learning rate of the networks.
    pub rate_network: f64,
    /// What is left of both rates, and of the weights of `tv` and `tv_time`, at the end.
    pub decay: f64,
    /// Steps at which Adam starts anew, at the first rates; empty for never.
    pub restarts: Vec<usize>,
    /// Weight of the mean absolute value of planes and lines of density.
    pub sparsity: f64,
    /// Weight of the total variation of appearance planes.
    pub tv: f64,
    /// Weight of the total variation of the vectors of time.
    pub tv_time: f64,
    /// Cells along each axis in which places that are empty at a time are marked, to be passed over; 0 for none.
    pub occupancy: usize,
    /// Steps between two markings.
    pub occupancy_every: usize,
    /// A cell with less opacity over one `render_step` is empty.
    pub occupancy_threshold: f64,
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
    /// Refuses settings that no training can start with.
    ///
    /// # Errors
    /// The first such key with its value, and what it may be.
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
        // far smaller ones would never come to the end of a ray
        if !(0.01..=100.0).contains(&self.render_step) {
            return Err(format!("visnerf.render_step = {:?}: between 0.01 and 100", self.render_step));
        }
        // 2^24 is as far as single precision counts
        if self.octaves > 24 {
            return Err(format!("visnerf.octaves = {}: at most 24", self.octaves));
        }
        if self.occupancy > 1024 {
            return Err(format!("visnerf.occupancy = {}: at most 1024", self.occupancy));
        }
        Ok(())
    }
}
