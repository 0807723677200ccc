//! Behaviour of transfer functions and of their TOML files.

use super::*;
use proptest::prelude::*;

const OK: &str = "name = \"t\"\ncolors = [[0.0, \"#000000\"], [1.0, [1.0, 0.5, 0]]]\nopacity = [[0, 0], [1, 1]]\n";

fn parse(text: &str) -> Result<TransferFunction, VolumeError> {
    file::parse(text, Path::new("dir/my tf.toml"))
}

fn message(text: &str) -> String {
    parse(text).unwrap_err().to_string()
}

#[test]
fn presets_load_pass_and_read_back() {
    for name in TransferFunction::presets() {
        let tf = TransferFunction::load(name).unwrap();
        assert_eq!(tf.name, name);
        tf.check(Path::new(name)).unwrap();
        assert!(tf.table(256).iter().any(|s| s[3] > 0.1), "{name}");
        assert_eq!(parse(&tf.to_toml()).unwrap(), tf, "{name}");
    }
    let error = TransferFunction::load("vortx").unwrap_err().to_string();
    assert!(TransferFunction::presets().iter().all(|p| error.contains(p)), "{error}");
    let error = TransferFunction::load("nowhere/x.toml").unwrap_err().to_string();
    assert!(error.contains("nowhere/x.toml") && error.contains("cannot read"), "{error}");
}

#[test]
fn values_between_at_and_outside_control_points() {
    let mut tf = parse(OK).unwrap();
    tf.opacity = vec![(0.2, 0.1), (0.5, 0.4), (0.5, 0.8), (0.9, 0.6)];
    for (at, want) in [(-3.0, 0.1), (0.2, 0.1), (0.35, 0.25), (0.5, 0.8), (0.7, 0.7), (0.9, 0.6), (9.0, 0.6)] {
        assert!((tf.opacity_at(at) - want).abs() < 1e-6, "{at}");
    }
    assert!((tf.opacity_at(0.5 - 1e-9) - 0.4).abs() < 1e-6);
    assert_eq!(tf.color_at(0.5), [0.5, 0.25, 0.0]);
    assert_eq!(tf.opacity_at(f64::NAN), 0.1);
    let table = tf.table(3);
    assert_eq!(table, vec![[0.0, 0.0, 0.0, 0.1], [0.5, 0.25, 0.0, 0.8], [1.0, 0.5, 0.0, 0.6]]);
    assert!(tf.table(0).is_empty());
    assert_eq!(tf.table(1).len(), 1);
}

#[test]
fn spans_and_segments() {
    let mut tf = parse(OK).unwrap();
    assert_eq!(tf.span([-2.0, 6.0]), [-2.0, 6.0]);
    assert_eq!(tf.span([4.0, 4.0]), [4.0, 8.0]);
    tf.range = Some([0.0, 1.0]);
    assert_eq!(tf.span([-2.0, 6.0]), [0.0, 1.0]);
    let segment = |name: &str, range| SegmentRange { name: name.into(), range, color: None };
    tf.segments = vec![segment("high", [0.6, 1.0]), segment("low", [0.1, 0.6])];
    let found: Vec<_> = [0.0, 0.1, 0.59, 0.6, 1.0, 1.1, f64::NAN].map(|f| tf.segment_of(f)).into();
    assert_eq!(found, [None, Some(1), Some(1), Some(0), Some(0), None, None]);
    assert_eq!(tf.segment_color(&tf.segments[1]), tf.color_at(0.35));
}

#[test]
fn data_units_become_fractions() {
    let text = "units = \"data\"\ncolors = [[-100, \"#000000\"], [300.0, \"#ffffff\"]]\nopacity = [[0, 0], [100, 1]]\n\
                [[segments]]\nname = \"a\"\nrange = [0.0, 300.0]\n";
    let tf = parse(text).unwrap();
    assert_eq!((tf.name.as_str(), tf.range), ("my-tf", Some([-100.0, 300.0])));
    assert_eq!(tf.opacity, vec![(0.25, 0.0), (0.5, 1.0)]);
    assert_eq!(tf.segments[0].range, [0.25, 1.0]);
    let wide = parse(&format!("range = [-100.0, 700.0]\n{text}")).unwrap();
    assert_eq!(wide.opacity, vec![(0.125, 0.0), (0.25, 1.0)]);
    let error = message(&format!("range = [0.0, 700.0]\n{text}"));
    assert!(error.contains("colors[0]: -100 is outside the range 0 to 700"), "{error}");
    let mapped = parse("units = \"data\"\ncolormap = \"viridis\"\nopacity = [[5, 0], [7, 1]]").unwrap();
    assert_eq!((mapped.range, mapped.colors.len()), (Some([5.0, 7.0]), 10));
}

