//! Occupied cells of the box, which rays must not skip, for each training time.

use volseggs_core::model::params::HostTensor;

/// Cells stored in one value of a tensor: the number of bits up to which `f32` counts exactly.
const BITS: usize = 24;

/// Marked cells of a cubic grid over the box, one grid per training time. Without any cells, everything counts as
/// marked.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OccupancyGrid {
    side: usize,
    /// `[knots][side^3]`, x fastest.
    cells: Vec<Vec<bool>>,
}

impl OccupancyGrid {
    /// The state before anything is known.
    pub fn unknown() -> Self {
        Self::default()
    }

    /// Marks, for each time, the cells given by `is_something` `[side^3]` and their neighbours, diagonal ones included:
    /// the value at a cell's centre may miss what lies at its border.
    pub fn new(side: usize, is_something: Vec<Vec<bool>>) -> Self {
        let cells = is_something.into_iter().map(|cells| grown(side, cells)).collect();
        Self { side, cells }
    }

    /// Centres of the cells `[side^3, 3]` in [-1, 1].
    pub fn centres(side: usize) -> Vec<f32> {
        let at = |i: usize| (2 * i + 1) as f32 / side as f32 - 1.0;
        let cells = 0..side * side * side;
        cells.flat_map(|i| [at(i % side), at(i / side % side), at(i / (side * side))]).collect()
    }

    /// Whether `point`, in [-1, 1], may be occupied between the training times `knots`.
    pub fn holds(&self, knots: [usize; 2], point: [f32; 3]) -> bool {
        if self.cells.is_empty() {
            return true;
        }
        let cell = |v: f32| ((0.5 * (v + 1.0) * self.side as f32) as usize).min(self.side - 1);
        let [x, y, z] = point.map(cell);
        let at = (z * self.side + y) * self.side + x;
        knots.iter().any(|knot| self.cells[*knot][at])
    }

    /// The fraction of marked cells.
    pub fn filled(&self) -> f64 {
        let all: usize = self.cells.iter().map(Vec::len).sum();
        if all == 0 {
            return 1.0;
        }
        self.cells.iter().flatten().filter(|is| **is).count() as f64 / all as f64
    }

    /// The cells as a tensor; `None` if nothing is known.
    pub fn to_tensor(&self) -> Option<HostTensor> {
        let bits: Vec<bool> = self.cells.concat();
        let word = |bits: &[bool]| bits.iter().rev().fold(0u32, |word, bit| word << 1 | u32::from(*bit)) as f32;
        let values: Vec<f32> = bits.chunks(BITS).map(word).collect();
        (!bits.is_empty()).then(|| HostTensor { shape: vec![values.len()], values })
    }

    /// Reads [`OccupancyGrid::to_tensor`], for grids of the given side at `knots` training times.
    ///
    /// # Errors
    /// If the tensor does not fit.
    pub fn from_tensor(tensor: Option<&HostTensor>, side: usize, knots: usize) -> Result<Self, String> {
        let Some(tensor) = tensor else { return Ok(Self::unknown()) };
        let of_knot = side.checked_pow(3).filter(|n| *n > 0).ok_or("occupancy: there is a tensor, but no cells")?;
        let all = of_knot.checked_mul(knots).ok_or("occupancy: too many cells")?;
        let is_word = |v: &f32| (0.0..(1u32 << BITS) as f32).contains(v) && v.fract() == 0.0;
        if tensor.values.len() != all.div_ceil(BITS) || !tensor.values.iter().all(is_word) {
            return Err(format!("occupancy: not {knots} grids of {side}^3 cells"));
        }
        let bits = tensor.values.iter().flat_map(|v| (0..BITS).map(move |k| *v as u32 >> k & 1 == 1));
        let bits: Vec<bool> = bits.take(all).collect();
        Ok(Self { side, cells: bits.chunks(of_knot).map(<[bool]>::to_vec).collect() })
    }
}

/// Marks the neighbours of marked cells, axis by axis.
fn grown(side: usize, mut cells: Vec<bool>) -> Vec<bool> {
    for stride in [1, side, side * side] {
        let old = cells.clone();
        for (i, cell) in cells.iter_mut().enumerate() {
            let at = i / stride % side;
            *cell |= at > 0 && old[i - stride] || at + 1 < side && old[i + stride];
        }
    }
    cells
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(side: usize, x: usize, y: usize, z: usize) -> Vec<bool> {
        let mut cells = vec![false; side.pow(3)];
        cells[(z * side + y) * side + x] = true;
        cells
    }

    #[test]
    fn cells_and_their_neighbours_are_held() {
        let side = 5;
        let occupancy = OccupancyGrid::new(side, vec![one(side, 2, 0, 4), vec![false; 125]]);
        assert!((occupancy.filled() - 3.0 * 2.0 * 2.0 / 250.0).abs() < 1e-12);
        let centres = OccupancyGrid::centres(side);
        for (i, point) in centres.chunks(3).enumerate() {
            let [x, y, z] = [i % 5, i / 5 % 5, i / 25];
            let near = x.abs_diff(2) <= 1 && y <= 1 && z >= 3;
            let point = [point[0], point[1], point[2]];
            assert_eq!(occupancy.holds([0, 0], point), near, "{x} {y} {z}");
            assert_eq!((occupancy.holds([0, 1], point), occupancy.holds([1, 1], point)), (near, false));
        }
        // edges of the box belong to it
        assert!(occupancy.holds([0, 0], [0.0, -1.0, 1.0]));
        assert!(OccupancyGrid::unknown().holds([3, 4], [0.0; 3]) && OccupancyGrid::unknown().filled() == 1.0);
    }

    #[test]
    fn it_is_written_and_read_to_the_bit() {
        let cells: Vec<Vec<bool>> = (0..3).map(|k| (0..64).map(|i| (i * 7 + k) % 3 == 0).collect()).collect();
        let occupancy = OccupancyGrid { side: 4, cells };
        let tensor = occupancy.to_tensor();
        assert_eq!(OccupancyGrid::from_tensor(tensor.as_ref(), 4, 3), Ok(occupancy));
        assert_eq!(OccupancyGrid::from_tensor(None, 4, 3), Ok(OccupancyGrid::unknown()));
        assert_eq!(OccupancyGrid::unknown().to_tensor(), None);
        for (side, knots) in [(4, 2), (5, 3), (0, 3), (usize::MAX, 3)] {
            assert!(OccupancyGrid::from_tensor(tensor.as_ref(), side, knots).is_err(), "{side} {knots}");
        }
        let mut broken = tensor.unwrap();
        broken.values[1] = 0.5;
        assert!(OccupancyGrid::from_tensor(Some(&broken), 4, 3).is_err());
    }
}
