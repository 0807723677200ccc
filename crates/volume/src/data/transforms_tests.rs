//! Bad input of every kind, the round trip, and mutations that must never panic.

use proptest::prelude::*;
use serde_json::{Value, json};

use super::*;

impl DataError {
    /// The frame that the error is about, counted from 0, where there is one.
    pub(crate) fn frame(&self) -> Option<usize> {
        match self {
            Self::Syntax { frame, .. } | Self::Field { frame, .. } => *frame,
            Self::Image { frame, .. } | Self::MixedResolution { frame, .. } => Some(*frame),
            Self::Io { .. } | Self::Option { .. } | Self::EmptyHull { .. } => None,
        }
    }

    /// The JSON field or the option that the error is about, where there is one.
    pub(crate) fn field(&self) -> Option<&str> {
        match self {
            Self::Field { field, .. } => Some(field),
            Self::Option { option, .. } => Some(option),
            Self::Image { .. } | Self::MixedResolution { .. } => Some("file_path"),
            Self::Io { .. } | Self::Syntax { .. } | Self::EmptyHull { .. } => None,
        }
    }
}

fn identity() -> Value {
    json!([[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]])
}

fn valid() -> Value {
    let frame = |i: usize| json!({"file_path": format!("./train/r_{i}"), "transform_matrix": identity(), "time": 0.25 * i as f64});
    json!({"camera_angle_x": 0.5, "frames": (0..4).map(frame).collect::<Vec<_>>()})
}

fn parse(value: &Value) -> Result<Transforms, DataError> {
    Transforms::parse(Path::new("data/transforms_train.json"), &value.to_string())
}

/// The change must be refused with an error that names file, frame, field and all of `words`.
fn refused(change: impl Fn(&mut Value), frame: Option<usize>, field: &str, words: &str) {
    let mut value = valid();
    change(&mut value);
    let error = parse(&value).unwrap_err();
    assert_eq!((error.frame(), error.field()), (frame, Some(field)), "{error}");
    let text = error.to_string();
    assert!(text.contains("transforms_train.json") && text.contains("Hint: ") && text.contains(words), "{text}");
    if let Some(i) = frame {
        assert!(text.contains(&format!("frame {i}")) && text.contains(field), "{text}");
    }
}

#[test]
fn reads_and_cleans_the_bottom_row() {
    let mut value = valid();
    value["frames"][2]["transform_matrix"][3] = json!([1e-8, 1e-8, 1e-8, 1.00000001]);
    let got = parse(&value).unwrap();
    assert_eq!((got.frames.len(), got.frames[2].time, got.intrinsics.camera_angle_x), (4, 0.5, Some(0.5)));
    assert_eq!(got.frames[2].camera_to_world.row(3), glam::DVec4::W);
    assert_eq!(got.frames[2].camera_to_world.w_axis, glam::DVec4::new(0.5, 0.0, 4.0, 1.0));
    assert_eq!(got.frames[0].image_path(Path::new("d")), Path::new("d/train/r_0.png"));
    assert_eq!(got.frames[0].name(), "r_0");
}

#[test]
fn extension_is_optional() {
    let record = |p: &str| FrameRecord { file_path: p.into(), camera_to_world: DMat4::IDENTITY, time: 0.0 };
    for (p, path, name) in
        [("a/r_1.5", "a/r_1.5.png", "r_1.5"), ("a/r.PNG", "a/r.PNG", "r"), ("é", "é.png", "é"), ("x", "x.png", "x")]
    {
        assert_eq!(record(p).image_path(Path::new("")), Path::new(path));
        assert_eq!(record(p).name(), name);
    }
}

#[test]
fn frames_of_one_name_are_told_apart_by_their_folders() {
    let record = |p: &str| FrameRecord { file_path: p.into(), camera_to_world: DMat4::IDENTITY, time: 0.0 };
    let names = |paths: &[&str]| frame_names(&paths.iter().map(|p| record(p)).collect::<Vec<_>>());
    assert_eq!(names(&["./test/r_0", "./test/r_1.png"]), ["r_0", "r_1"]);
    assert_eq!(names(&["./cam0/0001", "cam1/0001.png", "cam1/0002"]), ["cam0/0001", "cam1/0001", "0002"]);
}

