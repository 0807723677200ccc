//! The voxels that labels are assigned to: where they lie in the scene, and how the file describes them. The labels
//! themselves are in `labels`.

use super::super::{OpenRun, RunError};
use crate::data::calibration::{AxisConvention, PhysicalSpace};
use crate::data::{Aabb, Normalisation};
use crate::memory::{MemoryBudget, product};
use crate::model::HostGaussians;
use crate::prepare::PrepareRecord;
use crate::volume::formats;
use crate::volume::grid::Grid;
use crate::volume::placement::{VoxelPlacement, published_side};
use crate::volume::source::{PhysicalMetadata, VOXELS, VolumeHeader};
use glam::{DMat3, DQuat, DVec3};
use std::path::Path;

/// Largest accepted relative difference between the proportions of a volume and of the one the dataset was prepared
/// from, where places are unknown.
const TOLERANCE: f64 = 1e-3;
/// Largest difference between two grids that are the same: components of directions, and places in voxels.
const SAME: f64 = 1e-3;

/// One set of voxels in two coordinate systems.
#[derive(Clone, Debug, PartialEq)]
pub struct LabelGrid {
    /// Along the axes of the voxels, scene units: [`LabelGrid::along`] brings Gaussians there.
    pub scene: Grid,
    /// In physical space if that is known, otherwise in scene units.
    pub file: Grid,
    /// What the axes of that space mean; `None` where the data do not say.
    pub axes: Option<AxisConvention>,
    /// Unit of length of that space; `None` where the data name none.
    pub unit: Option<String>,
    /// Whether these are the voxels that the dataset was prepared from.
    pub is_source: bool,
    /// The axes of the voxels in the scene as columns, if they are others.
    turn: Option<DMat3>,
}

impl LabelGrid {
    /// Voxels of unit spacing, in the scene as in files.
    #[cfg(test)]
    pub(super) fn unit(dims: [usize; 3]) -> Self {
        let file = Grid::unit(dims);
        Self { scene: file, file, axes: None, unit: None, is_source: true, turn: None }
    }

    /// Gaussians of the scene as they are along the axes of the voxels: where these are mirrored, so are the Gaussians.
    pub fn along(&self, mut gaussians: HostGaussians) -> HostGaussians {
        let Some(turn) = self.turn else { return gaussians };
        let to_grid = turn.transpose();
        for mean in gaussians.means.chunks_exact_mut(3) {
            let turned = to_grid * DVec3::new(mean[0].into(), mean[1].into(), mean[2].into());
            mean.copy_from_slice(&turned.as_vec3().to_array());
        }
        // a Gaussian is the same with all of its axes reversed, so that a reflection becomes a rotation
        let proper = if to_grid.determinant() < 0.0 { -to_grid } else { to_grid };
        let proper = DQuat::from_mat3(&proper);
        for q in gaussians.rotations.chunks_exact_mut(4) {
            let turned = proper * DQuat::from_xyzw(q[1].into(), q[2].into(), q[3].into(), q[0].into());
            let [x, y, z, w] = turned.to_array().map(|v| v as f32);
            q.copy_from_slice(&[w, x, y, z]);
        }
        gaussians
    }

    /// The place in the scene of a place along the axes of the voxels.
    pub fn in_scene(&self, place: DVec3) -> DVec3 {
        self.turn.map_or(place, |turn| turn * place)
    }

    /// The voxels and the meaning of the axes as a file states them: those of the data, or those asked for with
    /// coordinates to match. Axes whose meaning the data do not say are taken to be what is asked for.
    pub fn stated(&self, asked: Option<Option<AxisConvention>>) -> (Grid, Option<AxisConvention>) {
        match (asked, self.axes) {
            (None, axes) => (self.file, axes),
            (Some(Some(asked)), Some(axes)) => (self.file.converted(axes, asked), Some(asked)),
            (Some(asked), _) => (self.file, asked),
        }
    }

    /// The voxels of a placed grid.
    fn placed(placement: &VoxelPlacement, file: Grid, physical: PhysicalMetadata, is_source: bool) -> Self {
        let scene = over_box((-placement.half).to_array(), placement.half.to_array(), file.dims);
        let PhysicalMetadata { axes, length_unit: unit, .. } = physical;
        Self { scene, file, axes, unit, is_source, turn: placement.turn() }
    }

