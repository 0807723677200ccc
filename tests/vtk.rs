//! Compares the ray caster with VTK's, on the same volume, camera and transfer function; and opens datasets that VTK
//! draws (`scripts/vtk_scenes.py`).
//!
//! Needs Python with the package `vtk` (`PYTHON` names the interpreter), and OpenGL without a display. The remaining
//! difference is explained at each comparison.
#![allow(clippy::unwrap_used)]

use glam::DVec3;
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;
use volseggs::data::{Camera, Dataset, OpenOptions, SplitName, Truth};
use volseggs::volume::grid::{Grid, Volume};
use volseggs::volume::placement::{VoxelPlacement, published_side};
use volseggs::volume::raycast::RayCaster;
use volseggs::volume::transfer::{Shading, TransferFunction};
use volseggs_testing::{Need, python_with, skip};

const SIZE: u32 = 200;

/// A sum of Gaussians on a grid of unequal spacing.
fn volume() -> Volume {
    let grid = Grid::aligned([64, 56, 40], [1.0, 1.0, 1.5], [0.0; 3]);
    let blobs: [([f64; 3], f64, f64); 5] = [
        ([-0.3, -0.2, 0.1], 0.28, 1.0),
        ([0.35, 0.1, -0.2], 0.22, 0.9),
        ([0.0, 0.4, 0.3], 0.18, 0.7),
        ([0.1, -0.45, -0.3], 0.2, 0.8),
        ([-0.1, 0.1, -0.1], 0.5, 0.35),
    ];
    let at = |i: usize, a: usize| 2.0 * i as f64 / (grid.dims[a] - 1) as f64 - 1.0;
    let mut values = Vec::with_capacity(grid.len());
    for z in 0..grid.dims[2] {
        for y in 0..grid.dims[1] {
            for x in 0..grid.dims[0] {
                let p = [at(x, 0), at(y, 1), at(z, 2)];
                let value: f64 = blobs
                    .iter()
                    .map(|(c, s, w)| w * (-(0..3).map(|a| (p[a] - c[a]).powi(2)).sum::<f64>() / (2.0 * s * s)).exp())
                    .sum();
                values.push(value as f32);
            }
        }
    }
    Volume { grid, values }
}

fn transfer(shading: Shading) -> TransferFunction {
    TransferFunction {
        name: "compare".into(),
        range: Some([0.0, 1.2]),
        colors: vec![(0.0, [0.1, 0.2, 0.8]), (0.4, [0.1, 0.7, 0.5]), (0.6, [0.9, 0.6, 0.1]), (1.0, [0.8, 0.1, 0.1])],
        opacity: vec![(0.15, 0.0), (0.25, 0.04), (0.35, 0.0), (0.5, 0.0), (0.65, 0.6), (1.0, 0.9)],
        unit_length: 0.02,
        shading,
        segments: Vec::new(),
    }
}

