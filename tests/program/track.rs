//! `volseggs track` as a whole program: pictures, masks and areas of segments at chosen times.

use crate::common::{SIZE, dataset, names, refused, run_json, train, volseggs};
use std::path::Path;

/// Returns the number of set pixels of a mask, whose values are all 0 or 255, and its size.
fn pixels(path: &Path) -> (u64, (u32, u32)) {
    let mask = image::open(path).unwrap().into_luma8();
    assert!(mask.pixels().all(|p| matches!(p.0, [0 | 255])), "{}", path.display());
    (mask.pixels().filter(|p| p.0 == [255]).count() as u64, mask.dimensions())
}

#[test]
fn masks_areas_and_pictures_of_chosen_times() {
    let folder = dataset();
    let root = folder.path();
    train(root, "run", &[]).assert().success();
    let coarse = run_json(root, &["segment", "coarse", "run", "--clusters", "2"]);
    let name = coarse["segments"][0]["name"].as_str().unwrap().to_owned();
    let other = coarse["segments"][1]["name"].as_str().unwrap().to_owned();
    let out = root.join("run/track").join(&name);
    let track = ["track", "run", "--segment", &name];

    let low = ["--mask-alpha", "0.2"];
    let plain = run_json(root, &[&track[..], &low, &["--frames", "4"]].concat());
    let tables = [
        "columns.csv",
        "events.csv",
        "over-time.svg",
        "statistics.csv",
        "statistics.json",
        "times.png",
        "tracks.csv",
        "velocity-over-time.svg",
    ];
    assert_eq!(names(&out), tables);
    let rows = plain[0]["statistics"].as_array().unwrap();
    assert_eq!(rows.len(), 4);
    for row in rows {
        let (area, share) = (row["projected_area"].as_u64().unwrap(), row["projected_share"].as_f64().unwrap());
        assert!(area > 0 && (share - area as f64 / f64::from(SIZE * SIZE)).abs() < 1e-12, "{row}");
    }
    let csv = std::fs::read_to_string(out.join("statistics.csv")).unwrap();
    let last = |line: &str| line.rsplit(',').nth(1).unwrap().to_owned();
    let lines: Vec<String> = csv.lines().map(last).collect();
    assert_eq!((lines[0].as_str(), &lines[1]), ("projected_area", &rows[0]["projected_area"].to_string()));
    assert!(std::fs::read_to_string(out.join("over-time.svg")).unwrap().contains("projected area"));

    // chosen times in any order, at twice the size, from a test view; both segments at once
    let chosen = ["--segment", &other, "--renders", "--at", "0.8", "--at", "0.1", "--at", "0.8", "--view", "2"];
    let rendered = run_json(root, &[&track[..], &low, &chosen, &["--size", "64"]].concat());
    let rows = rendered[0]["statistics"].as_array().unwrap();
    assert_eq!(rows.iter().map(|r| r["time"].as_f64().unwrap()).collect::<Vec<_>>(), [0.1, 0.8]);
    assert_eq!(rendered[0]["size"], serde_json::json!([64, 64]));
    for (i, segment) in [&name, &other].into_iter().enumerate() {
        let out = root.join("run/track").join(segment);
        assert_eq!(names(&out.join("renders")), ["000.png", "001.png"]);
        assert_eq!(names(&out.join("masks")), ["000.png", "001.png"]);
        for k in 0..2 {
            let (area, size) = pixels(&out.join(format!("masks/00{k}.png")));
            assert_eq!((size, rendered[i]["statistics"][k]["projected_area"].as_u64()), ((64, 64), Some(area)));
        }
        let render = image::open(out.join("renders/000.png")).unwrap();
        assert_eq!((render.width(), render.height()), (64, 64));
    }

    // a stricter mask is smaller; a camera of its own; a single time
    let one = [&track[..], &["--at", "0.8", "--view", "2", "--size", "64"]].concat();
    let area = |more: &[&str]| {
        let found = run_json(root, &[&one[..], more].concat());
        found[0]["statistics"][0]["projected_area"].as_u64().unwrap()
    };
    assert_eq!(area(&low), rows[1]["projected_area"].as_u64().unwrap());
    assert!(area(&["--mask-alpha", "0.6"]) < area(&low));
    let beside = run_json(root, &[&track[..], &low, &["--at", "0.8", "--camera=-9,0.5,3"]].concat());
    assert!(beside[0]["statistics"][0]["projected_share"].as_f64() < rows[1]["projected_share"].as_f64(), "{beside}");

    // edits apply only to the pictures
    let hide = format!(r#"{{"format":1,"operations":[{{"segments":["{name}"],"operation":"hide"}}],"undone":[]}}"#);
    std::fs::write(root.join("run/edits.json"), hide).unwrap();
    let hidden = run_json(root, &[&one[..], &low].concat());
    assert_eq!(hidden[0]["statistics"][0]["projected_area"], 0);
    assert_eq!(hidden[0]["statistics"][0]["opacity"], rows[1]["opacity"]);
    assert_eq!(area(&[&low[..], &["--no-edits"]].concat()), rows[1]["projected_area"].as_u64().unwrap());

    // a group does not take the name of a segment, unless it is the same
    let group = |members: &[&str], group: &str| {
        let mut command = volseggs();
        command.current_dir(root).args(["track", "run", "--at", "0.5", "--group", group]);
        command.args(members.iter().flat_map(|member| ["--segment", *member]));
        command
    };
    let table = std::fs::read(out.join("statistics.csv")).unwrap();
    refused(&mut group(&[&other], &name), &[&name, "other Gaussians"]);
    refused(&mut group(&[&name, &other], &name), &[&name, "other Gaussians"]);
    assert!(std::fs::read(out.join("statistics.csv")).unwrap() == table, "the segment's track is unchanged");
    group(&[&name], &name).assert().success();
    group(&[&name, &other], "pair").assert().success();
    assert!(names(&root.join("run/track")).contains(&"pair".to_owned()));

    let before = names(&out);
    for (arguments, words) in [
        (&["--at", "0.5", "--frames", "4"][..], &["--at", "--frames"][..]),
        (&["--at", "1.5"], &["--at", "1.5", "between 0 and 1"]),
        (&["--view", "99"], &["--view 99", "0 to 5"]),
        (&["--view", "1", "--camera", "1,2,3"], &["--view", "--camera"]),
        (&["--camera", "1,2"], &["--camera", "three"]),
        (&["--mask-alpha", "0"], &["--mask-alpha"]),
        (&["--size", "0"], &["--size"]),
    ] {
        refused(volseggs().current_dir(root).args(track).args(arguments), words);
    }
    assert_eq!(names(&out), before);
}
