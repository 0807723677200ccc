//! The mask that drops isolated floaters before components are formed. The neighbour search lives in `neighbours`.

use super::error::{PointsError, check_positive};
use super::neighbours::NeighbourGrid;

/// Default search radius in median nearest-neighbour distances. Points scattered at random on a surface have about 25
/// others within 6 of them (half as many at a rim), but only 11 within 4, where requiring 8 would lose a tenth of the
/// surface.
pub const SPACINGS: f32 = 6.0;

/// Settings of [`keep_mask`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutlierConfig {
    /// Search radius in scene units; `None` for [`SPACINGS`] times the median nearest-neighbour distance.
    pub radius: Option<f32>,
    /// Minimum number of other points within the radius.
    pub min_neighbours: u32,
}

impl Default for OutlierConfig {
    /// The radius is derived from the points; 8 neighbours are required.
    fn default() -> Self {
        Self { radius: None, min_neighbours: 8 }
    }
}

/// The outcome of [`keep_mask`].
#[derive(Debug, Clone, PartialEq)]
pub struct OutlierMask {
    /// `[M]`: true where the point is kept; always false for non-finite points.
    pub keep: Vec<bool>,
    /// The radius used in scene units; 0 where all points with a neighbour coincide.
    pub radius: f32,
}

/// Keeps the points of `points` `[M, 3]` that have at least `min_neighbours` others within the radius.
///
/// The median for the default radius is taken over positive nearest-neighbour distances, so duplicates do not make it
/// 0. A set of at most `min_neighbours` points loses all of them: lower the number for tiny segments.
///
/// # Errors
/// `points` not a whole number of rows; a given radius that is not positive and finite.
pub fn keep_mask(points: &[f32], config: &OutlierConfig) -> Result<OutlierMask, PointsError> {
    let (grid, radius) = match config.radius {
        Some(radius) => {
            check_positive("radius", radius)?;
            (NeighbourGrid::new(points, radius)?, radius)
        }
        None => {
            let fine = NeighbourGrid::adaptive(points)?;
            let radius = SPACINGS * median_spacing(&fine);
            if radius > 0.0 { (NeighbourGrid::new(points, radius)?, radius) } else { (fine, 0.0) }
        }
    };
    let needed = config.min_neighbours;
    let mut keep: Vec<bool> = grid.count_within(radius, needed.max(1)).iter().map(|&n| n >= needed).collect();
    if needed == 0 {
        keep = points.chunks_exact(3).map(|p| p.iter().all(|v| v.is_finite())).collect();
    }
    Ok(OutlierMask { keep, radius })
}

/// Median of the positive nearest-neighbour distances; 0 where there are none.
pub fn median_spacing(grid: &NeighbourGrid) -> f32 {
    let mut distances: Vec<f32> = grid.nearest_distances().into_iter().filter(|d| d.is_finite() && *d > 0.0).collect();
    if distances.is_empty() {
        return 0.0;
    }
    let middle = distances.len() / 2;
    *distances.select_nth_unstable_by(middle, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use volseggs_testing::generator;

    fn sheet_with_floaters() -> Vec<f32> {
        let mut u = generator(1);
        let mut points: Vec<f32> = (0..2000).flat_map(|_| [u(), u(), 0.0]).collect();
        points.extend([5.0, 5.0, 5.0, -4.0, 0.0, 1.0, f32::NAN, 0.0, 0.0]);
        points
    }

    #[test]
    fn floaters_go_and_the_sheet_stays() {
        let mask = keep_mask(&sheet_with_floaters(), &OutlierConfig::default()).unwrap();
        assert_eq!(&mask.keep[2000..], [false; 3]);
        assert!(mask.keep[..2000].iter().filter(|k| **k).count() > 1980);
        assert!(mask.radius > 0.01 && mask.radius < 0.2, "{}", mask.radius);
    }

    #[test]
    fn turning_and_scaling_the_points_scales_the_radius_alone() {
        let points = sheet_with_floaters();
        let turned: Vec<f32> = points.chunks_exact(3).flat_map(|p| [-4.0 * p[1], 4.0 * p[0], 4.0 * p[2]]).collect();
        let (a, b) = (
            keep_mask(&points, &OutlierConfig::default()).unwrap(),
            keep_mask(&turned, &OutlierConfig::default()).unwrap(),
        );
        assert_eq!(a.keep, b.keep);
        assert_eq!(a.radius * 4.0, b.radius);
    }

    #[test]
    fn poison_sets() {
        let config = OutlierConfig::default();
        assert!(keep_mask(&[], &config).unwrap().keep.is_empty());
        assert_eq!(keep_mask(&[1.0; 3], &config).unwrap().keep, [false]);
        assert_eq!(keep_mask(&[1.0; 30], &config).unwrap().keep, [true; 10]);
        assert_eq!(keep_mask(&[1.0, 1.0, f32::NAN], &config).unwrap().keep, [false]);
        let none = OutlierConfig { min_neighbours: 0, ..config };
        assert_eq!(keep_mask(&[1.0, 1.0, 1.0, f32::NAN, 0.0, 0.0], &none).unwrap().keep, [true, false]);
        let far = [vec![0.5; 30], vec![1e30, 0.0, 0.0, 0.51, 0.5, 0.5]].concat();
        let kept = keep_mask(&far, &config).unwrap().keep;
        assert_eq!((kept[0], kept[10], kept[11]), (true, false, true));
        assert!(keep_mask(&[0.0; 3], &OutlierConfig { radius: Some(0.0), ..config }).is_err());
    }
}
