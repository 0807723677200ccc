//! The placement of a volume in the scene: centred at the origin, its longest side of one fixed length, in proportion.

use super::grid::Grid;
use super::source::PhysicalMetadata;
use crate::data::Aabb;
use crate::data::calibration::PhysicalSpace;
use crate::data::paths::RADIUS;
use glam::{DMat3, DVec3};

/// Length of the longest side that fills half the frame of the published cameras: `RADIUS * tan(15 degrees)`.
pub fn published_side() -> f64 {
    RADIUS * (15f64.to_radians()).tan()
}

/// Where the voxels of a grid are in the scene, whose axes are those of physical space. Voxel `i` has its centre at
/// voxel coordinates `i`; the box is that between the outermost voxel centres, along the index axes of the grid, its
/// middle at the scene's origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VoxelPlacement {
    /// Half the size of the box along its own axes, scene units.
    pub half: DVec3,
    /// Voxels per scene unit along each of these axes.
    pub voxels_per_unit: DVec3,
    /// Physical position of the scene's origin.
    pub centre: DVec3,
    /// Physical length of a scene unit.
    pub scale: f64,
    /// The axes of the box in the scene as columns, if they are others.
    turn: Option<DMat3>,
}

impl VoxelPlacement {
    /// Centres the grid at the origin and scales its longest side to `side` scene units.
    pub fn new(grid: &Grid, side: f64) -> Self {
        let size = DVec3::from_array(grid.size());
        let scale = side / size.max_element();
        let spacing = DVec3::from_array(grid.spacing) * scale;
        Self {
            half: 0.5 * scale * size,
            voxels_per_unit: spacing.recip(),
            centre: grid.centre(),
            scale: size.max_element() / side,
            turn: grid.directions.turn(),
        }
    }

    /// The axes of the box in the scene as columns of an orthogonal matrix, which may mirror; `None` if they are those
    /// of the scene.
    pub fn turn(&self) -> Option<DMat3> {
        self.turn
    }

    /// A point or direction of the scene along the axes of the box.
    pub fn to_box(&self, scene: DVec3) -> DVec3 {
        self.turn.map_or(scene, |turn| turn.transpose() * scene)
    }

    /// The voxel coordinates of a point in the scene.
    pub fn to_voxel(&self, scene: DVec3) -> DVec3 {
        self.box_to_voxel(self.to_box(scene))
    }

    /// The voxel coordinates of a point given along the axes of the box.
    pub fn box_to_voxel(&self, point: DVec3) -> DVec3 {
        (point + self.half) * self.voxels_per_unit
    }

    /// The point in the scene of voxel coordinates.
    pub fn to_scene(&self, voxel: DVec3) -> DVec3 {
        let point = voxel * self.spacing() - self.half;
        self.turn.map_or(point, |turn| turn * point)
    }

    /// Distance between neighbouring voxels along the axes of the box, scene units.
    pub fn spacing(&self) -> DVec3 {
        self.voxels_per_unit.recip()
    }

    /// Length of the longest side, scene units.
    pub fn side(&self) -> f64 {
        2.0 * self.half.max_element()
    }

    /// The smallest box along the axes of the scene that encloses the volume.
    pub fn bounds(&self) -> Aabb {
        let half = self.turn.map_or(self.half, |turn| {
            let [x, y, z] = [turn.x_axis, turn.y_axis, turn.z_axis].map(DVec3::abs);
            x * self.half.x + y * self.half.y + z * self.half.z
        });
        Aabb { min: -half, max: half }
    }

    /// Physical space of the scene, given what the grid is in.
    pub fn space(&self, physical: &PhysicalMetadata) -> PhysicalSpace {
        let (centre, unit) = (self.centre.to_array(), physical.length_unit.clone());
        PhysicalSpace { centre, scale: self.scale, unit, axes: physical.axes }
    }

    /// Where a ray enters and leaves the box, as multiples of `direction`; none if it misses. Never before the eye. Both
    /// vectors are along the axes of the box, see [`VoxelPlacement::to_box`].
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
    use crate::volume::directions::Directions;

    #[test]
    fn proportions_are_kept() {
        let grid = Grid::aligned([5, 3, 2], [1.0, 1.0, 8.0], [7.0, 0.0, 0.0]);
        let p = VoxelPlacement::new(&grid, 2.0);
        assert!((p.half - DVec3::new(0.5, 0.25, 1.0)).length() < 1e-12);
        assert!((p.to_voxel(p.half) - DVec3::new(4.0, 2.0, 1.0)).length() < 1e-12);
        assert!(p.to_voxel(-p.half).length() < 1e-12);
        assert!((published_side() - 1.0801).abs() < 1e-4);
    }

    #[test]
    fn rays_are_clipped() {
        let p = VoxelPlacement::new(&Grid::unit([3, 3, 3]), 2.0);
        assert_eq!(p.clip(DVec3::X * 3.0, -DVec3::X), Some((2.0, 4.0)));
        assert_eq!(p.clip(DVec3::ZERO, DVec3::Z), Some((0.0, 1.0)));
        assert_eq!(p.clip(DVec3::new(3.0, 1.5, 0.0), -DVec3::X), None);
        assert_eq!(p.clip(DVec3::X * 3.0, DVec3::X), None);
    }

    #[test]
    fn voxels_are_at_their_physical_places_whatever_the_directions() {
        let (s, c) = 0.4f64.sin_cos();
        for steps in [
            [[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
            [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            [[c, 0.0, s], [0.0, -1.0, 0.0], [-s, 0.0, c]],
        ] {
            let (directions, _) = Directions::of_steps(steps).unwrap();
            let grid = Grid { dims: [5, 9, 3], spacing: [2.0, 0.5, 4.0], origin: [1e3, -40.0, 7.0], directions };
            let p = VoxelPlacement::new(&grid, 1.5);
            let space = p.space(&PhysicalMetadata { length_unit: Some("mm".into()), ..PhysicalMetadata::default() });
            let bounds = p.bounds();
            let mut reached = DVec3::ZERO;
            for index in [[0, 0, 0], [4, 0, 0], [0, 8, 0], [4, 8, 2], [1, 5, 2], [4, 0, 2], [0, 8, 2], [0, 0, 2]] {
                let voxel = DVec3::from_array(index.map(f64::from));
                let scene = p.to_scene(voxel);
                assert!((p.to_voxel(scene) - voxel).length() < 1e-12);
                let physical = DVec3::from_array(space.position(scene.to_array()));
                assert!((physical - grid.position(voxel)).length() < 1e-9, "{physical}");
                assert!(bounds.grown(1e-12).contains(scene));
                reached = reached.max(scene.abs());
            }
            assert!((reached - bounds.max).length() < 1e-9, "the box is no larger than needed");
            assert_eq!((p.side(), space.unit_name()), (1.5, "mm"));
        }
    }
}
