//! `volseggs segment` as a whole program: what is undone, what replaces what, and what is refused.

use crate::common::{dataset, names, refused, run_json, train, volseggs};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Runs `volseggs segment` and returns standard output and standard error.
fn segment(root: &Path, arguments: &[&str]) -> (String, String) {
    let output = volseggs().current_dir(root).arg("segment").args(arguments).assert().success().get_output().clone();
    (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap())
}

/// Returns the names of a listing, in its order.
fn listed(root: &Path) -> Vec<String> {
    let all = run_json(root, &["segment", "list", "run"]);
    all["segments"].as_array().unwrap().iter().map(|s| s["name"].as_str().unwrap().to_owned()).collect()
}

/// The file of the run's segments.
fn file(root: &Path) -> PathBuf {
    root.join("run/segments/segments.safetensors")
}

/// Trains a run, with `more` arguments, and makes two colours its segments.
fn two_colours(more: &[&str]) -> TempDir {
    let folder = dataset();
    train(folder.path(), "run", &[]).args(more).assert().success();
    run_json(folder.path(), &["segment", "coarse", "run", "--clusters", "2", "--keep-outliers"]);
    folder
}

/// Checks that a command is refused with `words` and leaves the run as it was.
fn refused_and_unchanged(root: &Path, arguments: &[&str], words: &[&str]) {
    let state = || (names(&root.join("run")), names(&root.join("run/segments")), std::fs::read(file(root)).unwrap());
    let before = state();
    refused(volseggs().current_dir(root).arg("segment").args(arguments), words);
    assert!(state() == before, "{arguments:?} changed something");
}

#[test]
fn changes_of_segments_are_undone_and_redone() {
    let folder = two_colours(&["--stop-after", "40"]);
    let root = folder.path();
    let colours = listed(root);
    let (one, two) = (colours[0].as_str(), colours[1].as_str());
    let members = |name: &str| {
        let all = volseggs::segment::segmentation::Segmentation::load(&file(root)).unwrap();
        all.get(name).unwrap().members.clone()
    };
    let of_two = members(two);

    segment(root, &["group", "run", "both", one, two]);
    segment(root, &["remove", "run", two]);
    assert_eq!(listed(root), [one, "both"]);
    let all = run_json(root, &["segment", "list", "run"]);
    let done = [format!("remove {two}"), "group both".into(), "coarse".into()];
    assert_eq!((&all["undo"], &all["redo"]), (&serde_json::json!(done), &serde_json::json!([])));
    let (_, message) = segment(root, &["list", "run"]);
    assert!(message.contains("3 to undo") && message.contains("segment undo run"), "{message}");

    let (out, _) = segment(root, &["undo", "run"]);
    assert_eq!(out, format!("undone: remove {two}\n"));
    assert_eq!((listed(root), members(two)), (vec![one.into(), two.into(), "both".into()], of_two.clone()));
    segment(root, &["redo", "run"]);
    assert_eq!(listed(root), [one, "both"]);
    let undone = run_json(root, &["segment", "undo", "run", "--count", "3"]);
    assert_eq!(undone["undone"], serde_json::json!(done));
    let (out, message) = segment(root, &["list", "run"]);
    assert!(
        out.is_empty() && message.contains("segment coarse run") && message.contains("3 to redo"),
        "{out}{message}"
    );
    assert_eq!(run_json(root, &["segment", "list", "run"])["segments"], serde_json::json!([]));
    refused_and_unchanged(root, &["undo", "run"], &["nothing to undo", "segments.safetensors"]);
    refused_and_unchanged(root, &["redo", "run", "--count", "4"], &["--count 4", "between 1 and 3"]);
    refused_and_unchanged(root, &["redo", "run", "--count", "0"], &["--count", "at least 1"]);
    segment(root, &["redo", "run", "--count", "2"]);
    assert_eq!(listed(root), [one, two, "both"]);

    // other colours in their place, then the old ones back
    run_json(root, &["segment", "coarse", "run", "--clusters", "3", "--replace"]);
    let new = listed(root);
    refused_and_unchanged(root, &["redo", "run"], &["nothing to redo"]);
    segment(root, &["undo", "run"]);
    assert_eq!((listed(root), members(two)), (vec![one.into(), two.into(), "both".into()], of_two));
    segment(root, &["redo", "run"]);
    assert_eq!(listed(root), new);

    // neither segments of another state of the scene nor those of a damaged file can be restored
    train(root, "run", &[]).arg("--resume").assert().success();
    refused(volseggs().current_dir(root).args(["segment", "undo", "run"]), &["another state", "--replace"]);
    run_json(root, &["segment", "coarse", "run", "--clusters", "2", "--replace"]);
    assert_eq!(run_json(root, &["segment", "list", "run"])["undo"], serde_json::json!(["coarse"]));
    let mut bytes = std::fs::read(file(root)).unwrap();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    std::fs::write(file(root), bytes).unwrap();
    refused_and_unchanged(root, &["undo", "run"], &["segments.safetensors", "damaged"]);
    let (_, message) = segment(root, &["coarse", "run", "--clusters", "2", "--replace"]);
    assert!(message.contains("undo cannot restore") && message.contains("damaged"), "{message}");
    assert_eq!(run_json(root, &["segment", "list", "run"])["undo"], serde_json::json!(["coarse"]));
}

