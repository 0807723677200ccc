//! Intersection over union in space: whose Gaussians occupy the cells that the true segment occupies.
//!
//! Every cell of a ground-truth volume that shows anything belongs to the selection or to the rest. It belongs to the
//! selection if the selected Gaussians have more than half of the density at its centre (density as in
//! [`voxels`](crate::segment::voxels)). Interiors of opaque bodies hold no Gaussians, as no picture shows them: a cell
//! that no Gaussian reaches within three standard deviations goes with the Gaussian of the highest density there.
//! Densities are compared by their logarithm, which orders Gaussians even where the density itself is practically 0,
//! among the [`NEAREST`] Gaussians by the distance of their centres. Cells are weighted by their true opacity, so that
//! what is barely visible hardly counts, and empty space not at all.

use super::select::Selected;
use crate::data::TruthVolume;
use crate::model::HostGaussians;
use crate::points::neighbours::Grid as Neighbours;
use crate::segment::voxels::{LabelledCloud, Vote, VoxelError, label_voxels};
use crate::volume::grid::Grid;
use glam::{DQuat, DVec3};
use rayon::prelude::*;

/// Cells of a true opacity up to this are empty: a thousandth over the length of a cell is not visible anywhere.
const FLOOR: f32 = 1e-3;
/// Number of Gaussians considered for an unreached cell.
const NEAREST: usize = 16;
/// Opacity below which a Gaussian is invisible, as in drawing and in votes.
const INVISIBLE: f32 = 1.0 / 255.0;
/// Labels of the vote; the smaller one wins a tie, so that half is not more than half.
const REST: u32 = 1;
const CHOSEN: u32 = 2;

/// Returns how the vote is held: everything that is reached counts. The smallest scale is the default one, in cells.
fn vote() -> Vote {
    Vote { threshold: 0.0, ..Vote::default() }
}

/// The cells of a ground-truth volume with the Gaussians at its time.
pub struct Cells<'a> {
    volume: &'a TruthVolume,
    at: &'a HostGaussians,
    grid: Grid,
    /// The cells that show something and that no Gaussian reaches, ascending, each with the Gaussian that it belongs
    /// to.
    owners: Vec<(usize, u32)>,
}

impl<'a> Cells<'a> {
    /// Finds the cells that no Gaussian reaches, and the Gaussians they belong to. `at` are all Gaussians of the scene,
    /// `[N]`, at the volume's time.
    ///
    /// # Errors
    /// If arrays of the volume do not match its grid, or arrays of `at` disagree.
    pub fn new(volume: &'a TruthVolume, at: &'a HostGaussians) -> Result<Self, VoxelError> {
        let grid = Grid::aligned(volume.dims, volume.spacing, volume.origin);
        for (field, found) in [("ids", volume.ids.len()), ("opacity", volume.opacity.len())] {
            if found != grid.len() {
                return Err(VoxelError::Shape { field, expected: grid.len(), found });
            }
        }
        let owners = owners(volume, &grid, at)?;
        Ok(Self { volume, at, grid, owners })
    }

    /// Returns whether a cell that shows something has one of `ids`; a segment thinner than the cells may have none.
    pub fn hold(&self, ids: &[u16]) -> bool {
        self.volume.ids.iter().zip(&self.volume.opacity).any(|(id, opacity)| shows(*opacity) && ids.contains(id))
    }

    /// Returns the share of what the cells show, by true opacity, that has an id, in [0, 1]; `None` if they show nothing.
    pub fn labelled_share(&self) -> Option<f64> {
        let (mut labelled, mut all) = (0.0f64, 0.0f64);
        for (id, opacity) in self.volume.ids.iter().zip(&self.volume.opacity).filter(|(_, o)| shows(**o)) {
            labelled += if *id > 0 { f64::from(*opacity) } else { 0.0 };
            all += f64::from(*opacity);
        }
        (all > 0.0).then(|| labelled / all)
    }

    /// Returns the sum of the true opacities of the cells that are both in a segment of `ids` and in the selection,
    /// over that of those in either, in [0, 1]; `None` if no cell is in either.
    ///
    /// # Errors
    /// If arrays disagree.
    pub fn iou(&self, selected: &Selected, ids: &[u16]) -> Result<Option<f64>, VoxelError> {
        if selected.moves() {
            // Gaussians that were cut back reach other cells
            let moved = selected.within(self.at);
            let owners = owners(self.volume, &self.grid, &moved)?;
            return self.compare(&moved, &owners, selected, ids);
        }
        self.compare(self.at, &self.owners, selected, ids)
    }

