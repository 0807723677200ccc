//! `volseggs eval --segments` as a whole program: clicks, every method, the table and its files.
#![allow(clippy::unwrap_used)]

mod common;

use common::{json, names, refused, train, volseggs};
use serde_json::Value;

const METHODS: [&str; 5] = ["sagd", "saga", "coarse", "fine", "coarse+fine"];

#[test]
fn known_segments_are_clicked_and_measured_by_every_method() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let few = "--dims 24 --series-steps 3 --times 3 --views 8 --size 32 --test-views 3 --segment-views 3";
    let prepare = ["prepare", "--synthetic", "jets", "--out", "data"];
    volseggs().current_dir(root).args(prepare).args(few.split(' ')).assert().success();
    train(root, "run", &[]).assert().success();

    let short = "--segments --fine-steps 20 --saga-steps 5 --mask-views 4 --clicks 2";
    let run = |more: &[&str]| -> Value {
        let all = ["eval", "run", "--json"];
        let output = volseggs().current_dir(root).args(all).args(short.split(' ')).args(more).assert().success();
        serde_json::from_slice(&output.get_output().stdout).unwrap()
    };
    let found = run(&[]);
    let folder = root.join("run/eval/segments");
    for file in ["segments.csv", "segments.json", "segments.png", "table.md", "tracking.csv"] {
        assert!(names(&folder).contains(&file.to_owned()), "{file} in {:?}", names(&folder));
    }
    assert_eq!(json(&folder.join("segments.json")), found);
    assert_eq!(names(&root.join("run/eval")), ["segments"], "masks are not kept");
    let results = found["results"].as_array().unwrap();
    assert!(!results.is_empty() && results.len() % METHODS.len() == 0);
    for (result, method) in results.iter().zip(METHODS.iter().cycle()) {
        assert_eq!(result["method"], *method);
        let fit = result["fit"].as_f64().unwrap();
        assert!((0.0..=1.0).contains(&fit) && result["pixel"][0].as_u64().unwrap() < 32, "{result}");
        for row in result["times"].as_array().unwrap() {
            assert!((0.0..=100.0).contains(&row["iou"].as_f64().unwrap()), "{row}");
        }
    }
    // the same again, bit by bit but for the seconds
    let numbers = |v: &Value| -> Vec<Value> {
        let of =
            |r: &Value| serde_json::json!([r["segment"], r["method"], r["setting"], r["fit"], r["at"], r["times"]]);
        v["results"].as_array().unwrap().iter().map(of).collect()
    };
    assert_eq!(numbers(&run(&[])), numbers(&found));

    // the truth as masks, one method, one segment; the table on the terminal
    let only = results[0]["segment"].as_str().unwrap();
    let arguments = ["eval", "run", "--masks", "labels", "--methods", "fine", "--only", only];
    let printed = volseggs().current_dir(root).args(arguments).args(short.split(' ')).assert().success();
    let printed = String::from_utf8(printed.get_output().stdout.clone()).unwrap();
    assert!(printed.contains(&format!("| {only} | fine |")) && printed.lines().count() == 3, "{printed}");
    assert_eq!(names(&root.join("run/eval")), ["segments", "segments-labels"]);

    for (arguments, needle) in [
        (&["--segments", "--only", "nobody"][..], only),
        (&["--segments", "--methods", "magic"], "coarse+fine"),
        (&["--segments", "--time", "2"], "--time <TIME>"),
        (&["--segments", "--clicks", "0"], "--clicks"),
        (&["--segments", "--mask-alpha", "0"], "--mask-alpha 0"),
        (&["--methods", "fine"], "--segments"),
    ] {
        refused(volseggs().current_dir(root).args(["eval", "run"]).args(arguments), &[needle]);
    }
    std::fs::remove_file(root.join("data/segments.json")).unwrap();
    refused(volseggs().current_dir(root).args(["eval", "run", "--segments"]), &["segments.json", "prepare"]);
}
