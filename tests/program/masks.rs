//! The sources of `volseggs segment masks` as a whole program: the ground truth of a dataset, masks of other programs,
//! a network.

use crate::common::{dataset, json, names, refused, run_json, text, train, volseggs};
use image::{GrayImage, Luma};
use std::path::Path;
use volseggs::segment::masks::{Annotation, MaskReader};

/// Reads all masks of `segments/masks.jsonl` of the run.
fn masks(root: &Path) -> (MaskReader, Vec<Annotation>) {
    let reader = MaskReader::open(&root.join("run/segments/masks.jsonl")).unwrap();
    let all = (0..reader.header().views.len()).flat_map(|v| reader.view(v).unwrap()).collect();
    (reader, all)
}

/// Checks that a command is refused with `words` and leaves the run's segments as they were.
fn refused_and_unchanged(root: &Path, arguments: &[&str], words: &[&str]) {
    let folder = root.join("run/segments");
    let state = || (names(&folder), std::fs::read(folder.join("masks.jsonl")).ok());
    let before = state();
    refused(volseggs().current_dir(root).args(["segment", "masks", "run"]).args(arguments), words);
    assert!(state() == before, "{arguments:?} left something behind");
}

#[test]
fn incompatible_options_are_refused_before_anything_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let with = |arguments: &[&str], words: &[&str]| {
        let mut command = volseggs();
        command.current_dir(folder.path()).env("XDG_CACHE_HOME", folder.path().join("cache"));
        refused(command.args(["segment", "masks", "run"]).args(arguments), words);
    };
    with(&["--masks", "d", "--source", "sam"], &["--masks is for --source dir"]);
    with(&["--points", "4"], &["--points is for --source sam"]);
    with(&["--sam-weights", "w"], &["--sam-weights is for --source sam"]);
    with(&["--source", "dir"], &["--masks PATH"]);
    with(&["--source", "dir", "--masks", "m", "--views", "3"], &["--views cannot be combined with --source dir"]);
    with(&["--source", "labels", "--size", "40"], &["--size cannot be combined with --source labels"]);
    with(&["--source", "sam", "--points", "0"], &["at least 1"]);
    with(&["--pictures", "--source", "labels"], &["omit --source"]);
    with(&["--time", "2"], &["between 0 and 1"]);
    with(&["--pictures", "--replace"], &["--pictures", "--replace", "cannot be used with"]);
    // the network's weights are looked for first, and the message says how to make them
    let places = ["cache/volseggs/mobile_sam.safetensors", "--sam-weights", "ChaoningZhang/MobileSAM", "save_file"];
    with(&["--source", "sam"], &places);
    with(&["--source", "sam", "--sam-weights", "mine.safetensors"], &["looked for mine.safetensors"]);
    assert!(names(folder.path()).is_empty());
}

