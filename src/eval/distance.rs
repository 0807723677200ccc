//! Metrics by the distance of a view's time from the nearest trained time: what is interpolation, and what is not.

use super::run::ViewMetrics;
use crate::metrics::values::MetricValues;
use serde::{Deserialize, Serialize};

/// Times closer than this count as equal.
const SAME: f64 = 1e-4;
/// Maximum number of groups; more distances than this are merged.
const MAX_GROUPS: usize = 6;

/// Means over the views at about the same distance from the nearest trained time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AtDistance {
    /// Smallest distance of the group, in units of time in [0, 1]; 0 for views at a trained time.
    pub from: f64,
    /// Largest distance of the group.
    pub to: f64,
    /// Number of views.
    pub views: usize,
    /// Means of the metrics.
    #[serde(flatten)]
    pub metrics: MetricValues,
}

/// Groups views by their distance from the nearest of the `trained` times, nearest first. A few distances are one group
/// each; if there are more, views at a trained time are one group, and the others form two halves. There are no groups
/// without trained times.
pub fn by_distance(views: &[ViewMetrics], trained: &[f64]) -> Vec<AtDistance> {
    if trained.is_empty() {
        return Vec::new();
    }
    let nearest = |time: f64| trained.iter().map(|t| (t - time).abs()).fold(f64::INFINITY, f64::min);
    let mut rows: Vec<(f64, &ViewMetrics)> = views.iter().map(|v| (nearest(v.time), v)).collect();
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut groups: Vec<Vec<(f64, &ViewMetrics)>> = Vec::new();
    for row in &rows {
        match groups.last_mut() {
            Some(group) if row.0 - group[0].0 < SAME => group.push(*row),
            _ => groups.push(vec![*row]),
        }
    }
    if groups.len() > MAX_GROUPS {
        let (at, away): (Vec<_>, Vec<_>) = rows.into_iter().partition(|row| row.0 < SAME);
        let (near, far) = away.split_at(away.len() / 2);
        groups = [at, near.to_vec(), far.to_vec()].into_iter().filter(|group| !group.is_empty()).collect();
    }
    groups.iter().map(|group| summary(group)).collect()
}

/// Returns the means of a group, which holds at least one view.
fn summary(group: &[(f64, &ViewMetrics)]) -> AtDistance {
    let distance = |row: Option<&(f64, &ViewMetrics)>| row.map_or(0.0, |(d, _)| if *d < SAME { 0.0 } else { *d });
    AtDistance {
        from: distance(group.first()),
        to: distance(group.last()),
        views: group.len(),
        metrics: MetricValues::mean(group.iter().map(|(_, view)| &view.metrics)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(time: f64, psnr: f64) -> ViewMetrics {
        let metrics = [("psnr", psnr), ("ssim", 0.9), ("lpips_alex", psnr / 100.0)].into_iter().collect();
        ViewMetrics { view: String::new(), time, metrics }
    }

    #[test]
    fn each_of_few_distances_is_a_group() {
        // steps of 1/99 with rounding errors, trained at steps 0, 3 and 6
        let trained = [0.0, 3.0 / 99.0, 6.0 / 99.0];
        let views: Vec<ViewMetrics> = (0..=6).map(|i| view(f64::from(i) / 99.0 + 1e-9, f64::from(i))).collect();
        let found = by_distance(&views, &trained);
        assert_eq!(found.iter().map(|g| g.views).collect::<Vec<_>>(), [3, 4]);
        assert_eq!((found[0].from, found[0].to, found[0].metrics.get("psnr")), (0.0, 0.0, Some(3.0)));
        assert!(
            (found[1].from - 1.0 / 99.0).abs() < 1e-6 && (found[1].metrics.get("psnr").unwrap() - 3.0).abs() < 1e-12
        );
        assert!((found[1].metrics.get("lpips_alex").unwrap() - 0.03).abs() < 1e-12);
    }

    #[test]
    fn many_distances_become_three_groups_and_no_view_is_lost() {
        let views: Vec<ViewMetrics> = (0..=100).map(|i| view(f64::from(i) / 100.0, 20.0)).collect();
        let found = by_distance(&views, &[0.0]);
        assert_eq!(found.iter().map(|g| g.views).collect::<Vec<_>>(), [1, 50, 50]);
        assert!(found[1].to < found[2].from && found[2].to == 1.0);
        assert_eq!(by_distance(&views, &[]), []);
        assert_eq!(by_distance(&[], &[0.5]), []);
    }
}
