//! ParaView files: spaces, names, opacities, errors.

use super::*;
use proptest::prelude::*;

const COOL_WARM: &str = r#"[{
  "ColorSpace" : "Diverging", "Creator" : "someone", "DefaultMap" : true, "Name" : "Cool to Warm",
  "NanColor" : [1, 1, 0],
  "RGBPoints" : [10, 0.230, 0.299, 0.754, 30, 0.706, 0.016, 0.150]
}, {
  "ColorSpace" : "RGB", "Name" : "two", "RGBPoints" : [4, 1, 1, 1, 0, 0, 0, 0, 1, 1, 0, 0],
  "Points" : [0, 0.2, 0.5, 0, 8, 1.0, 0.25, 0, 10, 0.0, 0.5, 1, 16, 0.5, 0.5, 0]
}]"#;

fn one(text: &str, name: Option<&str>) -> Result<TransferFunction, VolumeError> {
    parse(text, name, Path::new("maps.json"))
}

#[test]
fn cool_to_warm_goes_through_the_published_grey() {
    let tf = one(COOL_WARM, None).unwrap();
    assert_eq!((tf.name.as_str(), tf.range), ("cool-to-warm", None));
    assert!(tf.colors.len() >= 65);
    assert!(tf.color_at(0.5).iter().all(|v| (v - 0.865).abs() < 5e-4), "{:?}", tf.color_at(0.5));
    let quarter = tf.color_at(0.25).map(|v| v * 255.0);
    for (got, want) in quarter.into_iter().zip([141.0, 176.0, 254.0]) {
        assert!((got - want).abs() <= 1.0, "{quarter:?}");
    }
    assert_eq!(tf.opacity, vec![(0.0, 0.0), (1.0, 1.0)]);
    // The same with the grey as a point of its own, as newer files have it.
    let newer = COOL_WARM.replace("0.754, 30", "0.754, 20, 0.865, 0.865, 0.865, 30");
    let newer = one(&newer, None).unwrap();
    for i in 0..=40 {
        let (a, b) = (tf.color_at(f64::from(i) / 40.0), newer.color_at(f64::from(i) / 40.0));
        assert!((0..3).all(|c| (a[c] - b[c]).abs() < 5e-3), "{i}: {a:?} {b:?}");
    }
}

#[test]
fn names_points_and_opacity() {
    let tf = one(COOL_WARM, Some("two")).unwrap();
    let white = [1.0; 3];
    assert_eq!(tf.colors, vec![(0.0, [0.0; 3]), (0.25, [1.0, 0.0, 0.0]), (1.0, white)]);
    let want = [(0.0, 0.2), (0.5, 1.0), (0.53125, 0.5), (0.625, 0.0), (0.8125, 0.0), (0.8125, 0.5), (1.0, 0.5)];
    assert_eq!(tf.opacity, want);
    let error = one(COOL_WARM, Some("three")).unwrap_err().to_string();
    assert!(error.contains("Cool to Warm, two"), "{error}");
    assert_eq!(split_spec("a/b.JSON#My map"), Some(("a/b.JSON", Some("My map"))));
    assert_eq!(split_spec("a/b.json"), Some(("a/b.json", None)));
    assert_eq!(split_spec("a#b"), None);
}

#[test]
fn files_are_read_from_specs_and_from_toml() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("maps.json");
    std::fs::write(&path, COOL_WARM).unwrap();
    let spec = format!("{}#two", path.display());
    assert_eq!(TransferFunction::load(&spec).unwrap().name, "two");
    assert_eq!(TransferFunction::load(&path.display().to_string()).unwrap().name, "cool-to-warm");
    let toml = dir.path().join("Mine.toml");
    std::fs::write(&toml, "colormap = \"maps.json#two\"\nopacity = [[0, 0.1]]\n").unwrap();
    let tf = TransferFunction::load(&toml.display().to_string()).unwrap();
    assert_eq!((tf.name.as_str(), tf.colors.len(), tf.opacity.len()), ("mine", 3, 1));
}

