//! Where the voxels of labels lie in the scene and in files, whatever the directions of their axes.

use super::*;
use crate::segment::place::{Cloud, SHARE, SegmentPlaces, scene_grid};
use crate::volume::directions::Directions;
use crate::volume::grid::ScalarType;
use AxisConvention::{LeftPosteriorSuperior as Lps, RightAnteriorSuperior as Ras};

/// What `prepare` records of a grid.
fn recorded(grid: Grid, axes: Option<AxisConvention>) -> PrepareRecord {
    let placement = VoxelPlacement::new(&grid, 1.5);
    let stated = PhysicalMetadata { length_unit: Some("mm".into()), axes, time: None };
    let json = serde_json::json!({
        "version": "", "source": "", "transfer_function": "", "span": [0, 1], "dims": grid.dims,
        "spacing": grid.spacing, "origin": grid.origin, "directions": grid.directions, "side": 1.5,
        "half_size": placement.bounds().max.to_array(), "steps": 1, "step": 1, "train_views": 1, "test_views": 1,
        "size": [8, 8], "segments": [], "seconds": 1, "load_seconds": 0, "peak_memory_bytes": 0,
        "empty_times": [], "calibration": { "space": placement.space(&stated) },
    });
    serde_json::from_value(json).unwrap()
}

fn header(grid: Grid, axes: Option<AxisConvention>) -> VolumeHeader {
    let physical = PhysicalMetadata { axes, ..PhysicalMetadata::default() };
    VolumeHeader { grid, scalar: ScalarType::U8, steps: 1, physical, notes: Vec::new() }
}

const GRID: Grid = Grid::aligned([5, 9, 3], [1.0, 0.25, 4.0], [10.0, -3.0, 0.5]);