#[test]
fn every_mistake_names_its_field() {
    let segments = |lines: &str| format!("{OK}[[segments]]\nname = \"a\"\nrange = [0.0, 0.5]\n[[segments]]\n{lines}");
    let opacity = |list: &str| format!("colormap = \"gray\"\nopacity = {list}\n");
    let cases = [
        (String::new(), "opacity"),
        (format!("{OK}smoothness = 1\n"), "line 4: unknown field `smoothness`"),
        (format!("{OK}units = \"volts\"\n"), "line 4"),
        (format!("{OK}range = [1, \n"), "line"),
        (format!("{OK}range = [2.0, 1.0]\n"), "range: 2 to 1"),
        (format!("{OK}range = [nan, 1.0]\n"), "range: NaN"),
        (format!("{OK}range = [-1.7e308, 1.7e308]\n"), "range"),
        (format!("{OK}colormap = \"viridis\"\n"), "colormap: colors are given too"),
        ("opacity = [[0, 1]]".to_owned(), "colors: there is no color"),
        ("colormap = \"jet\"\nopacity = [[0, 1]]".to_owned(), "viridis"),
        ("colormap = \"x.json\"\nopacity = [[0, 1]]".to_owned(), "dir/x.json"),
        (opacity("[]"), "opacity: there is no control point"),
        (format!("units = \"data\"\n{}", opacity("[]")), "opacity: there is no control point"),
        (format!("units = \"data\"\n{}", opacity("[[1, 1]]")), "range: 1 to 1"),
        (format!("units = \"data\"\n{}", opacity("[[1, 1], [nan, 1], [2, 0]]")), "opacity[1]: NaN"),
        (opacity("[[0, 0, 1]]"), "opacity[0]: [0, 0, 1] is not a pair"),
        (opacity("[[0, 0], [\"a\", 1]]"), "opacity[1]: \"a\" is not a position"),
        (opacity("[[0, 0], [1, \"a\"]]"), "opacity[1]: \"a\" is not a valid value"),
        (opacity("[[0, 0], [1, 1.5]]"), "opacity[1]: 1.5"),
        (opacity("[[0, nan]]"), "opacity[0]: NaN"),
        (opacity("[[nan, 0]]"), "opacity[0]: position NaN"),
        (opacity("[[0, 0], [20, 1]]"), "units = \"data\""),
        (opacity("[[0.5, 0], [0.2, 1]]"), "opacity[1]: position 0.2 comes after 0.5"),
        (OK.replace("#000000", "#00000"), "colors[0]: \"#00000\" is not a valid value"),
        (OK.replace("0.5, 0]", "0.5]"), "colors[1]"),
        (OK.replace("[1.0, 0.5", "[1.5, 0.5"), "colors[1]"),
        (OK.replace("\"t\"", "\"My TF\""), "such as \"my-tf\""),
        (format!("{OK}unit_length = 0\n"), "unit_length"),
        (format!("{OK}unit_length = inf\n"), "unit_length"),
        (format!("{OK}[shading]\nambient = -0.1\n"), "shading.ambient"),
        (format!("{OK}[shading]\npower = 0\n"), "shading.power"),
        (format!("{OK}[shading]\nshine = 1\n"), "line 5: unknown field `shine`"),
        (segments("name = \"a\"\nrange = [0.5, 1.0]"), "segments[1].name: \"a\" is used twice"),
        (segments("name = \"\"\nrange = [0.5, 1.0]"), "segments[1].name"),
        (segments("name = \"b\"\nrange = [0.4, 1.0]"), "overlaps the segment \"a\""),
        (segments("name = \"b\"\nrange = [0.6, 0.6]"), "segments[1].range"),
        (segments("name = \"b\"\nrange = [0.6, 0.7]\ncolor = 3"), "segments[1].color: 3"),
    ];
    for (text, want) in cases {
        let error = message(&text);
        assert!(error.contains(want) && error.contains(".toml") | error.contains(".json"), "{want:?} not in {error:?}");
        assert!(!error.contains('\n'), "{error}");
    }
}

