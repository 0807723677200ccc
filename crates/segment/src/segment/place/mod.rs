//! Where a segment is: the one definition on which its volume, extent, centroid, labels on voxels and overlap with the
//! ground truth rest.
//!
//! A Gaussian i is drawn, by a ray that passes its centre at `d` standard deviations, with the optical depth
//! `D_i(d) = -ln(1 - opacity_i exp(-d^2 / 2))`. With its standard deviations `a_i, b_i, c_i` and their geometric mean
//! `s_i`, the *extinction density* of segment S is, per unit of length,
//!
//! ```text
//! sigma_S(x) = sum over i in S of  s_i^2 / (sqrt(2 pi) a_i b_i c_i)  D_i(d_i(x))
//! ```
//!
//! The Gaussians are those of a picture, widened by its dilation
//! ([`HostGaussians::widened`](crate::model::HostGaussians::widened)): trained ones may be far smaller than a pixel, and
//! still cover one.
//!
//! Density alone does not say where an opaque body ends: pictures only ask that its surface be dense enough, and say
//! nothing of how dense. They say where a ray that just misses it passes. Such a ray stays in a layer of thickness s
//! around a body of radius R over a length of `sqrt(2 pi R s)`. The *local opacity* of S is what it would absorb of that
//! ray,
//!
//! ```text
//! alpha_S(x) = 1 - exp(-sigma_S(x) L_S),   L_S = sqrt(2 pi R_S s_S)
//! ```
//!
//! where `s_S` is the mean of the `s_i` by content `2 pi D_i(0) s_i^2` (a Gaussian's density summed over space, if it is
//! thin), and `R_S` the radius of a ball with the volume that S has by its own density. In a thin medium it is
//! proportional to the density; where S is opaque it is 1, however dense. The *typical* local opacity of S is the mean of
//! `alpha_S` weighted by itself.
//!
//! S *is* at a place where its local opacity is at least half of the typical one ([`SHARE`]): a blur of any width has
//! half of its plateau at the edge of what was blurred. Of segments that are at the same place, the one of the largest
//! density has it. All Gaussians without a segment count as one more segment.
//!
//! *Hidden* places ([`sight`]) are in no picture: nearly nothing of any ray through one of them is left. They belong to
//! the segment of the nearest place that is not hidden: opaque bodies are full.
//!
//! Nothing here is a length or a density chosen in advance, so that the same scene in other units has the same segments.

pub mod bell;
pub mod density;
mod edge;
mod fields;
mod measure;
pub mod sight;
#[cfg(test)]
mod tests;

pub use edge::SegmentEdge;
pub use fields::DensityFields;
pub use measure::Measure;

use crate::model::HostGaussians;
use crate::volume::grid::{Grid, face_neighbours};
use bell::{Bell, BellProfile};
use density::{Density, bells, content};
use glam::DVec3;
use rayon::prelude::*;
use std::collections::VecDeque;

/// Share of a segment's typical local opacity down to which it is at a place.
pub const SHARE: f32 = 0.5;

/// Cells along the longest side of a scene.
const CELLS: usize = 128;
/// Share of a scene's box that is added on each side: a blur reaches beyond what it blurs.
const BORDER: f64 = 0.03;
/// Smallest standard deviation of a Gaussian in cells (of the smallest spacing). With 0, flat Gaussians between the
/// centres of cells leave holes: on a sphere of Gaussians a tenth of a cell thick half of the cells are missed, with 0.5
/// none.
const SMALLEST_SIGMA: f64 = 0.5;

/// Gaussians at one time with the segment of each; flat and row-major.
#[derive(Clone, Copy, Debug)]
pub struct Cloud<'a> {
    /// Positions `[N, 3]`, in the units of the grid.
    pub means: &'a [f32],
    /// Quaternions w, x, y, z `[N, 4]`, not necessarily of unit length.
    pub rotations: &'a [f32],
    /// Natural logarithm of the standard deviations `[N, 3]`, in the units of the grid.
    pub log_scales: &'a [f32],
    /// Linear opacity `[N]`; below 1/255 a Gaussian is invisible and does not count.
    pub opacity: &'a [f32],
    /// Label of the segment `[N]`, 0 to 65535; 0 is none.
    pub labels: &'a [u32],
}

