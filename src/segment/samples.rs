//! Samples of scenes of many Gaussians, for what is told by contacts between neighbours.
//!
//! Whether a layer is in contact with what it covers, and how much of it is edge, depends on how many Gaussians thick
//! it is, as each is compared with the same number of neighbours. The limits in `bodies` and `surface_layers` were
//! found on pieces of about [`KNOWN`] Gaussians. A material with far larger pieces is therefore judged in samples of
//! the scene in which they are of that size, and in which its Gaussians are enlarged by as much as they are farther
//! apart: in a volume by the cube root of the thinning, in a sheet one Gaussian thick by its square root. All others are
//! enlarged as in a volume. Materials differ in their sizes: beside shells of many thousand Gaussians there may be cores
//! of a few hundred. Small pieces of such a material are judged with the large ones, as they are mostly their fragments:
//! see the results of 2026-11-28.

use super::pieces::{Touch, pieces};
use crate::model::HostGaussians;
use crate::points::PointsError;
use crate::points::chunks::point;
use crate::points::neighbours::Grid;

/// Gaussians in a piece of a material, weighted by size, in the scene with the most layers among those on which the
/// limits were found: see the results of 2026-11-28 in `benches/results`.
const KNOWN: f64 = 1300.0;
/// How many times as many a piece must have for samples to be taken. Some of those scenes have such pieces too, and the
/// same result with and without samples.
const FAR_MORE: f64 = 2.0;
/// The neighbour whose distance tells how far apart Gaussians are.
const APART: usize = 6;
/// Samples that vote. In a single one, what is near a limit may fall on either side of it by chance.
pub(super) const SAMPLES: usize = 5;

/// A material with large pieces, which is judged in samples.
pub(super) struct Large {
    /// The material.
    pub material: u32,
    /// Its Gaussians, rows of `shown`, ascending.
    pub rows: Vec<usize>,
    /// How many times fewer Gaussians there must be for its pieces to have [`KNOWN`].
    pub thinning: f64,
    /// How far apart its Gaussians are, see [`spacing`], world units.
    apart: f32,
}

/// Returns a material if its pieces have far more than [`KNOWN`] Gaussians, on average over its Gaussians. `shown` `[M]`
/// are indices into `at`, and `labels` `[M]` the materials.
///
/// # Errors
/// If the arrays of `at` disagree, or points are too far apart.
///
/// # Panics
/// If an index is not below N.
pub(super) fn large(
    at: &HostGaussians,
    shown: &[u32],
    labels: &[u32],
    material: u32,
) -> Result<Option<Large>, PointsError> {
    let rows: Vec<usize> = (0..shown.len()).filter(|&n| labels[n] == material).collect();
    let found = pieces(at, &rows.iter().map(|&n| shown[n]).collect::<Vec<u32>>(), Touch::SEEN)?;
    let sizes = found.counts.into_iter().map(f64::from);
    let (total, squares) = sizes.fold((0.0, 0.0), |(total, squares), n| (total + n, squares + n * n));
    let typical = squares / f64::max(total, 1.0);
    if typical <= FAR_MORE * KNOWN {
        return Ok(None);
    }
    Ok(Some(Large { material, apart: spacing(at, shown, &rows)?, thinning: typical / KNOWN, rows }))
}

impl Large {
    /// Returns how many times farther apart these Gaussians are in a `sample` (rows of `shown`), between what it would be
    /// in a volume and in a sheet one Gaussian thick.
    fn farther_apart(&self, at: &HostGaussians, shown: &[u32], sample: &[usize]) -> Result<f32, PointsError> {
        let sampled: Vec<usize> = sample.iter().copied().filter(|row| self.holds(*row)).collect();
        let ratio = spacing(at, shown, &sampled)? / self.apart;
        let [volume, sheet] = [self.thinning.cbrt() as f32, self.thinning.sqrt() as f32];
        Ok(if ratio.is_finite() { ratio.clamp(volume, sheet) } else { volume })
    }

    /// Whether one of its Gaussians is in this row.
    pub fn holds(&self, row: usize) -> bool {
        self.rows.binary_search(&row).is_ok()
    }
}

/// Returns the median distance of the Gaussians `rows` of `shown` to the [`APART`]th nearest of them; NaN if there are
/// too few.
fn spacing(at: &HostGaussians, shown: &[u32], rows: &[usize]) -> Result<f32, PointsError> {
    let places: Vec<[f32; 3]> = rows.iter().map(|&n| point(&at.means, shown[n] as usize)).collect();
    let near = Grid::adaptive(places.as_flattened())?.nearest_of_each::<APART>();
    let distance = |(place, near): (&[f32; 3], &[u32; APART])| {
        let other = places[near[APART - 1] as usize];
        (0..3).map(|a| (place[a] - other[a]).powi(2)).sum::<f32>().sqrt()
    };
    let mut all: Vec<f32> = places.iter().zip(&near).map(distance).filter(|d| *d > 0.0).collect();
    let middle = all.len() / 2;
    Ok(if all.is_empty() { f32::NAN } else { *all.select_nth_unstable_by(middle, f32::total_cmp).1 })
}

/// A sample of M Gaussians.
pub(super) struct Sample {
    /// Its Gaussians.
    pub at: HostGaussians,
    /// The row of each among all.
    pub rows: Vec<usize>,
}