#[test]
fn slugs() {
    for (text, want) in [("Cool to Warm (Extended)", "cool-to-warm-extended"), ("--", "unnamed"), ("a_B-1", "a_b-1")] {
        assert_eq!(slug(text), want);
    }
}

fn any_function() -> impl Strategy<Value = TransferFunction> {
    let sorted = |mut v: Vec<f64>| {
        v.sort_by(f64::total_cmp);
        v
    };
    let place = || prop_oneof![0.0..=1.0f64, Just(0.0), Just(1.0), Just(0.5)];
    let places = move || prop::collection::vec(place(), 1..6).prop_map(sorted);
    let channel = || prop_oneof![0.0..=1.0f32, (0u8..=255).prop_map(|v| f32::from(v) / 255.0)];
    let rgb = move || prop::array::uniform3(channel());
    let colors = (places(), prop::collection::vec(rgb(), 6)).prop_map(|(p, c)| p.into_iter().zip(c).collect());
    let opacity = (places(), prop::collection::vec(0.0..=1.0f32, 6)).prop_map(|(p, c)| p.into_iter().zip(c).collect());
    let range = prop::option::of((-1e9..1e9f64, 1e-3..1e9f64).prop_map(|(low, width)| [low, low + width]));
    let shading = (any::<bool>(), prop::array::uniform4(1e-6..100.0f32)).prop_map(
        |(enabled, [ambient, diffuse, specular, power])| Shading { enabled, ambient, diffuse, specular, power },
    );
    let segments = (places(), prop::option::of(rgb())).prop_map(|(mut p, color)| {
        p.dedup();
        let segment =
            |(i, pair): (usize, &[f64])| SegmentRange { name: format!("s-{i}"), range: [pair[0], pair[1]], color };
        p.windows(2).enumerate().map(segment).collect()
    });
    ("[a-z0-9_-]{1,9}", range, colors, opacity, 1e-9..10.0f64, shading, segments).prop_map(
        |(name, range, colors, opacity, unit_length, shading, segments)| TransferFunction {
            name,
            range,
            colors,
            opacity,
            unit_length,
            shading,
            segments,
        },
    )
}

#[test]
fn lighting_that_is_given_replaces_and_turns_shading_on() {
    let before = Shading { enabled: false, ..Shading::default() };
    let mut now = before;
    Lighting::default().apply(&mut now);
    assert_eq!(now, before);
    let given = Lighting { ambient: Some(0.1), power: Some(80.0), ..Lighting::default() };
    given.apply(&mut now);
    assert_eq!(now, Shading { enabled: true, ambient: 0.1, power: 80.0, ..before });
    given.check().unwrap();
    for bad in ["ambient = -0.1", "diffuse = nan", "specular = inf", "power = 0.0"] {
        let lighting: Lighting = toml::from_str(bad).unwrap();
        let key = bad.split(' ').next().unwrap();
        assert!(lighting.check().unwrap_err().starts_with(&format!("{key} = ")), "{bad}");
    }
    assert!(toml::from_str::<Lighting>("shininess = 3.0").is_err(), "it is called power in files");
}

proptest! {
    #[test]
    fn toml_reads_back_equal(tf in any_function()) {
        prop_assert_eq!(parse(&tf.to_toml()).map_err(|e| TestCaseError::fail(e.to_string()))?, tf);
    }

    #[test]
    fn values_stay_within_the_control_points(tf in any_function(), at in -0.5..1.5f64) {
        let ends = tf.opacity.iter().fold((1.0f32, 0.0f32), |(a, b), p| (a.min(p.1), b.max(p.1)));
        let value = tf.opacity_at(at);
        prop_assert!(ends.0 - 1e-6 <= value && value <= ends.1 + 1e-6);
        prop_assert!(tf.color_at(at).iter().all(|v| (-1e-6..=1.0 + 1e-6).contains(v)));
    }

    #[test]
    fn no_text_panics(text in "[a-z=\\[\\]0-9.,\" \n#-]{0,60}", cut in 0usize..140) {
        let _ = parse(&text);
        let _ = parse(OK.get(..cut).unwrap_or(OK));
    }
}
