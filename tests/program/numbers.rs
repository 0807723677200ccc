//! Numbers and pictures for other programs: fields on voxels, depth and velocity as arrays, transparent frames, cameras,
//! and results of runs that are not to be written to.

use crate::common::{copy, json, names, refused, run_json, text, volseggs, with_segments};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use tempfile::TempDir;
use volseggs::volume::series::{Series, SeriesOptions};

/// A folder with the dataset in `data` and a run with two segments in `run`, made once; nothing writes into it.
fn made_once() -> &'static Path {
    static ROOT: OnceLock<PathBuf> = OnceLock::new();
    ROOT.get_or_init(|| with_segments("numbers", &["--clusters", "2"]))
}

/// A folder with links to both.
fn place() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["data", "run"] {
        copy(&made_once().join(name), &folder.path().join(name));
    }
    folder
}

/// The shape and the values of an NPY file of `<f4`.
fn npy(path: &Path) -> (Vec<usize>, Vec<f32>) {
    let bytes = std::fs::read(path).unwrap();
    let length = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let header = std::str::from_utf8(&bytes[10..10 + length]).unwrap();
    assert!(header.contains("'<f4'"), "{header}");
    let (_, shape) = header.split_once('(').unwrap();
    let shape =
        shape.split_once(')').unwrap().0.split(',').filter_map(|n| n.trim().parse().ok()).collect::<Vec<usize>>();
    let count: usize = shape.iter().product();
    let values = bytes[10 + length..][..4 * count].chunks(4);
    (shape, values.map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect())
}

/// Every file below a folder with its bytes.
fn bytes_of(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let entries = names(folder).into_iter().map(|name| folder.join(name));
    entries
        .flat_map(|p| if p.is_dir() { bytes_of(&p) } else { vec![(p.clone(), std::fs::read(&p).unwrap())] })
        .collect()
}

#[test]
fn depth_and_velocity_are_written_as_numbers() {
    let folder = place();
    let root = folder.path();
    let view = ["render", "run", "--view", "1", "--size", "32"];
    let with = |more: &[&str]| run_json(root, &[&view[..], more].concat());
    let report = with(&["--show", "depth", "--out", "d.npy"]);
    assert!(
        report["values"].as_str().unwrap().starts_with("depth") && report["cameras"]["frames"].is_array(),
        "{report}"
    );
    let (shape, depth) = npy(&root.join("d.npy"));
    assert_eq!(shape, [32, 32]);
    let seen: Vec<f32> = depth.iter().copied().filter(|d| !d.is_nan()).collect();
    assert!(seen.len() > 50 && seen.len() < 1024, "{} pixels", seen.len());
    // cameras are 4 units away from objects within 1.2 units of the centre
    let range = with(&["--show", "depth", "--out", "picture"])["range"].clone();
    let [near, far] = [0, 1].map(|i| range[i].as_f64().unwrap() as f32);
    assert!(seen.iter().filter(|d| (near - 0.5..far + 0.5).contains(*d)).count() > seen.len() / 2, "{near} {far}");

    let exr = || std::fs::read(root.join("d.exr")).unwrap();
    with(&["--show", "depth", "--out", "d.exr"]);
    let last: Vec<u8> = depth[32 * 31..].iter().flat_map(|v| v.to_le_bytes()).collect();
    assert!(exr().starts_with(&[0x76, 0x2f, 0x31, 0x01]) && exr().ends_with(&last), "the same numbers");
    with(&["--show", "velocity", "--out", "v.npy"]);
    with(&["--show", "velocity", "--velocity-axis", "speed", "--out", "s.npy"]);
    let ((shape, vectors), (of_speed, speed)) = (npy(&root.join("v.npy")), npy(&root.join("s.npy")));
    assert_eq!((shape, of_speed), (vec![32, 32, 3], vec![32, 32]));
    for ((v, s), d) in vectors.chunks(3).zip(&speed).zip(&depth) {
        assert_eq!((v[0].is_nan(), s.is_nan()), (d.is_nan(), d.is_nan()));
        assert!(d.is_nan() || ((v[0].powi(2) + v[1].powi(2) + v[2].powi(2)).sqrt() - s).abs() < 1e-3);
    }
    assert!(speed.iter().any(|s| *s > 0.0));
    run_json(
        root,
        &["render", "run", "--path", "orbit", "--frames", "3", "--size", "8", "--show", "depth", "--out", "d.npy"],
    );
    assert_eq!(npy(&root.join("d.npy")).0, [3, 8, 8], "replaced, with a frame for each view");

    for (arguments, words) in [
        (&["--out", "c.npy"][..], &["c.npy", "--show depth"][..]),
        (&["--show", "segments", "--out", "c.exr"], &["c.exr", "--show velocity"]),
        (&["--show", "depth", "--palette", "cividis", "--out", "c.npy"], &["--palette"]),
        (&["--show", "depth", "--background", "transparent", "--out", "c.npy"], &["--background"]),
    ] {
        refused(volseggs().current_dir(root).args(view).args(arguments), words);
    }
    let orbit = ["render", "run", "--path", "orbit", "--frames", "2", "--show", "depth", "--out", "c.exr"];
    refused(volseggs().current_dir(root).args(orbit), &["c.exr", "one picture"]);
    assert!(!root.join("c.npy").exists() && !root.join("c.exr").exists());
}