#[test]
fn simultaneous_commands_are_all_kept() {
    let folder = two_colours(&[]);
    let root = folder.path();
    let whole = &listed(root)[0];
    std::thread::scope(|scope| {
        for i in 0..6 {
            let name = format!("group-{i}");
            scope.spawn(move || segment(root, &["group", "run", &name, whole]));
        }
    });
    let all = run_json(root, &["segment", "list", "run"]);
    assert_eq!((all["segments"].as_array().unwrap().len(), all["undo"].as_array().unwrap().len()), (2 + 6, 1 + 6));
}

#[test]
fn a_split_keeps_segments_that_the_user_made() {
    let folder = two_colours(&[]);
    let root = folder.path();
    let colours = listed(root);
    let name = colours[0].as_str();
    run_json(root, &["segment", "masks", "run", "--views", "5", "--size", "64"]);
    run_json(root, &["segment", "fine", "run", "--steps", "30", "--pixels", "256"]);
    let split = |more: &[&str]| -> Vec<String> {
        let arguments = ["segment", "split", "run", name, "--keep-strays"];
        let parts = run_json(root, &[&arguments[..], more].concat());
        parts.as_array().unwrap().iter().map(|s| s["name"].as_str().unwrap().to_owned()).collect()
    };
    let part = |k: usize| format!("{name}.{k}");
    let pick = |made: &str, within: &str| {
        let all = ["segment", "pick", "run", "--camera", "3,-2,1.5", "--pixel", "16,16", "--threshold", "-1"];
        run_json(root, &[&all[..], &["--keep-strays", "--name", made, "--within", within]].concat());
    };
    assert_eq!(split(&["--clusters", "2"]), [part(1), part(2)]);
    pick("mine", name);
    assert_eq!(split(&["--clusters", "3"]), [part(1), part(2), part(3)]);
    let tree = [vec![name.to_owned(), "mine".into(), part(1), part(2), part(3)], colours[1..].to_vec()].concat();
    assert_eq!(listed(root), tree, "parts are listed below their parent");
    let (out, _) = segment(root, &["list", "run"]);
    assert_eq!(out.lines().filter(|l| l.starts_with("  ")).count(), 4, "{out}");

    // masks belong to the Gaussians that they were made from
    let affinity = root.join("run/segments/affinity.safetensors");
    let field = std::fs::read(&affinity).unwrap();
    segment(root, &["coarse", "run", "--clusters", "4", "--replace"]);
    let again = ["masks.jsonl", "volseggs segment masks run --replace"];
    refused_and_unchanged(root, &["fine", "run", "--steps", "5"], &again);
    segment(root, &["undo", "run"]);
    assert!(std::fs::read(&affinity).unwrap() == field);

    // picked in a part: it is removed only with --replace, and comes back
    let held = (1..=3).map(part).find(|p| {
        let arguments = ["segment", "pick", "run", "--camera", "3,-2,1.5", "--pixel", "16,16", "--within", p];
        volseggs().current_dir(root).args(arguments).output().unwrap().status.success()
    });
    let held = held.unwrap();
    pick("deep", &held);
    refused_and_unchanged(root, &["split", "run", name], &["deep", name, "--replace"]);
    segment(root, &["split", "run", name, "--clusters", "2", "--replace"]);
    assert!(!listed(root).contains(&"deep".to_owned()) && listed(root).contains(&"mine".to_owned()));
    segment(root, &["undo", "run"]);
    assert!(listed(root).contains(&"deep".to_owned()));

    // names in use are skipped
    segment(root, &["split", "run", name, "--clusters", "2", "--replace"]);
    segment(root, &["remove", "run", &part(1)]);
    segment(root, &["group", "run", &part(1), "mine"]);
    assert_eq!(split(&["--clusters", "2"]), [part(2), part(3)]);
    assert!(listed(root).contains(&part(1)));
    // so are names that edits of earlier parts use, undone ones too: they are of other Gaussians
    run_json(root, &["edit", "hide", "run", "--segment", &part(2)]);
    run_json(root, &["edit", "undo", "run"]);
    assert_eq!(split(&["--clusters", "2"]), [part(3), part(4)]);
}

