//! Samples of scenes of many Gaussians, for what is told by contacts between neighbours.
//!
//! Whether a layer is in contact with what it covers, and how much of it is edge, depends on how many Gaussians thick
//! it is, as each is compared with the same number of neighbours. The limits in `bodies` and `surface_layers` were
//! found on pieces of about [`KNOWN`] Gaussians. The far larger pieces of a material are therefore judged in samples of
//! the scene in which they are of that size, and in which each Gaussian is enlarged by as much as they are farther
//! apart in a volume, the cube root of the thinning; in a sheet one Gaussian thick, distances grow by its square root,
//! so that contacts are lost. Materials differ in their sizes: beside shells of many thousand Gaussians there may be
//! cores of a few hundred.

use super::pieces::{Touch, pieces};
use crate::model::HostGaussians;
use crate::points::PointsError;

/// Gaussians in a piece of a material, weighted by size, in the scene with the most layers among those on which the
/// limits were found: see the results of 2026-11-28 in `benches/results`.
const KNOWN: f64 = 1300.0;
/// How many times as many a piece must have for samples to be taken. Some of those scenes have such pieces too, and the
/// same result with and without samples.
const FAR_MORE: f64 = 2.0;
/// Samples that vote. In a single one, what is near a limit may fall on either side of it by chance.
pub(super) const SAMPLES: usize = 5;

/// The pieces of a material that are judged in samples.
pub(super) struct Large {
    /// Their Gaussians, rows of `shown`, ascending.
    pub rows: Vec<usize>,
    /// How many times fewer Gaussians there must be for these pieces to have [`KNOWN`].
    pub thinning: f64,
}

/// Returns the pieces of `material` that have far more than [`KNOWN`] Gaussians; `None` if there are none. `shown`
/// `[M]` are indices into `at`, and `labels` `[M]` the materials.
///
/// # Errors
/// If the arrays of `at` disagree, or points are too far apart.
///
/// # Panics
/// If an index is not below N.
pub(super) fn large_pieces(
    at: &HostGaussians,
    shown: &[u32],
    labels: &[u32],
    material: u32,
) -> Result<Option<Large>, PointsError> {
    let members: Vec<usize> = (0..shown.len()).filter(|&n| labels[n] == material).collect();
    let found = pieces(at, &members.iter().map(|&n| shown[n]).collect::<Vec<u32>>(), Touch::SEEN)?;
    let size_of = |label: u32| label.checked_sub(1).map_or(0.0, |piece| f64::from(found.counts[piece as usize]));
    let is_large = |label: u32| size_of(label) > FAR_MORE * KNOWN;
    let (rows, sizes): (Vec<usize>, Vec<f64>) =
        members.iter().zip(&found.labels).filter(|(_, l)| is_large(**l)).map(|(&n, &l)| (n, size_of(l))).unzip();
    // by the size of the piece that a Gaussian is in, on average
    let thinning = sizes.iter().sum::<f64>() / sizes.len() as f64 / KNOWN;
    Ok((!rows.is_empty()).then_some(Large { rows, thinning }))
}

/// A sample of M Gaussians.
pub(super) struct Sample {
    /// Its Gaussians.
    pub at: HostGaussians,
    /// The row of each among all.
    pub rows: Vec<usize>,
}

impl Sample {
    /// Takes about one in `thinning` of the Gaussians `shown` (`[M]`, indices into `at`), from another start for each
    /// `number`. From a thinning of [`SAMPLES`] on, no two samples share a Gaussian; the closer it is to 2, the more
    /// they share.
    ///
    /// # Panics
    /// If an index is not below N.
    pub fn of(at: &HostGaussians, shown: &[u32], thinning: f64, number: usize) -> Self {
        let first = thinning * number as f64 / SAMPLES as f64;
        let rows: Vec<usize> = (0..shown.len())
            .map(|k| (first + k as f64 * thinning) as usize)
            .take_while(|row| *row < shown.len())
            .collect();
        let mut sample = at.subset(&rows.iter().map(|&n| shown[n]).collect::<Vec<u32>>());
        let longer = thinning.cbrt().ln() as f32;
        sample.log_scales.iter_mut().for_each(|scale| *scale += longer);
        Self { at: sample, rows }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
    fn only_large_pieces_are_thinned_and_to_the_size_of_known_ones() {
        let (at, shown, labels) = row(6500);
        let of = |material| large_pieces(&at, &shown, &labels, material).unwrap();
        assert!(of(2).is_none() && of(3).is_none());
        let large = of(1).unwrap();
        assert_eq!((large.thinning, large.rows), (5.0, (0..6500).collect()));
        // a small piece of the same material far from it
        let one = vec![1; 6501];
        let large = large_pieces(&at, &shown, &one, 1).unwrap().unwrap();
        assert_eq!((large.thinning, large.rows.len()), (5.0, 6500));
        let (at, shown, labels) = row(2500);
        assert!(large_pieces(&at, &shown, &labels, 1).unwrap().is_none());
    }

    #[test]
    fn samples_share_no_gaussian_if_there_are_enough_and_are_enlarged() {
        let (at, shown, _) = row(6500);
        let samples: Vec<Sample> = (0..SAMPLES).map(|number| Sample::of(&at, &shown, 5.0, number)).collect();
        let mut rows: Vec<usize> = samples.iter().flat_map(|s| s.rows.iter().copied()).collect();
        rows.sort_unstable();
        assert_eq!(rows, (0..=6500).collect::<Vec<_>>());
        let longer = samples[1].at.log_scales[0] - at.log_scales[0];
        assert!((longer.exp().powi(3) - 5.0).abs() < 1e-4, "{longer}");
        assert_eq!(samples[1].at.means[3], at.means[3 * samples[1].rows[1]]);
    }
}
