//! Modes of weighted points: the peaks of their density in a plane, and the valleys of their density on a line. Unlike
//! k-means this finds groups of very unequal size, and their number. What the points stand for lives elsewhere.

use super::error::{PointsError, check_len, check_positive, rows};
use super::flood::{DensityPeak, flood};

/// Cells of the density along one side of the plane.
const SIDE: usize = 72;
/// Cells of the density along the line.
const LINE: usize = 96;
/// Cells less dense than this fraction of the densest belong to no mode.
const MIN_DENSITY: f64 = 1e-5;

/// Settings of [`modes`] and [`valleys`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModeConfig {
    /// Lowest and highest coordinate, for both axes of the plane; points outside count at the border.
    pub range: [f32; 2],
    /// Standard deviation of the density kernel, in the unit of the points.
    pub bandwidth: f32,
    /// Minimum fraction of the total weight in a mode, or on each side of a valley.
    pub smallest: f64,
}

/// The outcome of [`modes`].
#[derive(Debug, Clone, PartialEq)]
pub struct Modes {
    /// `[K, 2]`: centre of the densest cell of each mode, highest density first.
    pub peaks: Vec<[f32; 2]>,
    /// `[N]`: 1 + row of the point's mode; 0 for non-finite points and for the few that belong to none.
    pub labels: Vec<u32>,
}

/// Finds the modes of the density of `points` `[N, 2]` with weights `[N]`: a grid is filled from its densest cell
/// downwards, each new summit starts a mode, and two that meet are merged unless the pass between them is lower than
/// `pass(lower summit, higher summit)` times the density of the lower one. Weights that are negative or not finite
/// count as 0.
///
/// # Errors
/// Slices of the wrong length; an empty range, or a bandwidth that is not positive.
pub fn modes(
    points: &[f32],
    weights: &[f32],
    config: &ModeConfig,
    pass: impl Fn([f32; 2], [f32; 2]) -> f64,
) -> Result<Modes, PointsError> {
    let count = rows("points", points.len(), 2, "[N, 2]")?;
    check_len("weights", weights.len(), count, "[N]")?;
    let cell = config.cell(SIDE)?;
    let finite = |i: usize| points[2 * i].is_finite() && points[2 * i + 1].is_finite();
    let at = |i: usize| [0, 1].map(|a| config.bin(points[2 * i + a], SIDE));
    let mut masses = vec![0f64; SIDE * SIDE];
    for i in (0..count).filter(|&i| finite(i)) {
        let [x, y] = at(i);
        masses[y * SIDE + x] += usable(weights[i]);
    }
    let kernel = config.kernel(cell);
    let rows: Vec<f64> = masses.chunks_exact(SIDE).flat_map(|row| blur(row, &kernel)).collect();
    let mut density = vec![0f64; SIDE * SIDE];
    for x in 0..SIDE {
        let column: Vec<f64> = (0..SIDE).map(|y| rows[y * SIDE + x]).collect();
        blur(&column, &kernel).into_iter().enumerate().for_each(|(y, v)| density[y * SIDE + x] = v);
    }
    let middle = |c: usize| [c % SIDE, c / SIDE].map(|k| config.range[0] + (k as f32 + 0.5) * cell);
    let (of_cell, summits) =
        of_density(&density, &masses, config.smallest, |low, high| pass(middle(low), middle(high)));
    let labels = (0..count).map(|i| if finite(i) { of_cell[at(i)[1] * SIDE + at(i)[0]] } else { 0 }).collect();
    Ok(Modes { peaks: summits.into_iter().map(middle).collect(), labels })
}

