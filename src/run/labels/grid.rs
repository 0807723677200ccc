//! The voxels that labels are assigned to: where they lie in the scene, and how the file describes them. The labels
//! themselves are in `labels`.

use super::super::{OpenRun, RunError};
use crate::prepare::PrepareRecord;
use crate::volume::formats::{self, Format};
use crate::volume::grid::Grid;
use crate::volume::placement::{Placement, published_side};
use crate::volume::source::Header;
use std::path::Path;

/// Largest accepted relative difference between the proportions of a volume and of the one the dataset was prepared
/// from.
const TOLERANCE: f64 = 1e-3;

/// One set of voxels in two coordinate systems.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LabelGrid {
    /// In scene units, like the Gaussians.
    pub scene: Grid,
    /// In the units of the volume file if these are known; otherwise as `scene`.
    pub file: Grid,
    /// Whether these are the voxels that the dataset was prepared from.
    pub is_source: bool,
}

/// Reads the record of the run's dataset, or of the one at `data` instead; `None` if it was not prepared by this
/// program.
///
/// # Errors
/// If the record cannot be read, or `data` is not a folder.
pub(super) fn record(run: &OpenRun, data: Option<&Path>) -> Result<Option<PrepareRecord>, RunError> {
    let folder = data.unwrap_or(&run.record.dataset);
    if data.is_some() && !folder.is_dir() {
        let problem = "there is no such folder; it should hold prepare.json";
        return Err(RunError::input(format!("--data {}: {problem}", folder.display())));
    }
    PrepareRecord::read(folder).map_err(RunError::input)
}

