//! One volume stored in every orientation, in NIfTI, NRRD and VTI: it is drawn as it lies in space, and labels are index
//! for index on its voxels, at their physical places, also as nibabel, pynrrd and VTK read the files.

use crate::common::{json, refused, run_json, train, volseggs};
use glam::DVec3;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::AtomicBool;
use volseggs::device::DeviceName;
use volseggs::export::labels::{write_nrrd, write_vti};
use volseggs::prepare::views::{TrainingTimes, ViewOptions};
use volseggs::prepare::{
    FileLabels, PrepareOptions, PrepareRecord, PrepareSource, SegmentOptions, SegmentSteps, prepare,
};
use volseggs::run::OpenRun;
use volseggs::run::export::write_labels;
use volseggs::run::labels::{LabelPlan, RunLabels};
use volseggs::volume::directions::Directions;
use volseggs::volume::grid::Grid;
use volseggs::volume::placement::published_side;
use volseggs::volume::series::{Series, SeriesOptions};
use volseggs::volume::transfer::TransferFunction;
use volseggs_testing::{Need, python_with};

/// The volume as it is stored first: along the axes of space.
const PLAIN: Grid = Grid::aligned([16, 12, 10], [1.5, 2.0, 2.5], [30.0, -40.0, 7.0]);
/// First and last plain voxel of a block, which lies off the centre along every axis.
const BLOCK: [[f64; 2]; 3] = [[2.0, 6.0], [6.0, 10.0], [1.0, 4.0]];

/// A way to store the volume.
struct Stored {
    name: String,
    grid: Grid,
    /// `[z, y, x]` along the index axes.
    values: Vec<u8>,
}

impl Stored {
    fn new(name: String, grid: Grid) -> Self {
        let value = |i: usize| {
            let at = PLAIN.index(grid.position(voxel(&grid, i)));
            let inside = (0..3).all(|a| (BLOCK[a][0] - 0.5..=BLOCK[a][1] + 0.5).contains(&at[a]));
            if inside { 200 } else { 0 }
        };
        Self { values: (0..grid.len()).map(value).collect(), name, grid }
    }
}

/// The voxel coordinates of the voxel `i` in memory.
fn voxel(grid: &Grid, i: usize) -> DVec3 {
    let [nx, ny, _] = grid.dims;
    DVec3::from_array([i % nx, i / nx % ny, i / (nx * ny)].map(|v| v as f64))
}

/// Mean physical position of the voxels for which `which` holds.
fn centroid(grid: &Grid, which: impl Fn(usize) -> bool) -> DVec3 {
    let places: Vec<DVec3> = (0..grid.len()).filter(|i| which(*i)).map(|i| grid.position(voxel(grid, i))).collect();
    places.iter().sum::<DVec3>() / places.len() as f64
}

/// The 48 permutations and reversals of the axes, the plain one first, and one oblique volume over the same middle.
fn orientations() -> Vec<Stored> {
    let mut all = Vec::new();
    for axes in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
        for signs in 0..8u8 {
            let sign = |a: usize| if signs >> a & 1 == 1 { -1.0 } else { 1.0 };
            let steps = [0, 1, 2].map(|a| (DVec3::AXES[axes[a]] * sign(a)).to_array());
            let directions = Directions::of_steps(steps).unwrap().0;
            // the first voxel is at the end of each axis that runs backwards
            let mut first = DVec3::ZERO;
            for a in (0..3).filter(|a| sign(*a) < 0.0) {
                first[axes[a]] = (PLAIN.dims[axes[a]] - 1) as f64;
            }
            let (dims, spacing) = (axes.map(|a| PLAIN.dims[a]), axes.map(|a| PLAIN.spacing[a]));
            let grid = Grid { dims, spacing, origin: PLAIN.position(first).to_array(), directions };
            all.push(Stored::new(directions.code(None), grid));
        }
    }
    let (s, c) = 0.2f64.sin_cos();
    let directions = Directions::of_steps([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, 1.0]]).unwrap().0;
    let half = 0.5 * DVec3::from_array(PLAIN.size());
    let grid = Grid { origin: (PLAIN.centre() - directions.matrix() * half).to_array(), directions, ..PLAIN };
    all.push(Stored::new("oblique".into(), grid));
    all
}