    /// The voxels `file`, which are `grid` in the space of the scene.
    fn within(space: &PhysicalSpace, file: Grid, grid: &Grid, physical: PhysicalMetadata) -> Self {
        let turn = grid.directions.turn();
        let origin = DVec3::from_array(space.to_scene(grid.origin));
        let origin = turn.map_or(origin, |turn| turn.transpose() * origin);
        let scene = Grid::aligned(grid.dims, grid.spacing.map(|s| s / space.scale), origin.to_array());
        let PhysicalMetadata { axes, length_unit: unit, .. } = physical;
        Self { scene, file, axes, unit, is_source: false, turn }
    }
}

/// Checks that voxels with `bytes` bytes each fit into memory; `like` is the file that they were taken from.
///
/// # Errors
/// If they do not; the error names the option that chooses them.
pub(in crate::run) fn check_memory(grid: &LabelGrid, like: Option<&Path>, bytes: usize) -> Result<(), RunError> {
    let [x, y, z] = grid.file.dims;
    let what = match like {
        Some(file) => format!("--like {} ({x} x {y} x {z} voxels)", file.display()),
        None => format!("--dims {x},{y},{z}"),
    };
    MemoryBudget::now().check(what, product(&[x, y, z, bytes])).map_err(RunError::input)
}

/// Chooses the voxels: those of the file `like`; else those that the dataset at `data` was prepared from (`record`), or
/// `dims` voxels over the same box; else `dims` voxels over the box of the scene. Also returns notes: what had to be
/// assumed, and what the reader of the file reports.
///
/// # Errors
/// If a file cannot be read, lies elsewhere or has other proportions than the prepared volume, or nothing gives the
/// number of voxels.
pub(in crate::run) fn choose(
    run: &OpenRun,
    data: &Path,
    record: Option<&PrepareRecord>,
    dims: Option<[usize; 3]>,
    like: Option<&Path>,
) -> Result<(LabelGrid, Vec<String>), RunError> {
    let missing = || format!("{} has no prepare.json", data.display());
    if let Some(path) = like {
        let header = formats::open(path).map_err(RunError::input)?.header().clone();
        let mut notes = header.notes.clone();
        let centred = || {
            format!("{}: the volume is assumed to be centred, its longest side half as wide as the frame", missing())
        };
        let grid = alike(header, record, &mut notes);
        let grid = grid.map_err(|e| RunError::input(format!("--like {}: {e}", path.display())))?;
        notes.extend(record.is_none().then(centred));
        return Ok((grid, notes));
    }
    if let Some(record) = record {
        return Ok((prepared(record, dims), Vec::new()));
    }
    let Some(dims) = dims else {
        return Err(RunError::input(format!(
            "{}, so its voxels are unknown; name a volume that has them with --like VOLUME, or give their number with \
             --dims X,Y,Z (over the box of the scene)",
            missing()
        )));
    };
    let assumed = format!("{}: labels cover the box of the scene; to cover a volume, name it with --like", missing());
    let (spec, normalisation) = (&run.scene.spec, &run.record.normalisation);
    Ok((around(spec.centre, spec.half_size, dims, normalisation), vec![assumed]))
}

/// What the grid of a dataset is in.
fn physical(record: &PrepareRecord) -> PhysicalMetadata {
    let space = record.calibration.space.as_ref();
    PhysicalMetadata {
        length_unit: space.and_then(|s| s.unit.clone()),
        axes: space.and_then(|s| s.axes),
        ..PhysicalMetadata::default()
    }
}

