//! Small datasets on disk, whole and broken.

use super::*;
use crate::data::fixture::write_sphere_dataset;
use image::{Rgba, RgbaImage};

/// A dataset of `n` views of a sphere per split, `size` pixels square.
pub(crate) fn dataset(n: usize, size: u32) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_sphere_dataset(folder.path(), n, size).unwrap();
    folder
}

#[test]
fn loads_only_what_is_named() {
    let folder = dataset(4, 8);
    let open = |splits: &[SplitName]| {
        Dataset::open(folder.path(), &OpenOptions { downscale: 2, splits, max_views: None }).unwrap()
    };
    let train = open(&[SplitName::Train]);
    assert_eq!((train.train.images.len(), train.train.images.width, train.train.frames[0].camera.width), (4, 4, 4));
    assert!(train.test.is_none() && train.val.is_none() && train.split(SplitName::Test).is_none());
    assert_eq!(train.times(), [0.0, 1.0]);
    let test = open(&[SplitName::Test]);
    assert!(test.train.images.is_empty() && test.train.frames.len() == 4);
    assert_eq!(test.test.as_ref().unwrap().images.len(), 4);
    assert_eq!(test.fingerprint(), train.fingerprint());
    assert_eq!(Dataset::present(folder.path()), [SplitName::Train, SplitName::Test]);
    assert_eq!("val".parse::<SplitName>(), Ok(SplitName::Val));
    assert!("tset".parse::<SplitName>().unwrap_err().contains("train, val or test"));
}

#[test]
fn views_are_thinned_evenly_and_errors_keep_the_file_number() {
    let folder = dataset(4, 8);
    let split = read_split(folder.path(), SplitName::Train, 1, Some(2), None).unwrap();
    assert_eq!(split.frames.iter().map(|f| f.name.as_str()).collect::<Vec<_>>(), ["r_0", "r_2"]);
    let text = read_split(folder.path(), SplitName::Train, 1, Some(0), None).unwrap_err().to_string();
    assert!(text.contains("max_views"), "{text}");
    std::fs::remove_file(folder.path().join("train/r_2.png")).unwrap();
    let error = read_split(folder.path(), SplitName::Train, 1, Some(2), None).unwrap_err();
    assert_eq!(error.frame(), Some(2));
}

#[test]
fn the_fingerprint_follows_the_data() {
    let folder = dataset(4, 8);
    let open = |downscale| {
        let options = OpenOptions { downscale, ..OpenOptions::default() };
        Dataset::open(folder.path(), &options).unwrap().fingerprint()
    };
    let first = open(1);
    assert_eq!((first.len(), &first), (16, &open(1)));
    assert_ne!(first, open(2));
    RgbaImage::from_fn(8, 8, |x, y| Rgba([(x * 31 + y * 57) as u8, x as u8, y as u8, 9]))
        .save(folder.path().join("train/r_1.png"))
        .unwrap();
    assert_ne!(first, open(1));
}

/// Opening must fail with a message that contains all of `words`.
fn refused(folder: &Path, words: &[&str]) {
    let text = Dataset::open(folder, &OpenOptions::default()).unwrap_err().to_string();
    assert!(words.iter().chain(&["Hint: "]).all(|w| text.contains(w)), "{text}");
}

#[test]
fn bad_folders_and_images_are_refused() {
    let empty = tempfile::tempdir().unwrap();
    refused(empty.path(), &["transforms_train.json", "cannot read"]);

    let folder = dataset(4, 8);
    RgbaImage::new(6, 8).save(folder.path().join("train/r_3.png")).unwrap();
    refused(folder.path(), &["r_0.png is 8x8", "r_3.png is 6x8", "frame 3"]);
    std::fs::write(folder.path().join("train/r_3.png"), b"GIF89a").unwrap();
    refused(folder.path(), &["r_3.png", "not a readable PNG", "frame 3"]);
    let whole = std::fs::read(folder.path().join("train/r_1.png")).unwrap();
    std::fs::write(folder.path().join("train/r_3.png"), &whole[..whole.len() - 20]).unwrap();
    refused(folder.path(), &["r_3.png", "not a readable PNG", "frame 3"]);
    std::fs::remove_file(folder.path().join("train/r_3.png")).unwrap();
    refused(folder.path(), &["r_3.png", "missing", "frame 3", "transforms_train.json"]);
    std::fs::remove_file(folder.path().join("train/r_0.png")).unwrap();
    refused(folder.path(), &["r_0.png", "missing", "frame 0"]);

    let folder = dataset(4, 9);
    let options = OpenOptions { downscale: 2, ..OpenOptions::default() };
    let text = Dataset::open(folder.path(), &options).unwrap_err().to_string();
    assert!(text.contains("2 does not divide the image size 9x9") && text.contains("1, 3, 9"), "{text}");

    let path = SplitName::Train.json_path(folder.path());
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replacen('{', "{\"fl_x\": 9, \"w\": 18, \"h\": 9,", 1)).unwrap();
    refused(folder.path(), &["field `w`", "aspect ratio"]);
    let options = OpenOptions { splits: &[SplitName::Val], ..OpenOptions::default() };
    std::fs::write(&path, &text).unwrap();
    let text = Dataset::open(folder.path(), &options).unwrap_err().to_string();
    assert!(text.contains("transforms_val.json"), "{text}");
}

