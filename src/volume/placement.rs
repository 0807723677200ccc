//! The placement of a volume in the scene: centred at the origin, its longest side of one fixed length, in proportion.

use super::grid::Grid;
use crate::data::Aabb;
use crate::data::paths::RADIUS;
use glam::DVec3;

/// Length of the longest side that fills half the frame of the published cameras: `RADIUS * tan(15 degrees)`.
#[must_use]
pub fn published_side() -> f64 {
    RADIUS * (15f64.to_radians()).tan()
}

/// The map between scene coordinates and voxel coordinates, in which voxel `i` has its centre at `i`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Half the size of the box between the outermost voxel centres, scene units.
    pub half: DVec3,
    /// Voxels per scene unit along each axis.
    pub voxels_per_unit: DVec3,
}

impl Placement {
    /// Centres the grid at the origin and scales its longest side to `side` scene units.
    #[must_use]
    pub fn new(grid: &Grid, side: f64) -> Self {
        let size = DVec3::from_array(grid.size());
        let scale = side / size.max_element();
        let spacing = DVec3::from_array(grid.spacing) * scale;
        Self { half: 0.5 * scale * size, voxels_per_unit: spacing.recip() }
    }

    /// The voxel coordinates of a point in the scene.
    #[must_use]
    pub fn to_voxel(&self, point: DVec3) -> DVec3 {
        (point + self.half) * self.voxels_per_unit
    }

    /// Distance between neighbouring voxels along x, y, z, scene units.
    #[must_use]
    pub fn spacing(&self) -> DVec3 {
        self.voxels_per_unit.recip()
    }

    /// Length of the longest side, scene units.
    #[must_use]
    pub fn side(&self) -> f64 {
        2.0 * self.half.max_element()
    }

    /// The box in the scene.
    #[must_use]
    pub fn bounds(&self) -> Aabb {
        Aabb { min: -self.half, max: self.half }
    }

    /// Where a ray enters and leaves the box, as multiples of `direction`; none if it misses. Never before the eye.
    #[must_use]
    pub fn clip(&self, eye: DVec3, direction: DVec3) -> Option<(f64, f64)> {
        let (mut near, mut far) = (0.0f64, f64::INFINITY);
        for a in 0..3 {
            if direction[a] == 0.0 {
                if eye[a].abs() > self.half[a] {
                    return None;
                }
                continue;
            }
            let (s, t) = ((-self.half[a] - eye[a]) / direction[a], (self.half[a] - eye[a]) / direction[a]);
            near = near.max(s.min(t));
            far = far.min(s.max(t));
        }
        (near < far && far.is_finite()).then_some((near, far))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn proportions_are_kept() {
        let grid = Grid { dims: [5, 3, 2], spacing: [1.0, 1.0, 8.0], origin: [7.0, 0.0, 0.0] };
        let p = Placement::new(&grid, 2.0);
        assert!((p.half - DVec3::new(0.5, 0.25, 1.0)).length() < 1e-12);
        assert!((p.to_voxel(p.half) - DVec3::new(4.0, 2.0, 1.0)).length() < 1e-12);
        assert!(p.to_voxel(-p.half).length() < 1e-12);
        assert!((published_side() - 1.0801).abs() < 1e-4);
    }

    #[test]
    fn rays_are_clipped() {
        let p = Placement::new(&Grid::unit([3, 3, 3]), 2.0);
        assert_eq!(p.clip(DVec3::X * 3.0, -DVec3::X), Some((2.0, 4.0)));
        assert_eq!(p.clip(DVec3::ZERO, DVec3::Z), Some((0.0, 1.0)));
        assert_eq!(p.clip(DVec3::new(3.0, 1.5, 0.0), -DVec3::X), None);
        assert_eq!(p.clip(DVec3::X * 3.0, DVec3::X), None);
    }
}
