//! `volseggs export --format nrrd|vti` as a whole program: labels on the voxels of the volume, and their Dice scores.

use crate::common::{json, names, refused, run_json, train, volseggs};
use serde_json::Value;
use std::path::Path;
use std::process::Command;
use tempfile::TempDir;
use volseggs::volume::series::{Series, SeriesOptions};
use volseggs::volume::synthetic::Synthetic;
use volseggs_testing::{Need, python_with};

fn open(path: &Path) -> Series {
    Series::open(&[path.display().to_string()], &SeriesOptions::default()).unwrap()
}

/// Trains a run on small pictures of the jets and finds its segments.
fn jets() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let few =
        "--dims 24 --series-steps 3 --times 3 --views 8 --size 32 --test-views 3 --segment-views 0 --no-label-images";
    volseggs()
        .current_dir(root)
        .args(["prepare", "--synthetic", "jets", "--out", "data"])
        .args(few.split(' '))
        .assert()
        .success();
    train(root, "run", &[]).assert().success();
    run_json(root, &["segment", "coarse", "run", "--clusters", "3"]);
    folder
}

#[test]
fn labels_use_the_voxels_of_the_volume_and_agree_with_the_ground_truth() {
    let folder = jets();
    let root = folder.path();
    let nrrd = run_json(
        root,
        &["export", "run", "--format", "nrrd", "--time", "0.5", "--out", "l.seg.nrrd", "--truth", "jets"],
    );
    assert_eq!(
        (&nrrd["dims"], &nrrd["spacing"]),
        (&serde_json::json!([24, 24, 24]), &serde_json::json!([1.0, 1.0, 1.0]))
    );
    let listed = nrrd["labels"].as_array().unwrap().clone();
    assert_eq!(listed.len(), 3);
    let scores = nrrd["agreement"]["segments"].as_array().unwrap();
    assert_eq!(scores.len(), Synthetic::Jets.segment_names().len());
    let mean = nrrd["agreement"]["mean_dice"].as_f64().unwrap();
    assert!(mean > 0.0 && mean <= 1.0, "{nrrd}");
    let matched: Vec<&Value> = scores.iter().filter(|s| !s["segment"].is_null()).collect();
    assert!(!matched.is_empty() && matched.len() <= 3, "at most one segment per true label: {nrrd}");
    assert!(matched.iter().all(|s| s["set_dice"].as_f64() >= s["dice"].as_f64()), "{nrrd}");

    let labels = open(&root.join("l.seg.nrrd")).load_labels(0).unwrap();
    assert_eq!((labels.grid.dims, labels.grid.spacing, labels.grid.origin), ([24; 3], [1.0; 3], [0.0; 3]));
    let count = |id: u16| labels.ids.iter().filter(|l| **l == id).count();
    assert_eq!(nrrd["volumes"][0]["voxels"], serde_json::json!([count(1), count(2), count(3)]));
    assert!(count(1) > 0 && count(0) > 24 * 24 * 24 / 4, "{nrrd}");
    // most labelled voxels lie in the plumes: the labels are where the volume is, neither mirrored nor shifted
    let truth = Synthetic::Jets.sample([24; 3], 0.5).1.ids;
    let both = labels.ids.iter().zip(&truth).filter(|(l, t)| **l > 0 && **t > 0).count();
    let flipped: Vec<u16> = labels.ids.chunks(24 * 24).rev().flatten().copied().collect();
    let upside_down = flipped.iter().zip(&truth).filter(|(l, t)| **l > 0 && **t > 0).count();
    assert!(both > upside_down, "{both} voxels overlap, {upside_down} upside down");
    let header = String::from_utf8_lossy(&std::fs::read(root.join("l.seg.nrrd")).unwrap()).into_owned();
    assert!(header.contains(&format!("label_1:={}", listed[0]["name"].as_str().unwrap())), "{header}");
    assert!(header.contains("as trained, without edits") && header.contains("edited:=no"), "{header}");

    // the same labels in the other format, in the default location; the table is printed
    let printed = volseggs()
        .current_dir(root)
        .args(["export", "run", "--format", "vti", "--time", "0.5", "--truth", "l.seg.nrrd"])
        .assert()
        .success();
    let printed = String::from_utf8(printed.get_output().stdout.clone()).unwrap();
    assert!(printed.contains("mean Dice 1.0000"), "{printed}");
    let vti_path = root.join("run/labels/labels.vti");
    assert_eq!(open(&vti_path).load_labels(0).unwrap(), labels);
    vtk_reads_it(&vti_path, &labels.ids);

    // one segment, other voxels, several times
    let name = listed[1]["name"].as_str().unwrap();
    let some = ["export", "run", "--format", "nrrd", "--segment", name, "--dims", "12,24,6", "--frames", "2"];
    let frames = run_json(root, &[&some[..], &["--out", "frames"]].concat());
    assert_eq!(names(&root.join("frames")), ["0000.nrrd", "0001.nrrd", "export.json"]);
    let first = open(&root.join("frames/0000.nrrd"));
    assert_eq!((first.grid().dims, first.grid().size()), ([12, 24, 6], [23.0; 3]));
    assert_eq!(frames["labels"][0]["name"], name);
    let like = run_json(root, &["export", "run", "--format", "vti", "--like", "frames/0001.nrrd", "--out", "like.vti"]);
    assert_eq!((&like["dims"], &like["spacing"]), (&frames["dims"], &frames["spacing"]));

    // labels are of the scene as trained; with --edited, hidden segments have no voxels
    let hide = format!(r#"{{"format":1,"operations":[{{"segments":["{name}"],"operation":"hide"}}],"undone":[]}}"#);
    std::fs::write(root.join("run/edits.json"), hide).unwrap();
    let hidden = run_json(root, &["export", "run", "--format", "vti", "--time", "0.5", "--edited"]);
    assert_eq!((&hidden["volumes"][0]["voxels"][1], &hidden["edited"]), (&0.into(), &true.into()));
    assert!(String::from_utf8_lossy(&std::fs::read(&vti_path).unwrap()).contains("with the edits of the run"));
    for plain in [&[][..], &["--no-edits"]] {
        let shown = run_json(root, &[&["export", "run", "--format", "vti", "--time", "0.5"], plain].concat());
        assert_eq!((&shown["volumes"][0]["voxels"], &shown["edited"]), (&nrrd["volumes"][0]["voxels"], &false.into()));
        assert!(String::from_utf8_lossy(&std::fs::read(&vti_path).unwrap()).contains("as trained"));
    }

    // a group takes no voxels from its parts; it is a label when requested
    run_json(root, &["segment", "group", "run", "pair", listed[0]["name"].as_str().unwrap(), name]);
    let grouped = run_json(root, &["export", "run", "--format", "vti", "--time", "0.5"]);
    assert_eq!(grouped["labels"], nrrd["labels"]);
    assert_eq!(grouped["volumes"][0]["voxels"], nrrd["volumes"][0]["voxels"]);
    let pair = run_json(root, &["export", "run", "--format", "vti", "--time", "0.5", "--segment", "pair"]);
    assert!(pair["labels"][0]["name"] == "pair" && pair["volumes"][0]["voxels"][0].as_u64().unwrap() > 0, "{pair}");
}

#[test]
fn invalid_label_exports_are_refused() {
    let folder = jets();
    let root = folder.path();
    let export = |more: &[&str]| {
        let mut command = volseggs();
        command.current_dir(root).args(["export", "run", "--time", "0.5"]).args(more);
        command
    };
    std::fs::write(root.join("small.npy"), npy([4, 4, 4])).unwrap();
    std::fs::write(root.join("flat.npy"), npy([8, 8, 3])).unwrap();
    for (arguments, words) in [
        (&["--format", "vti", "--segment", "nobody"][..], &["nobody", "available"][..]),
        (&["--format", "vti", "--dims", "4,4"], &["--dims", "three"]),
        (&["--format", "vti", "--dims", "4,4,1"], &["--dims", "at least 2 voxels"]),
        (&["--format", "vti", "--like", "flat.npy"], &["flat.npy", "proportions"]),
        (&["--format", "vti", "--like", "none.nrrd"], &["none.nrrd"]),
        (&["--format", "vti", "--truth", "small.npy"], &["--like", "small.npy"]),
        (&["--format", "vti", "--truth", "jets", "--dims", "8,8,8"], &["--truth jets", "--dims"]),
        (&["--format", "vti", "--data", "nowhere"], &["--data nowhere", "no such folder"]),
        (&["--format", "nrrd", "--threshold", "-1"], &["--threshold", "-1"]),
        (&["--dims", "8,8,8", "--out", "x.ply"], &["--dims", "--format nrrd"]),
    ] {
        refused(&mut export(arguments), words);
    }
    assert!(!root.join("x.ply").exists() && !root.join("run/labels").exists());
    // for a dataset without a record the voxels must be given; over the box of the scene with a note
    std::fs::remove_file(root.join("data/prepare.json")).unwrap();
    for data in [&[][..], &["--data", "data"]] {
        refused(export(&["--format", "nrrd"]).args(data), &["data has no prepare.json", "--like", "--dims"]);
        export(&["--dims", "4,4,4", "--out", "own.nrrd"]).args(data).assert().success();
        export(&["--like", "small.npy", "--out", "own.vti"]).args(data).assert().success();
    }
    let output = export(&["--format", "vti", "--dims", "8,8,8", "--out", "box.vti"]).assert().success();
    assert!(String::from_utf8_lossy(&output.get_output().stderr).contains("--like"));
    assert_eq!(open(&root.join("box.vti")).grid().dims, [8; 3]);
    std::fs::remove_file(root.join("run/segments/segments.safetensors")).unwrap();
    refused(&mut export(&["--format", "vti"]), &["segment coarse"]);
    let record = json(&root.join("run/run.json"));
    assert!(record.is_object(), "the run is unchanged");
}

/// A NumPy file of zeros, `shape` in z, y, x.
fn npy(shape: [usize; 3]) -> Vec<u8> {
    let [z, y, x] = shape;
    let mut header = format!("{{'descr': '|u1', 'fortran_order': False, 'shape': ({z}, {y}, {x}), }}");
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    bytes.resize(bytes.len() + x * y * z, 0);
    bytes
}

/// Checks that VTK's own reader gives the same labels, names and colours. Skipped without the Python package `vtk`.
fn vtk_reads_it(path: &Path, ids: &[u16]) {
    let script = r#"
import json, sys, vtk
reader = vtk.vtkXMLImageDataReader()
reader.SetFileName(sys.argv[1])
reader.Update()
image = reader.GetOutput()
labels, fields = image.GetPointData().GetScalars(), image.GetFieldData()
names, colours = fields.GetAbstractArray("label_names"), fields.GetArray("label_colours")
print(json.dumps({
    "dims": image.GetDimensions(), "spacing": image.GetSpacing(), "origin": image.GetOrigin(), "array": labels.GetName(),
    "ids": [int(labels.GetTuple1(i)) for i in range(labels.GetNumberOfTuples())],
    "names": [names.GetValue(i) for i in range(names.GetNumberOfValues())],
    "colours": [colours.GetNumberOfTuples(), colours.GetNumberOfComponents()],
}))
"#;
    let Some(python) = python_with("vtk", Need::Vtk) else { return };
    let output = Command::new(&python).args(["-c", script]).arg(path).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let read: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(read["ids"], serde_json::json!(ids));
    assert_eq!((&read["dims"], &read["array"]), (&serde_json::json!([24, 24, 24]), &"labels".into()));
    assert_eq!((&read["spacing"], &read["colours"]), (&serde_json::json!([1.0, 1.0, 1.0]), &serde_json::json!([3, 3])));
    assert_eq!(read["names"].as_array().unwrap().len(), 3);
}
