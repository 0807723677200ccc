//! Means, deviations, and differences of two groups of seeds with their 95 % confidence intervals.

use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// A difference of two means.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MeanDifference {
    /// Mean of the first group minus that of the second.
    pub value: f64,
    /// 95 % confidence interval; `None` if a group has fewer than two values.
    pub interval: Option<[f64; 2]>,
    /// Whether the values were compared seed by seed.
    pub paired: bool,
}

impl MeanDifference {
    /// Whether the interval includes zero, which leaves open which mean is larger; `None` without an interval.
    pub fn includes_zero(&self) -> Option<bool> {
        self.interval.map(|[low, high]| low <= 0.0 && high >= 0.0)
    }
}

/// Arithmetic mean; `None` without values, or if it is not finite.
pub fn mean(values: &[f64]) -> Option<f64> {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    mean.is_finite().then_some(mean)
}

/// Sample standard deviation (n - 1); `None` for fewer than two values, or if it is not finite.
pub fn deviation(values: &[f64]) -> Option<f64> {
    if values.len() < 2 {
        return None;
    }
    let mean = mean(values)?;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    Some((squares / (values.len() - 1) as f64).sqrt()).filter(|d| d.is_finite())
}

/// Returns the mean of `ours` minus that of `base`, both as (seed, value). Non-finite values are skipped; `None` if
/// nothing is left of either.
///
/// If both have the same seeds, at least two, the interval is that of the differences seed by seed; otherwise it is
/// Welch's.
pub fn difference(ours: &[(u64, f64)], base: &[(u64, f64)]) -> Option<MeanDifference> {
    let (ours, base) = (by_seed(ours), by_seed(base));
    let (ours_values, base_values) = (values(&ours), values(&base));
    let value = Some(mean(&ours_values)? - mean(&base_values)?).filter(|v| v.is_finite())?;
    let paired = same_seeds(&ours, &base);
    let half = if paired {
        let differences: Vec<f64> = ours_values.iter().zip(&base_values).map(|(a, b)| a - b).collect();
        half_width(&differences)
    } else {
        welch_half_width(&ours_values, &base_values)
    };
    let interval = half.map(|half| [value - half, value + half]).filter(|i| i.iter().all(|v| v.is_finite()));
    Some(MeanDifference { value, interval, paired })
}

/// The 97.5 % quantile of Student's t distribution.
fn quantile(freedom: f64) -> Option<f64> {
    let t = StudentsT::new(0.0, 1.0, freedom).ok()?.inverse_cdf(0.975);
    t.is_finite().then_some(t)
}

/// Half-width of the confidence interval of a mean.
fn half_width(values: &[f64]) -> Option<f64> {
    let n = values.len() as f64;
    Some(quantile(n - 1.0)? * deviation(values)? / n.sqrt())
}

/// Half-width of the confidence interval of a difference of means with unequal variances.
fn welch_half_width(a: &[f64], b: &[f64]) -> Option<f64> {
    let variance = |v: &[f64]| Some(deviation(v)?.powi(2) / v.len() as f64);
    let (var_a, var_b) = (variance(a)?, variance(b)?);
    let sum = var_a + var_b;
    if sum == 0.0 {
        return Some(0.0);
    }
    // as fractions of the sum, because squared variances soon leave the range of floats
    let (share_a, share_b) = (var_a / sum, var_b / sum);
    let freedom = 1.0 / (share_a.powi(2) / (a.len() - 1) as f64 + share_b.powi(2) / (b.len() - 1) as f64);
    Some(quantile(freedom)? * sum.sqrt())
}

/// The finite values in the order of their seeds, so that results are bit-identical for any order of runs.
fn by_seed(values: &[(u64, f64)]) -> Vec<(u64, f64)> {
    let mut out: Vec<_> = values.iter().copied().filter(|(_, v)| v.is_finite()).collect();
    out.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    out
}

fn values(pairs: &[(u64, f64)]) -> Vec<f64> {
    pairs.iter().map(|p| p.1).collect()
}