#[test]
fn bad_poses_are_refused() {
    let m = "transform_matrix";
    refused(|v| v["frames"][1][m][0][0] = json!(null), Some(1), m, "finite");
    refused(|v| v["frames"][1][m][0][0] = json!("1"), Some(1), m, "(0, 0) is a string");
    refused(|v| v["frames"][3][m] = json!([[1, 0, 0], [0, 1, 0], [0, 0, 1]]), Some(3), m, "3 rows");
    refused(|v| v["frames"][3][m][2] = json!([1, 0, 0]), Some(3), m, "row 2 has 3 entries");
    refused(|v| v["frames"][3][m][2] = json!(7), Some(3), m, "row 2");
    refused(|v| v["frames"][2][m][3][0] = json!(0.01), Some(2), m, "bottom row");
    refused(|v| v["frames"][2][m][0][0] = json!(1.01), Some(2), m, "orthonormal");
    refused(|v| v["frames"][2][m][0][0] = json!(1e200), Some(2), m, "orthonormal");
    refused(|v| v["frames"][2][m][0][0] = json!(-1), Some(2), m, "mirrors");
    refused(|v| drop(v["frames"][0].as_object_mut().unwrap().remove(m)), Some(0), m, "missing");
}

#[test]
fn bad_times_paths_and_lenses_are_refused() {
    refused(|v| drop(v["frames"][2].as_object_mut().unwrap().remove("time")), Some(2), "time", "missing");
    refused(|v| v["frames"][2]["time"] = json!(1.5), Some(2), "time", "1.5 is outside [0, 1]");
    refused(|v| v["frames"][2]["time"] = json!(-1e-9), Some(2), "time", "outside");
    refused(|v| v["frames"][2]["time"] = json!("0.5"), Some(2), "time", "finite");
    refused(|v| v["frames"][2]["file_path"] = json!(" "), Some(2), "file_path", "empty");
    refused(|v| v["frames"][2]["fl_x"] = json!(10), Some(2), "fl_x", "is 10, but not given in frame 0");
    refused(|v| v["frames"][2]["w"] = json!("8"), Some(2), "w", "a string where");
    refused(|v| v["frames"][2] = json!(3), Some(2), "frames", "3 where an object");
    refused(|v| v["frames"] = json!([]), None, "frames", "empty");
    refused(|v| v["frames"] = json!({}), None, "frames", "an object");
    refused(|v| v["camera_angle_x"] = json!(30), None, "camera_angle_x", "radians");
    refused(|v| v["k1"] = json!(0.1), None, "k1", "distortion");
    refused(|v| v["rolling_shutter"] = json!([0, 0, 0.1, 0]), None, "rolling_shutter", "distortion");
    refused(|v| v["frames"][1]["k2"] = json!(0.1), Some(1), "k2", "distortion");
    refused(|v| v["camera_model"] = json!("OPENCV_FISHEYE"), None, "camera_model", "OPENCV_FISHEYE is not supported");
    refused(|v| v["frames"][3]["is_fisheye"] = json!(true), Some(3), "is_fisheye", "only pinhole cameras");
    refused(
        |v| v["frames"].as_array_mut().unwrap().iter_mut().for_each(|f| f["camera_angle_x"] = json!(0.6)),
        None,
        "camera_angle_x",
        "is 0.5, but 0.6 in the frames",
    );
    refused(|v| v["fl_x"] = json!(100), None, "w", "`w` and `h`");
    refused(|v| drop(v.as_object_mut().unwrap().remove("camera_angle_x")), None, "camera_angle_x", "missing");
    refused(|v| *v = json!([1]), None, "frames", "not a JSON object");
}

#[test]
fn a_lens_that_all_frames_repeat_is_that_of_the_split() {
    let mut value = valid();
    for frame in value["frames"].as_array_mut().unwrap() {
        for (field, number) in [("fl_x", 80.0), ("fl_y", 81.0), ("cx", 19.0), ("cy", 20.0), ("w", 40.0), ("h", 40.0)] {
            frame[field] = json!(number);
        }
        frame["camera_model"] = json!("OPENCV");
        frame["k1"] = json!(0.0);
    }
    value.as_object_mut().unwrap().remove("camera_angle_x");
    let camera = parse(&value).unwrap().intrinsics.camera(20, 20, DMat4::IDENTITY);
    assert_eq!((camera.fx, camera.fy, camera.cx, camera.cy), (40.0, 40.5, 9.5, 10.0));
    value["frames"][3]["fl_y"] = json!(82.0);
    let text = parse(&value).unwrap_err().to_string();
    assert!(text.contains("frame 3") && text.contains("is 82, but 81 in frame 0"), "{text}");
}