/// The grid with its axes turned: permuted and mirrored, or oblique.
fn turned() -> Vec<Grid> {
    let (s, c) = 0.35f64.sin_cos();
    let steps = [
        [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        [[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]],
        [[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, 1.0]],
    ];
    steps.into_iter().map(|steps| Grid { directions: Directions::of_steps(steps).unwrap().0, ..GRID }).collect()
}

/// The point of the scene at a voxel.
fn scene_point(labels: &LabelGrid, voxel: DVec3) -> DVec3 {
    let along = labels.scene.position(voxel);
    labels.turn.map_or(along, |turn| turn * along)
}

#[test]
fn voxels_lie_where_the_ray_caster_puts_them() {
    for grid in [vec![GRID], turned()].concat() {
        let placement = VoxelPlacement::new(&grid, 1.5);
        let record = recorded(grid, Some(Ras));
        let source = prepared(&record, None);
        assert_eq!(
            (source.file, source.is_source, source.axes, source.unit.as_deref()),
            (grid, true, Some(Ras), Some("mm"))
        );
        let same = alike(header(grid, Some(Ras)), Some(&record), &mut Vec::new()).unwrap();
        assert!(same.is_source);
        // the same voxels in a file of the other convention
        let mut notes = Vec::new();
        let other = alike(header(grid.converted(Ras, Lps), Some(Lps)), Some(&record), &mut notes).unwrap();
        assert_eq!((other.file, other.axes, notes.len()), (grid.converted(Ras, Lps), Some(Lps), 0));
        for labels in [source, same, other] {
            for voxel in [[0, 0, 0], [4, 8, 2], [1, 5, 2]] {
                let voxel = DVec3::from_array(voxel.map(f64::from));
                let back = placement.to_voxel(scene_point(&labels, voxel));
                assert!((back - voxel).length() < 1e-9, "{back}");
            }
        }
    }
}

#[test]
fn other_dims_cover_the_box_along_the_axes_of_space() {
    let fine = prepared(&recorded(GRID, None), Some([9, 9, 5]));
    assert!(fine.file.spacing.iter().zip([0.5, 0.25, 2.0]).all(|(a, b)| (a - b).abs() < 1e-12), "{:?}", fine.file);
    assert!((0..3).all(|a| (fine.file.origin[a] - GRID.origin[a]).abs() < 1e-12) && !fine.is_source);
    assert!(prepared(&recorded(GRID, None), Some(GRID.dims)).is_source);
    for grid in turned() {
        let record = recorded(grid, Some(Lps));
        let labels = prepared(&record, Some([7, 8, 9]));
        assert!(labels.file.directions.is_aligned() && labels.turn.is_none() && !labels.is_source);
        let space = record.calibration.space.as_ref().unwrap();
        for voxel in [[0, 0, 0], [6, 7, 8]].map(|v| DVec3::from_array(v.map(f64::from))) {
            let there = DVec3::from_array(space.position(scene_point(&labels, voxel).to_array()));
            assert!((there - labels.file.position(voxel)).length() < 1e-9);
        }
        // and the corners of the volume are in it
        for corner in 0..8u32 {
            let end =
                DVec3::new(4.0 * f64::from(corner & 1), 8.0 * f64::from(corner >> 1 & 1), 2.0 * f64::from(corner >> 2));
            let index = labels.file.index(grid.position(end));
            assert!(
                index.cmpge(DVec3::splat(-1e-9)).all() && index.cmple(DVec3::new(6.0, 7.0, 8.0) + 1e-9).all(),
                "{index}"
            );
        }
    }
    let scene = around([1.0, 0.0, 0.0], [2.0, 1.0, 0.5], [5, 3, 2], &Normalisation::NONE);
    assert_eq!((scene.scene.spacing, scene.scene.origin), ([1.0; 3], [-1.0, -1.0, -0.5]));
}

#[test]
fn a_volume_of_the_same_space_gives_its_voxels_and_one_from_elsewhere_is_refused() {
    let record = recorded(GRID, Some(Ras));
    let like = |grid, axes| {
        let mut notes = Vec::new();
        alike(header(grid, axes), Some(&record), &mut notes).map(|labels| (labels, notes))
    };
    // finer, and a part of the box
    let part = Grid::aligned([9, 9, 3], [0.25, 0.125, 2.0], [11.0, -3.0, 0.5]);
    let (labels, notes) = like(part, Some(Ras)).unwrap();
    assert!(labels.file == part && !labels.is_source && notes[0].contains("% of the volume"), "{notes:?}");
    let placement = VoxelPlacement::new(&GRID, 1.5);
    let place = placement.to_voxel(scene_point(&labels, DVec3::new(8.0, 4.0, 1.0)));
    assert!((place - GRID.index(part.position(DVec3::new(8.0, 4.0, 1.0)))).length() < 1e-9);
    let far = Grid { origin: [1e3, 0.0, 0.0], ..GRID };
    assert!(like(far, None).unwrap_err().contains("outside"));
    // the other convention puts the same numbers elsewhere
    assert!(like(GRID, Some(Lps)).unwrap_err().contains("outside"));
    let metres = VolumeHeader {
        physical: PhysicalMetadata { length_unit: Some("m".into()), ..PhysicalMetadata::default() },
        ..header(GRID, None)
    };
    assert!(alike(metres, Some(&record), &mut Vec::new()).unwrap_err().contains("mm"));
    // files that say nothing of their place have the same box if they have the same proportions
    let plain =
        |dims| alike(header(Grid::unit(dims), None), Some(&recorded(Grid::unit([5, 9, 3]), None)), &mut Vec::new());
    assert!(plain([9, 17, 5]).is_ok() && plain([5, 9, 3]).is_ok_and(|labels| labels.is_source));
    assert!(plain([9, 9, 9]).unwrap_err().contains("proportions"));
    assert!(alike(header(Grid::unit([5, 9, 1]), None), None, &mut Vec::new()).unwrap_err().contains("at least 2"));
}

#[test]
fn spaces_are_converted_where_they_are_known_and_named_where_not() {
    let labels = prepared(&recorded(GRID, Some(Ras)), None);
    assert_eq!(labels.stated(None), (GRID, Some(Ras)));
    assert_eq!(labels.stated(Some(Some(Lps))), (GRID.converted(Ras, Lps), Some(Lps)));
    assert_eq!(labels.stated(Some(None)), (GRID, None));
    let unknown = prepared(&recorded(GRID, None), None);
    assert_eq!(unknown.stated(None), (GRID, None));
    assert_eq!(unknown.stated(Some(Some(Lps))), (GRID, Some(Lps)));
}

/// A long Gaussian off the centre, turned: its labels on the voxels of a turned grid are those on the voxels of the
/// plain grid at the same places.
#[test]
fn gaussians_turn_with_the_voxels() {
    let cube = Grid::aligned([24; 3], [1.0; 3], [-11.5; 3]);
    let one = HostGaussians {
        means: vec![0.2, -0.1, 0.15],
        rotations: vec![0.8, 0.3, -0.4, 0.2],
        log_scales: [0.3f32, 0.1, 0.06].map(f32::ln).to_vec(),
        opacity_logits: vec![3.0],
        ..HostGaussians::zeros(1, 1)
    };
    let vote = |labels: &LabelGrid| {
        let (turned, opacity) = (labels.along(one.clone()), one.opacity());
        let places =
            SegmentPlaces::new(Cloud::new(&one, &opacity, &[1]), &scene_grid([0.0; 3], [0.75; 3]), SHARE).unwrap();
        let turned = Cloud::new(&turned, &opacity, &[1]);
        places.labels_on(turned, &labels.scene, |place| labels.in_scene(place)).unwrap()
    };
    let plain = vote(&prepared(&recorded(cube, None), None));
    assert!(plain.iter().filter(|id| **id == 1).count() > 100);
    for steps in [
        [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]],
        [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]],
    ] {
        let directions = Directions::of_steps(steps).unwrap().0;
        let first = directions.matrix() * DVec3::splat(-11.5);
        let grid = Grid { directions, origin: first.to_array(), ..cube };
        let found = vote(&prepared(&recorded(grid, None), None));
        let mut differ = 0;
        for (i, id) in found.iter().enumerate() {
            let voxel = DVec3::from_array([i % 24, i / 24 % 24, i / 576].map(|v| v as f64));
            let [x, y, z] = cube.index(grid.position(voxel)).to_array().map(|v| v.round() as usize);
            differ += usize::from(plain[(z * 24 + y) * 24 + x] != *id);
        }
        assert!(differ <= 2, "{differ} voxels differ: {steps:?}");
    }
}