    fn compare(
        &self,
        at: &HostGaussians,
        owners: &[(usize, u32)],
        selected: &Selected,
        ids: &[u16],
    ) -> Result<Option<f64>, VoxelError> {
        let mut labels = vec![REST; at.len()];
        selected.members.iter().for_each(|&i| labels[i as usize] = CHOSEN);
        let mut of_cells = label_voxels(&cloud(at, &at.opacity(), &labels), &self.grid, &vote())?;
        for &(cell, owner) in owners {
            of_cells[cell] = labels[owner as usize] as u16;
        }
        // one after the other, for the same sum with any number of threads
        let (mut both, mut either) = (0.0f64, 0.0f64);
        for ((label, id), opacity) in of_cells.iter().zip(&self.volume.ids).zip(&self.volume.opacity) {
            if !shows(*opacity) {
                continue;
            }
            let (chosen, known) = (u32::from(*label) == CHOSEN, ids.contains(id));
            both += if chosen && known { f64::from(*opacity) } else { 0.0 };
            either += if chosen || known { f64::from(*opacity) } else { 0.0 };
        }
        Ok((either > 0.0).then(|| both / either))
    }
}

/// Returns whether a cell of this true opacity counts; NaN does not.
fn shows(opacity: f32) -> bool {
    opacity > FLOOR && opacity.is_finite()
}

fn cloud<'a>(at: &'a HostGaussians, opacity: &'a [f32], labels: &'a [u32]) -> LabelledCloud<'a> {
    LabelledCloud { means: &at.means, rotations: &at.rotations, log_scales: &at.log_scales, opacity, labels }
}

/// Returns the cells that show something and that no Gaussian reaches, ascending, each with the Gaussian that it
/// belongs to; none if there is no visible Gaussian at all.
fn owners(volume: &TruthVolume, grid: &Grid, at: &HostGaussians) -> Result<Vec<(usize, u32)>, VoxelError> {
    let opacity = at.opacity();
    let reached = label_voxels(&cloud(at, &opacity, &vec![REST; at.len()]), grid, &vote())?;
    let open: Vec<usize> = (0..reached.len()).filter(|&c| reached[c] == 0 && shows(volume.opacity[c])).collect();
    let smallest = f64::from(vote().smallest_sigma) * grid.spacing.iter().copied().fold(f64::INFINITY, f64::min);
    let bells: Vec<Option<Bell>> =
        (0..at.len()).into_par_iter().map(|i| Bell::new(at, &opacity, i, smallest)).collect();
    let places: Vec<f32> = bells
        .iter()
        .zip(at.means.chunks_exact(3))
        .flat_map(|(bell, mean)| if bell.is_some() { [mean[0], mean[1], mean[2]] } else { [f32::NAN; 3] })
        .collect();
    // rows of three by construction
    let Ok(near) = Neighbours::adaptive(&places) else { return Ok(Vec::new()) };
    if near.is_empty() {
        return Ok(Vec::new());
    }
    let [x, y, _] = grid.dims;
    let owner = |&cell: &usize| {
        let centre = DVec3::from_array(volume.centre([cell % x, cell / x % y, cell / (x * y)]));
        let mut best: Option<(f64, u32)> = None;
        for (i, _) in near.nearest(centre.as_vec3().to_array(), NEAREST, None) {
            let Some(bell) = &bells[i as usize] else { continue };
            let density = bell.log_density(centre);
            if best.is_none_or(|(most, owner)| density > most || (density == most && i < owner)) {
                best = Some((density, i));
            }
        }
        best.map(|(_, owner)| (cell, owner))
    };
    Ok(open.par_iter().map(owner).collect::<Vec<_>>().into_iter().flatten().collect())
}

/// A Gaussian as a function of space.
struct Bell {
    mean: DVec3,
    turn: DQuat,
    sigma: DVec3,
    log_opacity: f64,
}

impl Bell {
    /// Returns `None` for those that do not vote either: invisible or non-finite ones.
    fn new(at: &HostGaussians, opacity: &[f32], i: usize, smallest: f64) -> Option<Self> {
        let q = &at.rotations[4 * i..4 * i + 4];
        let q = DQuat::from_xyzw(q[1].into(), q[2].into(), q[3].into(), q[0].into());
        let mean = DVec3::from_array(std::array::from_fn(|k| f64::from(at.means[3 * i + k])));
        let scales: [f32; 3] = std::array::from_fn(|k| at.log_scales[3 * i + k].exp());
        let visible = opacity[i] >= INVISIBLE && opacity[i].is_finite();
        let whole = q.length() > 0.0 && q.is_finite() && mean.is_finite() && scales.iter().all(|s| s.is_normal());
        (visible && whole).then(|| Self {
            mean,
            turn: q.normalize().inverse(),
            sigma: DVec3::from_array(scales.map(f64::from)).max(DVec3::splat(smallest)),
            log_opacity: f64::from(opacity[i]).ln(),
        })
    }

    /// Returns the natural logarithm of the density at `place`.
    fn log_density(&self, place: DVec3) -> f64 {
        self.log_opacity - 0.5 * (self.turn * (place - self.mean) / self.sigma).length_squared()
    }
}

#[cfg(test)]
#[path = "volume_tests.rs"]
mod tests;