#[test]
fn lenses_that_contradict_themselves_or_the_images_are_refused() {
    let check = |lens: Intrinsics| {
        super::super::lens::check_lens(Path::new("t.json"), &lens, (40, 20)).map_err(|e| e.to_string())
    };
    let lens = Intrinsics { camera_angle_x: Some(0.5), ..Intrinsics::default() };
    let fl_x = 20.0 / 0.25f64.tan();
    let pixels = Intrinsics { fl_x: Some(fl_x), w: Some(40.0), h: Some(20.0), ..lens };
    for good in
        [lens, Intrinsics { camera_angle_y: Some(0.25), ..lens }, pixels, Intrinsics { fl_y: Some(9.0), ..pixels }]
    {
        check(good).unwrap();
    }
    for (bad, words) in [
        (Intrinsics { camera_angle_y: Some(0.6), ..lens }, "contradicts `camera_angle_x`"),
        (Intrinsics { fl_x: Some(50.0), ..pixels }, "`camera_angle_x`: 0.5 is a focal length of 78.3"),
        (Intrinsics { camera_angle_y: Some(0.4), ..pixels }, "field `camera_angle_y`"),
        (Intrinsics { h: Some(40.0), ..pixels }, "aspect ratio"),
    ] {
        let text = check(bad).unwrap_err();
        assert!(text.contains(words) && text.contains("Hint: "), "{text}");
    }
}

#[test]
fn images_are_found_by_any_extension() {
    let folder = tempfile::tempdir().unwrap();
    let record = |p: &str| FrameRecord { file_path: p.into(), camera_to_world: DMat4::IDENTITY, time: 0.0 };
    for (there, asked, name) in [
        ("a.jpg", "a", "a"),
        ("b.JPEG", "./b", "b"),
        ("c.PNG", "c", "c"),
        ("d.v2.jpg", "d.v2", "d.v2"),
        ("e.jpg", "e.jpg", "e"),
    ] {
        std::fs::write(folder.path().join(there), "").unwrap();
        assert_eq!(record(asked).image_path(folder.path()), folder.path().join(there));
        assert_eq!(record(asked).name(), name);
    }
    assert_eq!(record("none").image_path(folder.path()), folder.path().join("none.png"));
    assert_eq!(record("r_000.jpg").image_path(Path::new("d")), Path::new("d/r_000.jpg"), "not r_000.jpg.png");
}

#[test]
fn non_finite_words_are_traced_to_their_frame() {
    for (word, field) in [("NaN", "time"), ("-Infinity", "time"), ("1e999", "time")] {
        let text = valid().to_string().replace("\"time\":0.5", &format!("\"time\":{word}"));
        let error = Transforms::parse(Path::new("t.json"), &text).unwrap_err();
        assert_eq!((error.frame(), error.field()), (Some(2), Some(field)), "{error}");
    }
    // Words inside strings stay as they are.
    let text = valid().to_string().replace("train/r_1", "NaN \\\" NaN").replace("\"time\":0.5", "\"time\":NaN");
    assert_eq!(Transforms::parse(Path::new("t.json"), &text).unwrap_err().frame(), Some(2));
}

#[test]
fn truncated_text_names_the_frame_it_breaks_in() {
    let text = valid().to_string();
    let third = text.find("r_2").unwrap() + 20;
    let error = Transforms::parse(Path::new("t.json"), &text[..third]).unwrap_err();
    assert_eq!(error.frame(), Some(2));
    let message = error.to_string();
    assert!(message.contains("ends too early") && message.contains("truncated"), "{message}");
    for cut in 0..text.len() {
        assert!(Transforms::parse(Path::new("t.json"), &text[..cut]).is_err());
    }
    let message = Transforms::parse(Path::new("t.json"), "").unwrap_err().to_string();
    assert!(message.contains("t.json"), "{message}");
}

#[test]
fn unreadable_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transforms_train.json");
    assert!(Transforms::read(&path).unwrap_err().to_string().contains("transforms_train.json: cannot read"));
    std::fs::write(&path, b"{\n\xff").unwrap();
    let error = Transforms::read(&path).unwrap_err();
    assert!(matches!(error, DataError::Syntax { line: 2, .. }), "{error}");
}

