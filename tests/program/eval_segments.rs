//! `volseggs eval --segments` as a whole program: clicks, every method, the table and its files.

use crate::common::{json, names, refused, run_json, train, volseggs};
use serde_json::Value;

const METHODS: [&str; 5] = ["sagd", "saga", "coarse", "fine", "coarse+fine"];

#[test]
fn known_segments_are_evaluated_with_every_method() {
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
    for file in ["segments.csv", "segments.json", "segments.png", "table.md", "tracking.csv", "volumes.csv"] {
        assert!(names(&folder).contains(&file.to_owned()), "{file} in {:?}", names(&folder));
    }
    assert_eq!(json(&folder.join("segments.json")), found);
    let csv = std::fs::read_to_string(folder.join("segments.csv")).unwrap();
    let last: Vec<&str> = csv.lines().map(|l| l.rsplit(',').next().unwrap()).collect();
    let time = found["results"][0]["fixed"]["time_3d"].as_f64().unwrap();
    assert_eq!(last[..2], ["time_3d".to_owned(), format!("{time:.6}")]);
    assert_eq!(names(&root.join("run/eval")), ["segments"], "masks are not kept");
    let results = found["results"].as_array().unwrap();
    assert!(!results.is_empty() && results.len() % METHODS.len() == 0);
    assert_eq!((&found["oracle_tries"], &found["seed"], &found["masks"]), (&12.into(), &0.into(), &"regions".into()));
    assert!(!found["volume_times"].as_array().unwrap().is_empty(), "prepare writes volumes of segment ids");
    for (result, method) in results.iter().zip(METHODS.iter().cycle()) {
        assert_eq!(result["method"], *method);
        assert!(result["pixel"][0].as_u64().unwrap() < 32, "{result}");
        assert!(result["fixed"]["fit"].is_null(), "the fixed setting does not use the ground truth");
        let fit = result["oracle"]["fit"].as_f64().unwrap();
        assert!((0.0..=1.0).contains(&fit), "{result}");
        for kind in ["fixed", "oracle"] {
            for row in result[kind]["times"].as_array().unwrap() {
                assert!(row["iou"].is_null() || (0.0..=100.0).contains(&row["iou"].as_f64().unwrap()), "{row}");
                assert!(row["psnr"].as_f64().unwrap() > 0.0 && row["views"].as_u64().unwrap() == 3, "{row}");
            }
            let volumes = result[kind]["volumes"].as_array().unwrap();
            assert_eq!(volumes.len(), found["volume_times"].as_array().unwrap().len());
            let (at, least) = (result[kind]["iou_3d"].as_f64(), result[kind]["least_iou_3d"].as_f64());
            assert!(least <= at && at.is_none_or(|v| (0.0..=100.0).contains(&v)), "{at:?} {least:?}");
        }
    }
    assert_eq!(found["means"].as_array().unwrap().len(), METHODS.len());
    // the same when repeated, bit for bit except for the seconds
    let numbers = |v: &Value| -> Vec<Value> {
        let kinds = |r: &Value| {
            ["fixed", "oracle"].map(|k| {
                let o = &r[k];
                serde_json::json!([o["setting"], o["fit"], o["iou_3d"], o["at"], o["times"], o["volumes"]])
            })
        };
        let of = |r: &Value| serde_json::json!([r["segment"], r["method"], kinds(r)]);
        v["results"].as_array().unwrap().iter().map(of).collect()
    };
    assert_eq!(numbers(&run(&[])), numbers(&found));

    // the ground truth as masks, one method, one segment and all as one; the table on the terminal
    let mut known: Vec<&str> = results.iter().map(|r| r["segment"].as_str().unwrap()).collect();
    known.dedup();
    let (only, all) = (known[0], format!("all={}", known.join("+")));
    let table = |more: &[&str]| {
        let printed = volseggs().current_dir(root).args(["eval", "run"]).args(more).args(short.split(' ')).assert();
        String::from_utf8(printed.success().get_output().stdout.clone()).unwrap()
    };
    let printed = table(&["--masks", "labels", "--methods", "fine", "--only", only, "--score", &all, "--no-oracle"]);
    assert!(printed.starts_with("| segment | method | 3D IoU % | min | 2D IoU % | min | PSNR dB |"), "{printed}");
    assert!(!printed.to_lowercase().contains("oracle") && printed.contains("Seed 0; masks: labels"), "{printed}");
    let row = |name: &str| printed.lines().find(|l| l.starts_with(&format!("| {name} | fine |"))).unwrap().to_owned();
    let cells = row("all").split('|').map(|c| c.trim().to_owned()).collect::<Vec<_>>();
    assert!(cells[3].parse::<f64>().is_ok() && cells[5].parse::<f64>().is_ok(), "{cells:?}");
    assert_eq!(cells[7..10], ["-", "-", "-"], "several segments scored as one have no picture");
    assert_eq!(row("**mean**").split('|').nth(3), row(only).split('|').nth(3), "the mean covers single segments only");
    assert_eq!(names(&root.join("run/eval")), ["segments", "segments-labels"]);

    // pictures for another program, and its masks read back
    let fine = ["eval", "run", "--methods", "fine", "--no-oracle"];
    let pictures = [&["--mask-pictures", "pictures"][..], &short.split(' ').collect::<Vec<_>>()[..]].concat();
    let written = run_json(root, &[&fine[..], &pictures].concat());
    assert!(written["pictures"].as_u64().is_some_and(|n| n > 0) && written["folder"] == "pictures", "{written}");
    refused(volseggs().current_dir(root).args(fine).args(&pictures), &["--mask-pictures pictures"]);
    for flag in [["--views", "5"], ["--split", "train"]] {
        let said = volseggs().current_dir(root).args(["eval", "run", "--segments"]).args(flag).assert().code(2);
        let text = String::from_utf8_lossy(&said.get_output().stderr).into_owned();
        assert!(text.contains(flag[0]) && text.contains("--segments"), "{text}");
    }
    let none = ["eval", "run", "--methods", "coarse", "--no-oracle", "--mask-pictures", "none"];
    refused(volseggs().current_dir(root).args(none).args(short.split(' ')), &["none of the methods needs masks"]);
    let biased = ["eval", "run", "--segments", "--masks", "labels", "--mask-bias", "x"];
    refused(volseggs().current_dir(root).args(biased), &["--mask-bias"]);
    for masks in ["labels", "sam"] {
        let (both, named) = (["--masks", masks, "--mask-pictures", "none"], format!("--masks {masks}"));
        let mut command = volseggs();
        command.current_dir(root).args(fine).args(both).args(short.split(' '));
        refused(&mut command, &["--mask-pictures", &named]);
    }
    assert_eq!(names(&root.join("pictures")), ["pictures.json", "scene"]);
    std::fs::create_dir_all(root.join("masks/scene")).unwrap();
    for view in 0..4 {
        let drawn = image::open(root.join(format!("pictures/scene/view-{view:03}.png"))).unwrap().into_luma8();
        let mask = image::GrayImage::from_fn(32, 32, |x, y| image::Luma([u8::from(drawn.get_pixel(x, y).0[0] < 250)]));
        mask.save(root.join(format!("masks/scene/view-{view:03}_1.png"))).unwrap();
    }
    let printed = table(&["--methods", "fine", "--no-oracle", "--masks", "dir", "--mask-dir", "masks"]);
    assert!(printed.contains("masks: dir, 4 views"), "{printed}");
    assert_eq!(names(&root.join("run/eval")), ["segments", "segments-dir", "segments-labels"]);

    // a dataset without views of its segments has no volumes
    let path = root.join("data/segments.json");
    let mut before = json(&path);
    before["volumes"] = serde_json::json!([]);
    std::fs::write(&path, before.to_string()).unwrap();
    let printed = table(&["--methods", "coarse", "--no-oracle"]);
    assert!(printed.contains("| coarse | - | - |") && printed.contains("volumes of segment ids"), "{printed}");

    for (arguments, needle) in [
        (&["--segments", "--only", "nobody"][..], only),
        (&["--segments", "--methods", "magic"], "coarse+fine"),
        (&["--segments", "--time", "2"], "--time <T>"),
        (&["--segments", "--clicks", "0"], "--clicks"),
        (&["--segments", "--mask-alpha", "0"], "--mask-alpha 0"),
        (&["--segments", "--score", "pair"], "NAME=SEGMENT+SEGMENT"),
        (&["--segments", "--score", "pair=nobody+no-one"], "nobody"),
        (&["--segments", "--mask-scale", "large"], "--mask-scale"),
        (&["--segments", "--masks", "dir"], "--mask-dir"),
        (&["--segments", "--mask-dir", "masks"], "--masks dir"),
        (&["--segments", "--masks", "dir", "--mask-dir", "no-such-masks"], "no-such-masks"),
        (&["--segments", "--masks", "sam", "--sam-weights", "no-such-weights"], "no-such-weights"),
        (&["--methods", "fine"], "--segments"),
    ] {
        refused(volseggs().current_dir(root).args(["eval", "run"]).args(arguments), &[needle]);
    }
    std::fs::remove_file(root.join("data/segments.json")).unwrap();
    refused(volseggs().current_dir(root).args(["eval", "run", "--segments"]), &["segments.json", "prepare"]);
}
