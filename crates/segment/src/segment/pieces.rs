//! Connected pieces of Gaussians that touch in space, and the strays among them.

use crate::config::types::segment::PiecesConfig;
use crate::model::HostGaussians;
use crate::points::PointsError;
use crate::points::components::{ComponentFilter, Components, components_touching, largest_scales};

/// When Gaussians are connected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TouchRule {
    /// Maximum distance of two Gaussians, as a multiple of the sum of their largest standard deviations.
    pub reach: f32,
    /// Minimum opacity of Gaussians that connect others.
    pub min_opacity: f32,
}

impl TouchRule {
    /// Visible Gaussians are connected.
    pub fn seen(config: &PiecesConfig) -> Self {
        Self { reach: config.reach, min_opacity: config.min_opacity }
    }

    /// Gaussians are connected, whether visible or not.
    pub fn all(config: &PiecesConfig) -> Self {
        Self { reach: config.reach, min_opacity: 0.0 }
    }
}

/// Finds the connected pieces of `members`, in which Gaussians `touch`. Labels `[M]` from 1; 0 for those that are too
/// transparent or not finite.
///
/// # Errors
/// If the arrays of `at` disagree, or points are too far apart.
///
/// # Panics
/// If a member is not below N.
pub fn pieces(at: &HostGaussians, members: &[u32], touch: TouchRule) -> Result<Components, PointsError> {
    let rows = |values: &[f32]| -> Vec<f32> {
        members.iter().flat_map(|&i| &values[3 * i as usize..][..3]).copied().collect()
    };
    let mut radii = largest_scales(&rows(&at.log_scales))?;
    let opacity: Vec<f32> = members.iter().map(|&i| at.opacity_of(i as usize)).collect();
    radii
        .iter_mut()
        .zip(&opacity)
        .filter(|(_, o)| o.is_nan() || **o < touch.min_opacity)
        .for_each(|(radius, _)| *radius = 0.0);
    components_touching(&rows(&at.means), &radii, touch.reach, &opacity, &ComponentFilter::default())
}

/// Returns the ascending `members` without strays: pieces that do not touch the rest, are small relative to the largest
/// and do not hold the Gaussian `kept`. They consist of Gaussians that no mask shows, whose features the field
/// interpolates between those that it knows.
///
/// # Errors
/// If the arrays of `at` disagree, or points are too far apart.
///
/// # Panics
/// If a member is not below N.
pub fn without_strays(
    at: &HostGaussians,
    members: &[u32],
    kept: Option<u32>,
    config: &PiecesConfig,
) -> Result<Vec<u32>, PointsError> {
    let found = pieces(at, members, TouchRule::all(config))?;
    let own = kept.and_then(|kept| members.binary_search(&kept).ok()).map_or(0, |row| found.labels[row]);
    let large = large(&found, config.stray);
    let stays = |label: u32| label > 0 && (label == own || large(label));
    Ok(members.iter().zip(&found.labels).filter(|(_, l)| stays(**l)).map(|(m, _)| *m).collect())
}

/// Returns which of the Gaussians `at` are visible strays, `[N]`: in pieces that do not touch the rest and are small
/// relative to the largest.
///
/// # Errors
/// If the arrays of `at` disagree, or points are too far apart.
pub fn strays(at: &HostGaussians, config: &PiecesConfig) -> Result<Vec<bool>, PointsError> {
    let visible: Vec<u32> = (0..at.len() as u32).filter(|&i| at.opacity_of(i as usize) >= config.min_opacity).collect();
    let found = pieces(at, &visible, TouchRule::seen(config))?;
    let large = large(&found, config.stray);
    let mut stray = vec![false; at.len()];
    for (&i, &label) in visible.iter().zip(&found.labels) {
        stray[i as usize] = label > 0 && !large(label);
    }
    Ok(stray)
}

/// Whether the piece of a label, from 1, is too large for a stray: at least a fraction `stray` of the largest.
fn large(found: &Components, stray: f64) -> impl Fn(u32) -> bool {
    let most = found.weights.iter().copied().fold(0.0, f64::max);
    move |label| found.weights[label as usize - 1] >= stray * most
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_pieces_apart_are_strays_and_large_ones_are_not() {
        let config = PiecesConfig::default();
        // rows along x: 30 that touch, 10 that touch far away, 1 alone
        let x: Vec<f32> = (0..30).chain(100..110).chain([200]).map(|i| 0.1 * i as f32).collect();
        let n = x.len();
        let mut at = HostGaussians {
            means: x.iter().flat_map(|&x| [x, 0.0, 0.0]).collect(),
            rotations: [1.0, 0.0, 0.0, 0.0].repeat(n),
            log_scales: vec![-2.5; 3 * n],
            opacity_logits: vec![1.0; n],
            sh: vec![0.0; 3 * n],
            sh_stride: 1,
            ..HostGaussians::default()
        };
        let all: Vec<u32> = (0..n as u32).collect();
        assert_eq!(without_strays(&at, &all, None, &config).unwrap(), all[..40]);
        assert_eq!(without_strays(&at, &all[40..], None, &config).unwrap(), [40], "a lone Gaussian is not a stray");
        assert_eq!(without_strays(&at, &[], None, &config).unwrap(), [0u32; 0]);
        assert_eq!(without_strays(&at, &all, Some(40), &config).unwrap(), all, "the clicked one is none");
        assert_eq!(without_strays(&at, &all, Some(3), &config).unwrap(), all[..40]);
        assert_eq!(strays(&at, &config).unwrap(), (0..n).map(|i| i == 40).collect::<Vec<_>>());
        at.opacity_logits[13..18].fill(-8.0);
        let parted = pieces(&at, &all, TouchRule::seen(&config)).unwrap().labels;
        assert_eq!((parted[15], parted[12] == parted[18]), (0, false), "invisible Gaussians connect nothing");
        assert_eq!(pieces(&at, &all, TouchRule::all(&config)).unwrap().labels[..30], [1; 30]);
        at.opacity_logits[..2].fill(f32::NAN);
        let without = pieces(&at, &all, TouchRule::seen(&config)).unwrap().labels;
        assert_eq!((without[0], without[1], without[2]), (0, 0, without[3]), "nor do those without an opacity");
        assert!(without[2] > 0);
        at.opacity_logits[..2].fill(1.0);
        at.means[3] = f32::NAN;
        assert!(!without_strays(&at, &all, None, &config).unwrap().contains(&1));
    }
}