#[test]
fn frames_without_a_background_have_straight_alpha() {
    let folder = place();
    let root = folder.path();
    let render = |out: &str, more: &[&str]| {
        let arguments = ["render", "run", "--path", "orbit", "--frames", "2", "--size", "32", "--out", out];
        run_json(root, &[&arguments[..], more].concat())
    };
    render("opaque", &[]);
    render("clear", &["--background", "transparent"]);
    for frame in ["0000.png", "0001.png"] {
        let [opaque, clear] = ["opaque", "clear"].map(|folder| image::open(root.join(folder).join(frame)).unwrap());
        assert_eq!((opaque.color(), clear.color()), (image::ColorType::Rgb8, image::ColorType::Rgba8));
        // the corner shows the background that the scene was trained over
        let background = opaque.to_rgb8().get_pixel(0, 0).0.map(f32::from);
        let (opaque, clear) = (opaque.into_rgb8(), clear.into_rgba8());
        let mut visible = 0;
        for (a, b) in opaque.pixels().zip(clear.pixels()) {
            let alpha = f32::from(b.0[3]) / 255.0;
            visible += usize::from(alpha > 0.2);
            for c in 0..3 {
                let over = alpha * f32::from(b.0[c]) + (1.0 - alpha) * background[c];
                assert!((over - f32::from(a.0[c])).abs() <= 2.0, "{a:?} {b:?}");
            }
        }
        assert!(visible > 20, "{visible} pixels");
    }
    assert_eq!(names(&root.join("clear")), ["0000.png", "0001.png", "animation.png", "frames.json"]);
    let film = ["render", "run", "--path", "orbit", "--frames", "2", "--size", "32", "--background", "transparent"];
    refused(volseggs().current_dir(root).args(film).args(["--out", "f.mp4"]), &["f.mp4", "no transparency"]);
    volseggs().current_dir(root).args(film).args(["--out", "f.png"]).assert().success();
    assert_eq!(image::open(root.join("f.png")).unwrap().color(), image::ColorType::Rgba8);
}

#[test]
fn the_cameras_of_a_render_are_a_path() {
    let folder = place();
    let root = folder.path();
    let report = run_json(root, &["render", "run", "--path", "orbit", "--frames", "3", "--size", "32", "--out", "one"]);
    assert_eq!(report["cameras"]["frames"].as_array().unwrap().len(), 3);
    std::fs::write(root.join("transforms_orbit.json"), report["cameras"].to_string()).unwrap();
    run_json(root, &["render", "run", "--path", "transforms_orbit.json", "--size", "32", "--out", "two"]);
    for frame in ["0000.png", "0001.png", "0002.png"] {
        let [one, two] = ["one", "two"].map(|out| std::fs::read(root.join(out).join(frame)).unwrap());
        assert!(one == two, "{frame}");
    }
}

