//! What a series takes from the names of its files, their arrays and their types.

use super::tests::{dir, here, one, open, refused};
use super::*;
use std::fs::write;
use tempfile::TempDir;

#[test]
fn several_numbers_and_dates_give_order_and_times() {
    let d = dir();
    let names = ["sim_20240131_235900", "sim_20240201_000000", "sim_20240201_000300"];
    let files = names.map(|n| one(&d, &format!("{n}.nrrd"), &[0.0, 1.0]));
    let folder = |d: &TempDir| open(&[here(d, "")]).unwrap();
    for s in [folder(&d), open(&files).unwrap(), open(&[here(&d, "sim*")]).unwrap()] {
        assert_eq!((0..3).map(|k| s.time(k)).collect::<Vec<_>>(), [0.0, 0.25, 1.0]);
        assert!(s.notes().iter().any(|n| n.contains("20240131_235900 to 20240201_000300")), "{:?}", s.notes());
    }
    let s = folder(&d);
    assert_eq!((s.time_values(), s.time_unit()), (Some(&[0.0, 60.0, 240.0][..]), Some("s")));
    let hours = SeriesOptions { time_unit: Some("h".into()), ..Default::default() };
    let message = Series::open(&files, &hours).map(|s| s.len()).unwrap_err().to_string();
    assert!(message.contains("give times in s, not h"), "{message}");
    let even = SeriesOptions { times: Some(vec![0.0, 1.0, 2.0]), ..Default::default() };
    assert_eq!(Series::open(&[here(&d, "")], &even).unwrap().time(1), 0.5);
    let swapped = [1, 0, 2].map(|i| files[i].clone());
    let message = refused(&swapped);
    assert!(message.contains("its date 20240131_235900 follows 20240201_000000"), "{message}");
    assert!(message.contains("list the files in order") && message.contains("or a pattern"), "{message}");

    let d = dir();
    for name in ["cycle01_step98", "cycle01_step99", "cycle02_step00"] {
        one(&d, &format!("{name}.nrrd"), &[0.0, 1.0]);
    }
    let s = folder(&d);
    assert_eq!([0, 2].map(|k| s.name(k)), ["cycle01_step98.nrrd", "cycle02_step00.nrrd"]);
    assert!(
        s.notes().iter().any(|n| n.contains("02_step00 follows 01_step99: taken for one series")),
        "{:?}",
        s.notes()
    );
}

#[test]
fn hints_do_not_advise_what_was_done() {
    // two series in one folder, and two folders of one each
    let d = dir();
    for name in ["a_1", "a_2", "b_1"] {
        one(&d, &format!("{name}.nrrd"), &[0.0, 1.0]);
    }
    let message = refused(&[here(&d, "*.nrrd")]);
    assert!(message.contains("these are several series") && message.contains("one by one"), "{message}");
    assert!(!message.contains("in quotes"), "{message}");
    let d = dir();
    for run in ["run1", "run2"] {
        std::fs::create_dir(d.path().join(run)).unwrap();
    }
    let files = ["run1/t0", "run1/t1", "run2/t0"].map(|n| one(&d, &format!("{n}.nrrd"), &[0.0, 1.0]));
    let message = refused(&[here(&d, "run*/t*.nrrd")]);
    assert!(message.contains("the steps begin again") && message.contains("one by one"), "{message}");
    assert_eq!(open(&files).unwrap().len(), 3, "listed one by one");
}

#[test]
fn decimal_times_that_are_not_even_are_noted() {
    let d = dir();
    let files = ["t0.25", "t0.5", "t1.5"].map(|n| one(&d, &format!("{n}.nrrd"), &[0.0, 1.0]));
    let s = open(&files).unwrap();
    assert!(s.time(1) == 0.5 && s.notes().iter().any(|n| n.contains("not evenly spaced")), "{:?}", s.notes());
    assert!(open(&files[..2]).unwrap().notes().is_empty());
}

/// A VTI file of 2 x 1 x 1 points with arrays of constant values, the first of which is active.
fn vti(folder: &TempDir, name: &str, arrays: &[(&str, f32)]) -> String {
    let array = |(name, v): &(&str, f32)| {
        format!("<DataArray type=\"Float32\" Name=\"{name}\" format=\"ascii\">{v} {v}</DataArray>")
    };
    let content: String = arrays.iter().map(array).collect();
    let text = format!(
        "<VTKFile type=\"ImageData\"><ImageData WholeExtent=\"0 1 0 0 0 0\"><Piece Extent=\"0 1 0 0 0 0\">\
         <PointData Scalars=\"{}\">{content}</PointData></Piece></ImageData></VTKFile>",
        arrays[0].0
    );
    let path = folder.path().join(name);
    write(&path, text).unwrap();
    path.to_string_lossy().into_owned()
}

