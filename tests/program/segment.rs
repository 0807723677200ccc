//! `volseggs segment` and `track` as whole programs: from a trained run to parts that are tracked through time.

use crate::common::{dataset, json, names, refused, run_json, train, volseggs};
use serde_json::Value;
use std::path::Path;

#[test]
fn a_run_is_segmented_split_and_tracked_through_time() {
    let folder = dataset();
    let root = folder.path();
    train(root, "run", &[]).assert().success();
    let segments = root.join("run/segments");

    // nothing exists yet: each command says what to run first
    for (arguments, hint) in [
        (&["segment", "masks", "run"][..], "segment coarse"),
        (&["segment", "fine", "run"], "segment masks"),
        (&["segment", "split", "run", "red"], "segment coarse"),
        (&["track", "run", "--segment", "red"], "segment coarse"),
    ] {
        refused(volseggs().current_dir(root).args(arguments), &[hint]);
    }
    assert!(!segments.exists() && !root.join("run/track").exists());

    let coarse = run_json(root, &["segment", "coarse", "run", "--clusters", "2", "--time", "0.4"]);
    let found = coarse["segments"].as_array().unwrap().clone();
    assert_eq!(found.len(), 2);
    assert_eq!(names(&segments), ["coarse.png", "segments.safetensors"]);
    refused(volseggs().current_dir(root).args(["segment", "coarse", "run"]), &["--replace"]);
    for (set, needles) in [
        ("loss.tv=0", &["--set loss.tv=0", "segment."][..]),
        ("segment.layers.egde=0", &["segment.layers.edge"]),
        ("segment.layers.edge=7", &["segment.layers.edge = 7", "from 0 to 1"]),
    ] {
        let arguments = ["segment", "coarse", "run", "--replace", "--set", set];
        refused(volseggs().current_dir(root).args(arguments), needles);
    }
    // refused before anything is opened: there is no run of this name
    let layers = ["segment", "coarse", "nowhere", "--space", "rgb", "--keep-surface-layers"];
    refused(volseggs().current_dir(root).args(layers), &["--keep-surface-layers", "--space material"]);
    let name = found[0]["name"].as_str().unwrap().to_owned();

    let masks = run_json(root, &["segment", "masks", "run", "--views", "5", "--size", "64"]);
    assert!(masks["masks"].as_u64().unwrap() > 0, "{masks}");
    let fine = run_json(root, &["segment", "fine", "run", "--steps", "30", "--pixels", "256"]);
    assert!(fine["loss"].as_f64().unwrap().is_finite());
    let bytes = std::fs::read(segments.join("affinity.safetensors")).unwrap();
    run_json(root, &["segment", "fine", "run", "--steps", "30", "--pixels", "256"]);
    assert!(
        std::fs::read(segments.join("affinity.safetensors")).unwrap() == bytes,
        "the same seed gives another field"
    );

    let parts = run_json(root, &["segment", "split", "run", &name, "--clusters", "2", "--scale", "0.5"]);
    assert_eq!(parts.as_array().unwrap().len(), 2);
    assert_eq!(parts[0]["parent"], name.as_str());
    run_json(root, &["segment", "split", "run", &name, "--clusters", "3"]);
    let all = run_json(root, &["segment", "list", "run"]);
    assert_eq!(all["segments"].as_array().unwrap().len(), 2 + 3, "the previous parts are replaced");

    let part = format!("{name}.1");
    let arguments =
        ["track", "run", "--segment", &name, "--segment", &part, "--frames", "5", "--from", "1", "--to", "0"];
    let tracked = run_json(root, &arguments);
    let times: Vec<f64> =
        tracked[0]["statistics"].as_array().unwrap().iter().map(|s| s["time"].as_f64().unwrap()).collect();
    assert_eq!(times, [1.0, 0.75, 0.5, 0.25, 0.0]);
    let written = names(&root.join("run/track").join(&part));
    assert!(written.contains(&"events.csv".to_owned()) && written.contains(&"times.png".to_owned()), "{written:?}");
    let rows = json(&root.join("run/track").join(&name).join("statistics.json"));
    assert_eq!(rows, tracked[0]["statistics"]);

    refused(volseggs().current_dir(root).args(["track", "run", "--segment", "nobody"]), &["nobody", &name]);

    clicks_and_groups(root, &name);
}