#[test]
fn pixel_intrinsics_scale_with_the_image() {
    let mut value = valid();
    for (k, v) in [("fl_x", 800.0), ("fl_y", 820.0), ("cx", 310.0), ("cy", 250.0), ("w", 640.0), ("h", 480.0)] {
        value[k] = json!(v);
    }
    let camera = parse(&value).unwrap().intrinsics.camera(320, 240, DMat4::IDENTITY);
    assert_eq!([camera.fx, camera.fy, camera.cx, camera.cy], [400.0, 410.0, 155.0, 125.0]);
    let lens = Intrinsics { camera_angle_x: Some(0.5), camera_angle_y: Some(0.4), ..Intrinsics::default() };
    assert!((lens.camera(100, 50, DMat4::IDENTITY).fov_y() - 0.4).abs() < 1e-12);
}

#[test]
fn writing_refuses_what_reading_would() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.json");
    let mut good = parse(&valid()).unwrap();
    good.write(&path).unwrap();
    let back = Transforms::read(&path).unwrap();
    assert_eq!((back.frames, back.intrinsics), (good.frames.clone(), good.intrinsics));
    good.frames[1].time = f64::NAN;
    assert_eq!(good.write(&folder.path().join("u.json")).unwrap_err().frame(), Some(1));
    assert!(!folder.path().join("u.json").exists());
}

/// Replaces the `at`-th value of the tree (in walking order) by `new`.
fn replace_nth(value: &mut Value, at: &mut usize, new: &Value) {
    if *at == 0 {
        *value = new.clone();
    }
    *at = at.wrapping_sub(1);
    match value {
        Value::Array(list) => list.iter_mut().for_each(|v| replace_nth(v, at, new)),
        Value::Object(map) => map.values_mut().for_each(|v| replace_nth(v, at, new)),
        _ => {}
    }
}

proptest! {
    #[test]
    fn mutated_bytes_never_panic(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<char>(), 0u8..3), 1..6),
        cut in prop::option::of(any::<prop::sample::Index>())
    ) {
        let mut text: Vec<char> = valid().to_string().chars().collect();
        for (at, c, what) in edits {
            let i = at.index(text.len());
            match what {
                0 => text[i] = c,
                1 => text.insert(i, c),
                _ => drop(text.remove(i)),
            }
        }
        if let Some(cut) = cut {
            text.truncate(cut.index(text.len()));
        }
        let text: String = text.into_iter().collect();
        if let Err(error) = Transforms::parse(Path::new("t.json"), &text) {
            prop_assert!(error.to_string().contains("t.json") && error.to_string().contains("Hint"));
        }
    }

    #[test]
    fn mutated_values_never_panic(at in 0usize..90, pick in 0usize..9, x in any::<f64>(), s in ".*") {
        let new = [
            json!(x), json!(s), json!(null), json!([]), json!({}), json!(true), json!(1e308), json!([[x]]), json!(-1),
        ][pick].clone();
        let (mut value, mut at) = (valid(), at);
        replace_nth(&mut value, &mut at, &new);
        if let Ok(transforms) = parse(&value) {
            for frame in &transforms.frames {
                prop_assert!((0.0..=1.0).contains(&frame.time) && frame.camera_to_world.is_finite());
                prop_assert!((glam::DMat3::from_mat4(frame.camera_to_world).determinant() - 1.0).abs() < 1e-2);
                let _ = (frame.name(), frame.image_path(Path::new("d")));
            }
        }
    }

    #[test]
    fn round_trip_is_bit_exact(
        eye in prop::array::uniform3(-9.0..9.0f64), time in 0.0..=1.0f64, angle in 0.01..3.0f64, name in "[a-z/é\"\\\\]{1,9}"
    ) {
        let camera = Camera::look_at(eye.into(), glam::DVec3::ZERO, glam::DVec3::Z, angle, 4, 4);
        let frames = vec![FrameRecord { file_path: name, camera_to_world: camera.camera_to_world, time }];
        let intrinsics = Intrinsics { camera_angle_x: Some(angle), ..Intrinsics::default() };
        let one = Transforms { path: "t.json".into(), intrinsics, frames };
        prop_assert_eq!(Transforms::parse(Path::new("t.json"), &one.to_json()).unwrap(), one);
    }
}
