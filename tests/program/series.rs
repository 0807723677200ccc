//! Series of volumes as users have them: arrays by name, dates in file names, formats that are not read.

use crate::common::{json, refused, run_json, text, volseggs};
use std::path::Path;

const FEW: [&str; 8] = ["--size", "16", "--times", "3", "--views", "2", "--test-views", "3"];

/// A VTI file of 4 x 4 x 4 points with arrays of ramps, times a factor each; the first is active.
fn write_vti(path: &Path, arrays: &[(&str, usize)]) {
    let values = |factor: usize| (0..64).map(|i| (i * factor).to_string()).collect::<Vec<_>>().join(" ");
    let array = |(name, factor): &(&str, usize)| {
        format!("<DataArray type=\"Float32\" Name=\"{name}\" format=\"ascii\">{}</DataArray>", values(*factor))
    };
    let active = arrays[0].0;
    let text = format!(
        "<VTKFile type=\"ImageData\"><ImageData WholeExtent=\"0 3 0 3 0 3\"><Piece Extent=\"0 3 0 3 0 3\"><PointData \
         Scalars=\"{active}\">{}<DataArray type=\"Float32\" Name=\"u\" NumberOfComponents=\"3\" format=\"ascii\">{}\
         </DataArray></PointData></Piece></ImageData></VTKFile>",
        arrays.iter().map(array).collect::<String>(),
        "0 ".repeat(192)
    );
    std::fs::write(path, text).unwrap();
}

#[test]
fn arrays_are_chosen_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write_vti(&root.join("t0.vti"), &[("rho", 1), ("p", 100)]);
    write_vti(&root.join("t1.vti"), &[("p", 200), ("rho", 2)]);
    write_vti(&root.join("t2.vti"), &[("rho", 3), ("p", 300)]);
    let shown = run_json(root, &["inspect", "t*.vti"]);
    assert_eq!((&shown["variable"], &shown["range"]), (&"rho".into(), &serde_json::json!([0.0, 189.0])));
    assert_eq!(shown["variables"][2], serde_json::json!({ "name": "u", "components": 3 }));
    let shown = run_json(root, &["inspect", "t*.vti", "--variable", "p"]);
    assert_eq!((&shown["variable"], &shown["range"]), (&"p".into(), &serde_json::json!([0.0, 18900.0])));
    let output = volseggs().current_dir(root).args(["inspect", "t1.vti"]).assert().success().get_output().clone();
    let printed = String::from_utf8(output.stdout).unwrap();
    assert!(printed.contains("arrays   p (read), rho, u (3 components)\n"), "{printed}");
    let prepare = |more: &[&str]| {
        let mut command = volseggs();
        command.current_dir(root).args(["prepare", "--volume", "t*.vti", "--out", "data"]).args(FEW).args(more);
        command
    };
    refused(&mut prepare(&["--variable", "T"]), &["t0.vti", "no array \"T\" among rho, p, u (3 components)"]);
    refused(&mut prepare(&["--variable", "u"]), &["t0.vti", "\"u\": has 3 components", "magnitude"]);
    refused(&mut prepare(&["--label-variable", "p"]), &["--labels"]);
    prepare(&["--variable", "p"]).assert().success();
    let record = json(&root.join("data/prepare.json"));
    assert_eq!(record["span"], serde_json::json!([0.0, 18900.0]));
    assert!(record["source"].as_str().unwrap().contains("(p, 4x4x4, 3 steps)"), "{record}");
}

#[test]
fn dates_in_names_give_the_times() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    for (name, factor) in
        [("wrf_2024-01-31_18:00:00", 1), ("wrf_2024-02-01_00:00:00", 2), ("wrf_2024-02-02_00:00:00", 3)]
    {
        write_vti(&root.join(format!("{name}.vti")), &[("rho", factor)]);
    }
    let mut prepare = volseggs();
    prepare.current_dir(root).args(["prepare", "--volume", ".", "--out", "data"]).args(FEW);
    let output = prepare.assert().success().get_output().clone();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("2024-01-31_18:00:00 to 2024-02-02_00:00:00"), "{said}");
    let frames = json(&root.join("data/transforms_train.json"));
    let mut times: Vec<f64> =
        frames["frames"].as_array().unwrap().iter().map(|f| f["time"].as_f64().unwrap()).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    assert_eq!(times, [0.0, 0.2, 1.0]);
}

#[test]
fn formats_that_are_not_read_are_named() {
    let folder = tempfile::tempdir().unwrap();
    for (name, words) in
        [("a.npz", "numpy.save"), ("a.hdr", "one .nii or .nii.gz file"), ("a.pvti", "save it from ParaView")]
    {
        let file = text(folder.path(), name);
        std::fs::write(&file, "x").unwrap();
        refused(volseggs().args(["inspect", &file]), &[name, words]);
        let out = text(folder.path(), "out");
        refused(
            volseggs().args(["prepare", "--volume", &file, "--transfer-function", "fire", "--out", &out]),
            &[name, words],
        );
    }
}
