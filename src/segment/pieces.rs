//! What hangs together in space: connected pieces of Gaussians that touch, and the strays among them.

use crate::model::HostGaussians;
use crate::points::PointsError;
use crate::points::components::{ComponentFilter, Components, components_touching, largest_scales};

/// Standard deviations at which Gaussians touch. At 2 a thread of Gaussians falls into dashes, from 3 on a thing joins
/// what lies next to it: see the results of 2026-11-22 in `benches/results`.
const REACH: f32 = 2.5;
/// Part of the largest connected piece's opacity below which another piece is a stray.
const STRAY: f64 = 0.05;

/// The pieces of `members`: Gaussians hang together where they touch. Labels `[M]` from 1; 0 for what is nowhere.
///
/// # Errors
/// If the arrays of `at` disagree, or points are too far apart.
///
/// # Panics
/// If a member is not below N.
pub fn pieces(at: &HostGaussians, members: &[u32]) -> Result<Components, PointsError> {
    let rows = |values: &[f32]| -> Vec<f32> {
        members.iter().flat_map(|&i| &values[3 * i as usize..][..3]).copied().collect()
    };
    let radii = largest_scales(&rows(&at.log_scales))?;
    let opacity: Vec<f32> = members.iter().map(|&i| at.opacity_of(i as usize)).collect();
    components_touching(&rows(&at.means), &radii, REACH, &opacity, &ComponentFilter::default())
}

/// The `members` without strays: pieces that do not touch the rest and are small beside the largest. They come of
/// Gaussians that no mask shows, whose features are what the field makes up between those that it knows.
///
/// # Errors
/// If the arrays of `at` disagree, or points are too far apart.
///
/// # Panics
/// If a member is not below N.
pub fn without_strays(at: &HostGaussians, members: &[u32]) -> Result<Vec<u32>, PointsError> {
    let found = pieces(at, members)?;
    let most = found.weights.iter().copied().fold(0.0, f64::max);
    let stays = |label: u32| label > 0 && found.weights[label as usize - 1] >= STRAY * most;
    Ok(members.iter().zip(&found.labels).filter(|(_, l)| stays(**l)).map(|(m, _)| *m).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_pieces_apart_are_strays_and_large_ones_are_not() {
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
            shading: None,
        };
        let all: Vec<u32> = (0..n as u32).collect();
        assert_eq!(without_strays(&at, &all).unwrap(), all[..40]);
        assert_eq!(without_strays(&at, &all[40..]).unwrap(), [40], "alone it is no stray");
        assert_eq!(without_strays(&at, &[]).unwrap(), [0u32; 0]);
        at.means[3] = f32::NAN;
        assert!(!without_strays(&at, &all).unwrap().contains(&1));
    }
}
