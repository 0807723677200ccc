//! Transfer functions.

use crate::driver::{Scratch, Target, accepted, fuzz};
use std::path::PathBuf;
use volseggs::volume::transfer::TransferFunction;

/// Returns a target for the transfer function at `path`, which is used and written again.
fn target(scratch: &Scratch, path: PathBuf, seeds: &[&str]) -> Target {
    let (again, scratch) = (scratch.path("again.toml"), scratch.clone());
    let read = move |bytes: &[u8]| {
        scratch.overwrite(&path, bytes);
        let Some(function) = accepted(TransferFunction::load(&path.to_string_lossy())) else { return false };
        let _ = function.span([0.0, 1.0]);
        for sample in function.table(33) {
            assert!(sample.iter().all(|v| (-1e-5..=1.00001).contains(v)), "{sample:?}");
        }
        for x in [f64::NAN, f64::INFINITY, -1.0, 0.0, 0.5, 1.0] {
            let _ = (function.color_at(x), function.opacity_at(x), function.segment_of(x));
        }
        for segment in &function.segments {
            let _ = function.segment_color(segment);
        }
        scratch.overwrite(&again, function.to_toml().as_bytes());
        let read = TransferFunction::load(&again.to_string_lossy()).unwrap();
        assert_eq!(read, function, "unchanged by writing and reading");
        true
    };
    Target::new(seeds.iter().map(|s| s.as_bytes().to_vec()).collect(), read)
}

#[test]
fn toml() {
    fuzz("transfer-toml", |scratch| {
        let seeds = [
            "name = \"a-b\"\nunits = \"data\"\nrange = [0.0, 255.0]\ncolors = [[0, \"#000000\"], [100.5, [0.1, 0.5, 1.0]], [255, \"#ff8000\"]]\n\
             opacity = [[0, 0.0], [128, 0.5], [255, 1.0]]\nunit_length = 0.02\n[shading]\nenabled = true\nambient = 0.2\n\
             power = 3.0\n[[segments]]\nname = \"low\"\nrange = [0, 100]\ncolor = \"#123456\"\n",
            "colormap = \"viridis\"\nopacity = [[0.0, 0.1], [1.0, 0.9]]\n[[segments]]\nname = \"x\"\nrange = [0.5, 1.0]\n",
            include_str!("../../configs/transfer-functions/fire.toml"),
            include_str!("../../configs/transfer-functions/ct-bone.toml"),
        ];
        target(scratch, scratch.path("a.toml"), &seeds).tokens(&[
            "units = \"data\"\n",
            "range = [0, 1]\n",
            "colormap = \"magma\"\n",
            "colormap = \"x.json\"\n",
            "colors = []\n",
            "opacity = [[nan, 1]]\n",
            "[shading]\n",
            "[[segments]]\n",
            "color = \"#zzzzzz\"\n",
            "\"#fffffg\"",
            "nan",
            "inf",
            "\"\"\"",
            "1979-05-27T07:32:00Z",
        ])
    });
}

#[test]
fn paraview() {
    fuzz("transfer-paraview", |scratch| {
        let seeds = [
            r#"[{"ColorSpace": "Diverging", "Name": "Cool to Warm", "NanColor": [1, 1, 0],
               "RGBPoints": [0, 0.23, 0.299, 0.754, 0.5, 0.865, 0.865, 0.865, 1, 0.706, 0.016, 0.15],
               "Points": [0, 0, 0.5, 0, 1, 1, 0.3, 1]}]"#,
            r#"{"ColorSpace": "HSV", "HSVWrap": 1, "Name": "x", "RGBPoints": [-1, 0, 0, 1, 2, 1, 0, 0]}"#,
            r#"[{"ColorSpace": "Lab", "Name": "", "RGBPoints": [0, 0, 0, 0, 0, 1, 1, 1, 5, 0.5, 0.5, 0.5]},
               {"ColorSpace": "Step", "Name": "b", "RGBPoints": [0, 0, 0, 0, 1, 1, 1, 1], "IndexedColors": [1]}]"#,
        ];
        target(scratch, scratch.path("a.json"), &seeds).tokens(&[
            "\"RGB\"",
            "\"HSV\"",
            "\"Lab\"",
            "\"Lab/CIEDE2000\"",
            "\"Step\"",
            "\"Diverging\"",
            "\"RGBPoints\"",
            "\"Points\"",
            "\"IndexedColors\"",
            "1e-308",
            "1e308",
            "[0, 0, 0, 0, 1e-320, 1, 1, 1]",
        ])
    });
}
