//! Turns the groups found into as many as requested.

use super::Smooth;
use super::centre::{Centre, Members};
use crate::config::types::segment::GroupsConfig;
use crate::points::PointsError;
use crate::points::kmeans::{KMeansConfig, kmeans};

/// Joins the two groups that cost least to join (Ward's criterion), or halves the group of largest scatter by k-means,
/// until there are `wanted`; stops with fewer if none can be halved.
pub(super) fn exactly(
    mut parts: Vec<Members>,
    wanted: usize,
    smooth: &Smooth,
    weights: &[f32],
    (config, uniform): (&GroupsConfig, &mut impl FnMut() -> f32),
) -> Result<Vec<Members>, PointsError> {
    while parts.len() > wanted {
        let centres: Vec<(Centre, f64)> =
            parts.iter().map(|p| (Centre::weighted(p, smooth, weights, config.clear), mass(p, weights))).collect();
        let mut best = (f64::INFINITY, 0, 1);
        for b in 1..parts.len() {
            for a in 0..b {
                let ((one, m), (other, n)) = (&centres[a], &centres[b]);
                let cost = m * n / (m + n).max(f64::MIN_POSITIVE) * f64::from(one.squared(other.plane, other.light));
                if cost < best.0 {
                    best = (cost, a, b);
                }
            }
        }
        let gone = parts.remove(best.2);
        let kept = &mut parts[best.1];
        kept.rows.extend(gone.rows);
        kept.rows.sort_unstable();
        kept.light = kept.light.min(gone.light);
    }
    let even = weights.iter().map(|w| f64::from(*w)).sum::<f64>() / wanted as f64;
    // if that is not enough, outliers may form a half too
    for min_weight in [config.min_half * even, 0.0] {
        halve(&mut parts, wanted, min_weight, smooth, weights, (config, &mut *uniform))?;
    }
    Ok(parts)
}

/// Halves the group of largest scatter until there are `wanted`, or no group has two halves of weight `min_weight` or
/// more.
fn halve(
    parts: &mut Vec<Members>,
    wanted: usize,
    min_weight: f64,
    smooth: &Smooth,
    weights: &[f32],
    (config, uniform): (&GroupsConfig, &mut impl FnMut() -> f32),
) -> Result<(), PointsError> {
    let mut scatters: Vec<Option<f64>> = vec![None; parts.len()];
    while parts.len() < wanted {
        for (part, scatter) in parts.iter().zip(&mut scatters).filter(|(_, s)| s.is_none()) {
            *scatter = Some(halves(part, 1, smooth, weights, (config, &mut *uniform))?.0);
        }
        let mut most = (0.0, None);
        for (k, scatter) in scatters.iter().enumerate() {
            if scatter.is_some_and(|s| s > most.0) {
                most = (scatter.unwrap_or(0.0), Some(k));
            }
        }
        let Some(k) = most.1 else { break };
        let labels = halves(&parts[k], 2, smooth, weights, (config, &mut *uniform))?.1;
        let of = |label: u32| Members {
            rows: parts[k].rows.iter().zip(&labels).filter(|(_, l)| **l == label).map(|(i, _)| *i).collect(),
            light: parts[k].light.max(config.halving),
        };
        let (first, second) = (of(1), of(2));
        if second.rows.is_empty() || mass(&second, weights) < min_weight {
            scatters[k] = Some(0.0);
            continue;
        }
        (parts[k], scatters[k]) = (first, None);
        parts.push(second);
        scatters.push(None);
    }
    Ok(())
}

fn mass(part: &Members, weights: &[f32]) -> f64 {
    part.rows.iter().map(|&i| f64::from(weights[i as usize])).sum()
}

/// Weighted scatter and labels of `count` clusters of a group.
fn halves(
    part: &Members,
    count: usize,
    smooth: &Smooth,
    weights: &[f32],
    (config, uniform): (&GroupsConfig, &mut impl FnMut() -> f32),
) -> Result<(f64, Vec<u32>), PointsError> {
    let lightness = if part.light > 0.0 { part.light.min(config.lightness) } else { config.halving };
    let rows = || part.rows.iter().map(|&i| i as usize);
    let points: Vec<f32> =
        rows().flat_map(|i| [smooth.plane[i][0], smooth.plane[i][1], lightness * smooth.light[i]]).collect();
    let weights: Vec<f32> = rows().map(|i| weights[i]).collect();
    let found = kmeans(&points, 3, &weights, &KMeansConfig::new(count), uniform)?;
    Ok((found.distortion, found.labels))
}