#[test]
fn published_dataset() {
    let Some(root) = test_data() else { return };
    let options = OpenOptions { downscale: 4, splits: &SplitName::ALL, max_views: Some(60) };
    let dataset = Dataset::open(&root, &options).unwrap();
    let all = OpenOptions { downscale: 1, splits: &[], max_views: None };
    let extent = Dataset::open(&root, &all).unwrap().scene_extent();
    assert!((extent - 4.4343).abs() < 1e-3, "{extent}");
    let all = Transforms::read(&SplitName::Train.json_path(&root)).unwrap();
    assert_eq!(all.frames.len(), 600);
    let cameras = dataset.train.frames.iter().map(|f| &f.camera);
    let (point, error) = crate::data::camera::look_at_point(cameras).unwrap();
    assert!(point.length() < 1e-5 && error < 1e-5);
    assert_eq!((dataset.train.images.width, dataset.train.images.len()), (100, 60));
    assert!((dataset.train.frames[0].camera.fx - 50.0 / 15f64.to_radians().tan()).abs() < 1e-9);
}

#[test]
fn two_frames_of_one_image_are_refused_with_both_numbers() {
    let folder = dataset(4, 8);
    let path = folder.path().join("transforms_train.json");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace("./train/r_3", "train/../train/r_1.png")).unwrap();
    for splits in [&[][..], &[SplitName::Train]] {
        let options = OpenOptions { downscale: 1, splits, max_views: None };
        let text = Dataset::open(folder.path(), &options).unwrap_err().to_string();
        assert!(["frame 3", "frame 1", "`file_path`"].iter().all(|w| text.contains(w)), "{text}");
    }
    let report = crate::data::inspect::inspect(folder.path());
    assert!(report.problems.iter().any(|p| p.contains("frame 3") && p.contains("frame 1")), "{report:#?}");
}

#[test]
fn a_camera_too_far_away_is_reported() {
    let folder = dataset(2, 8);
    let path = folder.path().join("transforms_train.json");
    let mut json: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    for (far, name) in [(1e300, "1e300"), (-2e15, "-2e15")] {
        json["frames"][1]["transform_matrix"][0][3] = far.into();
        std::fs::write(&path, json.to_string()).unwrap();
        let text = Dataset::open(folder.path(), &OpenOptions::default()).unwrap_err().to_string();
        let words = [format!("entry (0, 3) is {name}, too large: at most 1e15"), "transform_matrix".into()];
        assert!(words.iter().all(|w| text.contains(w)) && text.contains("frame 1"), "{text}");
    }
}

#[test]
fn cameras_at_one_place_still_give_a_scene_extent() {
    let folder = dataset(6, 8);
    let options = OpenOptions { downscale: 1, splits: &[SplitName::Train], max_views: None };
    let mut frames = Dataset::open(folder.path(), &options).unwrap().train.frames;
    let spread = scene_extent(&frames);
    assert!((2.0..=8.8).contains(&spread), "{spread}");
    let first = frames[0].camera.camera_to_world;
    frames.iter_mut().for_each(|f| f.camera.camera_to_world = first);
    // cameras lie on a sphere of radius 4
    assert!((scene_extent(&frames) - 4.4).abs() < 1e-6);
    assert_eq!(scene_extent(&[]), 0.0);
}