/// The voxels of a volume file: at their physical places if these are known of the file and of the dataset, otherwise
/// over the box of the dataset's volume.
fn alike(header: VolumeHeader, record: Option<&PrepareRecord>, notes: &mut Vec<String>) -> Result<LabelGrid, String> {
    let VolumeHeader { grid: file, physical: stated, .. } = header;
    if file.dims.iter().any(|n| *n < 2) {
        return Err(format!("{:?} voxels; at least 2 are needed along each axis", file.dims));
    }
    let Some(record) = record else {
        return Ok(LabelGrid::placed(&VoxelPlacement::new(&file, published_side()), file, stated, false));
    };
    let source = record.grid();
    if let Some(space) = &record.calibration.space
        && !file.is_unit()
        && !source.is_unit()
    {
        if let (Some(unit), Some(known)) = (&stated.length_unit, &space.unit)
            && unit != known
            && ![unit, known].contains(&&VOXELS.to_owned())
        {
            return Err(format!(
                "positions in {unit}, but the dataset was prepared from a volume in {known}; convert one"
            ));
        }
        let grid = match (stated.axes, space.axes) {
            (Some(own), Some(axes)) => file.converted(own, axes),
            _ => file,
        };
        let same = grid.dims == source.dims
            && grid.directions.agree(&source.directions, SAME)
            && [DVec3::ZERO, DVec3::from_array(grid.dims.map(|n| (n - 1) as f64))]
                .into_iter()
                .all(|end| (source.index(grid.position(end)) - end).abs().max_element() < SAME);
        if same {
            return Ok(LabelGrid::placed(&record.placement(), file, stated, true));
        }
        let covered = covered(&source, &grid);
        if covered == 0.0 {
            return Err(
                "lies outside of the volume that the dataset was prepared from; give one of the same space".into()
            );
        }
        if covered < 1.0 {
            let share = 100.0 * covered;
            notes.push(format!("--like covers {share:.0} % of the volume that the dataset was prepared from"));
        }
        return Ok(LabelGrid::within(space, file, &grid, stated));
    }
    let placement = VoxelPlacement::new(&file, record.side);
    let half = placement.bounds().max.to_array();
    if (0..3).any(|a| (half[a] - record.half_size[a]).abs() > TOLERANCE * record.side) {
        return Err(format!(
            "half sides of {half:.4?} in the scene, but the dataset was prepared from a volume with {:.4?}; give one \
             of the same proportions",
            record.half_size
        ));
    }
    let is_source = record.dims == file.dims && file.directions.agree(&source.directions, SAME);
    Ok(LabelGrid::placed(&placement, file, stated, is_source))
}

/// The share of a volume's box that another grid covers, of a sample of its places.
fn covered(source: &Grid, grid: &Grid) -> f64 {
    const N: usize = 12;
    let end = |grid: &Grid| DVec3::from_array(grid.dims.map(|n| (n - 1) as f64));
    let held = (0..N * N * N).filter(|i| {
        let at = [i % N, i / N % N, i / (N * N)].map(|k| k as f64 / (N - 1) as f64);
        let index = grid.index(source.position(end(source) * DVec3::from_array(at)));
        // half a voxel beyond the outermost centres, as far as a voxel reaches
        index.cmpge(DVec3::splat(-0.5)).all() && index.cmple(end(grid) + 0.5).all()
    });
    held.count() as f64 / (N * N * N) as f64
}

/// The voxels that a dataset was prepared from, or `dims` voxels along the axes of the scene over the box around them.
fn prepared(record: &PrepareRecord, dims: Option<[usize; 3]>) -> LabelGrid {
    let (source, placement) = (record.grid(), record.placement());
    let dims = match dims {
        Some(dims) if placement.turn().is_some() || dims != source.dims => dims,
        _ => return LabelGrid::placed(&placement, source, physical(record), true),
    };
    let Aabb { min, max } = placement.bounds();
    let scene = over_box(min.to_array(), max.to_array(), dims);
    let [low, high] = match placement.turn() {
        // exactly the outermost voxels
        None => [DVec3::ZERO, DVec3::from_array(source.dims.map(|n| (n - 1) as f64))].map(|end| source.position(end)),
        Some(_) => [min, max].map(|corner| placement.centre + placement.scale * corner),
    };
    let PhysicalMetadata { axes, length_unit: unit, .. } = physical(record);
    LabelGrid { scene, file: over_box(low.to_array(), high.to_array(), dims), axes, unit, is_source: false, turn: None }
}

fn around(centre: [f32; 3], half: [f32; 3], dims: [usize; 3], normalisation: &Normalisation) -> LabelGrid {
    let (centre, half) = (centre.map(f64::from), half.map(f64::from));
    let corner = |sign: f64| std::array::from_fn(|a| centre[a] + sign * half[a]);
    let scene = over_box(corner(-1.0), corner(1.0), dims);
    let [low, high] = [-1.0, 1.0].map(|sign| normalisation.to_dataset(corner(sign).into()).to_array());
    LabelGrid { scene, file: over_box(low, high, dims), axes: None, unit: None, is_source: false, turn: None }
}

/// Lays voxels over a box, with the outermost voxel centres on its faces.
fn over_box(low: [f64; 3], high: [f64; 3], dims: [usize; 3]) -> Grid {
    Grid::aligned(dims, std::array::from_fn(|a| (high[a] - low[a]) / (dims[a] - 1) as f64), low)
}

#[cfg(test)]
#[path = "grid_tests.rs"]
mod tests;
