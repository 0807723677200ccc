//! The visual hull of the alpha masks: where the data can be. Provides the bounding box, points inside it and the
//! colours seen there. Knows nothing of Gaussians.
//!
//! A point is in the hull of a time if at least half of that time's views have it in their image, and all of these show
//! alpha there. The hull of a split is the union over its times.

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::carve::{AlphaMasks, HullGrid};
use super::dataset::Split;
use super::error::DataError;
use super::fit::shrink_to_silhouettes;
use crate::rng::{Purpose, Rng};

/// Maximum number of draws per point before the last one is accepted. Cells are kept only if they may hold hull, so
/// this is reached only in cells that barely touch the hull.
const MAX_DRAWS: usize = 64;
const CHUNK: usize = 1024;

/// An axis-aligned box in scene units.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Aabb {
    /// Smallest corner.
    pub min: DVec3,
    /// Largest corner.
    pub max: DVec3,
}

impl Aabb {
    /// The cube around `centre` of half-side `half`.
    pub fn cube(centre: DVec3, half: f64) -> Self {
        Self { min: centre - DVec3::splat(half), max: centre + DVec3::splat(half) }
    }

    /// The three side lengths.
    pub fn size(&self) -> DVec3 {
        self.max - self.min
    }

    /// The centre.
    pub fn centre(&self) -> DVec3 {
        0.5 * (self.min + self.max)
    }

    /// The box with `fraction` of its size added on every side.
    pub fn grown(&self, fraction: f64) -> Self {
        Self { min: self.min - fraction * self.size(), max: self.max + fraction * self.size() }
    }

    /// Whether the box holds the point (its faces included).
    pub fn contains(&self, p: DVec3) -> bool {
        p.cmpge(self.min).all() && p.cmple(self.max).all()
    }
}

/// Carving options.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HullOptions {
    /// Alpha in [0, 1] above which a pixel counts as seen.
    pub alpha_threshold: f32,
    /// Cells per axis of the coarse grid; the fine one has twice as many.
    pub resolution: usize,
}

impl Default for HullOptions {
    fn default() -> Self {
        Self { alpha_threshold: 0.0, resolution: 64 }
    }
}

/// The carved hull of a split.
#[derive(Debug, Clone, PartialEq)]
pub struct VisualHull {
    /// Its axis-aligned box, without spikes that no silhouette requires where there are enough views to decide.
    pub bounds: Aabb,
    /// The fraction of the box that the hull fills (cells of the fine grid), in (0, 1].
    pub filled: f64,
    /// False where the images have no transparent pixel: `bounds` then only shows where the cameras look.
    pub carved: bool,
}

impl VisualHull {
    /// Carves the hull from the alpha masks, coarse to fine.
    ///
    /// # Errors
    /// If the hull is empty.
    pub fn carve(split: &Split, options: &HullOptions) -> Result<Self, DataError> {
        let start = view_box(split);
        let masks = AlphaMasks::new(split, options.alpha_threshold);
        if masks.opaque() {
            return Ok(Self { bounds: start, filled: 1.0, carved: false });
        }
        let empty = || DataError::EmptyHull { split: split.name.to_string(), views: split.frames.len() };
        let n = options.resolution.max(2);
        // whole cells first, so that nothing thin is lost; then half cells of a box that fits
        let rough = HullGrid::carve(&masks, start, n / 2, 0.87).bounds().ok_or_else(empty)?;
        let coarse = HullGrid::carve(&masks, rough, n, 0.87);
        let fine = coarse.refine(&masks, 0.25);
        let bounds = fine.bounds().ok_or_else(empty)?;
        let bounds = shrink_to_silhouettes(split, bounds, options.alpha_threshold);
        let cells = bounds.size() / fine.cell();
        let held = fine.cells.iter().filter(|c| bounds.contains(fine.point(c.index, DVec3::splat(0.5)))).count();
        let filled = (held as f64 / (cells.x * cells.y * cells.z)).min(1.0);
        Ok(Self { bounds, filled, carved: true })
    }
}

