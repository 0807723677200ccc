//! Deep nesting: a reader that recurses ends the whole process by overflowing its stack, so each is tried in a process
//! of its own, on a stack as large as the program's main thread has.

use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;
use volseggs::config::PRESETS;
use volseggs::config::layers::Layers;
use volseggs::config::types::Config;
use volseggs::data::Transforms;
use volseggs::edit::EditStack;
use volseggs::segment::masks::MaskReader;
use volseggs::segment::masks::source::foreign::Foreign;
use volseggs::sweep::file::SweepFile;
use volseggs::volume::formats;
use volseggs::volume::transfer::TransferFunction;

/// Names the reader and the file to the process that is started.
const FILE: &str = "VOLSEGGS_FUZZ_NESTED";
const STACK: usize = 8 << 20;

/// Reads the file; whether it is accepted does not matter.
fn read(kind: &str, path: &Path) {
    let text = path.to_string_lossy().into_owned();
    match kind {
        "config" => drop(Layers::new(PRESETS).source(text).resolve::<Config>().map_err(|e| e.to_string())),
        "set" => {
            let line = std::fs::read_to_string(path).unwrap();
            drop(Layers::new(PRESETS).sets([line]).resolve::<Config>().map_err(|e| e.to_string()));
        }
        "sweep" => drop(SweepFile::read(path).map_err(|e| e.to_string())),
        "transfer" => drop(TransferFunction::load(&text).map_err(|e| e.to_string())),
        "volume" => drop(formats::open(path).map_err(|e| e.to_string())),
        "transforms" => drop(Transforms::read(path).map_err(|e| e.to_string())),
        "edits" => drop(EditStack::load(path).map_err(|e| e.to_string())),
        "masks" => drop(MaskReader::open(path).map_err(|e| e.to_string())),
        "coco" => drop(Foreign::open(path, &["a".into()], &["b".into()], 4, 2).map_err(|e| e.to_string())),
        other => panic!("no reader {other}"),
    }
}

/// What the started process does; nothing where none was asked for.
#[test]
fn nested_file() {
    let Ok(what) = std::env::var(FILE) else { return };
    let (kind, path) = what.split_once('=').map(|(k, p)| (k.to_owned(), PathBuf::from(p))).unwrap();
    let thread = std::thread::Builder::new().stack_size(STACK).spawn(move || read(&kind, &path)).unwrap();
    thread.join().unwrap();
}

/// Forms of TOML that nest, each key through as many tables as the parser lets pass.
fn tomls(start: &str) -> Vec<String> {
    let dotted = vec!["a"; 79].join(".");
    let tables =
        |levels: usize| format!("{start}{}1{}", format!("{dotted} = {{").repeat(levels) + "b = ", "}".repeat(levels));
    vec![
        format!("{start}a = {}", "[".repeat(100_000)),
        format!("{start}a = {}{}", "[".repeat(79), "]".repeat(79)),
        format!("{start}a = {}", "{a = ".repeat(100_000)),
        format!("{start}{} = 1", vec!["a"; 100_000].join(".")),
        format!("{start}[{}]\nb = 1", vec!["a"; 100_000].join(".")),
        format!("{start}[{dotted}]\n{dotted} = 1"),
        tables(20),
        tables(79),
    ]
}

fn jsons() -> Vec<String> {
    vec!["[".repeat(1_000_000), "{\"a\":".repeat(1_000_000), format!("{}{}", "[".repeat(127), "]".repeat(127))]
}

fn survives(kind: &str, name: &str, text: &str, folder: &TempDir) {
    let path = folder.path().join(name);
    std::fs::write(&path, text).unwrap();
    let mut child = Command::new(std::env::current_exe().unwrap());
    let child = child.args(["nesting::nested_file", "--exact"]).env(FILE, format!("{kind}={}", path.display()));
    let out = child.output().unwrap();
    let start: String = text.chars().take(60).collect();
    assert!(out.status.success(), "{kind}: {} on {start}...\n{}", out.status, String::from_utf8_lossy(&out.stderr));
}

#[test]
fn toml_may_nest() {
    let folder = tempfile::tempdir().unwrap();
    for (kind, name) in [("config", "a.toml"), ("sweep", "a.toml"), ("transfer", "b.toml")] {
        tomls("").iter().for_each(|text| survives(kind, name, text, &folder));
    }
    std::fs::write(folder.path().join("v.raw"), [0; 8]).unwrap();
    for text in tomls("") {
        std::fs::write(folder.path().join("v.raw.toml"), &text).unwrap();
        survives("volume", "v.raw", "12345678", &folder);
    }
    // keys that are free, where depth is not the schema's
    tomls("[loss.extra]\n").iter().for_each(|text| survives("config", "a.toml", text, &folder));
    tomls("[grid]\n").iter().for_each(|text| survives("sweep", "a.toml", text, &folder));
    for value in ["[".repeat(100_000), format!("{}=1", vec!["a"; 100_000].join(".")), "{a=".repeat(100_000)] {
        survives("set", "set.txt", &format!("loss.extra.x={value}"), &folder);
        survives("set", "set.txt", &value, &folder);
    }
}

#[test]
fn json_may_nest() {
    let folder = tempfile::tempdir().unwrap();
    for text in jsons() {
        for kind in ["transforms", "edits", "masks", "coco"] {
            survives(kind, "a.json", &text, &folder);
        }
        survives("transfer", "a.json", &text, &folder);
    }
    let deep =
        format!("{{\"images\":[],\"annotations\":[{{\"image_id\":1,\"segmentation\":{}}}]}}", "[".repeat(100_000));
    survives("coco", "a.json", &deep, &folder);
}

#[test]
fn xml_may_nest() {
    let folder = tempfile::tempdir().unwrap();
    let start = "<VTKFile type=\"ImageData\"><ImageData WholeExtent=\"0 1 0 1 0 1\"><Piece Extent=\"0 1 0 1 0 1\"><PointData><DataArray>";
    for text in [
        "<VTKFile type=\"ImageData\">".repeat(100_000),
        format!("{start}{}", "<a>".repeat(500_000)),
        "<!-- ".repeat(100_000),
    ] {
        survives("volume", "a.vti", &text, &folder);
    }
}
