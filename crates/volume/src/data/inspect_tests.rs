//! Whole, broken and missing folders.

use super::*;
use crate::data::dataset::tests::dataset;

fn failing(report: &DatasetReport) -> Vec<&str> {
    report.checks.iter().filter(|c| !c.ok).map(|c| c.name.as_str()).collect()
}

#[test]
fn a_good_folder_passes() {
    let folder = dataset(8, 16);
    let report = inspect(folder.path());
    assert!(report.ok() && report.problems.is_empty(), "{report:#?}");
    let train = &report.splits[0];
    assert_eq!((train.frames, train.resolution, train.times), (8, Some([16, 16]), 2));
    assert_eq!((train.views_per_time, train.missing_images), (Some([4, 4]), 0));
    assert!((train.camera_radius.unwrap()[0] - 4.0).abs() < 1e-6 && train.look_at_error.unwrap() < 1e-6);
    let text = serde_json::to_string(&report).unwrap();
    assert_eq!(serde_json::from_str::<DatasetReport>(&text).unwrap(), report);
}

#[test]
fn all_problems_are_gathered() {
    let folder = dataset(8, 16);
    std::fs::remove_file(folder.path().join("train/r_1.png")).unwrap();
    std::fs::write(folder.path().join("train/r_2.png"), b"no").unwrap();
    image::RgbaImage::new(3, 3).save(folder.path().join("train/r_3.png")).unwrap();
    let path = folder.path().join("transforms_train.json");
    let text = std::fs::read_to_string(&path).unwrap();
    let mut json: serde_json::Value = serde_json::from_str(&text).unwrap();
    json["frames"][5]["time"] = 2.into();
    json["frames"][6]["transform_matrix"][0][0] = 9.into();
    std::fs::write(&path, json.to_string()).unwrap();
    std::fs::write(folder.path().join("transforms_test.json"), &text[..100]).unwrap();
    let report = inspect(folder.path());
    let expected = [
        "train: json",
        "train: poses",
        "train: images present",
        "train: images readable",
        "train: resolution",
        "test: json",
    ];
    assert_eq!(failing(&report), expected, "{report:#?}");
    assert_eq!(report.problems.len(), 6, "{:#?}", report.problems);
    for words in ["frame 5, field `time`", "frame 6, field `transform_matrix`", "r_1.png", "r_3.png", "ends too early"]
    {
        assert!(report.problems.iter().any(|p| p.contains(words)), "{words}: {:#?}", report.problems);
    }
}

#[test]
fn what_training_refuses_fails_and_what_it_accepts_passes() {
    let folder = dataset(8, 16);
    for i in 0..8 {
        let path = folder.path().join(format!("train/r_{i}.png"));
        let mut image = image::open(&path).unwrap().to_rgba8();
        image.pixels_mut().for_each(|p| p.0[3] = 255);
        image.save(&path).unwrap();
    }
    let report = inspect(folder.path());
    let alpha = report.checks.iter().find(|c| c.name == "train: alpha").unwrap();
    assert!(alpha.ok && alpha.detail.contains("no transparency"), "{report:#?}");

    let path = folder.path().join("transforms_train.json");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replacen('{', "{\"fl_x\": 9, \"w\": 18, \"h\": 9,", 1)).unwrap();
    let report = inspect(folder.path());
    assert!(failing(&report).contains(&"train: aspect"), "{report:#?}");
    assert!(report.problems.iter().any(|p| p.contains("field `w`")), "{:#?}", report.problems);
}

#[test]
fn empty_and_missing_folders_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let report = inspect(folder.path());
    assert_eq!((report.ok(), report.problems.len()), (false, 2));
    assert!(!inspect(&folder.path().join("none")).ok());
}

#[test]
fn published_dataset() {
    let Some(root) = crate::data::dataset::test_data() else {
        return;
    };
    let report = inspect(&root);
    assert!(report.ok(), "{:#?}", report.checks);
    let train = &report.splits[0];
    assert_eq!((train.frames, train.times, train.views_per_time), (600, 30, Some([20, 20])));
    assert!((train.fov_x_degrees.unwrap() - 30.0).abs() < 1e-9 && train.orthonormality_error < 1e-6);
    assert!((0.1..0.2).contains(&train.alpha_coverage.unwrap()), "{:?}", train.alpha_coverage);
    assert!(report.notes.iter().any(|n| n.contains("test is byte-for-byte identical to val")));
}