impl<'a> Cloud<'a> {
    /// The Gaussians `at` one time with their linear `opacity` and `labels`.
    pub fn new(at: &'a HostGaussians, opacity: &'a [f32], labels: &'a [u32]) -> Self {
        Self { means: &at.means, rotations: &at.rotations, log_scales: &at.log_scales, opacity, labels }
    }

    /// The content of Gaussian `i`, `2 pi tau s^2`: its extinction density summed over space; 0 if it is invisible or
    /// not finite.
    pub fn content(&self, i: usize) -> f64 {
        let opacity = self.opacity[i];
        let log = self.log_scales[3 * i..3 * i + 3].iter().map(|s| f64::from(*s)).sum::<f64>();
        let content = bell::depth(opacity) * std::f64::consts::TAU * (2.0 / 3.0 * log).exp();
        if opacity >= bell::INVISIBLE && opacity.is_finite() && content.is_finite() { content } else { 0.0 }
    }
}

/// Why places cannot be found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PlaceError {
    /// An array is of the wrong length.
    #[error("{field}: {found} values, but {expected} are needed; give every array the same number of Gaussians")]
    Shape {
        /// The array.
        field: &'static str,
        /// Values needed.
        expected: usize,
        /// Values found.
        found: usize,
    },
    /// A label does not fit 16 bits.
    #[error("labels: label {label} of Gaussian {index} is above 65535; renumber the segments")]
    Label {
        /// The label.
        label: u32,
        /// The Gaussian.
        index: usize,
    },
    /// The grid has no cell, or too many, or no size.
    #[error("grid: {problem}; give at least one voxel per axis, positive spacings and a finite origin")]
    Grid {
        /// What is wrong.
        problem: String,
    },
    /// The share is out of range.
    #[error("threshold: {0} is out of range; give a number from 0 to 1")]
    Share(f32),
}

/// Returns the cells on which segments of a scene with this box, scene units, are found: about 128 along its longest
/// side, cubes, the same at all times.
pub fn scene_grid(centre: [f32; 3], half_size: [f32; 3]) -> Grid {
    let half = half_size.map(|h| f64::from(h) * (1.0 + 2.0 * BORDER));
    let longest = half.iter().copied().fold(0.0, f64::max).max(f64::MIN_POSITIVE);
    let cell = 2.0 * longest / CELLS as f64;
    let dims = half.map(|h| ((2.0 * h / cell).ceil() as usize).max(1));
    let origin = std::array::from_fn(|k| f64::from(centre[k]) - 0.5 * cell * (dims[k] - 1) as f64);
    Grid::aligned(dims, [cell; 3], origin)
}

/// One cell.
#[derive(Clone, Copy, Debug, Default)]
struct PlaceCell {
    /// Density of the owner; 0 if there is none.
    density: f32,
    /// Local opacity of the owner.
    opacity: f32,
    /// Label of the owner.
    owner: u16,
    hidden: bool,
}

/// A Gaussian in the cell that holds its centre.
#[derive(Clone, Copy, Debug)]
struct Site {
    index: u32,
    label: u32,
    cell: u32,
}

/// Where segments are at one time.
#[derive(Debug)]
pub struct SegmentPlaces<'a> {
    cloud: Cloud<'a>,
    grid: Grid,
    cells: Vec<PlaceCell>,
    /// By label.
    edges: Vec<SegmentEdge>,
    sites: Vec<Site>,
}

