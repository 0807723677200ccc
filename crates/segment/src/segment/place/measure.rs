//! How large segments are and where, from their places.

use super::{PlaceCell, SegmentPlaces};
use rayon::prelude::*;

/// Sums over the place of one segment, in the units of the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measure {
    /// Volume of the place.
    pub volume: f64,
    /// Volume of the part that is hidden.
    pub hidden_volume: f64,
    /// Sum of the local opacities of the cells, hidden ones count 1.
    pub weight: f64,
    /// Mean of the places weighted by local opacity.
    pub centroid: [f64; 3],
    /// Covariance of the places weighted by local opacity.
    pub covariance: [[f64; 3]; 3],
    /// Lower corner of the box around the place.
    pub box_min: [f64; 3],
    /// Upper corner of that box.
    pub box_max: [f64; 3],
}

/// Sums in cells, about the first cell of the grid.
#[derive(Clone, Copy)]
struct CellSums {
    cells: u64,
    hidden: u64,
    weight: f64,
    first: [f64; 3],
    second: [[f64; 3]; 3],
    low: [usize; 3],
    high: [usize; 3],
}

const NONE: CellSums = CellSums {
    cells: 0,
    hidden: 0,
    weight: 0.0,
    first: [0.0; 3],
    second: [[0.0; 3]; 3],
    low: [usize::MAX; 3],
    high: [0; 3],
};

impl CellSums {
    fn add(&mut self, cell: &PlaceCell, at: [usize; 3]) {
        let weight = f64::from(cell.opacity);
        let place = at.map(|v| v as f64);
        self.cells += 1;
        self.hidden += u64::from(cell.hidden);
        self.weight += weight;
        for i in 0..3 {
            self.first[i] += weight * place[i];
            (0..3).for_each(|j| self.second[i][j] += weight * place[i] * place[j]);
            self.low[i] = self.low[i].min(at[i]);
            self.high[i] = self.high[i].max(at[i]);
        }
    }

    fn join(&mut self, other: &Self) {
        self.cells += other.cells;
        self.hidden += other.hidden;
        self.weight += other.weight;
        for i in 0..3 {
            self.first[i] += other.first[i];
            (0..3).for_each(|j| self.second[i][j] += other.second[i][j]);
            self.low[i] = self.low[i].min(other.low[i]);
            self.high[i] = self.high[i].max(other.high[i]);
        }
    }
}

impl SegmentPlaces<'_> {
    /// Measures the segments with these labels; `None` for one that is nowhere.
    pub fn measure(&self, labels: &[u32]) -> Vec<Option<Measure>> {
        let mut column = vec![usize::MAX; self.edges.len()];
        for (i, label) in labels.iter().enumerate() {
            if let Some(column) = column.get_mut(*label as usize) {
                *column = i;
            }
        }
        let [x, y, _] = self.grid.dims;
        let slice = |(k, cells): (usize, &[PlaceCell])| {
            let mut sums = vec![NONE; labels.len()];
            for (c, cell) in cells.iter().enumerate().filter(|(_, cell)| cell.density > 0.0) {
                if let Some(sums) = sums.get_mut(column[usize::from(cell.owner)]) {
                    sums.add(cell, [c % x, c / x, k]);
                }
            }
            sums
        };
        let slices: Vec<Vec<CellSums>> = self.cells.par_chunks(x * y).enumerate().map(slice).collect();
        let mut total = vec![NONE; labels.len()];
        for slice in &slices {
            total.iter_mut().zip(slice).for_each(|(total, part)| total.join(part));
        }
        total.iter().map(|sums| self.finish(sums)).collect()
    }

    fn finish(&self, sums: &CellSums) -> Option<Measure> {
        if sums.cells == 0 {
            return None;
        }
        let (spacing, origin) = (self.grid.spacing, self.grid.origin);
        let cell = spacing.iter().product::<f64>();
        let mean = sums.first.map(|v| v / sums.weight);
        let at = |k: usize, index: f64| origin[k] + spacing[k] * index;
        let covariance = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                // and the spread within a cell
                let own = if i == j { 1.0 / 12.0 } else { 0.0 };
                spacing[i] * spacing[j] * (sums.second[i][j] / sums.weight - mean[i] * mean[j] + own)
            })
        });
        Some(Measure {
            volume: sums.cells as f64 * cell,
            hidden_volume: sums.hidden as f64 * cell,
            weight: sums.weight,
            centroid: std::array::from_fn(|k| at(k, mean[k])),
            covariance,
            box_min: std::array::from_fn(|k| at(k, sums.low[k] as f64 - 0.5)),
            box_max: std::array::from_fn(|k| at(k, sums.high[k] as f64 + 0.5)),
        })
    }
}