/// Whether both have the same two or more seeds, each once.
fn same_seeds(a: &[(u64, f64)], b: &[(u64, f64)]) -> bool {
    a.len() >= 2
        && a.len() == b.len()
        && a.iter().zip(b).all(|(a, b)| a.0 == b.0)
        && a.windows(2).all(|pair| pair[0].0 < pair[1].0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn near(a: f64, b: f64, tolerance: f64) {
        assert!((a - b).abs() <= tolerance, "{a} is not {b}");
    }

    #[test]
    fn means_and_deviations() {
        assert_eq!(mean(&[]), None);
        assert_eq!(mean(&[f64::NAN, 1.0]), None);
        assert_eq!(deviation(&[3.0]), None);
        near(mean(&[2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]).unwrap(), 5.0, 1e-12);
        near(deviation(&[2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]).unwrap(), (32.0f64 / 7.0).sqrt(), 1e-12);
    }

    #[test]
    fn quantiles_are_those_of_the_tables() {
        for (freedom, t) in [(1.0, 12.706), (2.0, 4.303), (4.0, 2.776), (9.0, 2.262), (30.0, 2.042), (1000.0, 1.962)] {
            near(quantile(freedom).unwrap(), t, 5e-4);
        }
        assert_eq!(quantile(0.0), None);
        assert_eq!(quantile(f64::NAN), None);
    }

    #[test]
    fn the_same_seeds_are_paired() {
        // differences 1, 2, 3, 4, 5: deviation sqrt(2.5), half width 2.776 * sqrt(2.5 / 5)
        let base: Vec<(u64, f64)> = (0..5).map(|i| (i, 10.0 * i as f64)).collect();
        let ours: Vec<(u64, f64)> = (0..5).rev().map(|i| (i, 11.0 * i as f64 + 1.0)).collect();
        let found = difference(&ours, &base).unwrap();
        assert!(found.paired);
        near(found.value, 3.0, 1e-12);
        let [low, high] = found.interval.unwrap();
        near(high - 3.0, 2.776_445 * 0.5f64.sqrt(), 1e-5);
        near(3.0 - low, high - 3.0, 1e-12);
        assert_eq!(found.includes_zero(), Some(false));
    }

    #[test]
    fn other_seeds_are_welch() {
        // variances of the means 1/3 and 4/3: degrees of freedom (5/3)^2 / (1/18 + 16/18) = 50/17
        let ours = [(0, 5.0), (1, 6.0), (2, 7.0)];
        let base = [(3, 2.0), (4, 4.0), (5, 6.0)];
        let found = difference(&ours, &base).unwrap();
        assert!(!found.paired);
        near(found.value, 2.0, 1e-12);
        // t(0.975, 50/17) = 3.21876, times sqrt(5/3)
        near(found.interval.unwrap()[1] - 2.0, 3.21876 * (5.0f64 / 3.0).sqrt(), 1e-4);
        assert_eq!(found.includes_zero(), Some(true));
        // a repeated seed cannot be paired
        assert!(!difference(&[(0, 1.0), (0, 2.0)], &[(0, 1.0), (0, 2.0)]).unwrap().paired);
    }

    #[test]
    fn too_few_values_have_no_interval() {
        assert_eq!(difference(&[], &[(0, 1.0)]), None);
        assert_eq!(difference(&[(0, f64::NAN)], &[(0, 1.0)]), None);
        let one = difference(&[(0, 3.0)], &[(0, 1.0), (1, 1.0)]).unwrap();
        assert_eq!((one.value, one.interval, one.includes_zero()), (2.0, None, None));
        // a seed without a finite value does not count
        let found = difference(&[(0, 3.0), (1, f64::INFINITY)], &[(0, 1.0), (1, 1.0)]).unwrap();
        assert_eq!(found, MeanDifference { value: 2.0, interval: None, paired: false });
    }

    #[test]
    fn no_spread_is_an_interval_of_no_width() {
        let found = difference(&[(0, 3.0), (1, 3.0)], &[(2, 1.0), (3, 1.0)]).unwrap();
        assert_eq!(found.interval, Some([2.0, 2.0]));
    }

    proptest! {
        #[test]
        fn intervals_hold_their_difference(
            a in prop::collection::vec((0u64..4, prop::num::f64::ANY), 0..6),
            b in prop::collection::vec((0u64..4, -1e3..1e3), 0..6),
        ) {
            for found in [difference(&a, &b), difference(&b, &b), difference(&b, &a)].into_iter().flatten() {
                prop_assert!(found.value.is_finite());
                if let Some([low, high]) = found.interval {
                    prop_assert!(low <= found.value && found.value <= high && low.is_finite() && high.is_finite());
                }
            }
        }

        #[test]
        fn quantiles_fall_with_freedom(freedom in 1.0..500.0) {
            let (t, next) = (quantile(freedom).unwrap(), quantile(freedom + 1.0).unwrap());
            prop_assert!(t > next && next > 1.959);
        }
    }
}
