//! Measures the time per view of the ray caster and, if the Python package `vtk` is installed, of VTK's on the same
//! volume.
//!
//! `cargo bench --bench raycast -- [voxels per side] [pixels per side] [--repeats N]`; default 256 and 800.
#![allow(clippy::unwrap_used, missing_docs)]

use glam::DVec3;
use serde_json::json;
use std::path::Path;
use std::process::Command;
use std::time::Instant;
use volseggs::data::Camera;
use volseggs::volume::grid::Volume;
use volseggs::volume::placement::{VoxelPlacement, published_side};
use volseggs::volume::raycast::RayCaster;
use volseggs::volume::synthetic::Synthetic;
use volseggs::volume::transfer::TransferFunction;

fn main() {
    let mut numbers = Vec::new();
    let mut repeats = 5;
    let mut arguments = std::env::args().skip(1);
    while let Some(a) = arguments.next() {
        match a.as_str() {
            "--repeats" => repeats = arguments.next().unwrap().parse().unwrap(),
            a => numbers.extend(a.parse::<usize>()),
        }
    }
    let side = numbers.first().copied().unwrap_or(256);
    let pixels = numbers.get(1).copied().unwrap_or(800) as u32;
    let camera = Camera::look_at(DVec3::new(2.4, -2.9, 1.4), DVec3::ZERO, DVec3::Z, 30f64.to_radians(), pixels, pixels);
    println!(
        "| scene | covered | lay out | ours | VTK fixed-point, wall | VTK, CPU of all threads | VTK / ours | first view: ours | VTK | VTK / ours |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for scene in Synthetic::ALL {
        let (volume, _) = scene.sample([side; 3], 0.5);
        let tf = scene.transfer_function().unwrap();
        let placement = VoxelPlacement::new(&volume.grid, published_side());
        let started = Instant::now();
        let caster = RayCaster::new(&volume, None, &tf, [0.0, 1.0], placement, 1.0);
        let layout = started.elapsed().as_secs_f64();
        let coverage = caster.render(&camera, None).coverage();
        let mut ours: Vec<f64> = (0..repeats)
            .map(|_| {
                let started = Instant::now();
                std::hint::black_box(caster.render(&camera, None));
                started.elapsed().as_secs_f64()
            })
            .collect();
        ours.sort_by(f64::total_cmp);
        let (fastest, median) = (ours[0], ours[repeats / 2]);
        let theirs = vtk(&volume, &tf, &placement, &camera, repeats);
        let cell = |v: &[f64]| format!("{:.3} / {:.3}", v[0], v[v.len() / 2]);
        let ours = format!("{layout:.3} | {fastest:.3} / {median:.3}");
        // each volume of a series is shown in few views, so the layout before the first view counts
        let first = layout + fastest;
        let theirs = theirs.map_or_else(
            || format!("- | - | - | {first:.3} | - | -"),
            |t| {
                let ratio = [t.wall[0] / fastest, t.first / first];
                let (wall, cpu) = (cell(&t.wall), cell(&t.cpu));
                format!("{wall} | {cpu} | {:.2} | {first:.3} | {:.3} | {:.1}", ratio[0], t.first, ratio[1])
            },
        );
        println!("| {scene} | {:.0} % | {ours} | {theirs} |", 100.0 * coverage);
    }
}

/// Sorted times of VTK's CPU ray caster, wall and summed over all threads, and the time of its first view, in seconds.
struct Vtk {
    wall: Vec<f64>,
    cpu: Vec<f64>,
    first: f64,
}

/// Times VTK's CPU ray caster; returns `None` if it cannot be run.
fn vtk(
    volume: &Volume,
    tf: &TransferFunction,
    placement: &VoxelPlacement,
    camera: &Camera,
    repeats: usize,
) -> Option<Vtk> {
    let folder = tempfile::tempdir().unwrap();
    let raw: Vec<u8> = volume.values.iter().flat_map(|v| v.to_le_bytes()).collect();
    std::fs::write(folder.path().join("v.raw"), raw).unwrap();
    let job = json!({
        "raw": folder.path().join("v.raw"), "dims": volume.grid.dims,
        "spacing": placement.spacing().to_array(), "origin": (-placement.half).to_array(),
        "eye": camera.position().to_array(), "target": [0, 0, 0], "up": [0, 0, 1],
        "fov_y_degrees": camera.fov_y().to_degrees(), "width": camera.width, "height": camera.height,
        "span": [0.0, 1.0],
        "colors": tf.colors.iter().map(|(p, c)| [*p, f64::from(c[0]), f64::from(c[1]), f64::from(c[2])]).collect::<Vec<_>>(),
        "opacity": tf.opacity.iter().map(|(p, a)| [*p, f64::from(*a)]).collect::<Vec<_>>(),
        "unit_distance": tf.unit_length * placement.side(), "step": placement.spacing().min_element(),
        "shade": true, "ambient": tf.shading.ambient, "diffuse": tf.shading.diffuse,
        "specular": tf.shading.specular, "power": tf.shading.power,
        "mapper": "fixed", "repeats": repeats, "threads": rayon::current_num_threads(),
        "out": folder.path().join("v.rgba"),
    });
    let file = folder.path().join("job.json");
    std::fs::write(&file, job.to_string()).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support/vtk_reference.py");
    let python = std::env::var("PYTHON").unwrap_or_else(|_| "python3".into());
    let output = Command::new(python).arg(script).arg(&file).output().ok()?;
    if !output.status.success() {
        eprintln!("VTK: {}", String::from_utf8_lossy(&output.stderr).lines().last().unwrap_or_default());
        return None;
    }
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).ok()?;
    let sorted = |key: &str| {
        let mut v: Vec<f64> = report[key].as_array()?.iter().filter_map(serde_json::Value::as_f64).collect();
        v.sort_by(f64::total_cmp);
        (!v.is_empty()).then_some(v)
    };
    Some(Vtk { wall: sorted("seconds")?, cpu: sorted("cpu_seconds")?, first: report["first_seconds"].as_f64()? })
}