/// Returns the mode of each cell (from 1, 0 for none) and the summit cells, highest first.
fn of_density(
    density: &[f64],
    masses: &[f64],
    smallest: f64,
    pass: impl Fn(usize, usize) -> f64,
) -> (Vec<u32>, Vec<usize>) {
    let highest = density.iter().copied().fold(0.0, f64::max);
    let min_mass = smallest * masses.iter().sum::<f64>();
    let mut order: Vec<usize> = (0..density.len()).filter(|&c| density[c] > MIN_DENSITY * highest).collect();
    order.sort_by(|&a, &b| density[b].total_cmp(&density[a]).then(a.cmp(&b)));
    let around = |c: usize, near: &mut Vec<usize>| {
        let (x, y) = (c % SIDE, c / SIDE);
        for j in y.saturating_sub(1)..=(y + 1).min(SIDE - 1) {
            near.extend((x.saturating_sub(1)..=(x + 1).min(SIDE - 1)).map(|i| j * SIDE + i));
        }
    };
    let parted = |low: &DensityPeak, top: &DensityPeak, c: usize| {
        density[c] <= pass(low.summit, top.summit) * density[low.summit] && low.mass >= min_mass
    };
    let (of_cell, modes) = flood(&order, density.len(), |c| masses[c], around, parted);
    let mut names = vec![0u32; modes.len()];
    let mut kept = Vec::new();
    for (name, mode) in names.iter_mut().zip(&modes).filter(|(_, h)| h.mass >= min_mass) {
        kept.push(mode.summit);
        *name = kept.len() as u32;
    }
    (of_cell.into_iter().map(|h| if h == usize::MAX { 0 } else { names[h] }).collect(), kept)
}

/// Returns the clear valleys of the density of `values` `[N]` with weights `[N]`, ascending: cells less dense than
/// `pass` times the lower of the summits on either side. Non-finite values are skipped; weights that are negative or
/// not finite count as 0.
///
/// # Errors
/// Slices of different lengths; an empty range, or a bandwidth that is not positive.
pub fn valleys(values: &[f32], weights: &[f32], config: &ModeConfig, pass: f64) -> Result<Vec<f32>, PointsError> {
    check_len("weights", weights.len(), values.len(), "[N]")?;
    let cell = config.cell(LINE)?;
    let mut masses = vec![0f64; LINE];
    for (value, weight) in values.iter().zip(weights).filter(|(v, _)| v.is_finite()) {
        masses[config.bin(*value, LINE)] += usable(*weight);
    }
    let density = blur(&masses, &config.kernel(cell));
    let min_mass = config.smallest * masses.iter().sum::<f64>();
    let mut cuts = Vec::new();
    let mut open = vec![(0, LINE)];
    while let Some((start, end)) = open.pop() {
        let mut best: Option<(f64, usize)> = None;
        for c in start + 1..end.saturating_sub(1) {
            let summit = |r: std::ops::Range<usize>| density[r].iter().copied().fold(0.0, f64::max);
            let lower = summit(start..c).min(summit(c..end));
            let mass = |r: std::ops::Range<usize>| masses[r].iter().sum::<f64>();
            let deep = density[c] < pass * lower && mass(start..c).min(mass(c..end)) > min_mass;
            if deep && best.is_none_or(|(share, _)| density[c] / lower < share) {
                best = Some((density[c] / lower, c));
            }
        }
        if let Some((_, c)) = best {
            cuts.push(config.range[0] + (c as f32 + 0.5) * cell);
            open.extend([(start, c), (c, end)]);
        }
    }
    cuts.sort_by(f32::total_cmp);
    Ok(cuts)
}

impl ModeConfig {
    fn cell(&self, cells: usize) -> Result<f32, PointsError> {
        check_positive("range", self.range[1] - self.range[0])?;
        check_positive("bandwidth", self.bandwidth)?;
        Ok((self.range[1] - self.range[0]) / cells as f32)
    }

    fn bin(&self, value: f32, cells: usize) -> usize {
        let share = (value - self.range[0]) / (self.range[1] - self.range[0]);
        ((share * cells as f32).max(0.0) as usize).min(cells - 1)
    }

    /// Half of a symmetric kernel, starting at its centre; the whole kernel sums to 1.
    fn kernel(&self, cell: f32) -> Vec<f64> {
        let spread = f64::from(self.bandwidth / cell);
        let reach = (4.0 * spread).ceil().min(LINE as f64) as usize;
        let half: Vec<f64> = (0..=reach).map(|t| (-0.5 * (t as f64 / spread).powi(2)).exp()).collect();
        let sum = half[0] + 2.0 * half[1..].iter().sum::<f64>();
        half.into_iter().map(|v| v / sum).collect()
    }
}