/// A NIfTI-1 file: right-anterior-superior by an sform, in mm.
fn nifti(stored: &Stored) -> Vec<u8> {
    let mut h = vec![0u8; 352];
    let mut put = |at: usize, bytes: &[u8]| h[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &348i32.to_le_bytes());
    put(40, &3i16.to_le_bytes());
    for a in 0..7 {
        let size = stored.grid.dims.get(a).map_or(1, |n| *n as i16);
        put(42 + 2 * a, &size.to_le_bytes());
    }
    put(70, &2i16.to_le_bytes()); // uint8
    put(72, &8i16.to_le_bytes());
    put(76, &1f32.to_le_bytes());
    for (a, spacing) in stored.grid.spacing.iter().enumerate() {
        put(80 + 4 * a, &(*spacing as f32).to_le_bytes());
    }
    put(108, &352f32.to_le_bytes());
    put(112, &1f32.to_le_bytes());
    put(123, &[2]); // mm
    put(254, &1i16.to_le_bytes()); // sform_code
    let steps = stored.grid.steps();
    for row in 0..3 {
        let numbers = [steps.x_axis[row], steps.y_axis[row], steps.z_axis[row], stored.grid.origin[row]];
        for (c, v) in numbers.iter().enumerate() {
            put(280 + 16 * row + 4 * c, &(*v as f32).to_le_bytes());
        }
    }
    put(344, b"n+1\0");
    [&h[..], &stored.values].concat()
}

/// An NRRD file: left-posterior-superior, in mm.
fn nrrd(stored: &Stored) -> Vec<u8> {
    let Grid { dims: [nx, ny, nz], origin, .. } = stored.grid;
    let vector = |v: DVec3| format!("({},{},{})", v.x, v.y, v.z);
    let steps = stored.grid.steps();
    let [x, y, z] = [steps.x_axis, steps.y_axis, steps.z_axis].map(vector);
    let head = format!(
        "NRRD0004\ntype: uchar\ndimension: 3\nspace: left-posterior-superior\nsizes: {nx} {ny} {nz}\n\
         space directions: {x} {y} {z}\nkinds: domain domain domain\nencoding: raw\n\
         space units: \"mm\" \"mm\" \"mm\"\nspace origin: {}\n\n",
        vector(DVec3::from_array(origin))
    );
    [head.as_bytes(), &stored.values].concat()
}

/// VTK image data, which knows neither a convention nor a unit.
fn vti(stored: &Stored) -> Vec<u8> {
    let Grid { dims, spacing: [sx, sy, sz], origin: [ox, oy, oz], directions } = stored.grid;
    let [nx, ny, nz] = dims.map(|n| n - 1);
    let direction = directions.matrix().transpose().to_cols_array().map(|v| v.to_string()).join(" ");
    let values: Vec<String> = stored.values.iter().map(u8::to_string).collect();
    let extent = format!("0 {nx} 0 {ny} 0 {nz}");
    format!(
        r#"<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian"><ImageData WholeExtent="{extent}"
        Origin="{ox} {oy} {oz}" Spacing="{sx} {sy} {sz}" Direction="{direction}"><Piece Extent="{extent}">
        <PointData Scalars="d"><DataArray type="UInt8" Name="d" format="ascii">{}</DataArray></PointData>
        </Piece></ImageData></VTKFile>"#,
        values.join(" ")
    )
    .into_bytes()
}

fn transfer(root: &Path) -> PathBuf {
    let path = root.join("block.toml");
    let text = "colors = [[0.0, \"#d03020\"], [1.0, \"#d03020\"]]\nopacity = [[0.0, 0.0], [0.4, 0.0], [0.6, 0.3], [1.0, 0.3]]\n\
                range = [0.0, 200.0]\n[shading]\nenabled = false\n";
    std::fs::write(&path, text).unwrap();
    path
}

fn options() -> PrepareOptions {
    PrepareOptions {
        views: ViewOptions {
            size: [32; 2],
            times: TrainingTimes::Count(1),
            views_per_time: 24,
            test_views: 3,
            ..ViewOptions::default()
        },
        side: published_side(),
        step: 0.5,
        segments: SegmentOptions { views: 0, steps: SegmentSteps::default(), label_images: false },
        replace: false,
        needed: Vec::new(),
    }
}

fn series(path: &Path) -> Series {
    Series::open(&[path.display().to_string()], &SeriesOptions::default()).unwrap()
}

fn make(volume: &Path, transfer: &TransferFunction, out: &Path) -> PrepareRecord {
    let source = PrepareSource::Files { series: Box::new(series(volume)), labels: FileLabels::None };
    prepare(&source, transfer, &options(), out, &|_| {}, &AtomicBool::new(false)).unwrap()
}

