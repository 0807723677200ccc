//! Neighbour search among points: a sorted grid of cells, looked up by rows of cells. What is done with neighbours
//! (outliers, components) lives elsewhere.

use super::chunks::{finite, map_chunks, point};
use super::error::{PointsError, check_positive, rows};
use super::nearest_rows::NearestRows;
use rayon::prelude::*;
use std::ops::Range;

/// Maximum number of cells along one axis; points beyond share the outermost cell (slower, still correct).
const MAX_CELLS: f64 = (1u32 << 31) as f64;

/// Number of cells along one axis from which [`NeighbourGrid::adaptive`] makes them no smaller, below [`MAX_CELLS`]
/// even after one more step. With few, a single point far away would leave all others in one cell.
const MOST_CELLS: f64 = 5e8;

/// A grid of cubic cells over points `[M, 3]`; non-finite points are skipped.
///
/// Points are sorted by cell with x running fastest, so the cells of one row that a query covers form one slice.
#[derive(Debug, Clone)]
pub struct NeighbourGrid {
    count: usize,
    cell: f64,
    low: [f64; 3],
    top: [u32; 3],
    clamped: bool,
    /// Original index and position of each sorted point.
    ids: Vec<u32>,
    places: Vec<[f32; 3]>,
    /// x of each occupied cell and its first sorted point; `starts` has one entry more.
    columns: Vec<u32>,
    starts: Vec<u32>,
    /// `(z, y)` of each occupied row, ascending, and its first cell; `row_starts` has one entry more.
    row_keys: Vec<u64>,
    row_starts: Vec<u32>,
}

impl NeighbourGrid {
    /// Sorts `points` `[M, 3]` into cells of side `cell` (scene units; ideally about the radius of the later queries).
    ///
    /// # Errors
    /// `points` not a whole number of rows; `cell` not positive and finite.
    pub fn new(points: &[f32], cell: f32) -> Result<Self, PointsError> {
        rows("points", points.len(), 3, "[M, 3]")?;
        check_positive("cell", cell)?;
        let keep: Vec<u32> = (0..points.len() as u32 / 3).collect();
        Ok(Self::of(points, &keep, f64::from(cell)))
    }

    /// A grid whose occupied cells hold about 2 to 8 points each, whatever the extent: for nearest-neighbour queries
    /// rather than queries of a known radius.
    ///
    /// # Errors
    /// `points` not a whole number of rows.
    pub fn adaptive(points: &[f32]) -> Result<Self, PointsError> {
        let count = rows("points", points.len(), 3, "[M, 3]")?;
        let keep: Vec<u32> = (0..count as u32).collect();
        let (low, high) = bounds(points, &keep);
        let side = (0..3).map(|a| high[a] - low[a]).fold(0.0, f64::max);
        if !side.is_finite() || side <= 0.0 {
            return Ok(Self::of(points, &keep, 1.0));
        }
        let mut cell = side / (count as f64).cbrt().max(1.0);
        loop {
            let grid = Self::of(points, &keep, cell);
            // Mean number of points that share a point's cell; distant outliers hardly change it.
            let crowd: f64 = (0..grid.cells()).map(|c| (grid.slots(c).len() as f64).powi(2)).sum();
            if crowd <= 8.0 * grid.len() as f64 || side / cell > MOST_CELLS {
                return Ok(grid);
            }
            cell /= if crowd > 64.0 * grid.len() as f64 { 2.5 } else { 1.5 };
        }
    }

    /// A grid over the rows `keep` of `points`; ids are the entries of `keep`.
    pub(crate) fn of(points: &[f32], keep: &[u32], cell: f64) -> Self {
        let (low, high) = bounds(points, keep);
        let mut grid = Self {
            count: points.len() / 3,
            cell,
            low,
            top: [0; 3],
            clamped: (0..3).any(|a| (high[a] - low[a]) / cell >= MAX_CELLS - 1.0),
            ids: Vec::new(),
            places: Vec::new(),
            columns: Vec::new(),
            starts: vec![0],
            row_keys: Vec::new(),
            row_starts: vec![0],
        };
        let mut keys: Vec<(u64, u32, u32)> = keep
            .par_iter()
            .filter(|&&i| finite(point(points, i as usize)))
            .map(|&i| {
                let p = point(points, i as usize);
                let [x, y, z] = [0, 1, 2].map(|a| grid.coordinate(f64::from(p[a]), a));
                (row_key(y, z), x, i)
            })
            .collect();
        keys.par_sort_unstable();
        for (slot, &(row, x, id)) in keys.iter().enumerate() {
            let new_row = slot == 0 || keys[slot - 1].0 != row;
            if new_row || keys[slot - 1].1 != x {
                if slot > 0 {
                    grid.starts.push(slot as u32);
                }
                if new_row && slot > 0 {
                    grid.row_starts.push(grid.columns.len() as u32);
                }
                grid.columns.push(x);
            }
            if new_row {
                grid.row_keys.push(row);
            }
            grid.ids.push(id);
            grid.places.push(point(points, id as usize));
        }
        if !keys.is_empty() {
            grid.starts.push(keys.len() as u32);
            grid.row_starts.push(grid.columns.len() as u32);
            grid.top = [0, 1, 2].map(|a| grid.coordinate(high[a], a));
        }
        grid
    }

