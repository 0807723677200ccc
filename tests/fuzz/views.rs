//! Saved views, as JSON and in the text chunk of a picture, and camera paths through keyframes.

use crate::data::with_checksums;
use crate::driver::{Target, accepted, fuzz};
use image::RgbImage;
use volseggs::export::images::encode_png_with;
use volseggs::model::ToKernel;
use volseggs::run::cameras::SIDE;
use volseggs::run::keyframes::SavedPath;
use volseggs::run::saved::{KEYWORD, SavedView};
use volseggs::user_error::UserError;

/// A view on its own.
const VIEW: &str = r#"{"eye":[4.0,0.30000000000000004,-1e-7],"target":[0.0,0.0,0.0],"up":[0.0,0.0,1.0],"fov":0.5,
    "size":[800,600],"time":0.5,"look":"depth","alone":["red"],"hidden":["blue","a-b"],"edits":true,"palette":"cividis",
    "range":[0.1,123.456]}"#;
const KEYS: &str = r#"[{"seconds":0,"time":0.2,"eye":[4,0,0.1],"target":[0,0,0],"up":[0,0,1],"fov":0.5},
    {"seconds":2.5,"time":0.4,"eye":[1,3.8,0.1],"target":[0.5,0,0],"up":[0,0.1,1],"fov":0.7},
    {"seconds":4,"time":1,"eye":[-2,-1,1],"target":[0,0,0],"up":[0,0,1],"fov":0.5}]"#;

const TOKENS: &[&str] = &[
    "\"view\"",
    "\"keys\"",
    "\"frames\"",
    "\"format\":1,",
    "\"format\":2,",
    "\"eye\":[0,0,0],",
    "\"up\":[4,0,0],",
    "\"fov\":3.09,",
    "\"size\":[1,4096],",
    "\"look\":\"velocity x\",",
    "\"look\":\"colour\",",
    "\"palette\":\"red-green\",",
    "\"range\":[1,0],",
    "\"seconds\"",
    "[1e12,1e12,1e12]",
    "1e-9",
    "volseggs view",
    "iTXt",
    "IDAT",
];

/// Returns the file of a view, with `more` fields beside it.
fn saved(more: &str) -> String {
    format!(
        r#"{{"format":1,"version":"9","run":"rün","scene":"0123456789abcdef","command":"volseggs render",{more}"view":{VIEW}}}"#
    )
}

/// Uses a view as commands do before they draw it.
fn used(saved: &SavedView) {
    let [camera, half] = [1.0, 0.5].map(|part| saved.view.camera(part));
    assert!(camera.width > 0 && half.height > 0);
    let _ = camera.to_kernel();
    match saved.clone().sized(400) {
        Ok(sized) => assert!(sized.view.size.iter().all(|n| (1..=SIDE).contains(n))),
        Err(error) => assert!(error.is_input(), "{error}"),
    }
    let again = SavedView::parse("again", &serde_json::to_string(saved).unwrap()).unwrap();
    assert_eq!(again, *saved, "unchanged by writing and reading");
}

fn texts(list: &[String]) -> Vec<Vec<u8>> {
    list.iter().map(|text| text.clone().into_bytes()).collect()
}

#[test]
fn json() {
    fuzz("view-json", |scratch| {
        let (path, scratch) = (scratch.path("view.json"), scratch.clone());
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            let found = accepted(SavedView::read(&path));
            found.iter().for_each(used);
            found.is_some()
        };
        Target::new(texts(&[saved(""), VIEW.into()]), read).tokens(TOKENS)
    });
}

#[test]
fn picture() {
    fuzz("view-png", |scratch| {
        let (path, scratch) = (scratch.path("view.png"), scratch.clone());
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            let found = accepted(SavedView::read(&path));
            found.iter().for_each(used);
            found.is_some()
        };
        let png = |keyword: &str, text: &str| encode_png_with(&RgbImage::new(5, 4), keyword, text).unwrap();
        let seeds = vec![png(KEYWORD, &saved("")), png(KEYWORD, VIEW), png("Comment", "x")];
        Target::new(seeds, read).tokens(TOKENS).assemble(with_checksums)
    });
}

#[test]
fn path() {
    fuzz("camera-path", |_| {
        let read = |bytes: &[u8]| {
            let text = String::from_utf8_lossy(bytes);
            let keyed = SavedPath::is_in(&text);
            let Some((shown, path)) = accepted(SavedPath::parse("p.json", &text)) else { return false };
            assert!(keyed, "a file that is read as a path is recognised as one");
            used(&shown);
            for frames in [1, 2, 9] {
                for key in path.frames(frames) {
                    let seen = key.view(&shown.view);
                    assert_eq!(seen.check(), Ok(()), "{key:?}");
                    let _ = seen.camera(1.0).to_kernel();
                }
            }
            for seconds in [f64::NEG_INFINITY, -1.0, path.seconds() / 3.0, f64::INFINITY] {
                let _ = path.key_at(seconds);
            }
            true
        };
        let two = r#"[{"seconds":1,"time":0,"eye":[0,0,4],"target":[0,0,0],"up":[0,1,0],"fov":0.01},
            {"seconds":86400,"time":1,"eye":[0,0,-4],"target":[0,0,0],"up":[0,1,0],"fov":3}]"#;
        let seeds = [KEYS, two].map(|keys| saved(&format!("\"keys\":{keys},")));
        Target::new(texts(&seeds), read).tokens(TOKENS)
    });
}
