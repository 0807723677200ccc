//! Every sweep file that comes with the program, from its own scenes through its own variants to its report: in tiny
//! images, with few Gaussians, and for one step of training.

use crate::common::{BINARY, json};
use assert_cmd::Command;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use volseggs::config::types::Config;
use volseggs::sweep::file::{SweepFile, name_of};

/// Where the files are; a new one is found.
const FOLDERS: [&str; 3] = ["configs/ablations", "configs/tables", "configs/sweeps"];

/// Images of volumes of 24^3 voxels.
const SCENES: [&str; 2] = ["voxels=24", "test_views=10"];
/// Pixels along a side of the images.
const SMALL: [&str; 1] = ["size=32"];
/// In smaller images no mask covers a bead; a few label images are enough.
const LABELLED: [&str; 3] = ["size=48", "times=2", "segment_views=2"];

/// A run ends after its first step (0 would be no limit), whatever number of steps its variant has.
const ONE_STEP: &str = "output.max_minutes=1e-6";

/// With halving, runs are compared at the steps where some are stopped: the steps stay, in a small field.
const SMALL_FIELD: &str = "model.resolution=8";

/// Few Gaussians, where a variant does not say how many.
const FEW: [&str; 2] = ["init.points=300", "densify.budget=300"];

/// Segments are measured with few masks and steps.
const SEGMENTS: [&str; 5] = [
    "segments.oracle=false",
    "segments.views=3",
    "segments.fine_steps=2",
    "segments.saga_steps=2",
    "segments.pixels=64",
];

/// The sweep files; the other files in their folders are the configurations that these start from.
fn sweeps() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found = Vec::new();
    for folder in FOLDERS {
        for entry in std::fs::read_dir(root.join(folder)).unwrap() {
            let path = entry.unwrap().path();
            match SweepFile::read(&path) {
                Ok(_) => found.push(path),
                Err(e) => {
                    let layers = volseggs::method::layers().source(path.to_string_lossy());
                    let as_config = layers.resolve::<Config>().err();
                    assert!(as_config.is_none(), "neither a sweep ({e}) nor a configuration ({as_config:?})");
                }
            }
        }
    }
    // networks of the paper's size take minutes for a step: methods are met at their small sizes first
    found.sort_by_key(|path| (is_large(path), path.clone()));
    found
}

/// `volseggs sweep FILE` at tiny sizes, with as few images as its variants permit.
fn sweep(path: &Path, out: &Path) -> Command {
    let (file, text) = (SweepFile::read(path).unwrap(), std::fs::read_to_string(path).unwrap());
    let mut command = Command::new(BINARY);
    command.arg("sweep").arg(path).arg("--out").arg(out).args(["--jobs", "2", "--seeds", "0", "--json"]);
    // GPUs have tests of their own
    command.args(["--devices", if file.devices.len() > 1 { "flex,ndarray" } else { "flex" }]);
    let few = if text.contains("data.views_per_time") { "times=2" } else { "views=2" };
    let own: &[&str] = if file.segments.is_some() { &LABELLED } else { &SMALL };
    command.args(SCENES.iter().chain([&few]).chain(own).flat_map(|key| ["--synthetic", key]));
    // methods without Gaussians refuse their keys
    let gaussians = FEW.iter().filter(|_| file.variant.iter().all(|variant| variant.config.is_none()));
    let segments = SEGMENTS.iter().filter(|_| file.segments.is_some());
    let end = if file.halving.is_some() { &SMALL_FIELD } else { &ONE_STEP };
    command.args(gaussians.chain(segments).chain([end]).flat_map(|key| ["--set", key]));
    command
}

/// A file of the paper's size, with the variants of a small one.
fn is_large(path: &Path) -> bool {
    name_of(path).ends_with("-paper")
}

/// Keys of the runs to do: the last one, one of each method that is not yet `covered`, and the first one if some are to
/// be stopped. All others have been resolved and checked for the plan.
fn chosen(plan: &Value, halving: bool, covered: &mut BTreeSet<String>) -> BTreeSet<String> {
    let method = |run: &Value| toml::from_str::<Config>(run["config"].as_str().unwrap()).unwrap().method;
    let runs = plan["runs"].as_array().unwrap();
    let new = runs.iter().filter(|run| covered.insert(method(run)));
    new.chain(runs.last())
        .chain(runs.first().filter(|_| halving))
        .map(|run| run["key"].as_str().unwrap().to_owned())
        .collect()
}

#[test]
fn every_sweep_file_runs_to_its_report() {
    let out = Path::new(env!("CARGO_TARGET_TMPDIR")).join("sweep-files");
    let _ = std::fs::remove_dir_all(&out);
    let files = sweeps();
    assert!(files.len() > 30, "{files:?}");
    let mut covered = BTreeSet::new();
    for path in files {
        let object = |command: &mut Command| -> Value {
            let said = command.output().unwrap();
            assert!(said.status.success(), "{}: {}", path.display(), String::from_utf8_lossy(&said.stderr));
            serde_json::from_slice(&said.stdout).unwrap()
        };
        let file = SweepFile::read(&path).unwrap();
        let halving = file.halving.is_some();
        let keys = chosen(&object(sweep(&path, &out).arg("--dry-run"))["plan"], halving, &mut covered);
        let results = object(sweep(&path, &out).args(keys.iter().flat_map(|key| ["--only", key])));
        let report = out.join(name_of(&path));
        assert_eq!(results["outcomes"], json(&report.join("results.json"))["set"]["outcomes"]);
        let is_chosen = |o: &&Value| keys.iter().any(|key| o["run"].as_str().unwrap().ends_with(key.as_str()));
        let of_chosen: Vec<&Value> = results["outcomes"].as_array().unwrap().iter().filter(is_chosen).collect();
        let done: Vec<&&Value> = of_chosen.iter().filter(|o| o["state"] == "done").collect();
        // some are stopped, some segments cannot be clicked in such small images
        let some = halving || file.segments.is_some();
        assert!(!done.is_empty() && (some || done.len() == of_chosen.len()), "{}: {of_chosen:?}", path.display());
        for name in ["report.html", "report.md", "table.tex", "results.csv"] {
            assert!(report.join(name).is_file(), "{}: no {name}", path.display());
        }
    }
}
