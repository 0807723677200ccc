//! The volume of a ray caster on a coarser grid: the segment and the opacity of every cell of its box.

use super::RayCaster;
use crate::volume::placement::VoxelPlacement;
use glam::DVec3;
use rayon::prelude::*;

/// Minimum and maximum number of parts of a cell along an axis, over each of which the opacity is integrated.
const PARTS: [usize; 2] = [2, 4];
/// Voxels beyond the box that count as its faces: rounding.
const ROUNDING: f64 = 1e-6;

/// The box of the scene that encloses a volume, cut into cells of (nearly) equal sides along the axes of the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneCells {
    /// Number of cells along x, y, z.
    pub dims: [usize; 3],
    /// Size of a cell along x, y, z, scene units.
    pub spacing: [f64; 3],
    /// Centre of the first cell, scene units.
    pub origin: [f64; 3],
    /// `[z, y, x]`: the segment of the voxel nearest to the cell's centre, 0 for none and outside of the volume.
    pub ids: Vec<u16>,
    /// `[z, y, x]`: the fraction of light, in [0, 1], that the mean content of the cell absorbs over the length of a
    /// cell (the cube root of its volume).
    pub opacity: Vec<f32>,
}

/// Voxels along the axes of the scene per scene unit.
fn voxels_per_unit(placement: &VoxelPlacement) -> DVec3 {
    placement.turn().map_or(placement.voxels_per_unit, |turn| {
        let along = |row: DVec3| (row * placement.voxels_per_unit).length();
        DVec3::new(along(turn.row(0)), along(turn.row(1)), along(turn.row(2)))
    })
}

/// The cells of a box: number, size and centre of the first along each axis. Together they fill the box exactly; the
/// longest side has as many as there would be voxels of the finest spacing along it, at most `longest`.
fn layout(placement: &VoxelPlacement, longest: usize) -> ([usize; 3], [f64; 3], [f64; 3]) {
    let size = placement.bounds().size().to_array();
    let longest_side = size.into_iter().fold(0.0, f64::max);
    // not the voxels along that side: few thick slices would make cells that hide what the slices show
    let finest = (longest_side * placement.voxels_per_unit.max_element()).round() + 1.0;
    let side = longest_side / (finest as usize).min(longest).max(1) as f64;
    let counts = size.map(|s| ((s / side).round() as usize).max(1));
    let spacing: [f64; 3] = std::array::from_fn(|a| size[a] / counts[a] as f64);
    (counts, spacing, std::array::from_fn(|a| 0.5 * (spacing[a] - size[a])))
}

impl RayCaster {
    /// The segments and opacities of the cells of the box that encloses the volume, at most `longest` of them along its
    /// longest side.
    ///
    /// Each cell is divided into 2 to 4 parts per axis, no longer than a voxel unless the cell is longer than 4; in
    /// each part the values run from one corner to the opposite one, as along a ray, and the extinction is their mean
    /// under the transfer function. Parts outside of the volume are empty. Bit-identical for any number of threads.
    pub fn cells(&self, longest: usize) -> SceneCells {
        let (dims, spacing, origin) = layout(&self.placement, longest);
        let per_unit = voxels_per_unit(&self.placement);
        let voxels: [f64; 3] = std::array::from_fn(|a| spacing[a] * per_unit[a]);
        let parts = voxels.map(|v| (v.ceil() as usize).clamp(PARTS[0], PARTS[1]));
        // the voxel coordinates of a point in cells from the corner of the first
        let low = DVec3::from_array(std::array::from_fn(|a| origin[a] - 0.5 * spacing[a]));
        let place = |p: [f64; 3]| match self.placement.turn() {
            None => DVec3::from_array(std::array::from_fn(|a| p[a] * voxels[a])),
            Some(_) => self.placement.to_voxel(low + DVec3::from_array(p) * DVec3::from_array(spacing)),
        };
        // in steps, as the extinction is that of a step
        let length = (spacing[0] * spacing[1] * spacing[2]).cbrt() / self.step;
        let count = dims.iter().product();
        let (mut ids, mut opacity) = (vec![0; count], vec![0.0; count]);
        let slice = dims[0] * dims[1];
        ids.par_chunks_mut(slice).zip(opacity.par_chunks_mut(slice)).enumerate().for_each(|(k, (ids, opacity))| {
            for (at, (id, opacity)) in ids.iter_mut().zip(opacity).enumerate() {
                let cell = [at % dims[0], at / dims[0], k];
                *id = self.nearest_segment(place(cell.map(|c| c as f64 + 0.5)));
                let extinction = self.extinction(cell, &place, parts);
                *opacity = -(-extinction * length).exp_m1() as f32;
            }
        });
        SceneCells { dims, spacing, origin, ids, opacity }
    }