#[test]
fn a_series_reads_the_same_array_from_every_file() {
    let d = dir();
    let files = [
        vti(&d, "t0.vti", &[("rho", 1.0), ("p", 10.0)]),
        // another one is active, and the order differs
        vti(&d, "t1.vti", &[("p", 20.0), ("rho", 2.0)]),
        vti(&d, "t2.vti", &[("rho", 3.0), ("p", 30.0)]),
    ];
    let values = |s: &Series| (0..s.len()).map(|k| s.load(k).unwrap().values[0]).collect::<Vec<_>>();
    let s = open(&files).unwrap();
    assert_eq!((s.variable(), values(&s)), (Some("rho"), vec![1.0, 2.0, 3.0]));
    let named = |name: &str| SeriesOptions { variable: Some(name.into()), ..Default::default() };
    let s = Series::open(&files, &named("p")).unwrap();
    assert_eq!((s.variable(), values(&s)), (Some("p"), vec![10.0, 20.0, 30.0]));
    assert_eq!(s.variables().unwrap().len(), 2);
    let lacking = [files[0].clone(), vti(&d, "t3.vti", &[("p", 1.0), ("T", 2.0)])];
    assert!(
        refused(&lacking).contains("t3.vti: PointData: there is no array \"rho\" among p, T"),
        "{}",
        refused(&lacking)
    );
    let message = Series::open(&files, &named("u")).map(|s| s.len()).unwrap_err().to_string();
    assert!(message.contains("t0.vti") && message.contains("no array \"u\" among rho, p"), "{message}");
    let plain = one(&d, "a.nrrd", &[0.0, 1.0]);
    let message = Series::open(&[plain], &named("u")).map(|s| s.len()).unwrap_err().to_string();
    assert!(message.contains("--variable: \"u\" is requested, but such files hold one field"), "{message}");
}

#[test]
fn what_single_precision_loses_is_said() {
    let d = dir();
    let path = d.path().join("a.nrrd");
    let rounding = |kind: &str, bytes: Vec<u8>| {
        let head = format!("NRRD0004\ntype: {kind}\ndimension: 3\nsizes: 2 1 1\nendian: little\nencoding: raw\n\n");
        write(&path, [head.as_bytes(), &bytes].concat()).unwrap();
        let s = open(&[here(&d, "a.nrrd")]).unwrap();
        assert_eq!(s.rounding(), None, "not before the values are known");
        s.range().unwrap();
        s.rounding()
    };
    let whole = |a: i64, b: i64| [a, b].iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let real = |a: f64, b: f64| [a, b].iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    assert_eq!(rounding("longlong", whole(-5, 1 << 24)), None);
    let lost = rounding("longlong", whole(0, (1 << 30) + 1)).unwrap();
    assert!(lost.contains("i64 up to 1073741824 are rounded to single precision, by at most 64"), "{lost}");
    assert!(!lost.contains("subtract"), "{lost}");
    assert_eq!(rounding("double", real(0.0, 1e30)), None);
    let lost = rounding("double", real(1e9, 1e9 + 1000.0)).unwrap();
    assert!(lost.contains("by at most 32") && lost.contains("subtract a constant"), "{lost}");
    assert_eq!(rounding("uint", [0u32, 7].iter().flat_map(|v| v.to_le_bytes()).collect()), None);
    assert!(rounding("uint", [0u32, u32::MAX].iter().flat_map(|v| v.to_le_bytes()).collect()).is_some());
    // labels are exact or refused
    let head = "NRRD0004\ntype: longlong\ndimension: 3\nsizes: 2 1 1\nendian: little\nencoding: raw\n\n";
    for (label, fine) in [(65535, true), (65536, false), ((1 << 53) + 1, false), (-1, false)] {
        write(&path, [head.as_bytes(), &whole(0, label)].concat()).unwrap();
        assert_eq!(open(&[here(&d, "a.nrrd")]).unwrap().load_labels(0).is_ok(), fine, "{label}");
    }
}
