//! Which files are read and refused, and how edits look in a list.

use super::super::{EditError, EditStack, Operation};
use super::edit;
use crate::data::Calibration;
use proptest::prelude::*;

fn load(text: &[u8]) -> Result<EditStack, EditError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("edits.json");
    std::fs::write(&path, text).unwrap();
    EditStack::load(&path)
}

fn with(operation: &str) -> String {
    format!(r#"{{"format":1,"operations":[{{"segments":["a"],"operation":{operation}}}],"undone":[]}}"#)
}

#[test]
fn an_error_names_file_and_field() {
    let op = "operations[0].operation";
    for (text, field, problem) in [
        (r#"[]"#.to_owned(), "the file", "not an object"),
        (r#"{"format":1,"operations":[]}"#.to_owned(), "undone", "missing"),
        (r#"{"format":1,"operations":{},"undone":[]}"#.to_owned(), "operations", "not a list"),
        (r#"{"format":1,"operations":[],"undone":[],"x":1}"#.to_owned(), "x", "unknown"),
        (r#"{"format":1,"operations":[],"undone":[{"operation":"hide"}]}"#.to_owned(), "undone[0].segments", "missing"),
        (with(r#""hide","x":1"#), "operations[0].x", "unknown"),
        (with(r#""explode""#), op, "explode"),
        (with(r#"{"hide":{}}"#), &format!("{op}.hide"), "unit"),
        (with(r#"{"opacity":{}}"#), &format!("{op}.opacity"), "factor"),
        (with(r#"{"opacity":{"factor":"1"}}"#), &format!("{op}.opacity.factor"), "not a number"),
        (with(r#"{"opacity":{"factor":1,"x":2}}"#), &format!("{op}.opacity"), "`x`"),
        (with(r#"{"opacity":{"factor":-1}}"#), &format!("{op}.opacity.factor"), "at least 0"),
        (with(r#"{"opacity":{"factor":1e39}}"#), &format!("{op}.opacity.factor"), "finite"),
        (with(r#"{"scale":{"factor":0}}"#), &format!("{op}.scale.factor"), "from 1e-6 to 1e6"),
        (with(r#"{"translate":{"by":[1,2]}}"#), &format!("{op}.translate.by"), "three numbers"),
        (with(r#"{"rotate":{"axis":[0,0,0],"degrees":1}}"#), &format!("{op}.rotate.axis"), "direction"),
        (with(r#"{"rotate":{"axis":[0,0,1],"degrees":1,"about":1}}"#), &format!("{op}.rotate.about"), "or null"),
        (with(r#"{"recolour":{"rgb":[0,0,2],"keep_shading":true}}"#), &format!("{op}.recolour.rgb"), "0 to 1"),
        (with(r#"{"recolour":{"rgb":[0,0,1],"keep_shading":1}}"#), &format!("{op}.recolour.keep_shading"), "true"),
    ] {
        let error = load(text.as_bytes()).unwrap_err();
        let line = error.to_string();
        assert!(matches!(&error, EditError::Field { field: f, .. } if f == field), "{text}: {line}");
        assert!(line.contains("edits.json") && line.contains(problem), "{text}: {line}");
    }
    assert!(matches!(load(b"{"), Err(EditError::Json { .. })));
    let missing = EditStack::load(std::path::Path::new("no/such/edits.json"));
    assert!(matches!(missing, Err(EditError::Io { .. })));
}

#[test]
fn another_version_is_reported_even_with_unknown_fields() {
    for (text, found) in [
        (r#"{"format":7,"operations":[{"warp":1}],"layers":[]}"#, "is 7"),
        (r#"{"operations":[],"undone":[]}"#, "is missing"),
    ] {
        let error = load(text.as_bytes()).unwrap_err();
        assert!(matches!(error, EditError::Format { .. }), "{error}");
        assert!(error.to_string().contains("edits.json: format: ") && error.to_string().contains(found), "{error}");
    }
}

#[test]
fn optional_points_may_be_left_out_or_null() {
    let without = load(with(r#"{"scale":{"factor":2}}"#).as_bytes()).unwrap();
    let null = load(with(r#"{"scale":{"factor":2,"about":null}}"#).as_bytes()).unwrap();
    assert_eq!(without, null);
    assert_eq!(without.operations, [edit(&["a"], Operation::Scale { factor: 2.0, about: None })]);
}

#[test]
fn opacity_shows_again_only_where_it_says_so() {
    let plain = load(with(r#"{"opacity":{"factor":2}}"#).as_bytes()).unwrap();
    assert_eq!(plain.operations, [edit(&["a"], Operation::Opacity { factor: 2.0, show: false })]);
    assert!(!serde_json::to_string(&plain).unwrap().contains("show"));
    let shown = load(with(r#"{"opacity":{"factor":2,"show":true}}"#).as_bytes()).unwrap();
    assert_eq!(shown.operations[0].to_string(), "show and multiply the opacity of a by 2");
}

#[test]
fn lists_are_readable() {
    let mut stack = EditStack::default();
    let rotate = |about| Operation::Rotate { axis: [0.0, 0.0, 1.0], degrees: 90.0, about };
    for (names, operation) in [
        (&["jet"][..], Operation::Recolour { rgb: [1.0, 0.5, 0.0], keep_shading: true }),
        (&["jet"], Operation::Opacity { factor: 0.5, show: false }),
        (&["jet"], rotate(None)),
        (&["jet", "ring"], rotate(None)),
        (&["ring"], Operation::Scale { factor: 2.0, about: Some([0.0, 0.5, 1.0]) }),
        (&["ring"], Operation::Translate { by: [0.1, 0.0, -2.0] }),
        (&["ring"], Operation::Isolate),
    ] {
        stack.push(edit(names, operation)).unwrap();
    }
    stack.undo();
    stack.undo();
    assert_eq!(
        stack.list(&Calibration::default()),
        [
            "1. recolour jet to #ff8000, keeping the shading",
            "2. multiply the opacity of jet by 0.5",
            "3. rotate jet by 90° about the axis (0, 0, 1) through its centre",
            "4. rotate jet, ring by 90° about the axis (0, 0, 1) through their own centres",
            "5. scale ring by 2 about (0, 0.5, 1)",
            "6. move ring by (0.1, 0, -2) (undone)",
            "7. hide everything but ring (undone)",
        ]
    );
    let nobody = stack.push(edit(&[], Operation::Hide)).unwrap_err();
    let blank = stack.push(edit(&["a", " "], Operation::Hide)).unwrap_err();
    assert!(matches!(nobody, EditError::Value { .. }) && blank.to_string().contains("segments[1]"));
    assert_eq!(stack.undone.len(), 2, "a refused edit keeps the undone ones");
}

proptest! {
    #[test]
    fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = load(&bytes);
    }

    #[test]
    fn any_change_of_a_good_file_is_read_or_refused(at in any::<prop::sample::Index>(), byte in 32u8..127) {
        let mut text = with(r#"{"rotate":{"axis":[0,0.5,1],"degrees":-3e1,"about":[1,2,3]}}"#).into_bytes();
        let at = at.index(text.len());
        text[at] = byte;
        if let Ok(stack) = load(&text) {
            prop_assert!(stack.validate(&|_| true).is_ok());
        }
    }
}