#[test]
fn coarse_accounts_for_every_gaussian() {
    let folder = two_colours(&[]);
    let root = folder.path();
    let coarse = ["segment", "coarse", "run", "--replace", "--min-opacity", "0.05"];
    let found = run_json(root, &coarse);
    let number = |key: &str| found[key].as_u64().unwrap();
    let outside = number("transparent") + number("outliers") + number("not_finite");
    assert_eq!((number("in_segments") + outside, number("gaussians")), (400, 400), "{found}");
    let (out, message) = segment(root, &coarse[1..]);
    let counts: Vec<u64> = out.lines().map(|l| l.split_whitespace().nth(1).unwrap().parse().unwrap()).collect();
    assert!(counts.iter().sum::<u64>() == number("in_segments") && counts.iter().all(|n| *n > 0), "{out}");
    let line = format!("{} of 400 Gaussians are in segments; {} are too", number("in_segments"), number("transparent"));
    assert!(
        message.contains(&line) && message.contains("--min-opacity 0.05") && message.contains("--keep-outliers"),
        "{message}"
    );
    // if none are left, the previous segments stay
    let none = ["coarse", "run", "--replace", "--min-opacity", "1"];
    refused_and_unchanged(root, &none, &["no segments", "400 are too transparent", "--min-opacity 1"]);
}