fn in_space(space: &str) -> TransferFunction {
    let text = format!(r#"{{"Name":"x","ColorSpace":"{space}","RGBPoints":[0,1,0,0,1,0,0,1,2,0,0,0.5]}}"#);
    one(&text, None).unwrap()
}

#[test]
fn spaces_differ_where_they_should() {
    let near = |a: [f32; 3], b: [f32; 3]| (0..3).all(|c| (a[c] - b[c]).abs() < 0.01);
    assert!(near(in_space("RGB").color_at(0.25), [0.5, 0.0, 0.5]));
    assert!(near(in_space("HSV").color_at(0.25), [0.0, 1.0, 0.0]));
    // Red and blue meet in CIELAB at L 42.8, a 79.6, b -20.3.
    assert!(near(in_space("Lab").color_at(0.25), [0.793, 0.0, 0.535]), "{:?}", in_space("Lab").color_at(0.25));
    assert_eq!(in_space("Lab/CIEDE2000").colors, in_space("LabCIEDE2000").colors);
    assert_eq!(in_space("CIELAB").colors, in_space("Lab").colors);
    let step = in_space("Step");
    assert_eq!((step.color_at(0.0), step.color_at(0.49)), ([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]));
    assert_eq!((step.color_at(0.5), step.color_at(1.0)), ([0.0, 0.0, 0.5], [0.0, 0.0, 0.5]));
    for space in ["HSV", "Lab", "Diverging"] {
        assert!(in_space(space).colors.len() >= 65, "{space}");
    }
}

#[test]
fn every_mistake_names_its_field() {
    let cases = [
        ("{", "line 1: is not JSON"),
        ("[]", "Name: there is no color map"),
        ("[3]", "the fields"),
        (r#"{"Name":"a"}"#, "RGBPoints of \"a\""),
        (r#"{"Name":"a","IndexedColors":[1,0,0]}"#, "categorical"),
        (r#"{"Name":"a","RGBPoints":[0,1,1]}"#, "3 numbers"),
        (r#"{"Name":"a","RGBPoints":[]}"#, "0 numbers"),
        (r#"{"Name":"a","RGBPoints":["x"]}"#, "the fields"),
        (r#"{"Name":"a","RGBPoints":[0,1,1,1,0,0,0,0]}"#, "from 0 to 0"),
        (r#"{"Name":"a","RGBPoints":[0,1,1,1,1,0,0,255]}"#, "outside [0, 1]"),
        (r#"{"Name":"a","RGBPoints":[0,1,1,1,1,0,0,0],"ColorSpace":"XYZ"}"#, "\"XYZ\" is not supported"),
        (r#"{"Name":"a","RGBPoints":[0,1,1,1,1,0,0,0],"Points":[0,0,0.5]}"#, "Points of \"a\""),
        (r#"{"Name":"a","RGBPoints":[0,1,1,1,1,0,0,0],"Points":[0,7,0.5,0,1,1,0.5,0]}"#, "opacity[0]: 7"),
    ];
    for (text, want) in cases {
        let error = one(text, None).unwrap_err().to_string();
        assert!(error.contains(want) && error.starts_with("maps.json"), "{want:?} not in {error:?}");
    }
}

proptest! {
    #[test]
    fn any_points_give_a_sound_function_or_an_error(
        groups in prop::collection::vec((-10i32..10, prop::array::uniform3(0.0..=1.0f64)), 1..9),
        space in 0usize..6,
    ) {
        let list: Vec<f64> = groups.iter().flat_map(|(x, c)| [f64::from(*x), c[0], c[1], c[2]]).collect();
        let space = ["RGB", "HSV", "Lab", "Diverging", "Step", "LabCIEDE2000"][space];
        let text = serde_json::json!({"Name": "m", "ColorSpace": space, "RGBPoints": list, "Points": list}).to_string();
        let varied = groups.iter().any(|g| g.0 != groups[0].0);
        prop_assert_eq!(one(&text, None).is_ok(), varied);
    }
}

#[test]
fn logarithmic_maps_are_refused_by_name() {
    for (value, refused) in [("1", true), ("true", true), ("0", false), ("false", false)] {
        let text = COOL_WARM.replacen("\"NanColor\"", &format!("\"UseLogScale\": {value}, \"NanColor\""), 1);
        let message = one(&text, None).map(|tf| tf.name).map_err(|e| e.to_string());
        assert_eq!(message.is_err(), refused, "{value}: {message:?}");
        assert!(
            !refused || message.as_ref().is_err_and(|m| m.contains("UseLogScale of \"Cool to Warm\"")),
            "{message:?}"
        );
    }
}

#[test]
fn byte_order_marks_are_no_part_of_a_map() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("maps.json");
    for bytes in [
        [b"\xef\xbb\xbf", COOL_WARM.as_bytes()].concat(),
        [&[0xff, 0xfe][..], &COOL_WARM.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>()].concat(),
    ] {
        std::fs::write(&path, bytes).unwrap();
        assert_eq!(read(&path, None).unwrap(), one(COOL_WARM, None).unwrap());
    }
}