impl<'a> SegmentPlaces<'a> {
    /// Finds the places of the segments of `cloud` on the cells of `grid`; a segment is where its local opacity is at
    /// least `share` of the typical one.
    ///
    /// Gaussians with a non-finite value, a quaternion of length 0, or a scale beyond single precision do not count.
    ///
    /// # Errors
    /// [`PlaceError`]: arrays that disagree, a label above 65535, an impossible grid or share.
    pub fn new(cloud: Cloud<'a>, grid: &Grid, share: f32) -> Result<Self, PlaceError> {
        let mut cells = vec![PlaceCell::default(); check(&cloud, grid)?];
        if !(0.0..=1.0).contains(&share) {
            return Err(PlaceError::Share(share));
        }
        let bells = bells(&cloud, grid, smallest(grid));
        let labels = cloud.labels.iter().max().map_or(1, |l| *l as usize + 1);
        let mut edges = vec![SegmentEdge::default(); labels];
        for party in bells.chunk_by(|a, b| a.label == b.label) {
            let label = party[0].label;
            let density = Density::new(party, BellProfile::Drawn);
            let edge = SegmentEdge::new(&density, party, grid, share);
            density.rows(grid.dims, &mut cells, |values, cells| {
                for (value, cell) in values.iter().zip(cells) {
                    if *value >= edge.density && *value > cell.density {
                        let opacity = -(-f64::from(*value) * edge.path).exp_m1();
                        *cell = PlaceCell { density: *value, opacity: opacity as f32, owner: label as u16, ..*cell };
                    }
                }
            });
            edges[label as usize] = edge;
        }
        let site = |bell: &Bell| {
            let cell = bell.cell(grid.dims)? as u32;
            Some(Site { index: bell.index, label: bell.label, cell })
        };
        let sites = bells.iter().filter_map(site).collect();
        let mut places = Self { cloud, grid: *grid, cells, edges, sites };
        places.fill(&bells);
        Ok(places)
    }

    /// Gives hidden places to the segment of the nearest place that is not.
    fn fill(&mut self, bells: &[Bell]) {
        let hidden = sight::hidden(&content(bells, self.grid.dims), &self.grid);
        let around = |c: usize| face_neighbours(c, self.grid.dims);
        let inside = (0..hidden.len()).filter(|c| hidden[*c]);
        let mut open: Vec<usize> =
            inside.flat_map(around).filter(|c| !hidden[*c] && self.cells[*c].density > 0.0).collect();
        open.sort_unstable();
        open.dedup();
        let mut open = VecDeque::from(open);
        while let Some(c) = open.pop_front() {
            let PlaceCell { owner, density, .. } = self.cells[c];
            for n in around(c).filter(|n| hidden[*n]) {
                let cell = &mut self.cells[n];
                if !cell.hidden {
                    // as opaque as can be
                    (cell.hidden, cell.owner, cell.opacity) = (true, owner, 1.0);
                    cell.density = cell.density.max(density);
                    open.push_back(n);
                }
            }
        }
    }

    /// The cells.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Where the segment `label` ends; zeros if it is nowhere.
    pub fn edge(&self, label: u32) -> SegmentEdge {
        self.edges.get(label as usize).copied().unwrap_or_default()
    }

    /// The label of the segment at each cell, `[z, y, x]`; 0 for none.
    pub fn labels(&self) -> Vec<u16> {
        self.cells.iter().map(|cell| cell.owner).collect()
    }

    /// The Gaussians whose centres lie in the place of segment `label`, ascending.
    pub fn within(&self, label: u32) -> Vec<u32> {
        let there = |site: &&Site| {
            let cell = &self.cells[site.cell as usize];
            cell.density > 0.0 && u32::from(cell.owner) == label
        };
        let mut found: Vec<u32> = self.sites.iter().filter(there).map(|site| site.index).collect();
        found.sort_unstable();
        found
    }

    /// The share of the content of each segment whose Gaussians lie in its place, by label from 0; `None` for a segment
    /// without visible Gaussians.
    pub fn shares(&self) -> Vec<Option<f64>> {
        let mut sums = vec![[0.0f64; 2]; self.edges.len()];
        for (i, label) in self.cloud.labels.iter().enumerate() {
            sums[*label as usize][1] += self.cloud.content(i);
        }
        for site in &self.sites {
            let cell = &self.cells[site.cell as usize];
            if cell.density > 0.0 && u32::from(cell.owner) == site.label {
                sums[site.label as usize][0] += self.cloud.content(site.index as usize);
            }
        }
        sums.into_iter().map(|[inside, all]| (all > 0.0).then(|| (inside / all).min(1.0))).collect()
    }

