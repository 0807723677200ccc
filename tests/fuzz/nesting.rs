//! Deep nesting: a reader that recurses ends the whole process by overflowing its stack, so each is tried in a separate
//! process, on a stack as large as that of the program's main thread.

use crate::driver::chosen;
use std::path::Path;
use std::process::Command;
use volseggs::config::types::Config;
use volseggs::data::Transforms;
use volseggs::edit::EditStack;
use volseggs::segment::masks::MaskReader;
use volseggs::segment::masks::source::dir::ForeignMasks;
use volseggs::sweep::file::SweepFile;
use volseggs::volume::formats;
use volseggs::volume::transfer::TransferFunction;

/// Passes the reader, the files and their folder to the started process.
const FILES: &str = "VOLSEGGS_FUZZ_NESTED";
const STACK: usize = 8 << 20;

/// Reads the file; whether it is accepted does not matter.
fn read(kind: &str, path: &Path) {
    let text = path.to_string_lossy().into_owned();
    match kind {
        "config" => drop(volseggs::method::layers().source(text).resolve::<Config>().map_err(|e| e.to_string())),
        "set" => {
            let line = std::fs::read_to_string(path).unwrap();
            drop(volseggs::method::layers().sets([line]).resolve::<Config>().map_err(|e| e.to_string()));
        }
        "sweep" => drop(SweepFile::read(path).map_err(|e| e.to_string())),
        "transfer" => drop(TransferFunction::load(&text).map_err(|e| e.to_string())),
        "volume" => drop(formats::open(path).map_err(|e| e.to_string())),
        "transforms" => drop(Transforms::read(path).map_err(|e| e.to_string())),
        "edits" => drop(EditStack::load(path).map_err(|e| e.to_string())),
        "masks" => drop(MaskReader::open(path).map_err(|e| e.to_string())),
        "coco" => drop(ForeignMasks::open(path, &["a".into()], &[], &["b".into()], [4, 2]).map_err(|e| e.to_string())),
        other => panic!("no reader {other}"),
    }
}

/// The work of the started process; nothing if none was requested. It reports which file it reads, as it may end there.
#[test]
fn nested_files() {
    let Ok(what) = std::env::var(FILES) else { return };
    let [kind, name, root] = <[&str; 3]>::try_from(what.splitn(3, '=').collect::<Vec<_>>()).unwrap().map(str::to_owned);
    let work = move || {
        for case in 0.. {
            let path = Path::new(&root).join(case.to_string()).join(&name);
            if !path.exists() {
                break;
            }
            eprintln!("{}", path.display());
            read(&kind, &path);
        }
    };
    std::thread::Builder::new().stack_size(STACK).spawn(work).unwrap().join().unwrap();
}

/// Returns a key through `levels` tables.
fn dotted(levels: usize) -> String {
    format!("{}a", "a.".repeat(levels - 1))
}

/// Returns forms of nested TOML, each key through as many tables as the parser accepts.
fn tomls(start: &str) -> Vec<String> {
    let key = dotted(79);
    let tables = |levels: usize| format!("{start}{}b = 1{}", format!("{key} = {{").repeat(levels), "}".repeat(levels));
    vec![
        format!("{start}a = {}", "[".repeat(100_000)),
        format!("{start}a = {}{}", "[".repeat(79), "]".repeat(79)),
        format!("{start}a = {}", "{a = ".repeat(100_000)),
        format!("{start}{} = 1", dotted(100_000)),
        format!("{start}[{}]\nb = 1", dotted(100_000)),
        format!("{start}[{key}]\n{key} = 1"),
        tables(20),
        tables(40),
    ]
}

fn jsons() -> Vec<String> {
    let annotation = "{\"images\":[],\"annotations\":[{\"image_id\":1,\"segmentation\":";
    vec![
        "[".repeat(1_000_000),
        "{\"a\":".repeat(1_000_000),
        format!("{}{}", "[".repeat(127), "]".repeat(127)),
        format!("{annotation}{}", "[".repeat(100_000)),
    ]
}

/// Reads files of these texts called `name`, and reports which one ends the process. Another file may lie beside each.
fn survives(kind: &str, name: &str, texts: &[String], beside: Option<&str>) {
    if !chosen("nesting") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    for (case, text) in texts.iter().enumerate() {
        let case = folder.path().join(case.to_string());
        std::fs::create_dir(&case).unwrap();
        std::fs::write(case.join(name), text).unwrap();
        if let Some(other) = beside {
            std::fs::write(case.join(other), [0; 8]).unwrap();
        }
    }
    let read = beside.unwrap_or(name);
    let mut child = Command::new(std::env::current_exe().unwrap());
    let child = child.args(["nesting::nested_files", "--exact", "--nocapture"]);
    let out = child.env(FILES, format!("{kind}={read}={}", folder.path().display())).output().unwrap();
    let log = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{kind}: {}; the last file named below ended it\n{log}", out.status);
    assert_eq!(log.matches(read).count(), texts.len(), "{kind}: not all files were read\n{log}");
}

#[test]
fn toml_may_nest() {
    for (kind, name) in [("config", "c.toml"), ("sweep", "s.toml"), ("transfer", "t.toml")] {
        survives(kind, name, &tomls(""), None);
    }
    survives("volume", "v.raw.toml", &tomls(""), Some("v.raw"));
    // free keys, whose depth the schema does not limit
    survives("config", "c.toml", &tomls("[loss.extra]\n"), None);
    survives("sweep", "s.toml", &tomls("[grid]\n"), None);
    let values = ["[".repeat(100_000), format!("{}=1", dotted(10_000)), "{a=".repeat(100_000)];
    let sets: Vec<String> = values.iter().flat_map(|v| [v.clone(), format!("loss.extra.x={v}")]).collect();
    survives("set", "set.txt", &sets, None);
}

#[test]
fn json_may_nest() {
    for kind in ["transforms", "edits", "masks", "coco", "transfer"] {
        survives(kind, "a.json", &jsons(), None);
    }
}

#[test]
fn xml_may_nest() {
    let file = "<VTKFile type=\"ImageData\">";
    let array = format!(
        "{file}<ImageData WholeExtent=\"0 1 0 1 0 1\"><Piece Extent=\"0 1 0 1 0 1\"><PointData><DataArray>{}",
        "<a>".repeat(500_000)
    );
    survives("volume", "a.vti", &[file.repeat(100_000), array, "<!-- ".repeat(100_000)], None);
}
