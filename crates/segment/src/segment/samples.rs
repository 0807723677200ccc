//! Samples of scenes of many Gaussians, for what is told by contacts between neighbours.
//!
//! Whether a layer is in contact with what it covers, and how much of it is edge, depends on how many Gaussians thick
//! it is, as each is compared with the same number of neighbours. The limits in `bodies` and `surface_layers` were
//! found on pieces of about `segment.layers.sampled_size` Gaussians. A material with far larger pieces is therefore judged in samples of
//! the scene in which they are of that size, and in which each Gaussian is enlarged by as much as they are farther
//! apart in a volume, the cube root of the thinning; in a sheet one Gaussian thick, distances grow by its square root,
//! so that contacts are lost (sizes by the measured distances were tried, and change what should stay). Materials differ
//! in their sizes: beside shells of many thousand Gaussians there may be cores of a few hundred. Small pieces of a
//! material are judged with its large ones, as they are mostly their fragments: see the results of 2026-11-28.

use super::pieces::{TouchRule, pieces};
use crate::config::types::SegmentConfig;
use crate::model::HostGaussians;
use crate::points::PointsError;

/// A material with large pieces, which is judged in samples.
pub(super) struct Large {
    /// The material.
    pub material: u32,
    /// Its Gaussians, rows of `shown`, ascending.
    pub rows: Vec<usize>,
    /// How many times fewer Gaussians there must be for its pieces to be of the
    /// known size.
    pub thinning: f64,
}

/// Returns a material if its pieces have far more Gaussians than the known ones, on average over its Gaussians. `shown` `[M]`
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
    config: &SegmentConfig,
) -> Result<Option<Large>, PointsError> {
    let (touch, config) = (TouchRule::seen(&config.pieces), &config.layers);
    let rows: Vec<usize> = (0..shown.len()).filter(|&n| labels[n] == material).collect();
    let found = pieces(at, &rows.iter().map(|&n| shown[n]).collect::<Vec<u32>>(), touch)?;
    let sizes = found.counts.into_iter().map(f64::from);
    // the size of the piece that a Gaussian is in, on average
    let (total, squares) = sizes.fold((0.0, 0.0), |(total, squares), n| (total + n, squares + n * n));
    let typical = squares / f64::max(total, 1.0);
    if !config.samples || typical <= config.far_more * config.sampled_size {
        return Ok(None);
    }
    Ok(Some(Large { material, rows, thinning: typical / config.sampled_size }))
}

/// A sample of M Gaussians.
pub(super) struct GaussianSample {
    /// Its Gaussians.
    pub at: HostGaussians,
    /// The row of each among all.
    pub rows: Vec<usize>,
}

impl GaussianSample {
    /// Takes about one in `thinning` of the Gaussians `shown` (`[M]`, indices into `at`), from another start for
    /// each `number` of `samples`. From a thinning of `samples` on, no two share a Gaussian; the closer it is to 2, the
    /// more they share.
    ///
    /// # Panics
    /// If an index is not below N.
    pub fn take(at: &HostGaussians, shown: &[u32], thinning: f64, (number, samples): (usize, usize)) -> Self {
        let first = thinning * number as f64 / samples as f64;
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
    use crate::segment::test_support::add;

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
        let config = SegmentConfig::default();
        let of = |material| large(&at, &shown, &labels, material, &config).unwrap();
        assert!(of(2).is_none() && of(3).is_none());
        let found = of(1).unwrap();
        assert_eq!((found.material, found.thinning, found.rows), (1, 5.0, (0..6500).collect()));
        // with a small piece far from it, all of the material is judged in samples
        let found = large(&at, &shown, &vec![1; 6501], 1, &config).unwrap().unwrap();
        assert!((found.thinning - 5.0).abs() < 0.01 && found.rows.len() == 6501, "{}", found.thinning);
        let (at, shown, labels) = row(2500);
        assert!(large(&at, &shown, &labels, 1, &config).unwrap().is_none());
    }

    #[test]
    fn samples_share_no_gaussian_if_there_are_enough_and_are_enlarged() {
        let (at, shown, _) = row(6500);
        let samples: Vec<GaussianSample> =
            (0..5).map(|number| GaussianSample::take(&at, &shown, 5.0, (number, 5))).collect();
        let mut rows: Vec<usize> = samples.iter().flat_map(|s| s.rows.iter().copied()).collect();
        rows.sort_unstable();
        assert_eq!(rows, (0..=6500).collect::<Vec<_>>());
        let longer = samples[1].at.log_scales[0] - at.log_scales[0];
        assert!((longer.exp().powi(3) - 5.0).abs() < 1e-4, "{longer}");
        assert_eq!(samples[1].at.means[3], at.means[3 * samples[1].rows[1]]);
    }
}