#[test]
fn the_ground_truth_of_a_dataset_becomes_masks() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let few = "prepare --synthetic jets --dims 32 --series-steps 4 --size 64 --times 2 --views 6 --test-views 4 \
               --segment-views 0 --out";
    volseggs().args(few.split_whitespace()).arg(text(root, "data")).assert().success();
    train(root, "run", &[]).assert().success();
    run_json(root, &["segment", "coarse", "run", "--clusters", "2", "--time", "0.9"]);

    let made = run_json(root, &["segment", "masks", "run", "--source", "labels", "--views", "6"]);
    assert_eq!((&made["time"], &made["source"]), (&1.0.into(), &"labels of data".into()));
    let (reader, all) = masks(root);
    let header = reader.header();
    assert_eq!((header.width, header.height, header.time), (64, 64, 1.0));
    assert_eq!((header.views.len(), header.source.as_str()), (6, "labels of data"));
    assert!(header.views.iter().all(|v| v.file.starts_with("train/r_")));
    assert_eq!(made["masks"], all.len());
    assert!(!all.is_empty() && all.iter().all(|a| a.mask.area() >= 16 && a.predicted_iou == 1.0));
    // a mask shows pixels of one label only, and no pixel is in masks of two labels or segments
    for (view, entry) in header.views.iter().enumerate() {
        let labels = image::open(root.join(format!("data/labels/{}.png", entry.file))).unwrap().to_luma8();
        let mut taken = [false; 64 * 64];
        for annotation in reader.view(view).unwrap() {
            let pixels: Vec<u32> = annotation.mask.pixels().collect();
            let label = labels.as_raw()[pixels[0] as usize];
            assert!(label > 0 && pixels.iter().all(|p| labels.as_raw()[*p as usize] == label));
            assert!(pixels.iter().all(|p| !std::mem::replace(&mut taken[*p as usize], true)));
        }
    }
    run_json(root, &["segment", "fine", "run", "--steps", "5", "--pixels", "128"]);
    let began = std::time::Instant::now();
    for more in [&["--pictures"][..], &["--replace"]] {
        let words = ["--views 9999999: a mask file holds at most 671088 views"];
        refused_and_unchanged(root, &[&["--views", "9999999"], more].concat(), &words);
    }
    assert!(began.elapsed().as_secs() < 20, "{:?}", began.elapsed());
    // more views than training has at that time: the test view of that time joins; fewer: some of them
    let again = ["segment", "masks", "run", "--source", "labels", "--replace"];
    refused_and_unchanged(root, &["--source", "labels"], &["masks.jsonl", "--replace"]);
    run_json(root, &again);
    let files = |reader: &MaskReader| reader.header().views.iter().map(|v| v.file.clone()).collect::<Vec<_>>();
    assert_eq!(files(&masks(root).0)[6..], ["test/r_3"]);
    run_json(root, &[&again[..], &["--views", "2", "--time", "0.1"]].concat());
    let (reader, _) = masks(root);
    assert_eq!((reader.header().views.len(), reader.header().time), (2, 0.0));

    // a wrong image among them leaves the old masks
    let wrong = root.join("data/labels").join(format!("{}.png", files(&reader)[1]));
    let kept = std::fs::read(&wrong).unwrap();
    GrayImage::new(60, 64).save(&wrong).unwrap();
    let labels = ["--source", "labels", "--time", "0.1", "--replace"];
    refused_and_unchanged(root, &labels, &["60x64", "64x64", wrong.file_name().unwrap().to_str().unwrap()]);
    std::fs::write(&wrong, kept).unwrap();
    std::fs::rename(root.join("data"), root.join("moved")).unwrap();
    refused_and_unchanged(root, &labels, &["data", "no longer there", "--data"]);
    run_json(root, &[&again[..], &["--data", "moved"]].concat());
    assert_eq!(masks(root).0.header().source, "labels of moved");
    // a dataset with other cameras, to which the scene does not belong
    let moved = ["--source", "labels", "--data", "moved", "--replace"];
    let cameras = root.join("moved/transforms_train.json");
    let kept = std::fs::read_to_string(&cameras).unwrap();
    std::fs::write(&cameras, format!("{kept}\n")).unwrap();
    refused_and_unchanged(root, &moved, &["moved", "of another scene", "--data"]);
    std::fs::write(&cameras, kept).unwrap();
    std::fs::remove_file(root.join("moved/segments.json")).unwrap();
    refused_and_unchanged(root, &moved, &["segments.json", "volseggs prepare"]);
}