/// Checks what is under a pixel, what is similar to it, and several segments as one.
fn clicks_and_groups(root: &Path, name: &str) {
    let file = root.join("run/segments/segments.safetensors");
    let before = std::fs::read(&file).unwrap();
    let part = format!("{name}.1");
    let click = |more: &[&str]| {
        let all = ["segment", "pick", "run", "--camera", "3,-2,1.5", "--pixel", "16,16", "--within", name];
        run_json(root, &[&all[..], more].concat())
    };
    let found = click(&[]);
    assert!(found["segments"].as_array().unwrap().contains(&name.into()), "{found}");
    assert!(found["made"].is_null() && std::fs::read(&file).unwrap() == before, "a query changes nothing");

    let count = |v: &Value| v["made"][1].as_u64().unwrap();
    let all = count(&click(&["--name", "all", "--threshold", "-1"]));
    let made = click(&["--name", "some", "--threshold", "0.95", "--scale", "0.1"]);
    let some = count(&made);
    assert!(made["from_other_times"].as_u64().unwrap() < some, "{made}");
    assert!(0 < some && some <= all, "{some} of {all}");
    let list = run_json(root, &["segment", "list", "run"]);
    let made = list["segments"].as_array().unwrap().iter().find(|s| s["name"] == "some").unwrap().clone();
    assert_eq!((made["parent"].as_str().unwrap(), made["origin"]["kind"].as_str().unwrap()), (name, "pick"));

    let group = run_json(root, &["segment", "group", "run", "both", &part, name]);
    let whole = run_json(root, &["segment", "group", "run", "whole", name]);
    assert_eq!(group["gaussians"], whole["gaussians"], "a part adds nothing to its whole");
    let left = run_json(root, &["segment", "remove", "run", "both", "whole", "all"]);
    assert_eq!(left["removed"], 3);
    let list = run_json(root, &["segment", "list", "run"]);
    assert!(!list.to_string().contains("\"both\""));

    let bytes = std::fs::read(&file).unwrap();
    for (arguments, needles) in [
        (&["pick", "run", "--camera", "3,-2,1.5", "--pixel", "16,99"][..], &["--pixel", "32x32"][..]),
        (&["pick", "run", "--camera", "3,-2,1.5", "--pixel", "0,0"], &["nothing is there"]),
        (&["pick", "run", "--pixel", "1,1"], &["--camera"]),
        (&["pick", "run", "--view", "999", "--pixel", "1,1"], &["--view 999"]),
        (&["pick", "run", "--camera", "3,-2,1.5", "--pixel", "16,16", "--scale", "2"], &["--scale", "between 0 and 1"]),
        (&["pick", "run", "--camera", "3,-2,1.5", "--pixel", "16,16", "--within", "nobody"], &["nobody"]),
        (&["group", "run", name, "some"], &["this name is taken"]),
        (&["group", "run", "a b", "some"], &["letters"]),
        (&["remove", "run", "some", "nobody"], &["nobody"]),
    ] {
        refused(volseggs().current_dir(root).arg("segment").args(arguments), needles);
    }
    assert!(std::fs::read(&file).unwrap() == bytes, "refused commands change nothing");
}

#[test]
fn segments_of_another_state_of_the_scene_are_refused() {
    let folder = dataset();
    let root = folder.path();
    train(root, "run", &[]).args(["--stop-after", "40"]).assert().success();
    run_json(root, &["segment", "coarse", "run", "--clusters", "2"]);
    train(root, "run", &[]).arg("--resume").assert().success();
    refused(volseggs().current_dir(root).args(["segment", "list", "run"]), &["segments.safetensors", "--replace"]);
    run_json(root, &["segment", "coarse", "run", "--clusters", "2", "--replace"]);
    run_json(root, &["segment", "list", "run"]);
}