/// The largest difference of a level between the training images of two datasets, and its mean.
fn difference(a: &Path, b: &Path) -> (u8, f64) {
    let (mut largest, mut sum, mut n) = (0, 0.0, 0.0);
    for view in 0..24 {
        let [a, b] = [a, b].map(|d| image::open(d.join(format!("train/r_{view}.png"))).unwrap().to_rgba8().into_raw());
        for (p, q) in a.chunks_exact(4).zip(b.chunks_exact(4)) {
            let off = p[3].abs_diff(q[3]);
            largest = largest.max(off);
            sum += f64::from(off);
            n += 1.0;
        }
    }
    (largest, sum / n)
}

type Writer = fn(&Stored) -> Vec<u8>;

#[test]
fn labels_are_index_for_index_on_volumes_in_every_orientation() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let tf = TransferFunction::load(&transfer(root).display().to_string()).unwrap();
    let all = orientations();
    assert_eq!(all.len(), 49);
    // trained once: the scene's axes are those of space, so that every orientation gives the same scene
    std::fs::write(root.join("first.nii"), nifti(&all[0])).unwrap();
    make(&root.join("first.nii"), &tf, &root.join("data"));
    let still = ["init.points=1500", "densify.budget=1500", "model.sh_degree=0", "stages.joint_steps=40"];
    train(root, "run", &still).assert().success();
    run_json(root, &["segment", "coarse", "run", "--clusters", "1"]);
    let run = OpenRun::open(&root.join("run"), &DeviceName::cpu().unwrap().open().unwrap()).unwrap();
    let block = centroid(&PLAIN, |i| all[0].values[i] > 0);
    let mut plain: Vec<u16> = Vec::new();
    let formats: [(&str, &str, Writer); 3] =
        [("nii", "seg.nrrd", nifti), ("nrrd", "seg.nrrd", nrrd), ("vti", "vti", vti)];
    for (extension, labels_extension, encode) in formats {
        let mut pairs = Vec::new();
        for (i, stored) in all.iter().enumerate() {
            let name = format!("{}.{extension}", stored.name);
            let volume = root.join(&name);
            std::fs::write(&volume, encode(stored)).unwrap();
            let data = root.join(format!("data-{name}"));
            let record = make(&volume, &tf, &data);
            let oblique = stored.name == "oblique";
            let (largest, mean) = difference(&data, &root.join("data"));
            assert!(if oblique { mean < 2.0 } else { largest <= 1 }, "{name}: pictures differ by {largest}, {mean:.2}");
            let grid = record.grid();
            let off =
                (grid.steps() - stored.grid.steps()).to_cols_array().into_iter().map(f64::abs).fold(0.0, f64::max);
            assert!(off < 1e-6 && record.grid().dims == stored.grid.dims, "{name}: {off}");
            let space = record.calibration.space.unwrap();
            assert!((DVec3::from_array(space.centre) - PLAIN.centre()).length() < 1e-4, "{name}");

            // labels rest on the grid alone, so that one format shows all of them
            if extension != "nrrd" && i % 7 != 0 && !oblique {
                continue;
            }
            // as if it had been trained on this one
            let mut run = run.share();
            run.record.dataset.clone_from(&data);
            let labels = RunLabels::new(&run, &LabelPlan::default()).unwrap();
            let ids = labels.labels_at(0.0).unwrap().ids;
            let written = root.join(format!("{}-{extension}.{labels_extension}", stored.name));
            let format = if extension == "vti" { write_vti } else { write_nrrd };
            write_labels(&written, &labels, &ids, false, format, None).unwrap();
            let read = series(&written);
            let off =
                (read.grid().steps() - grid.steps()).to_cols_array().into_iter().map(f64::abs).fold(0.0, f64::max);
            let first = DVec3::from_array(read.grid().origin) - DVec3::from_array(grid.origin);
            assert!(off < 1e-6 && first.length() < 1e-6 && read.grid().dims == grid.dims, "{name}: {off} {first}");
            assert_eq!((read.physical().axes, read.physical().length_unit.is_some()), (space.axes, extension != "vti"));
            pairs.push(json!([volume, written]));
            let there = centroid(read.grid(), |i| ids[i] > 0);
            assert!((there - block).length() < 2.0, "{name}: labels at {there}, the block at {block}");
            if plain.is_empty() {
                plain.clone_from(&ids);
                assert!(ids.iter().filter(|id| **id > 0).count() > 40, "the block has labels");
            }
            // the same label at the same place
            let mut wrong = 0;
            for (i, id) in ids.iter().enumerate() {
                let at = PLAIN.index(stored.grid.position(voxel(&stored.grid, i))).round();
                let inside = (0..3).all(|a| at[a] >= 0.0 && at[a] < PLAIN.dims[a] as f64);
                let [x, y, z] = at.to_array().map(|v| v as usize);
                let expected = if inside { plain[(z * PLAIN.dims[1] + y) * PLAIN.dims[0] + x] } else { 0 };
                wrong += usize::from(expected != *id);
            }
            let labelled = plain.iter().filter(|id| **id > 0).count();
            assert!(wrong <= if oblique { labelled / 2 } else { 2 }, "{name}: {wrong} of {labelled} labels differ");
        }
        others_agree(extension, &pairs);
    }
}

