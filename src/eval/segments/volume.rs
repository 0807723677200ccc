//! Intersection over union in space: which of the cells of the true segment the selection occupies.
//!
//! The selection is one segment and everything else another; where they are, [`place`](crate::segment::place) says, on
//! the cells of a ground-truth volume that show anything. Cells are weighted by their true opacity, so that what is
//! barely visible hardly counts, and empty space not at all.

use super::select::SelectedGaussians;
use crate::data::TruthVolume;
use crate::model::HostGaussians;
use crate::segment::place::{Cloud, PlaceError, SHARE, SegmentPlaces};
use crate::volume::grid::Grid;

/// Cells of a true opacity up to this are empty: a thousandth over the length of a cell is not visible anywhere.
const FLOOR: f32 = 1e-3;
/// Label of the selection; the rest has 0.
const CHOSEN: u32 = 1;

/// The cells of a ground-truth volume with the Gaussians at its time.
pub struct TruthCells<'a> {
    volume: &'a TruthVolume,
    at: &'a HostGaussians,
    /// The same as wide as they are drawn.
    drawn: HostGaussians,
    grid: Grid,
    widening: f64,
}

impl<'a> TruthCells<'a> {
    /// Takes all Gaussians of the scene, `[N]`, at the volume's time; drawing widens them by the standard deviation
    /// `widening`, scene units.
    ///
    /// # Errors
    /// If arrays of the volume do not match its grid.
    pub fn new(volume: &'a TruthVolume, at: &'a HostGaussians, widening: f64) -> Result<Self, PlaceError> {
        let grid = Grid::aligned(volume.dims, volume.spacing, volume.origin);
        for (field, found) in [("ids", volume.ids.len()), ("opacity", volume.opacity.len())] {
            if found != grid.len() {
                return Err(PlaceError::Shape { field, expected: grid.len(), found });
            }
        }
        Ok(Self { volume, at, drawn: at.clone().widened(widening), grid, widening })
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
    pub fn iou(&self, selected: &SelectedGaussians, ids: &[u16]) -> Result<Option<f64>, PlaceError> {
        // Gaussians that were cut back reach other cells
        let moved = selected.moves().then(|| selected.within(self.at).widened(self.widening));
        let at = moved.as_ref().unwrap_or(&self.drawn);
        let mut labels = vec![0; at.len()];
        selected.members.iter().for_each(|&i| labels[i as usize] = CHOSEN);
        let opacity = at.opacity();
        let of_cells = SegmentPlaces::new(Cloud::new(at, &opacity, &labels), &self.grid, SHARE)?.labels();
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

#[cfg(test)]
#[path = "volume_tests.rs"]
mod tests;