#[test]
fn invalid_numbers_are_refused() {
    let folder = two_colours(&[]);
    let root = folder.path();
    let name = &listed(root)[0];
    let pick = ["pick", "run", "--pixel", "16,16", "--camera"];
    let at = |camera: &'static str, more: &[&'static str]| [&pick[..], &[camera], more].concat();
    for (arguments, words) in [
        (vec!["coarse", "run", "--replace", "--clusters", "999999999"], &["--clusters 999999999", "only 400"][..]),
        (vec!["coarse", "run", "--replace", "--clusters", "0"], &["--clusters", "at least 1"]),
        (vec!["coarse", "run", "--replace", "--min-opacity", "nan"], &["--min-opacity", "between 0 and 1"]),
        (vec!["coarse", "run", "--replace", "--radius", "nan"], &["--radius", "above 0"]),
        (vec!["coarse", "run", "--replace", "--radius", "0"], &["--radius", "above 0"]),
        (vec!["coarse", "run", "--replace", "--time", "nan"], &["--time", "between 0 and 1"]),
        (vec!["split", "run", name, "--clusters", "999999999"], &["--clusters 999999999", name, "only"]),
        (vec!["split", "run", name, "--scale", "nan"], &["--scale", "between 0 and 1"]),
        (vec!["fine", "run", "--steps", "0"], &["--steps", "at least 1"]),
        (vec!["fine", "run", "--pixels", "0"], &["--pixels", "at least 1"]),
        (vec!["fine", "run", "--margin", "5"], &["--margin", "between -1 and 1"]),
        (vec!["fine", "run", "--rate", "nan"], &["--rate", "above 0"]),
        (vec!["fine", "run", "--hierarchy", "-1"], &["--hierarchy"]),
        (vec!["masks", "run", "--size", "99999"], &["--size", "16384"]),
        (vec!["masks", "run", "--size", "16384", "--memory", "100M"], &["--size 16384", "--memory"]),
        (vec!["masks", "run", "--views", "99999999999"], &["--views 99999999999", "at most"]),
        (vec!["masks", "run", "--views", "0"], &["--views", "at least 1"]),
        (at("nan,0,0", &[]), &["--camera", "three finite numbers"]),
        (at("1e300,0,0", &[]), &["--camera", "three finite numbers"]),
        (at("1,2", &[]), &["--camera", "three finite numbers"]),
        (at("3,0,0", &["--size", "99999"]), &["--size", "16384"]),
        (at("3,0,0", &["--size", "16384", "--memory", "1M"]), &["--size 16384", "--memory"]),
        (at("3,0,0", &["--threshold", "nan"]), &["--threshold", "between -1 and 1"]),
    ] {
        refused_and_unchanged(root, &arguments, words);
    }
    // a camera at the centre itself
    let (_, newest) = volseggs::train::checkpoint::list(&root.join("run")).pop().unwrap();
    let device = volseggs::device::DeviceName::Flex.open().unwrap();
    let scene = volseggs::model::Scene::load(&newest.join("scene.safetensors"), &device).unwrap();
    let [x, y, z] = scene.spec.centre;
    let centre = format!("{x},{y},{z}");
    refused_and_unchanged(root, &[&pick[..], &[&centre]].concat(), &["--camera", "is at the centre"]);
}

#[test]
fn renaming_a_segment_updates_its_edits() {
    let folder = two_colours(&["--stop-after", "40"]);
    let root = folder.path();
    let colours = listed(root);
    let (one, two) = (colours[0].as_str(), colours[1].as_str());
    run_json(root, &["edit", "hide", "run", "--segment", one]);
    let made = run_json(root, &["segment", "rename", "run", one, "core"]);
    assert_eq!(made, serde_json::json!({ "old": one, "name": "core", "segments": ["core", two] }));
    let edits = |root: &Path| run_json(root, &["edit", "list", "run"])["operations"][0]["segments"][0].clone();
    assert_eq!(edits(root), "core");
    let (out, _) = segment(root, &["undo", "run"]);
    assert_eq!((out, edits(root)), (format!("undone: rename {one} core\n"), one.into()));
    segment(root, &["redo", "run"]);
    assert_eq!((listed(root), edits(root)), (vec!["core".to_owned(), two.to_owned()], "core".into()));

    refused_and_unchanged(root, &["rename", "run", one, "x"], &["no segment", one]);
    refused_and_unchanged(root, &["rename", "run", "core", two], &["this name is taken"]);
    refused_and_unchanged(root, &["rename", "run", "core", "../x"], &["cannot be a name"]);
    std::fs::create_dir_all(root.join("run/track").join(two)).unwrap();
    refused_and_unchanged(root, &["rename", "run", two, "x"], &["track", two]);
    // an undone edit still holds the name of a removed segment
    run_json(root, &["segment", "group", "run", "both", "core", two]);
    run_json(root, &["edit", "hide", "run", "--segment", "both"]);
    run_json(root, &["edit", "undo", "run"]);
    run_json(root, &["segment", "remove", "run", "both"]);
    refused_and_unchanged(root, &["rename", "run", "core", "both"], &["both", "edits.json"]);
}