/// The box of the visual hull of `split`, with the default options.
///
/// # Errors
/// If the hull is empty.
pub fn bounds(split: &Split) -> Result<Aabb, DataError> {
    VisualHull::carve(split, &HullOptions::default()).map(|hull| hull.bounds)
}

/// `n` points `[n, 3]`, uniform in the part of `bounds` that is in the hull of at least one time, or in all of `bounds`
/// if that part is empty. The same for the same `seed`, whatever the number of threads.
pub fn sample(split: &Split, bounds: Aabb, n: usize, seed: u64) -> Vec<[f32; 3]> {
    sample_in(&AlphaMasks::new(split, 0.0), bounds, n, seed).into_iter().map(|(p, _)| p.as_vec3().to_array()).collect()
}

/// Like [`sample`], with the straight RGB `[n, 3]` in [0, 1] seen at each point: the mean, weighted by alpha, over the
/// views of one time whose hull holds it; mid-grey where no view shows it.
pub fn sample_coloured(split: &Split, bounds: Aabb, n: usize, seed: u64) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let masks = AlphaMasks::new(split, 0.0);
    sample_in(&masks, bounds, n, seed)
        .into_par_iter()
        .with_min_len(CHUNK)
        .map(|(p, group)| (p.as_vec3().to_array(), masks.mean_colour(group, p)))
        .unzip()
}

/// Points, each with the index of a time group whose hull holds it.
fn sample_in(masks: &AlphaMasks<'_>, bounds: Aabb, n: usize, seed: u64) -> Vec<(DVec3, usize)> {
    let grid = if masks.opaque() { HullGrid::full(bounds) } else { HullGrid::carve(masks, bounds, 64, 0.87) };
    let grid = if grid.cells.is_empty() { HullGrid::full(bounds) } else { grid };
    let inside = |p: DVec3, first: usize| {
        if masks.opaque() { Some(first) } else { masks.group_holding(p, first) }
    };
    (0..n)
        .into_par_iter()
        .with_min_len(CHUNK)
        .map(|i| {
            let mut rng = Rng::new(seed, i as u64, Purpose::HullPoints);
            let mut last = (bounds.centre(), 0);
            for _ in 0..MAX_DRAWS {
                let cell = grid.cells[rng.below(grid.cells.len())];
                let at = DVec3::from_array(std::array::from_fn(|_| f64::from(rng.uniform())));
                let p = grid.point(cell.index, at);
                last = (p, cell.group);
                if let Some(group) = inside(p, cell.group) {
                    return (p, group);
                }
            }
            last
        })
        .collect()
}

/// Where the cameras look: the cube around the point nearest to all optical axes, as wide as the widest view there.
/// Where the axes do not meet, the cube in front of the mean camera at twice the cameras' spread.
pub fn view_box(split: &Split) -> Aabb {
    let cameras = || split.frames.iter().map(|f| &f.camera);
    let n = split.frames.len().max(1) as f64;
    let mean = cameras().map(super::camera::Camera::position).sum::<DVec3>() / n;
    let spread = cameras().map(|c| c.position().distance(mean)).fold(0.0, f64::max);
    let ahead = cameras().map(super::camera::Camera::forward).sum::<DVec3>().normalize_or_zero();
    let centre = super::camera::look_at_point(cameras())
        .map_or_else(|| mean + ahead * if spread > 0.0 { 2.0 * spread } else { 1.0 }, |(p, _)| p);
    let half = cameras().map(|c| c.position().distance(centre) * c.widest_slope()).fold(0.0, f64::max);
    Aabb::cube(centre, if half > 0.0 && half.is_finite() { half } else { 1.0 })
}

#[cfg(test)]
#[path = "hull_tests.rs"]
mod tests;
