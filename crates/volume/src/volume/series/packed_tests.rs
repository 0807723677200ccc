//! Series in compressed files and in one file of many steps.

use super::tests::{dir, open, refused};
use super::*;
use std::fs::write;
use tempfile::TempDir;

/// A gzip-compressed 4D file, time last or first.
fn packed(folder: &TempDir, name: &str, sizes: &str, kinds: &str, values: impl Iterator<Item = f32>) -> String {
    let head = format!(
        "NRRD0004\ntype: float\ndimension: 4\nsizes: {sizes}\nkinds: {kinds}\nendian: little\nencoding: gzip\n\n"
    );
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    let bytes: Vec<u8> = values.flat_map(f32::to_le_bytes).collect();
    std::io::Write::write_all(&mut encoder, &bytes).unwrap();
    let path = folder.path().join(name);
    write(&path, [head.as_bytes(), &encoder.finish().unwrap()].concat()).unwrap();
    path.to_string_lossy().into_owned()
}

#[test]
fn many_small_compressed_steps_are_unpacked_together() {
    let d = dir();
    // step by step, 3e12 bytes would be decompressed
    let steps = 1_000_000;
    for (name, sizes, kinds) in [
        ("last.nrrd", format!("2 1 1 {steps}"), "domain domain domain time"),
        ("first.nrrd", format!("{steps} 2 1 1"), "time domain domain domain"),
    ] {
        let series = open(&[packed(&d, name, &sizes, kinds, (0..2 * steps).map(|k| k as f32 - 7.0))]).unwrap();
        assert_eq!((series.len(), series.range().unwrap()), (steps, [-7.0, 1_999_992.0]));
    }
    let with_nan = |k: usize| if k == 2 * steps - 1 { f32::NAN } else { k as f32 };
    let sizes = format!("2 1 1 {steps}");
    let file = packed(&d, "nan.nrrd", &sizes, "domain domain domain time", (0..2 * steps).map(with_nan));
    let message = open(std::slice::from_ref(&file)).unwrap().range().unwrap_err().to_string();
    assert!(message.contains("nan.nrrd[999999]") && message.contains("x=1 y=0 z=0"), "{message}");
    let options = SeriesOptions { nan_as: Some(-1.0), ..SeriesOptions::default() };
    assert_eq!(Series::open(&[file], &options).unwrap().range().unwrap(), [0.0, 1_999_998.0]);
}

#[test]
fn steps_of_one_file_are_read_together_as_they_are_one_by_one() {
    let d = dir();
    for (name, sizes, kinds) in
        [("last.nrrd", "2 1 1 5", "domain domain domain time"), ("first.nrrd", "5 2 1 1", "time domain domain domain")]
    {
        let path = packed(&d, name, sizes, kinds, (0..10).map(|k| k as f32));
        let file = formats::open(Path::new(&path)).unwrap();
        let (mut one, mut together) = (Vec::new(), Vec::new());
        for steps in [0..5, 1..3, 4..5] {
            let mut all = Vec::new();
            for step in steps.clone() {
                file.read(step, &mut one).unwrap();
                all.extend_from_slice(&one);
            }
            file.read_range(steps.clone(), &mut together).unwrap();
            assert_eq!(together, all, "{name} {steps:?}");
        }
        assert!(file.read_range(3..6, &mut together).is_err());
    }
}

#[test]
fn compressed_files_that_would_be_unpacked_for_days_are_refused() {
    let d = dir();
    let steps = 2_000_000;
    let file =
        packed(&d, "a.nrrd", &format!("{steps} 1 1 1"), "time domain domain domain", std::iter::repeat_n(0.0, steps));
    let message = refused(&[file]);
    assert!(message.contains("encoding") && message.contains("time as the last axis"), "{message}");
}
