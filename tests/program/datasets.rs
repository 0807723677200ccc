//! Datasets of any size, place and picture format; and cameras that are refused.

use crate::common::{copy, dataset, json, names, refused, run_json, text, train, volseggs};
use glam::DVec3;
use image::{DynamicImage, RgbaImage};
use serde_json::{Value, json};
use std::path::Path;

/// Changes both `transforms_*.json` of the dataset `data` under `root`.
fn change(root: &Path, data: &str, change: impl Fn(&mut Value)) {
    for split in ["train", "test"] {
        let path = root.join(data).join(format!("transforms_{split}.json"));
        let mut value = json(&path);
        change(&mut value);
        std::fs::write(path, value.to_string()).unwrap();
    }
}

/// Changes every frame of the dataset `data` under `root`.
fn change_frames(root: &Path, data: &str, edit: impl Fn(&mut Value)) {
    change(root, data, |value| value["frames"].as_array_mut().unwrap().iter_mut().for_each(&edit));
}

fn psnr(root: &Path, run: &str) -> f64 {
    run_json(root, &["eval", run])["psnr"].as_f64().unwrap()
}

fn still(root: &Path, run: &str, camera: DVec3, out: &str) -> RgbaImage {
    let DVec3 { x, y, z } = camera;
    let camera = format!("{x},{y},{z}");
    let mut render = volseggs();
    render.current_dir(root).args(["render", run, "--camera", &camera, "--out", out]).assert().success();
    image::open(root.join(out).join("0000.png")).unwrap().to_rgba8()
}

#[test]
fn scenes_of_any_size_and_place_are_trained_and_drawn_alike() {
    let folder = dataset();
    let root = folder.path();
    train(root, "run", &[]).assert().success();
    let (expected, eye) = (psnr(root, "run"), DVec3::new(3.0, -2.0, 1.5));
    let picture = still(root, "run", eye, "still");
    assert_eq!(json(&root.join("run/run.json"))["normalisation"], Value::Null);
    for (name, scale, shift) in [
        ("tiny", 1e-4, DVec3::ZERO),
        ("huge", 1e4, DVec3::ZERO),
        ("far", 1.0, DVec3::new(450_000.0, 5_400_000.0, 300.0)),
        ("both", 250.0, DVec3::new(450_000.0, 5_400_000.0, 300.0)),
    ] {
        let data = format!("{name}-data");
        copy(&root.join("data"), &root.join(&data));
        change_frames(root, &data, |frame| {
            for axis in 0..3 {
                let place = &mut frame["transform_matrix"][axis][3];
                *place = json!(scale * place.as_f64().unwrap() + shift[axis]);
            }
        });
        let data = text(root, &data);
        // the last --data would be refused, so the arguments are written anew
        let mut command = volseggs();
        let arguments = crate::common::train_arguments(root, name, &[]);
        let own = text(root, "data");
        command.args(arguments.into_iter().map(|a| if a == own { data.clone() } else { a })).assert().success();
        let found = psnr(root, name);
        assert!((found - expected).abs() < 0.3, "{name}: {found} dB, {expected} dB as it was");
        // cameras are given in the dataset's coordinates
        let same = still(root, name, scale * eye + shift, &format!("{name}-still"));
        let off = picture.pixels().zip(same.pixels()).map(|(a, b)| (0..3).map(|c| a[c].abs_diff(b[c])).max().unwrap());
        let large = off.filter(|off| *off > 24).count();
        assert!(large < picture.pixels().len() / 20, "{name}: {large} pixels differ");
        let space = &json(&root.join(name).join("run.json"))["calibration"]["space"];
        let centre: Vec<f64> = (0..3).map(|a| space["centre"][a].as_f64().unwrap()).collect();
        assert!((DVec3::from_slice(&centre) - shift).length() <= 10.0 * scale, "{space}");
    }
    let unusual = run_json(root, &["inspect", "far-data"]);
    assert!(unusual["notes"][0].as_str().unwrap().contains("450000"), "{unusual}");
}

#[test]
fn views_of_a_run_lie_where_it_was_trained() {
    let folder = dataset();
    let root = folder.path();
    let moved = |frame: &mut Value| {
        let place = &mut frame["transform_matrix"][0][3];
        *place = json!(place.as_f64().unwrap() + 1e6);
    };
    change_frames(root, "data", moved);
    train(root, "run", &[]).assert().success();
    let own = psnr(root, "run");
    // other training cameras, whose own normalisation differs; and no training cameras at all
    copy(&root.join("data"), &root.join("other"));
    let path = root.join("other/transforms_train.json");
    let mut value = json(&path);
    value["frames"][0]["transform_matrix"][0][3] = json!(0.0);
    std::fs::write(&path, value.to_string()).unwrap();
    let measured = |data: &str| run_json(root, &["eval", "run", "--data", data])["psnr"].as_f64().unwrap();
    assert_eq!(measured("other"), own);
    std::fs::remove_file(&path).unwrap();
    assert_eq!(measured("other"), own);
}