#[test]
fn runs_of_others_are_measured_without_writing_into_them() {
    let folder = place();
    let root = folder.path();
    let before = bytes_of(&root.join("run"));
    let name = run_json(root, &["segment", "list", "run"])["segments"][0]["name"].as_str().unwrap().to_owned();
    let eval = ["eval", "run", "--views", "3"];
    run_json(root, &[&eval[..], &["--out", "mine/eval"]].concat());
    assert_eq!(json(&root.join("mine/eval/mean.json"))["views"], 3);
    let track = ["track", "run", "--segment", &name, "--frames", "2"];
    run_json(root, &[&track[..], &["--out", "mine/tracks"]].concat());
    assert!(root.join("mine/tracks").join(&name).join("statistics.csv").is_file());
    let unlocked = |entries: Vec<(PathBuf, Vec<u8>)>| -> Vec<_> {
        entries.into_iter().filter(|(path, _)| !path.ends_with(".lock")).collect()
    };
    assert!(unlocked(bytes_of(&root.join("run"))) == unlocked(before), "nothing is written into the run");
    // replaced by the next, and nothing else is
    run_json(root, &[&eval[..], &["--out", "mine/eval"]].concat());
    std::fs::create_dir(root.join("notes")).unwrap();
    std::fs::write(root.join("notes/thesis.tex"), "x").unwrap();
    refused(volseggs().current_dir(root).args(eval).args(["--out", "notes"]), &["notes"]);
    refused(volseggs().current_dir(root).args(eval).args(["--out", "run"]), &["run"]);
}

#[test]
fn fields_are_written_on_voxels() {
    let folder = place();
    let root = folder.path();
    let export = ["export", "run", "--time", "0.5", "--dims", "12,10,8"];
    let with = |more: &[&str]| run_json(root, &[&export[..], more].concat());
    let report = with(&["--fields", "--out", "f.vti"]);
    let channels = ["density", "velocity_x", "velocity_y", "velocity_z", "red", "green", "blue"];
    assert_eq!((&report["channels"], &report["dims"]), (&json!(channels), &json!([12, 10, 8])));
    assert_eq!(report["length_unit"], "normalised");
    let open = |name: &str| Series::open(&[text(root, name)], &SeriesOptions::default()).unwrap();
    let density = |name: &str| open(name).load(0).unwrap().values;
    let whole = density("f.vti");
    assert!(whole.len() == 960 && whole.iter().any(|v| *v > 0.0) && whole.iter().all(|v| *v >= 0.0));
    with(&["--fields", "density", "--out", "d.nrrd"]);
    with(&["--fields", "density", "--out", "d.npy"]);
    assert!(density("d.nrrd") == whole && density("d.npy") == whole, "the same in every format");
    assert_eq!(open("d.nrrd").grid(), open("f.vti").grid());
    with(&["--fields", "velocity,luminance", "--out", "v.npy"]);
    let (shape, values) = npy(&root.join("v.npy"));
    assert_eq!(shape, [8, 10, 12, 4]);
    assert!(values.chunks(4).zip(&whole).all(|(v, density)| *density > 0.0 || v == [0.0; 4]));
    assert!(values.chunks(4).all(|v| (0.0..=1.001).contains(&v[3])) && values.iter().all(|v| v.is_finite()));

    // the segments hold all Gaussians that are visible, or nearly
    let all = run_json(root, &["segment", "list", "run"])["segments"].clone();
    let mut parts = vec![0.0; 960];
    for segment in all.as_array().unwrap() {
        with(&["--fields", "density", "--segment", segment["name"].as_str().unwrap(), "--out", "s.nrrd"]);
        parts.iter_mut().zip(density("s.nrrd")).for_each(|(sum, v)| *sum += v);
    }
    let sum = |values: &[f32]| values.iter().map(|v| f64::from(*v)).sum::<f64>();
    assert!(sum(&parts) <= sum(&whole) * 1.0001 && sum(&parts) > 0.5 * sum(&whole), "{}", sum(&parts) / sum(&whole));

    let frames = ["export", "run", "--frames", "2", "--dims", "4,4,4", "--fields", "density", "--format", "npy"];
    run_json(root, &[&frames[..], &["--out", "frames"]].concat());
    assert_eq!(names(&root.join("frames")), ["0000.npy", "0001.npy", "export.json"]);
    let reported: Value = json(&root.join("frames/export.json"));
    assert_eq!(reported["format"], "npy");
    for (arguments, words) in [
        (&["--fields", "heat", "--out", "x.vti"][..], &["heat", "density"][..]),
        (&["--fields", "--out", "x.ply"], &["--fields", ".vti"]),
        (&["--out", "x.npy"], &[".npy", "--fields"]),
        (&["--fields"], &["--out"]),
        (&["--fields", "--threshold", "0.1", "--out", "x.vti"], &["--threshold"]),
        (&["--fields", "--segment", "nobody", "--out", "x.vti"], &["nobody"]),
    ] {
        refused(volseggs().current_dir(root).args(export).args(arguments), words);
    }
    assert!(!names(root).iter().any(|name| name.starts_with("x.")));
}