#[test]
fn undo_and_redo_rename_only_what_rename_would() {
    let folder = two_colours(&["--stop-after", "40"]);
    let root = folder.path();
    let colours = listed(root);
    let (one, two) = (colours[0].as_str(), colours[1].as_str());
    let track = |name: &str| root.join("run/track").join(name);

    // another segment has had the name since, and edits of it remain
    segment(root, &["rename", "run", one, "core"]);
    segment(root, &["group", "run", one, "core", two]);
    run_json(root, &["edit", "hide", "run", "--segment", one]);
    refused_and_unchanged(root, &["undo", "run", "--count", "2"], &["undo", one, "edits.json"]);
    segment(root, &["undo", "run"]);
    refused_and_unchanged(root, &["undo", "run"], &["undo", one, "edits.json"]);
    run_json(root, &["edit", "clear", "run"]);
    segment(root, &["undo", "run"]);

    // tracks keep the name of their segment
    std::fs::create_dir_all(track("core")).unwrap();
    refused_and_unchanged(root, &["redo", "run"], &["redo", "core", "track"]);
    refused_and_unchanged(root, &["rename", "run", two, "core"], &["core", "track"]);
    std::fs::remove_dir(track("core")).unwrap();
    segment(root, &["redo", "run"]);
    std::fs::create_dir_all(track("core")).unwrap();
    refused_and_unchanged(root, &["undo", "run"], &["undo", "core", "track"]);
    std::fs::remove_dir(track("core")).unwrap();
    segment(root, &["undo", "run", "--count", "1"]);
    assert_eq!(listed(root), colours);
}

#[test]
fn a_rename_that_the_edits_missed_can_be_taken_back() {
    let folder = two_colours(&["--stop-after", "40"]);
    let root = folder.path();
    let one = listed(root)[0].clone();
    let edits = root.join("run/edits.json");
    run_json(root, &["edit", "hide", "run", "--segment", &one]);
    let before = std::fs::read(&edits).unwrap();
    segment(root, &["rename", "run", &one, "core"]);
    let after = std::fs::read(&edits).unwrap();
    // as if the program had been stopped between the two files
    std::fs::write(&edits, &before).unwrap();
    segment(root, &["undo", "run"]);
    assert!(listed(root)[0] == one && std::fs::read(&edits).unwrap() == before);
    std::fs::write(&edits, &after).unwrap();
    segment(root, &["redo", "run"]);
    assert!(listed(root)[0] == "core" && std::fs::read(&edits).unwrap() == after);
}

#[test]
fn masks_know_segments_with_exchanged_names_and_draw_each_once() {
    let folder = two_colours(&[]);
    let root = folder.path();
    let colours = listed(root);
    let (one, two) = (colours[0].as_str(), colours[1].as_str());
    let masks = ["segment", "masks", "run", "--views", "5", "--size", "64", "--replace", "--segment", one];
    let once = run_json(root, &masks)["masks"].clone();
    assert_eq!(run_json(root, &[&masks[..], &["--segment", one]].concat())["masks"], once);
    let reader = volseggs::segment::masks::MaskReader::open(&root.join("run/segments/masks.jsonl")).unwrap();
    assert_eq!(reader.header().segments, [one]);
    drop(reader);

    run_json(root, &[&masks[..], &["--segment", two]].concat());
    for (old, new) in [(one, "other"), (two, one), ("other", two)] {
        segment(root, &["rename", "run", old, new]);
    }
    assert_eq!(listed(root), [two, one]);
    run_json(root, &["segment", "fine", "run", "--steps", "5", "--pixels", "256"]);
}