/// Chooses the voxels: those of the file `like`; else those that the dataset at `data` was prepared from (`record`), or
/// `dims` voxels over the same box; else `dims` voxels over the box of the scene. Also returns notes: what had to be
/// assumed, and what the reader of the file reports, such as an orientation that is ignored.
///
/// # Errors
/// If a file cannot be read or has other proportions than the prepared volume, or nothing gives the number of voxels.
pub(super) fn choose(
    run: &OpenRun,
    data: &Path,
    record: Option<&PrepareRecord>,
    dims: Option<[usize; 3]>,
    like: Option<&Path>,
) -> Result<(LabelGrid, Vec<String>), RunError> {
    let missing = || format!("{} has no prepare.json", data.display());
    if let Some(path) = like {
        let Header { grid: file, mut notes, .. } = formats::open(path).map_err(RunError::input)?.header().clone();
        let centred = || {
            format!("{}: the volume is assumed to be centred, its longest side half as wide as the frame", missing())
        };
        let grid = alike(file, record).map_err(|e| RunError::input(format!("--like {}: {e}", path.display())))?;
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
    Ok((around(run.scene.spec.centre, run.scene.spec.half_size, dims), vec![assumed]))
}

/// Whether the description of a series in a dataset's record, such as `ct.nii[0] .. ct.nii[9] (4x4x4, 10 steps)`, names
/// NIfTI files.
pub(super) fn is_nifti(source: &str) -> bool {
    let names = match source.rsplit_once(" (") {
        Some((names, shape)) if shape.ends_with(')') => names,
        _ => source,
    };
    let first = names.split(" .. ").next().unwrap_or(names);
    let name = match first.rsplit_once('[') {
        Some((name, step)) if step.strip_suffix(']').is_some_and(|n| n.parse::<usize>().is_ok()) => name,
        _ => first,
    };
    is_nifti_file(Path::new(name))
}

/// Whether a file is named as NIfTI files are.
pub(super) fn is_nifti_file(path: &Path) -> bool {
    formats::format_of(path).is_some_and(|(format, _)| format == Format::Nifti)
}

fn alike(file: Grid, record: Option<&PrepareRecord>) -> Result<LabelGrid, String> {
    if file.dims.iter().any(|n| *n < 2) {
        return Err(format!("{:?} voxels; at least 2 are needed along each axis", file.dims));
    }
    let side = record.map_or(published_side(), |r| 2.0 * r.half_size.into_iter().fold(0.0, f64::max));
    let placement = Placement::new(&file, side);
    let half = placement.half.to_array();
    if let Some(record) = record
        && (0..3).any(|a| (half[a] - record.half_size[a]).abs() > TOLERANCE * side)
    {
        return Err(format!(
            "half sides of {half:.4?} in the scene, but the dataset was prepared from a volume with {:.4?}; give one \
             of the same proportions",
            record.half_size
        ));
    }
    let origin = half.map(|h| -h);
    let scene = Grid { dims: file.dims, spacing: placement.spacing().to_array(), origin };
    let is_source = record.is_some_and(|r| r.dims == file.dims);
    Ok(LabelGrid { scene, file, is_source })
}

fn prepared(record: &PrepareRecord, dims: Option<[usize; 3]>) -> LabelGrid {
    let dims = dims.unwrap_or(record.dims);
    let scene = over_box(record.half_size.map(|h| -h), record.half_size, dims);
    let file = match (record.spacing, record.origin) {
        (Some(spacing), Some(origin)) => {
            let source = Grid { dims: record.dims, spacing, origin };
            let (size, same) = (source.size(), dims == record.dims);
            let spacing = if same { spacing } else { std::array::from_fn(|a| size[a] / (dims[a] - 1) as f64) };
            Grid { dims, spacing, origin }
        }
        _ => scene,
    };
    LabelGrid { scene, file, is_source: dims == record.dims }
}

fn around(centre: [f32; 3], half: [f32; 3], dims: [usize; 3]) -> LabelGrid {
    let (centre, half) = (centre.map(f64::from), half.map(f64::from));
    let corner = |sign: f64| std::array::from_fn(|a| centre[a] + sign * half[a]);
    let scene = over_box(corner(-1.0), corner(1.0), dims);
    LabelGrid { scene, file: scene, is_source: false }
}

/// Lays voxels over a box, with the outermost voxel centres on its faces.
fn over_box(low: [f64; 3], high: [f64; 3], dims: [usize; 3]) -> Grid {
    Grid { dims, spacing: std::array::from_fn(|a| (high[a] - low[a]) / (dims[a] - 1) as f64), origin: low }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// What `prepare` records of a grid.
    fn recorded(grid: Grid, known: bool) -> PrepareRecord {
        let half = Placement::new(&grid, 1.5).half.to_array();
        let json = serde_json::json!({
            "version": "", "source": "", "transfer_function": "", "span": [0, 1], "dims": grid.dims, "half_size": half,
            "steps": 1, "step": 1, "train_views": 1, "test_views": 1, "size": [8, 8], "segments": [],
            "seconds": 1, "load_seconds": 0, "peak_memory_bytes": 0,
        });
        let mut record: PrepareRecord = serde_json::from_value(json).unwrap();
        if known {
            (record.spacing, record.origin) = (Some(grid.spacing), Some(grid.origin));
        }
        record
    }

    #[test]
    fn nifti_files_are_recognised_in_records() {
        for nifti in ["ct.nii.gz", "a/ct.NII (4x4x4)", "ct.nii.gz[0] .. ct.nii.gz[9] (4x4x4, 10 steps)"] {
            assert!(is_nifti(nifti), "{nifti}");
        }
        for nifti in
            ["scan (1).nii.gz (4x4x4)", "old[a] (2)/scan[1].nii", "a [b].nii[0] .. a [b].nii[3] (4x4x4, 4 steps)"]
        {
            assert!(is_nifti(nifti), "{nifti}");
        }
        assert!(is_nifti_file(Path::new("/data (old)/brain.nii.gz")) && !is_nifti_file(Path::new("/x.nii/a.nrrd")));
        for other in ["", "v.nrrd (4x4x4)", "synthetic jets (4x4x4, 10 steps)", "nii.raw .. x.nii.raw (4x4x4, 2 steps)"]
        {
            assert!(!is_nifti(other), "{other}");
        }
    }

    #[test]
    fn voxels_lie_where_the_ray_caster_puts_them() {
        let grid = Grid { dims: [5, 9, 3], spacing: [1.0, 0.25, 4.0], origin: [10.0, -3.0, 0.5] };
        let placement = Placement::new(&grid, 1.5);
        let source = prepared(&recorded(grid, true), None);
        assert_eq!((source.file, source.is_source), (grid, true));
        let same = alike(grid, Some(&recorded(grid, false))).unwrap();
        for labels in [source, same] {
            for voxel in [[0usize, 0, 0], [4, 8, 2], [1, 5, 2]] {
                let at = |a: usize| labels.scene.origin[a] + labels.scene.spacing[a] * voxel[a] as f64;
                let back = placement.to_voxel(DVec3::new(at(0), at(1), at(2)));
                assert!((back - DVec3::from_array(voxel.map(|v| v as f64))).length() < 1e-9, "{back}");
            }
        }
        assert_eq!(prepared(&recorded(grid, false), None).file, source.scene, "an old record: scene units");
    }

    #[test]
    fn other_dims_cover_the_same_box_and_other_proportions_are_refused() {
        let grid = Grid { dims: [5, 9, 3], spacing: [1.0, 0.25, 4.0], origin: [10.0, -3.0, 0.5] };
        let fine = prepared(&recorded(grid, true), Some([9, 9, 5]));
        assert_eq!((fine.file.spacing, fine.file.origin, fine.is_source), ([0.5, 0.25, 2.0], grid.origin, false));
        assert_eq!(fine.file.size(), grid.size());
        let other = Grid { spacing: [1.0, 0.5, 4.0], ..grid };
        assert!(alike(other, Some(&recorded(grid, true))).unwrap_err().contains("proportions"));
        assert!(alike(Grid { dims: [5, 9, 1], ..grid }, None).unwrap_err().contains("at least 2"));
        let scene = around([1.0, 0.0, 0.0], [2.0, 1.0, 0.5], [5, 3, 2]);
        assert_eq!((scene.scene.spacing, scene.scene.origin), ([1.0; 3], [-1.0, -1.0, -0.5]));
    }
}