#[test]
fn masks_of_another_program_are_imported() {
    let folder = dataset();
    let root = folder.path();
    train(root, "run", &[]).assert().success();
    run_json(root, &["segment", "coarse", "run", "--clusters", "2"]);
    let dir = ["--source", "dir", "--masks", "masks", "--replace"];
    refused_and_unchanged(root, &dir, &["--pictures"]);

    // 1. the pictures
    let made =
        run_json(root, &["segment", "masks", "run", "--pictures", "--views", "3", "--size", "40", "--time", "0.3"]);
    let pictures = root.join("run/segments/pictures");
    let groups: Vec<String> = names(&pictures).into_iter().filter(|n| n != "pictures.json").collect();
    assert_eq!((&made["pictures"], groups.len()), (&6.into(), 2));
    assert_eq!(names(&pictures.join(&groups[0])), ["view-000.png", "view-001.png", "view-002.png"]);
    refused_and_unchanged(root, &["--pictures"], &["pictures", "remove the folder"]);
    refused_and_unchanged(root, &dir, &["masks"]);
    assert!(!root.join("run/segments/masks.jsonl").exists());

    // 2. another program: everything that differs from the background, left and right halves; no mask in the last view
    let mut coco = (Vec::new(), Vec::new());
    for (g, group) in groups.iter().enumerate() {
        std::fs::create_dir_all(root.join("masks").join(group)).unwrap();
        for view in ["view-000", "view-001"] {
            let picture = image::open(pictures.join(group).join(format!("{view}.png"))).unwrap().to_rgb8();
            assert_eq!(picture.dimensions(), (40, 40));
            let empty = *picture.get_pixel(0, 0);
            let id = coco.0.len();
            coco.0.push(serde_json::json!({
                "id": id, "file_name": format!("{group}/{view}.png"), "width": 40, "height": 40
            }));
            for half in 0..2 {
                let inside = |x: u32, y: u32| *picture.get_pixel(x, y) != empty && x / 20 == half;
                let mask = GrayImage::from_fn(40, 40, |x, y| Luma([255 * u8::from(inside(x, y))]));
                mask.save(root.join("masks").join(group).join(format!("{view}_{half}.png"))).unwrap();
                let rows: Vec<bool> = mask.as_raw().iter().map(|v| *v > 0).collect();
                let mask = volseggs::segment::masks::Mask::from_rows(40, 40, &rows).unwrap();
                assert!(mask.area() > 0, "segment {g} is not in view");
                coco.1.push(serde_json::json!({
                    "image_id": id, "segmentation": { "size": [40, 40], "counts": mask.counts }
                }));
            }
        }
    }

    // 3. read them
    let made = run_json(root, &[&["segment", "masks", "run"], &dir[..]].concat());
    assert_eq!((&made["masks"], made["time"].as_f64()), (&8.into(), Some(0.3)));
    let (reader, all) = masks(root);
    let header = reader.header();
    assert_eq!((header.width, header.height, header.source.as_str()), (40, 40, "dir masks"));
    assert_eq!((header.views.len(), reader.view_len(2)), (3, 0));
    for annotation in &all {
        let (view, group) = (annotation.image_id, &header.segments[annotation.segment as usize]);
        let half = usize::from(annotation.mask.bbox()[0] >= 20);
        let path = root.join("masks").join(group).join(format!("view-{view:03}_{half}.png"));
        let rows = image::open(path).unwrap().to_luma8();
        assert_eq!(annotation.mask.to_rows(), rows.as_raw().iter().map(|v| *v > 0).collect::<Vec<_>>());
    }
    // the same from a COCO file; then for one segment only
    let text = serde_json::json!({ "images": coco.0, "annotations": coco.1 }).to_string();
    std::fs::write(root.join("masks.json"), text).unwrap();
    refused_and_unchanged(root, &["--source", "dir", "--masks", "masks.json"], &["masks.jsonl", "--replace"]);
    run_json(root, &["segment", "masks", "run", "--source", "dir", "--masks", "masks.json", "--replace"]);
    assert_eq!(masks(root).1, all);
    let one = ["segment", "masks", "run", "--source", "dir", "--masks", "masks", "--replace", "--segment", &groups[1]];
    assert_eq!(run_json(root, &one)["masks"], 4);
    run_json(root, &["segment", "fine", "run", "--steps", "5", "--pixels", "128"]);

    // a mask of the wrong size is named, and the previous masks stay
    let wrong = root.join("masks").join(&groups[1]).join("view-001_1.png");
    GrayImage::new(41, 40).save(&wrong).unwrap();
    refused_and_unchanged(root, &dir, &["view-001_1.png", "41x40", "40x40"]);
    std::fs::rename(&wrong, wrong.with_file_name("view-009.png")).unwrap();
    refused_and_unchanged(root, &dir, &["view-009.png", "fits no view"]);
    // other Gaussians under the old names
    let list = pictures.join("pictures.json");
    let list_before = json(&list);
    let mut changed = list_before.clone();
    changed["groups"][0]["gaussians"] = 1.into();
    std::fs::write(&list, changed.to_string()).unwrap();
    refused_and_unchanged(root, &dir, &["had 1 Gaussians", "--pictures"]);
    // as many others
    let mut changed = list_before.clone();
    changed["groups"][0]["members"] = "0".into();
    std::fs::write(&list, changed.to_string()).unwrap();
    refused_and_unchanged(root, &dir, &["has other Gaussians now", "--pictures"]);
}