#[test]
fn cameras_that_are_no_pinholes_are_refused_by_name() {
    let folder = dataset();
    let root = folder.path();
    let train_refused = |words: &[&str]| {
        refused(&mut train(root, "run", &[]), words);
        assert!(!root.join("run").exists());
        volseggs().args(["inspect", &text(root, "data")]).assert().code(2);
    };
    let with = |field: &str, value: Value, in_frames: bool, words: &[&str]| {
        if in_frames {
            change_frames(root, "data", |frame| frame[field] = value.clone());
        } else {
            change(root, "data", |top| top[field] = value.clone());
        }
        train_refused(&[&[field, "transforms_train.json"][..], words].concat());
        let clean = |value: &mut Value| drop(value.as_object_mut().unwrap().remove(field));
        if in_frames { change_frames(root, "data", clean) } else { change(root, "data", clean) }
    };
    for in_frames in [false, true] {
        for model in ["OPENCV_FISHEYE", "EQUIRECTANGULAR", "ORTHOGRAPHIC"] {
            with("camera_model", json!(model), in_frames, &[model, "only pinhole cameras"]);
        }
        with("is_fisheye", json!(true), in_frames, &["only pinhole cameras"]);
        with("k1", json!(-0.2), in_frames, &["lens distortion"]);
        with("p2", json!("0.1"), in_frames, &["lens distortion"]);
    }
    with("camera_angle_y", json!(0.1), true, &["contradicts", "camera_angle_x"]);
}

#[test]
fn jpegs_are_read_and_mixtures_with_transparency_refused() {
    let folder = dataset();
    let root = folder.path();
    // opaque pictures over the background that training composites over
    for split in ["train", "test"] {
        for name in names(&root.join("data").join(split)) {
            let path = root.join("data").join(split).join(name);
            let mut image = image::open(&path).unwrap().to_rgba8();
            for pixel in image.pixels_mut() {
                let alpha = u16::from(pixel[3]);
                (0..3).for_each(|c| pixel[c] = (u16::from(pixel[c]) * alpha / 255 + 255 - alpha) as u8);
                pixel[3] = 255;
            }
            DynamicImage::ImageRgba8(image).to_rgb8().save(&path).unwrap();
        }
    }
    let settings: &[&str] = &[];
    train(root, "png", settings).assert().success();
    for split in ["train", "test"] {
        for name in names(&root.join("data").join(split)) {
            let path = root.join("data").join(split).join(name);
            image::open(&path).unwrap().save(path.with_extension("jpg")).unwrap();
            std::fs::remove_file(path).unwrap();
        }
    }
    // `./train/r_000` finds r_000.jpg
    train(root, "jpeg", settings).assert().success();
    let [png, jpeg] = ["png", "jpeg"].map(|run| psnr(root, run));
    assert!((png - jpeg).abs() < 1.0, "{png} dB, {jpeg} dB with JPEG");
    let path = root.join("data/train/r_003.jpg");
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&path, &whole[..whole.len() * 2 / 3]).unwrap();
    refused(&mut train(root, "cut", settings), &["r_003.jpg", "not a readable JPEG"]);
    std::fs::remove_file(&path).unwrap();
    let rgba = RgbaImage::new(crate::common::SIZE, crate::common::SIZE);
    rgba.save(root.join("data/train/r_003.png")).unwrap();
    refused(
        &mut train(root, "mixed", settings),
        &["r_000.jpg", "has no alpha channel", "r_003.png has one", "transparent background"],
    );
    let report = volseggs().args(["inspect", "--json", &text(root, "data")]).assert().code(2).get_output().clone();
    let report: Value = serde_json::from_slice(&report.stdout).unwrap();
    let found = report["problems"].as_array().unwrap().iter().map(|p| p.as_str().unwrap());
    assert!(found.clone().any(|p| p.contains("r_003.png") && p.contains("alpha channel")), "{report}");
}

#[test]
fn prepared_scenes_of_any_radius_are_normalised_with_their_known_segments() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let scene = "prepare --synthetic jets --dims 24 --series-steps 3 --size 32 --times 2 --views 6 --test-views 3";
    for (name, radius) in [("usual", "4.0311"), ("small", "0.15")] {
        let mut prepare = volseggs();
        prepare.current_dir(root).args(scene.split_whitespace()).args(["--radius", radius, "--out", name]);
        prepare.assert().success();
    }
    let opened = ["usual", "small"].map(|name| {
        let options = volseggs::data::OpenOptions::default();
        volseggs::data::Dataset::open(&root.join(name), &options).unwrap()
    });
    let [usual, small] = &opened;
    let ratio = 0.15 / 4.0311;
    let (normalisation, calibrations) = (small.normalisation(), opened.each_ref().map(|d| d.calibration()));
    assert!(usual.normalisation().is_none() && normalisation.centre == DVec3::ZERO, "{normalisation:?}");
    let factor = ratio / normalisation.scale; // of scene lengths, from the usual to the small one
    for (a, b) in usual.train.frames.iter().zip(&small.train.frames) {
        assert!((factor * a.camera.position() - b.camera.position()).length() < 1e-9);
    }
    if let (Some(a), Some(b)) = (&calibrations[0].space, &calibrations[1].space) {
        assert!((a.scale / b.scale / factor - 1.0).abs() < 1e-9, "{a:?} {b:?}");
    }
    let [a, b] = ["usual", "small"].map(|name| volseggs::data::Truth::read(&root.join(name)).unwrap());
    let [at, bt] = [&a, &b].map(|truth| truth.volume(0.5).unwrap());
    for axis in 0..3 {
        assert!((factor * at.spacing[axis] / bt.spacing[axis] - 1.0).abs() < 1e-6);
        assert!((factor * at.origin[axis] / bt.origin[axis] - 1.0).abs() < 1e-6);
    }
    let place = |truth: &volseggs::data::Truth| truth.file.segments[0].frames[0].transform_matrix[2][3];
    assert!((factor * place(&a) - place(&b)).abs() < 1e-9);
    let views = [&a, &b].map(|truth| truth.views_near(0.0, 1, 1).unwrap()[0].camera.position());
    assert!((factor * views[0] - views[1]).length() < 1e-9);
}