/// Renders VTK's image over white, `[H, W, 3]`; `None` if VTK is not available.
fn vtk(
    folder: &Path,
    volume: &Volume,
    tf: &TransferFunction,
    camera: &Camera,
    mapper: &str,
    step: f64,
) -> Option<Vec<f32>> {
    let placement = VoxelPlacement::new(&volume.grid, published_side());
    let raw: Vec<u8> = volume.values.iter().flat_map(|v| v.to_le_bytes()).collect();
    std::fs::write(folder.join("v.raw"), raw).unwrap();
    let smallest = placement.spacing().min_element();
    let job = serde_json::json!({
        "raw": folder.join("v.raw"),
        "dims": volume.grid.dims,
        "spacing": placement.spacing().to_array(),
        "origin": (-placement.half).to_array(),
        "eye": camera.position().to_array(), "target": [0, 0, 0], "up": [0, 0, 1],
        "fov_y_degrees": camera.fov_y().to_degrees(),
        "width": camera.width, "height": camera.height,
        "span": tf.range.unwrap(),
        "colors": tf.colors.iter().map(|(p, c)| [*p, f64::from(c[0]), f64::from(c[1]), f64::from(c[2])]).collect::<Vec<_>>(),
        "opacity": tf.opacity.iter().map(|(p, a)| [*p, f64::from(*a)]).collect::<Vec<_>>(),
        "unit_distance": tf.unit_length * placement.side(),
        "step": step * smallest,
        "shade": tf.shading.enabled,
        "ambient": tf.shading.ambient, "diffuse": tf.shading.diffuse,
        "specular": tf.shading.specular, "power": tf.shading.power,
        "mapper": mapper, "repeats": 1, "threads": 0,
        "out": folder.join("v.rgba"),
    });
    std::fs::write(folder.join("job.json"), job.to_string()).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support/vtk_reference.py");
    let python = python_with("vtk", Need::VtkRendering)?;
    let output = Command::new(&python).arg(script).arg(folder.join("job.json")).output().unwrap();
    if !output.status.success() {
        // on a machine without any OpenGL library, VTK is there but cannot make a window
        let said = String::from_utf8_lossy(&output.stderr);
        skip(
            Need::VtkRendering,
            &format!("VTK cannot draw: {}", said.trim().lines().last().unwrap_or("no reason given")),
        );
        return None;
    }
    let bytes = std::fs::read(folder.join("v.rgba")).unwrap();
    let rgba: Vec<f32> = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    Some(rgba.chunks_exact(4).flat_map(|p| [0, 1, 2].map(|c| p[c] + 1.0 - p[3])).collect())
}

fn psnr(a: &[f32], b: &[f32]) -> f64 {
    assert_eq!(a.len(), b.len());
    let mean = a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / a.len() as f64;
    -10.0 * mean.log10()
}

#[test]
fn pictures_agree_with_vtk() {
    let folder = tempfile::tempdir().unwrap();
    let volume = volume();
    let placement = VoxelPlacement::new(&volume.grid, published_side());
    let lit = |specular| Shading { enabled: true, ambient: 0.3, diffuse: 0.7, specular, power: 20.0 };
    let cases = [
        // emission, opacity and positions alone: samples lie half a step apart
        ("gpu", Shading { enabled: false, ..Shading::default() }, 55.0),
        // the same headlight: from the eye along each ray
        ("gpu", lit(0.0), 55.0),
        // VTK's CPU ray caster: one light direction for the whole image, normals in 16 bits, 15-bit colours
        ("fixed", Shading { enabled: false, ..Shading::default() }, 52.0),
        ("fixed", lit(0.2), 42.0),
        // VTK's GPU caster has Phong's highlight (of the reflected ray), this project's Blinn-Phong's
        ("gpu", lit(0.2), 38.0),
    ];
    for eye in [DVec3::new(2.2, -3.0, 1.5), DVec3::new(-1.0, 1.0, -3.7)] {
        let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 30f64.to_radians(), SIZE, SIZE);
        for (mapper, shading, minimum) in cases {
            let tf = transfer(shading);
            let Some(theirs) = vtk(folder.path(), &volume, &tf, &camera, mapper, 0.25) else { return };
            let caster = RayCaster::new(&volume, None, &tf, [0.0, 1.2], placement, 0.25);
            let ours = caster.render(&camera, None).over([1.0; 3]);
            let agreement = psnr(&ours, &theirs);
            println!("{mapper} specular {} shaded {}: {agreement:.1} dB", shading.specular, shading.enabled);
            let drawn = ours.chunks_exact(3).filter(|p| p[0] < 0.9).count();
            assert!(drawn > 2000, "too few pixels are drawn: {drawn}");
            assert!(agreement > minimum, "{mapper} {shading:?}: {agreement:.1} dB, at least {minimum} expected");
        }
    }
}