    /// The label of the segment at the centre of each voxel of another grid, `[z, y, x]` with x fastest; 0 for none.
    /// `along` are the same Gaussians along the axes of that grid, and `in_scene` brings a place there back. Hidden places
    /// are those of the cells that the voxels' centres are in.
    ///
    /// # Errors
    /// If the grid is impossible, or arrays of `along` disagree.
    pub fn labels_on(
        &self,
        along: Cloud<'_>,
        grid: &Grid,
        in_scene: impl Fn(DVec3) -> DVec3 + Sync,
    ) -> Result<Vec<u16>, PlaceError> {
        let mut voxels = vec![(0.0f32, 0u16); check(&along, grid)?];
        let smallest = smallest(grid).max(smallest(&self.grid));
        for party in bells(&along, grid, smallest).chunk_by(|a, b| a.label == b.label) {
            let label = party[0].label;
            let edge = self.edge(label).density;
            Density::new(party, BellProfile::Drawn).rows(grid.dims, &mut voxels, |values, voxels| {
                for (value, voxel) in values.iter().zip(voxels) {
                    if edge > 0.0 && *value >= edge && *value > voxel.0 {
                        *voxel = (*value, label as u16);
                    }
                }
            });
        }
        if self.cells.iter().all(|cell| !cell.hidden) {
            return Ok(voxels.into_iter().map(|(_, label)| label).collect());
        }
        let [x, y, _] = grid.dims;
        let [cx, cy, _] = self.grid.dims;
        let (origin, steps) = (DVec3::from_array(grid.origin), grid.steps());
        let (first, inverse) = (DVec3::from_array(self.grid.origin), self.grid.steps().inverse());
        let cell = |v: usize| {
            let index = [v % x, v / x % y, v / (x * y)].map(|v| v as f64);
            let at = (inverse * (in_scene(origin + steps * DVec3::from_array(index)) - first)).round();
            let inside = (0..3).all(|k| at[k] >= 0.0 && at[k] < self.grid.dims[k] as f64);
            inside.then(|| &self.cells[(at[2] as usize * cy + at[1] as usize) * cx + at[0] as usize])
        };
        let label = |(v, (_, label)): (usize, &(f32, u16))| {
            cell(v).filter(|cell| cell.hidden).map_or(*label, |cell| cell.owner)
        };
        Ok(voxels.par_iter().enumerate().map(label).collect())
    }
}

/// The smallest standard deviation that a Gaussian counts with on a grid, in its units.
fn smallest(grid: &Grid) -> f64 {
    SMALLEST_SIGMA * grid.spacing.iter().copied().fold(f64::INFINITY, f64::min)
}

/// Checks all arguments and returns the number of cells.
fn check(cloud: &Cloud<'_>, grid: &Grid) -> Result<usize, PlaceError> {
    let n = cloud.labels.len();
    for (field, found, expected) in [
        ("means", cloud.means.len(), 3 * n),
        ("rotations", cloud.rotations.len(), 4 * n),
        ("log_scales", cloud.log_scales.len(), 3 * n),
        ("opacity", cloud.opacity.len(), n),
    ] {
        if found != expected {
            return Err(PlaceError::Shape { field, expected, found });
        }
    }
    if let Some(index) = cloud.labels.iter().position(|&l| l > u32::from(u16::MAX)) {
        return Err(PlaceError::Label { label: cloud.labels[index], index });
    }
    let bad = |problem: String| Err(PlaceError::Grid { problem });
    if !grid.spacing.iter().all(|s| s.is_finite() && *s > 0.0) || !grid.origin.iter().all(|o| o.is_finite()) {
        return bad(format!("spacing {:?}, origin {:?}", grid.spacing, grid.origin));
    }
    let count = grid.dims.iter().try_fold(1usize, |n, d| n.checked_mul(*d));
    match count.filter(|n| *n > 0 && isize::try_from(*n).is_ok_and(|n| n.checked_mul(2).is_some())) {
        Some(count) => Ok(count),
        None => bad(format!("{:?} voxels", grid.dims)),
    }
}