    /// Whether voxel coordinates are in the volume's box, but for rounding.
    fn holds(&self, p: DVec3) -> bool {
        let end = DVec3::from_array(self.field.dims.map(|n| (n - 1) as f64));
        p.cmpge(DVec3::splat(-ROUNDING)).all() && p.cmple(end + ROUNDING).all()
    }

    /// The segment of the voxel nearest to voxel coordinates `p`; 0 outside of the volume.
    fn nearest_segment(&self, p: DVec3) -> u16 {
        if !self.holds(p) {
            return 0;
        }
        let voxel: [f32; 3] = std::array::from_fn(|a| (p[a].round() as usize).min(self.field.dims[a] - 1) as f32);
        let value = self.field.sample(voxel);
        self.segment(voxel, value, value)
    }

    /// Mean extinction of a step in a cell, over its parts; `place` gives voxel coordinates.
    fn extinction(&self, cell: [usize; 3], place: &impl Fn([f64; 3]) -> DVec3, parts: [usize; 3]) -> f64 {
        let end = self.field.dims.map(|n| (n - 1) as f64);
        let corner = |part: [usize; 3], side: [bool; 3]| -> Option<[f32; 3]> {
            let p = place(std::array::from_fn(|a| {
                let along = (part[a] + usize::from(side[a])) as f64 / parts[a] as f64;
                cell[a] as f64 + along
            }));
            self.holds(p).then(|| std::array::from_fn(|a| p[a].clamp(0.0, end[a]) as f32))
        };
        let mut sum = 0.0;
        for z in 0..parts[2] {
            for y in 0..parts[1] {
                for x in 0..parts[0] {
                    // the four diagonals in turn, so that no direction of the gradient is missed
                    let from = [false, (x + z) % 2 == 1, (x + y) % 2 == 1];
                    let [Some(a), Some(b)] = [from, from.map(|side| !side)].map(|side| corner([x, y, z], side)) else {
                        continue;
                    };
                    let [a, b] = [a, b].map(|p| self.field.sample(p));
                    sum += f64::from(self.table.mean(self.table.between(a, b), 0)[3]);
                }
            }
        }
        sum / parts.iter().product::<usize>() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::grid::{Grid, Volume, VolumeLabels};
    use crate::volume::transfer::TransferFunction;
    use proptest::prelude::*;

    /// A volume of `dims` voxels with values and labels by position in [0, 1]^3 between the outermost centres.
    fn caster(dims: [usize; 3], opacity: &[(f64, f32)], at: impl Fn([f64; 3]) -> (f32, u16)) -> RayCaster {
        let grid = Grid::unit(dims);
        let place = |i: usize| {
            let index = [i % dims[0], i / dims[0] % dims[1], i / (dims[0] * dims[1])];
            at(std::array::from_fn(|a| index[a] as f64 / (dims[a] - 1) as f64))
        };
        let (values, ids) = (0..grid.len()).map(place).unzip();
        let mut transfer = TransferFunction::load("ramp").unwrap();
        transfer.opacity = opacity.to_vec();
        transfer.unit_length = 0.01;
        let placement = VoxelPlacement::new(&grid, 2.0);
        RayCaster::new(
            &Volume { grid, values },
            Some(VolumeLabels { grid, ids }),
            &transfer,
            [0.0, 1.0],
            placement,
            0.5,
        )
    }

    #[test]
    fn an_even_fog_has_the_opacity_of_its_length() {
        let cells = caster([33, 17, 9], &[(0.0, 0.2)], |_| (0.5, 7)).cells(16);
        assert_eq!((cells.dims, cells.ids[0]), ([16, 8, 4], 7));
        assert_eq!(cells.spacing, [0.125; 3]);
        assert_eq!(cells.origin, [-0.9375, -0.4375, -0.1875]);
        // a cell is 6.25 hundredths of the longest side long
        let expected = 1.0 - 0.8_f64.powf(6.25);
        assert!(
            cells.opacity.iter().all(|o| (f64::from(*o) - expected).abs() < 1e-5),
            "{expected} {}",
            cells.opacity[0]
        );
    }

    #[test]
    fn thick_slices_have_cells_of_the_finest_spacing() {
        let counts = |dims: [usize; 3], spacing: [f64; 3]| {
            let grid = Grid::aligned(dims, spacing, [0.0; 3]);
            layout(&VoxelPlacement::new(&grid, 2.0), 96).0
        };
        assert_eq!(counts([64, 64, 8], [1.0, 1.0, 12.0]), [64, 64, 85]);
        assert_eq!(counts([8, 64, 64], [12.0, 1.0, 1.0]), [85, 64, 64]);
        // no more than the limit, however thin the voxels are
        assert_eq!(counts([256, 256, 8], [1.0, 1.0, 40.0]), [87, 87, 96]);
        assert_eq!(counts([2, 2, 2], [1e-30, 1.0, 1.0]), [1, 96, 96]);
        // cubic voxels: one cell each, up to the limit
        for spacing in [0.1, 0.3, 1.0, 7.7] {
            for n in [2, 3, 9, 40, 64, 95, 96, 97, 1000] {
                assert_eq!(counts([n; 3], [spacing; 3]), [n.min(96); 3], "{spacing}");
                assert_eq!(counts([n, n, 2], [spacing; 3])[0], n.min(96), "{spacing}");
            }
        }
    }

    #[test]
    fn a_band_between_voxels_is_not_missed() {
        // values rise along x; the band lies between two voxels, whose own values show nothing
        let band = [(0.0, 0.0), (0.52, 0.0), (0.52, 0.4), (0.54, 0.4), (0.54, 0.0), (1.0, 0.0)];
        for turn in 0..3 {
            let mut dims = [9; 3];
            dims[turn] = 12;
            let cells = caster(dims, &band, |p| (p[turn] as f32, 0)).cells(6);
            let along = |i: usize| {
                [i % cells.dims[0], i / cells.dims[0] % cells.dims[1], i / (cells.dims[0] * cells.dims[1])][turn]
            };
            let shown: Vec<usize> = (0..cells.ids.len()).filter(|i| cells.opacity[*i] > 0.0).map(along).collect();
            assert!(!shown.is_empty() && shown.iter().all(|x| *x == 3), "{turn}: {shown:?}");
            // through 2 % of the side at 0.4 a hundredth; the cells are sixths of the side
            let through = f64::from(cells.opacity.iter().copied().fold(0.0, f32::max));
            assert!((through - (1.0 - 0.6_f64.powi(2))).abs() < 0.05, "{turn}: {through}");
        }
    }

    proptest! {
        #[test]
        fn cells_fill_the_box_and_take_the_nearest_voxels_id(dims in prop::array::uniform3(2..40_usize), longest in 1..50_usize) {
            let caster = caster(dims, &[(0.0, 0.1)], |p| (p[0] as f32, (p[0] * 60.0) as u16 + 1));
            let cells = caster.cells(longest);
            prop_assert!(cells.dims.iter().all(|n| *n <= longest.max(1) && *n > 0));
            let half = caster.placement.half.to_array();
            for a in 0..3 {
                let last = cells.origin[a] + cells.spacing[a] * (cells.dims[a] - 1) as f64;
                prop_assert!((cells.origin[a] - 0.5 * cells.spacing[a] + half[a]).abs() < 1e-9);
                prop_assert!((last + 0.5 * cells.spacing[a] - half[a]).abs() < 1e-9);
            }
            for (i, id) in cells.ids.iter().enumerate() {
                let x = cells.origin[0] + cells.spacing[0] * (i % cells.dims[0]) as f64;
                let voxel = (x + half[0]) / (2.0 * half[0]) * (dims[0] - 1) as f64;
                let of = |v: f64| (v / (dims[0] - 1) as f64 * 60.0) as u16 + 1;
                // between two voxels either is the nearest
                prop_assert!(*id == of((voxel + 1e-6).round()) || *id == of((voxel - 1e-6).round()));
            }
            prop_assert!(cells.opacity.iter().all(|o| (0.0..=1.0).contains(o)));
        }
    }

    #[test]
    fn threads_do_not_matter() {
        let caster = caster([20, 31, 12], &[(0.0, 0.0), (1.0, 1.0)], |p| ((p[0] * p[1] + 0.3 * p[2]) as f32, 1));
        let with = |n: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
            pool.install(|| caster.cells(11))
        };
        assert!(with(1) == with(3));
    }
}
