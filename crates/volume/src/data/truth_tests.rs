//! A dataset with label images, made here, and its errors.

use super::*;
use crate::data::Transforms;
use crate::data::fixture::claims_to_be;
use crate::data::transforms::{FrameRecord, Intrinsics};
use glam::DMat4;
use image::{GrayImage, ImageBuffer, Luma};

/// Training views at times 0, 0.5, 0.5 and 1, a test view at 0.5; 4x2 pixels, the id of a pixel is its index.
fn write(root: &Path) {
    for (split, times) in [(SplitName::Train, vec![0.0, 0.5, 0.5, 1.0]), (SplitName::Test, vec![0.5])] {
        let folder = root.join("labels").join(split.as_str());
        std::fs::create_dir_all(&folder).unwrap();
        let frames = times.iter().enumerate().map(|(i, time)| {
            GrayImage::from_fn(4, 2, |x, y| Luma([(4 * y + x) as u8])).save(folder.join(format!("r_{i}.png"))).unwrap();
            FrameRecord { file_path: format!("./{split}/r_{i}"), camera_to_world: DMat4::IDENTITY, time: *time }
        });
        let intrinsics = Intrinsics { camera_angle_x: Some(0.5), ..Intrinsics::default() };
        let json = Transforms { path: split.json_path(root), intrinsics, frames: frames.collect() };
        json.write(&json.path).unwrap();
    }
    let file = SegmentFile {
        source: "labels".into(),
        mask_alpha: 0.05,
        camera_angle_x: 0.5,
        size: [4, 2],
        label_images: vec!["./labels/train".into(), "./labels/test".into()],
        segments: Vec::new(),
        volumes: Vec::new(),
        lineage: Vec::new(),
    };
    std::fs::write(root.join(FILE), crate::versioned::to_json(&file).unwrap()).unwrap();
}

#[test]
fn names_and_paths_that_lead_out_of_the_dataset_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path());
    let good = Truth::read(folder.path()).unwrap().file;
    let frame = |file_path: &str, mask_path: &str| {
        let (file_path, mask_path) = (file_path.to_owned(), mask_path.to_owned());
        SegmentFrame {
            file_path,
            mask_path,
            transform_matrix: DMat4::IDENTITY.to_cols_array_2d(),
            time: 0.0,
            pixels: 1,
        }
    };
    let segment = |name: &str, frames| SegmentEntry { id: 1, name: name.into(), frames };
    let volume = |file: &str| VolumeEntry { time: 0.0, file: file.into() };
    let with = |segments, volumes| SegmentFile { segments, volumes, ..good.clone() };
    for (file, words) in [
        (with(vec![segment("<img src=x>", vec![])], vec![]), "segments[0].name"),
        (with(vec![segment("../up", vec![])], vec![]), "cannot be a name"),
        (with(vec![segment("a", vec![frame("/etc/passwd", "b.png")])], vec![]), "segments[0].frames[0].file_path"),
        (with(vec![segment("a", vec![frame("a.png", "./a/../../b.png")])], vec![]), "frames[0].mask_path"),
        (with(vec![], vec![volume("../v")]), "volumes[0].file"),
        (SegmentFile { label_images: vec!["/tmp/train".into()], ..good.clone() }, "label_images[0]"),
    ] {
        std::fs::write(folder.path().join(FILE), crate::versioned::to_json(&file).unwrap()).unwrap();
        let error = Truth::read(folder.path()).unwrap_err().to_string();
        assert!(error.contains(words) && error.contains(FILE), "{words}: {error}");
    }
    let fine = with(vec![segment("a", vec![frame("./a/../a.png", "b.png")])], vec![volume("./volumes/s")]);
    std::fs::write(folder.path().join(FILE), crate::versioned::to_json(&fine).unwrap()).unwrap();
    Truth::read(folder.path()).unwrap();
}

#[test]
fn views_of_the_nearest_time() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path());
    let truth = Truth::read(folder.path()).unwrap();
    let names = |time, enough| -> Vec<String> {
        truth.views_near(time, enough, 1).unwrap().into_iter().map(|v| v.name).collect()
    };
    assert_eq!(names(0.6, 2), ["train/r_1", "train/r_2"]);
    assert_eq!(names(0.6, 3), ["train/r_1", "train/r_2", "test/r_0"]);
    assert_eq!(names(0.0, 30), ["train/r_0"]);
    // views without a label image do not count
    std::fs::remove_file(folder.path().join("labels/train/r_3.png")).unwrap();
    assert_eq!(names(1.0, 2), ["train/r_1", "train/r_2"]);
}

#[test]
fn a_segment_is_pictured_at_the_times_of_views_that_show_it() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path());
    let mut truth = Truth::read(folder.path()).unwrap();
    let frame = |time: f64, pixels: usize| SegmentFrame {
        file_path: "a.png".into(),
        mask_path: "a_mask.png".into(),
        transform_matrix: DMat4::IDENTITY.to_cols_array_2d(),
        time,
        pixels,
    };
    let frames = vec![frame(0.0, 0), frame(0.5, 0), frame(0.5, 3)];
    truth.file.segments = vec![SegmentEntry { id: 4, name: "a".into(), frames }];
    assert!(truth.is_pictured(&[4], 0.5) && truth.is_pictured(&[1, 4], 0.5));
    assert!(!truth.is_pictured(&[4], 0.0) && !truth.is_pictured(&[4], 1.0) && !truth.is_pictured(&[1], 0.5));
}

#[test]
fn ids_of_8_and_16_bits_at_both_sizes() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path());
    let truth = Truth::read(folder.path()).unwrap();
    let full = &truth.views_near(0.0, 1, 1).unwrap()[0];
    assert_eq!(truth.labels(full).unwrap(), [0, 1, 2, 3, 4, 5, 6, 7]);
    let half = &truth.views_near(0.0, 1, 2).unwrap()[0];
    assert_eq!((half.camera.width, half.camera.height), (2, 1));
    assert_eq!(truth.labels(half).unwrap(), [5, 7]);
    let wide: ImageBuffer<Luma<u16>, Vec<u16>> = ImageBuffer::from_fn(4, 2, |x, _| Luma([300 * x as u16]));
    wide.save(&full.path).unwrap();
    assert_eq!(truth.labels(full).unwrap()[..4], [0, 300, 600, 900]);
    assert!(truth.views_near(0.0, 1, 3).unwrap_err().to_string().contains("3 does not divide"));
}

#[test]
fn wrong_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    assert!(Truth::read(root).unwrap_err().to_string().contains("volseggs prepare"));
    write(root);
    let mut truth = Truth::read(root).unwrap();
    let view = truth.views_near(0.0, 1, 1).unwrap().remove(0);
    let fails = |words: &str| {
        let error = truth.labels(&view).unwrap_err().to_string();
        assert!(error.contains("r_0.png") && error.contains(words), "{error}");
    };
    GrayImage::new(4, 3).save(&view.path).unwrap();
    fails("4x3");
    image::RgbImage::new(4, 2).save(&view.path).unwrap();
    fails("grey");
    std::fs::write(&view.path, "text").unwrap();
    fails("PNG");
    std::fs::write(&view.path, claims_to_be(60_000, 30_000).unwrap()).unwrap();
    fails("more than its");
    truth.file.label_images.clear();
    assert!(truth.views_near(0.0, 1, 1).unwrap_err().to_string().contains("label_images"));
    std::fs::write(root.join(FILE), "{").unwrap();
    assert!(Truth::read(root).unwrap_err().to_string().contains("line 1"));
}