/// Whether VTK draws here; otherwise the test skips.
fn vtk_draws(folder: &Path) -> bool {
    let camera = Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, 30f64.to_radians(), 8, 8);
    vtk(folder, &volume(), &transfer(Shading::default()), &camera, "gpu", 2.0).is_some()
}

#[test]
fn scenes_that_vtk_draws_are_datasets_with_ground_truth() {
    let folder = tempfile::tempdir().unwrap();
    if !vtk_draws(folder.path()) {
        return;
    }
    let python = python_with("vtk", Need::VtkRendering).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts/vtk_scenes.py");
    let small = "--size 32 --times 2 --views 2 --test-views 3 --segment-views 2 --voxels 24";
    for scene in ["vtk-cells:0", "vtk-surfaces:0"] {
        let root = folder.path().join(scene.replace(':', "-"));
        let mut command = Command::new(&python);
        command.arg(&script).args([scene, "--out"]).arg(&root).args(small.split(' '));
        let output = command.output().unwrap();
        assert!(output.status.success(), "{scene}: {}", String::from_utf8_lossy(&output.stderr));
        let splits = [SplitName::Train, SplitName::Test];
        let dataset = Dataset::open(&root, &OpenOptions { downscale: 1, splits: &splits, max_views: None }).unwrap();
        assert_eq!((dataset.train.images.width, dataset.train.frames.len()), (32, 4), "{scene}");
        check_truth(scene, &Truth::read(&root).unwrap());
    }
}

/// Masks, label images and volumes agree in their sizes, and all show the same segments.
fn check_truth(scene: &str, truth: &Truth) {
    assert_eq!(truth.file.size, [32, 32], "{scene}");
    let known: BTreeSet<u16> = truth.file.segments.iter().map(|s| s.id).collect();
    assert_eq!(known, (1..=known.len() as u16).collect(), "{scene}");
    let (mut in_space, mut in_masks) = (BTreeSet::new(), BTreeSet::new());
    assert_eq!(truth.volume_times(), [0.0, 1.0], "{scene}");
    for time in truth.volume_times() {
        let volume = truth.volume(time).unwrap();
        assert_eq!(volume.dims, [24; 3], "{scene}");
        let visible = volume.ids.iter().zip(&volume.opacity).filter(|(id, opacity)| **id > 0 && **opacity > 0.01);
        in_space.extend(visible.map(|(id, _)| *id));
    }
    for segment in &truth.file.segments {
        assert_eq!(segment.frames.len(), 4, "{scene}: two views at two times");
        for frame in &segment.frames {
            let mask = image::open(truth.root.join(&frame.mask_path)).unwrap().into_luma8();
            assert_eq!(mask.dimensions(), (32, 32), "{scene}: {}", frame.mask_path);
            assert!(mask.pixels().all(|p| [0, 255].contains(&p.0[0])), "{scene}: {}", frame.mask_path);
            assert_eq!(mask.pixels().filter(|p| p.0[0] > 0).count(), frame.pixels, "{scene}: {}", frame.mask_path);
            let alone = image::open(truth.root.join(&frame.file_path)).unwrap().into_rgba8();
            let least = truth.file.mask_alpha * 255.0;
            let agree = alone.pixels().zip(mask.pixels()).all(|(p, m)| (m.0[0] > 0) == (f32::from(p.0[3]) >= least));
            assert!(agree, "{scene}: {}", frame.file_path);
            if frame.pixels > 0 {
                in_masks.insert(segment.id);
            }
        }
    }
    assert_eq!((&in_space, &in_masks), (&known, &known), "{scene}");
    let views = truth.views_near(0.0, usize::MAX, 1).unwrap();
    assert_eq!(views.len(), 3, "{scene}: two of training and one of test");
    for view in views {
        let found: BTreeSet<u16> = truth.labels(&view).unwrap().into_iter().filter(|id| *id > 0).collect();
        assert!(!found.is_empty() && found.is_subset(&known), "{scene}: {}: {found:?}", view.name);
    }
}