/// Checks by programs of others that the labels have the affine of their volumes, and lie where the block is bright.
/// Skipped without the Python packages.
fn others_agree(extension: &str, pairs: &[Value]) {
    let needs = match extension {
        "nii" => [("nibabel", Need::Nibabel), ("nrrd", Need::Pynrrd)],
        "nrrd" => [("numpy", Need::Pynrrd), ("nrrd", Need::Pynrrd)],
        _ => [("numpy", Need::Vtk), ("vtk", Need::Vtk)],
    };
    let mut python = None;
    for (package, need) in needs {
        python = python_with(package, need);
        if python.is_none() {
            return;
        }
    }
    let output = Command::new(python.unwrap())
        .args(["-c", AGREE])
        .arg(Value::Array(pairs.to_vec()).to_string())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found: Vec<(f64, f64)> = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(found.len(), pairs.len());
    for ((affine, off), pair) in found.into_iter().zip(pairs) {
        assert!(affine < 1e-4, "{pair}: the affines differ by {affine}");
        assert!(off < 2.0, "{pair}: the labels are {off} mm from the block");
    }
}

/// Prints, for each volume and its labels, the largest difference of their affines and the distance of their centroids.
const AGREE: &str = r#"
import json, sys
import numpy as np

def read(path):
    if path.endswith(".nii"):
        import nibabel
        image = nibabel.load(path)
        return np.asarray(image.dataobj), image.affine
    if path.endswith(".vti"):
        import vtk
        from vtk.util.numpy_support import vtk_to_numpy
        reader = vtk.vtkXMLImageDataReader()
        reader.SetFileName(path)
        reader.Update()
        image = reader.GetOutput()
        matrix = image.GetIndexToPhysicalMatrix()
        values = vtk_to_numpy(image.GetPointData().GetScalars()).reshape(image.GetDimensions()[::-1]).transpose(2, 1, 0)
        return values, np.array([[matrix.GetElement(r, c) for c in range(4)] for r in range(4)])
    import nrrd
    values, header = nrrd.read(path)
    affine = np.eye(4)
    affine[:3, :3] = np.array(header["space directions"], float).T
    affine[:3, 3] = header["space origin"]
    assert header["space"] in ("left-posterior-superior", "right-anterior-superior")
    # in right-anterior-superior, as nibabel gives it
    return values, (np.diag([-1, -1, 1, 1]) if header["space"].startswith("left") else np.eye(4)) @ affine

def centroid(mask, affine):
    return affine[:3, :3] @ np.argwhere(mask).mean(0) + affine[:3, 3]

found = []
for volume, labels in json.loads(sys.argv[1]):
    (values, a), (ids, b) = read(volume), read(labels)
    assert values.shape == ids.shape
    found.append((float(abs(a - b).max()), float(np.linalg.norm(centroid(values > 0, a) - centroid(ids > 0, b)))))
print(json.dumps(found))
"#;