    /// Monotone in `value`, so that range look-ups are complete.
    fn coordinate(&self, value: f64, axis: usize) -> u32 {
        ((value - self.low[axis]) / self.cell).floor().clamp(0.0, MAX_CELLS - 1.0) as u32
    }

    /// Number of points in the grid (the finite ones).
    pub fn len(&self) -> usize {
        self.ids.len()
    }

    /// Whether the grid holds no points.
    pub fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }

    /// Side of a cell in scene units.
    pub fn cell(&self) -> f64 {
        self.cell
    }

    /// Whether the extent was too large for the cell side, so that the outermost cells are larger than `cell`.
    pub(crate) fn clamped(&self) -> bool {
        self.clamped
    }

    pub(crate) fn cells(&self) -> usize {
        self.columns.len()
    }

    /// Sorted points of cell `c`.
    pub(crate) fn slots(&self, c: usize) -> Range<usize> {
        self.starts[c] as usize..self.starts[c + 1] as usize
    }

    pub(crate) fn id(&self, slot: usize) -> u32 {
        self.ids[slot]
    }

    pub(crate) fn place(&self, slot: usize) -> [f32; 3] {
        self.places[slot]
    }

    /// Calls `each` with runs of occupied cells that together cover the box `low..=high`, until `each` returns false.
    pub(crate) fn cells_in(&self, low: [f64; 3], high: [f64; 3], mut each: impl FnMut(Range<usize>) -> bool) {
        if self.is_empty() {
            return;
        }
        let from = [0, 1, 2].map(|a| self.coordinate(low[a], a));
        let to = [0, 1, 2].map(|a| self.coordinate(high[a], a).min(self.top[a]));
        if (0..3).any(|a| from[a] > to[a]) {
            return;
        }
        let mut run = |row: usize| {
            let first = self.row_starts[row] as usize;
            let columns = &self.columns[first..self.row_starts[row + 1] as usize];
            let start = columns.partition_point(|&x| x < from[0]);
            let end = start + columns[start..].iter().take_while(|&&x| x <= to[0]).count();
            start == end || each(first + start..first + end)
        };
        let from_row = |y: u32, z: u32| self.row_keys.partition_point(|&key| key < row_key(y, z));
        let mut row = from_row(from[1], from[2]);
        while let Some(&key) = self.row_keys.get(row) {
            let (y, z) = (key as u32, (key >> 32) as u32);
            if z > to[2] {
                return;
            }
            if y < from[1] {
                row = from_row(from[1], z);
            } else if y > to[1] {
                row = from_row(from[1], z + 1);
            } else if run(row) {
                row += 1;
            } else {
                return;
            }
        }
    }

    /// Calls `each(index, squared distance)` for every point within `radius` of `query` (inclusive), in an order that
    /// depends on the points alone, until `each` returns false.
    pub fn visit(&self, query: [f32; 3], radius: f32, mut each: impl FnMut(u32, f32) -> bool) {
        if !finite(query) || radius.is_nan() || radius < 0.0 {
            return;
        }
        // Slightly more than the radius, to allow for rounding of the squared distances.
        let reach = f64::from(radius) * 1.000_01;
        let low = query.map(|v| f64::from(v) - reach);
        let high = query.map(|v| f64::from(v) + reach);
        let limit = radius * radius;
        self.cells_in(low, high, |cells| {
            for slot in self.starts[cells.start] as usize..self.starts[cells.end] as usize {
                let distance = squared(query, self.places[slot]);
                if distance <= limit && !each(self.ids[slot], distance) {
                    return false;
                }
            }
            true
        });
    }

    /// Returns the `k` points nearest to `query` other than `skip`, as `(index, squared distance)` from near to far
    /// (smaller index first among equals); fewer if the grid holds fewer.
    pub fn nearest(&self, query: [f32; 3], k: usize, skip: Option<u32>) -> Vec<(u32, f32)> {
        let mut found: Vec<(u32, f32)> = Vec::with_capacity(k + 1);
        if !finite(query) || self.is_empty() || k == 0 {
            return found;
        }
        let farthest = (0..3)
            .map(|a| {
                let (q, span) = (f64::from(query[a]), (f64::from(self.top[a]) + 1.0) * self.cell);
                (q - self.low[a]).abs().max((q - self.low[a] - span).abs())
            })
            .fold(0.0, f64::max);
        let mut radius = self.cell * (k as f64 / 6.0).cbrt().max(0.5);
        loop {
            let all = self.clamped || radius > 2.0 * farthest;
            found.clear();
            self.visit(query, if all { f32::INFINITY } else { radius as f32 }, |id, distance| {
                let near = found.len() < k || found.last().is_some_and(|last| (distance, id) < (last.1, last.0));
                if near && Some(id) != skip {
                    let at = found.partition_point(|&(i, d)| (d, i) < (distance, id));
                    found.insert(at, (id, distance));
                    found.truncate(k);
                }
                true
            });
            if found.len() == k || all {
                return found;
            }
            radius *= 2.0;
        }
    }

    /// Returns, for each of the `M` points, the number of other points within `radius`, counted up to `cap` `[M]`; 0
    /// for skipped points.
    pub fn count_within(&self, radius: f32, cap: u32) -> Vec<u32> {
        self.per_point(0, |slot| {
            let (id, mut count) = (self.ids[slot], 0);
            self.visit(self.places[slot], radius, |other, _| {
                count += u32::from(other != id);
                count < cap
            });
            count.min(cap)
        })
    }

    /// Returns, for each of the `M` points, the indices of the `k` nearest other points, from near to far `[M, k]`. The
    /// point's own index fills missing places and the rows of skipped points.
    pub fn nearest_of_each(&self, k: usize) -> NearestRows {
        let sorted = map_chunks(self.len(), |range| {
            let of = |slot| self.nearest(self.places[slot], k, Some(self.ids[slot]));
            range.map(|slot| (self.ids[slot], of(slot))).collect::<Vec<_>>()
        });
        let mut out = NearestRows::own(self.count, k);
        for (id, found) in sorted.into_iter().flatten() {
            out.row_mut(id as usize).iter_mut().zip(found).for_each(|(out, (other, _))| *out = other);
        }
        out
    }

    /// Returns, for each of the `M` points, the distance to its nearest other point `[M]`; NaN for skipped points and
    /// for a single point.
    pub fn nearest_distances(&self) -> Vec<f32> {
        self.per_point(f32::NAN, |slot| {
            self.nearest(self.places[slot], 1, Some(self.ids[slot])).first().map_or(f32::NAN, |n| n.1.sqrt())
        })
    }

    /// Runs `work` on each sorted point; the results are in the original order, with `blank` for skipped points.
    fn per_point<T: Copy + Send>(&self, blank: T, work: impl Fn(usize) -> T + Sync) -> Vec<T> {
        let sorted = map_chunks(self.len(), |range| range.map(&work).collect::<Vec<T>>()).concat();
        let mut out = vec![blank; self.count];
        for (value, &id) in sorted.into_iter().zip(&self.ids) {
            out[id as usize] = value;
        }
        out
    }
}

fn bounds(points: &[f32], keep: &[u32]) -> ([f64; 3], [f64; 3]) {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for p in keep.iter().map(|&i| point(points, i as usize)).filter(|&p| finite(p)) {
        for a in 0..3 {
            low[a] = low[a].min(f64::from(p[a]));
            high[a] = high[a].max(f64::from(p[a]));
        }
    }
    (low, high)
}

/// Orders rows by z, then y.
fn row_key(y: u32, z: u32) -> u64 {
    (u64::from(z) << 32) | u64::from(y)
}

/// The squared distance of two points.
pub fn squared(a: [f32; 3], b: [f32; 3]) -> f32 {
    let [x, y, z] = [0, 1, 2].map(|i| a[i] - b[i]);
    x * x + y * y + z * z
}

#[cfg(test)]
#[path = "neighbours_tests.rs"]
mod tests;