impl Sample {
    /// Takes about one in `large.thinning` of the Gaussians `shown` (`[M]`, indices into `at`), from another start for
    /// each `number`. From a thinning of [`SAMPLES`] on, no two samples share a Gaussian; the closer it is to 2, the
    /// more they share.
    ///
    /// # Errors
    /// If the means are not rows of three.
    ///
    /// # Panics
    /// If an index is not below N.
    pub fn of(at: &HostGaussians, shown: &[u32], large: &Large, number: usize) -> Result<Self, PointsError> {
        let thinning = large.thinning;
        let first = thinning * number as f64 / SAMPLES as f64;
        let rows: Vec<usize> = (0..shown.len())
            .map(|k| (first + k as f64 * thinning) as usize)
            .take_while(|row| *row < shown.len())
            .collect();
        let mut sample = at.subset(&rows.iter().map(|&n| shown[n]).collect::<Vec<u32>>());
        let [own, others] = [large.farther_apart(at, shown, &rows)?, thinning.cbrt() as f32].map(f32::ln);
        for (scales, row) in sample.log_scales.chunks_exact_mut(3).zip(&rows) {
            let longer = if large.holds(*row) { own } else { others };
            scales.iter_mut().for_each(|scale| *scale += longer);
        }
        Ok(Self { at: sample, rows })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, Rng};
    use crate::segment::balls::add;

    /// A row of Gaussians that touch, one of them of another material and far from the rest.
    fn row(count: usize) -> (HostGaussians, Vec<u32>, Vec<u32>) {
        let mut at = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
        (0..count).for_each(|i| add(&mut at, [0.01 * i as f32, 0.0, 0.0], [-4.5; 3]));
        add(&mut at, [-50.0, 0.0, 0.0], [-4.5; 3]);
        let labels = (0..=count).map(|i| if i < count { 1 } else { 2 }).collect();
        (at, (0..=count as u32).collect(), labels)
    }

    #[test]
    fn materials_with_large_pieces_are_thinned_and_to_the_size_of_known_ones() {
        let (at, shown, labels) = row(6500);
        let of = |material| large(&at, &shown, &labels, material).unwrap();
        assert!(of(2).is_none() && of(3).is_none());
        let found = of(1).unwrap();
        assert_eq!((found.material, found.thinning, found.rows), (1, 5.0, (0..6500).collect()));
        // with a small piece far from it, all of the material is judged in samples
        let found = large(&at, &shown, &vec![1; 6501], 1).unwrap().unwrap();
        assert!((found.thinning - 5.0).abs() < 0.01 && found.rows.len() == 6501, "{}", found.thinning);
        let (at, shown, labels) = row(2500);
        assert!(large(&at, &shown, &labels, 1).unwrap().is_none());
    }

    #[test]
    fn samples_share_no_gaussian_if_there_are_enough() {
        let (at, shown, _) = row(6500);
        let large = Large { material: 1, rows: (0..6500).collect(), thinning: 5.0, apart: 0.03 };
        let samples: Vec<Sample> = (0..SAMPLES).map(|n| Sample::of(&at, &shown, &large, n).unwrap()).collect();
        let mut rows: Vec<usize> = samples.iter().flat_map(|s| s.rows.iter().copied()).collect();
        rows.sort_unstable();
        assert_eq!(rows, (0..=6500).collect::<Vec<_>>());
        assert_eq!(samples[1].at.means[3], at.means[3 * samples[1].rows[1]]);
    }

    #[test]
    fn gaussians_are_enlarged_by_as_much_as_they_are_farther_apart() {
        for (dimensions, [x, y, z]) in [(2, [80, 75, 1]), (3, [20, 20, 15])] {
            let mut places: Vec<[i32; 3]> = (0..x * y * z).map(|i| [i % x, i / x % y, i / (x * y)]).collect();
            Rng::new(0, 0, Purpose::Custom(0)).shuffle(&mut places);
            let mut at = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
            places.iter().for_each(|place| add(&mut at, place.map(|v| v as f32), [-1.0; 3]));
            let shown: Vec<u32> = (0..at.len() as u32).collect();
            let rows: Vec<usize> = (0..at.len() / 2).collect();
            let apart = spacing(&at, &shown, &rows).unwrap();
            let large = Large { material: 1, rows, thinning: 27.0, apart };
            let sample = Sample::of(&at, &shown, &large, 0).unwrap();
            let [found, others] = [0, 3 * sample.rows.len() - 3].map(|i| (sample.at.log_scales[i] + 1.0).exp());
            let expected = 27f32.powf(1.0 / dimensions as f32);
            assert!((0.8..1.5).contains(&(found / expected)), "{dimensions} dimensions: {found}, not {expected}");
            assert!((others - 3.0).abs() < 1e-5, "those of other pieces, as in a volume: {others}");
        }
        let none = Large { material: 1, rows: vec![0], thinning: 8.0, apart: f32::NAN };
        let (at, shown, _) = row(10);
        let sample = Sample::of(&at, &shown, &none, 0).unwrap();
        assert!((sample.at.log_scales[0] - at.log_scales[0] - 2f32.ln()).abs() < 1e-6, "too few to tell");
    }
}