#[test]
fn the_space_of_labels_is_that_of_the_data_unless_another_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let stored = &orientations()[1];
    std::fs::write(root.join("a.nii"), nifti(stored)).unwrap();
    std::fs::write(root.join("a.vti"), vti(stored)).unwrap();
    std::fs::write(root.join("lps.nrrd"), nrrd(stored)).unwrap();
    let tf = transfer(root).display().to_string();
    let prepare = |volume: &str, out: &str| {
        let few = "--size 32 --times 1 --views 8 --test-views 2 --segment-views 0";
        let mut command = volseggs();
        command.current_dir(root).args(["prepare", "--volume", volume, "--transfer-function", &tf, "--out", out]);
        command.args(few.split(' '));
        command
    };
    prepare("a.nii", "data").assert().success();
    prepare("a.vti", "vti").args(["--length-unit", "um"]).assert().success();
    let record = json(&root.join("data/prepare.json"));
    let source = &record["source_files"][0];
    assert_eq!((&source["given"], record["side"].is_number()), (&json!("a.nii"), true));
    assert_eq!(source["absolute"], json!(root.join("a.nii")));
    let space = &record["calibration"]["space"];
    assert_eq!((&space["unit"], &space["axes"]), (&json!("mm"), &json!("right-anterior-superior")));
    assert!(record["calibration"]["time"].is_null() && record["time_values"].is_null(), "one step");
    let space = &json(&root.join("vti/prepare.json"))["calibration"]["space"];
    assert_eq!((&space["unit"], &space["axes"]), (&json!("um"), &Value::Null));
    train(root, "run", &[]).assert().success();
    run_json(root, &["segment", "coarse", "run", "--clusters", "1"]);
    let export = |more: &[&str]| {
        let name = format!("{}.seg.nrrd", more.len());
        let report = run_json(root, &[&["export", "run", "--time", "0", "--out", &name], more].concat());
        let header = std::fs::read(root.join(&name)).unwrap();
        let end = header.windows(2).position(|w| w == b"\n\n").unwrap();
        (report, String::from_utf8(header[..end].to_vec()).unwrap())
    };
    let has = |header: &str, line: &str| header.lines().any(|l| l == line);
    let (report, header) = export(&[]);
    assert_eq!((&report["orientation"], &report["unit"]), (&json!("LAS"), &json!("mm")));
    assert!(
        has(&header, "space: right-anterior-superior") && has(&header, "space units: \"mm\" \"mm\" \"mm\""),
        "{header}"
    );
    assert!(has(&header, "space directions: (-1.5,0,0) (0,2,0) (0,0,2.5)"), "{header}");
    let (report, header) = export(&["--space", "lps"]);
    assert_eq!(report["orientation"], json!("LAS"), "the same voxels");
    assert!(has(&header, "space directions: (1.5,0,0) (0,-2,0) (0,0,2.5)"), "{header}");
    assert!(has(&header, "space: left-posterior-superior"), "{header}");
    // the voxels of a file of the other convention, as they are described there
    let (report, header) = export(&["--space", "none"]);
    assert!(report["axes"].is_null() && has(&header, "space dimension: 3"), "{header}");
    // nothing anatomical is claimed of data that says nothing
    let (path, kept) = (root.join("run/run.json"), json(&root.join("run/run.json")));
    let mut other = kept.clone();
    other["dataset"] = json!(root.join("vti"));
    std::fs::write(&path, other.to_string()).unwrap();
    let (report, header) = export(&[]);
    std::fs::write(&path, kept.to_string()).unwrap();
    assert_eq!((&report["axes"], &report["unit"]), (&Value::Null, &json!("um")));
    assert!(has(&header, "space dimension: 3") && !header.contains("posterior"), "{header}");
    // data in the other convention lie elsewhere: with the same numbers they are turned by half a turn
    let mut elsewhere = volseggs();
    elsewhere.current_dir(root).args(["export", "run", "--time", "0", "--like", "lps.nrrd", "--out", "x.nrrd"]);
    refused(&mut elsewhere, &["lps.nrrd", "outside"]);
    // a sheared volume is refused before anything is drawn
    let mut sheared = nrrd(stored);
    let at = sheared.windows(7).position(|w| w == b"(0,2,0)").unwrap();
    sheared.splice(at..at + 7, *b"(.5,2,0)");
    std::fs::write(root.join("sheared.nrrd"), sheared).unwrap();
    refused(&mut prepare("sheared.nrrd", "none"), &["space directions", "degrees apart", "resample"]);
    // labels that are stored in another orientation than the volume
    std::fs::write(root.join("other.nii"), nifti(&orientations()[2])).unwrap();
    refused(prepare("a.nii", "none").args(["--labels", "other.nii"]), &["--labels", "other.nii", "LAS", "resample"]);
    // inspect says it all
    let shown = volseggs().current_dir(root).args(["inspect", "a.nii"]).assert().success();
    let shown = String::from_utf8(shown.get_output().stdout.clone()).unwrap();
    assert!(shown.contains("axes     LAS") && shown.contains("1.5 x 2 x 2.5 mm"), "{shown}");
}