fn blur(values: &[f64], half: &[f64]) -> Vec<f64> {
    let side = |i: usize, t: usize| {
        let left = i.checked_sub(t).map_or(0.0, |j| values[j]);
        left + values.get(i + t).copied().unwrap_or(0.0)
    };
    (0..values.len())
        .map(|i| half[0] * values[i] + (1..half.len()).map(|t| half[t] * side(i, t)).sum::<f64>())
        .collect()
}

fn usable(weight: f32) -> f64 {
    if weight.is_finite() { f64::from(weight.max(0.0)) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::kmeans::tests::blobs;

    const PLANE: ModeConfig = ModeConfig { range: [-1.0, 1.0], bandwidth: 0.04, smallest: 0.006 };

    #[test]
    fn a_hundredth_of_the_points_is_a_mode_and_a_stray_is_not() {
        let mut points = blobs(&[vec![-0.5, 0.0]], 3000, 0.2, 1);
        points.extend(blobs(&[vec![0.5, 0.1]], 30, 0.1, 2));
        points.extend([0.0, 0.9, f32::NAN, 0.0, 9.0, -9.0]);
        let found = modes(&points, &[1.0; 3033], &PLANE, |_, _| 0.5).unwrap();
        assert_eq!(found.peaks.len(), 2);
        assert!((found.peaks[0][0] + 0.5).abs() < 0.1 && (found.peaks[1][0] - 0.5).abs() < 0.1, "{:?}", found.peaks);
        assert_eq!(&found.labels[3030..], [0, 0, 0]);
        let right = found.labels[..3030].iter().enumerate().filter(|(i, l)| **l == 1 + u32::from(*i >= 3000)).count();
        assert!(right > 3000, "{right}");
    }

    #[test]
    fn the_pass_decides_whether_near_summits_are_separate() {
        let points = blobs(&[vec![-0.12, 0.0], vec![0.12, 0.0]], 4000, 0.15, 3);
        let found = |pass: f64| modes(&points, &[1.0; 8000], &PLANE, |_, _| pass).unwrap().peaks.len();
        assert_eq!((found(0.9), found(0.1)), (2, 1));
    }

    #[test]
    fn a_line_is_cut_where_it_is_empty() {
        let mut values: Vec<f32> = (0..1000).map(|i| 0.2 + 0.0001 * i as f32).collect();
        values.extend((0..200).map(|i| 0.7 + 0.0005 * i as f32));
        values.push(f32::INFINITY);
        let config = ModeConfig { range: [0.0, 1.0], bandwidth: 0.03, smallest: 0.03 };
        let cuts = valleys(&values, &[1.0; 1201], &config, 0.3).unwrap();
        assert!(cuts.len() == 1 && cuts[0] > 0.35 && cuts[0] < 0.68, "{cuts:?}");
        assert!(valleys(&values[..1000], &[1.0; 1000], &config, 0.3).unwrap().is_empty());
        let smallest = ModeConfig { smallest: 0.3, ..config };
        assert!(valleys(&values, &[1.0; 1201], &smallest, 0.3).unwrap().is_empty());
    }

    #[test]
    fn empty_and_invalid_inputs() {
        let none = modes(&[], &[], &PLANE, |_, _| 0.5).unwrap();
        assert!(none.peaks.is_empty() && none.labels.is_empty());
        let weightless = modes(&[0.0; 4], &[f32::NAN, -1.0], &PLANE, |_, _| 0.5).unwrap();
        assert_eq!((weightless.peaks.len(), weightless.labels), (0, vec![0, 0]));
        assert!(valleys(&[], &[], &PLANE, 0.3).unwrap().is_empty());
        assert!(
            modes(&[0.0; 3], &[1.0], &PLANE, |_, _| 0.5).is_err()
                && modes(&[0.0; 4], &[1.0], &PLANE, |_, _| 0.5).is_err()
        );
        for bad in [ModeConfig { bandwidth: 0.0, ..PLANE }, ModeConfig { range: [1.0, 1.0], ..PLANE }] {
            assert!(modes(&[0.0; 2], &[1.0], &bad, |_, _| 0.5).is_err() && valleys(&[0.0], &[1.0], &bad, 0.3).is_err());
        }
    }
}
