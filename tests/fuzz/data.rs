//! Datasets: `transforms_*.json`, images, `segments.json`.

use crate::driver::{Scratch, Target, accepted, fuzz};
use image::{GrayImage, ImageFormat, Luma, Rgba, RgbaImage};
use std::io::Cursor;
use std::path::Path;
use volseggs::data::hull::Aabb;
use volseggs::data::paths::{Lens, training_cameras};
use volseggs::data::transforms::{FrameRecord, Intrinsics};
use volseggs::data::truth::{SegmentEntry, SegmentFile, SegmentFrame};
use volseggs::data::{Dataset, Frame, OpenOptions, SplitName, Transforms, Truth, inspect, layout};
use volseggs::prepare::PrepareRecord;

/// Width and height of the images.
const SIZE: u32 = 8;

/// Returns the JSON of a split of two views.
fn json(split: &str, lens: Intrinsics) -> String {
    let cameras = training_cameras(2, 4.0, Lens { fov_x: 0.5, width: SIZE, height: SIZE });
    let record = |(i, camera): (usize, volseggs::data::Camera)| FrameRecord {
        file_path: format!("./{split}/r_{i}"),
        camera_to_world: camera.camera_to_world,
        time: i as f64,
    };
    let frames = cameras.into_iter().enumerate().map(record).collect();
    Transforms { path: "transforms.json".into(), intrinsics: lens, frames }.to_json()
}

fn angle() -> Intrinsics {
    Intrinsics { camera_angle_x: Some(0.5), ..Intrinsics::default() }
}

/// Returns the JSON in several forms.
fn jsons() -> Vec<Vec<u8>> {
    let side = Some(f64::from(SIZE));
    let focal =
        Intrinsics { fl_x: Some(9.0), fl_y: Some(8.0), cx: Some(4.0), cy: Some(4.0), w: side, h: side, ..angle() };
    let compact: serde_json::Value = serde_json::from_str(&json("train", angle())).unwrap();
    [json("train", angle()), json("train", focal), compact.to_string()].map(String::into_bytes).to_vec()
}

const TOKENS: &[&str] = &[
    "\"frames\"",
    "\"file_path\"",
    "\"transform_matrix\"",
    "\"time\"",
    "\"camera_angle_x\": 0.6,",
    "\"fl_x\": 100,",
    "\"w\": 8,",
    "\"h\": 8,",
    "\"k1\": 0.1,",
    "../../etc/passwd",
    "/dev/zero",
    ".PNG",
    "./train/r_1",
    "\"\"",
    "[0, 0, 0, 1]",
];

pub fn png(image: &image::DynamicImage) -> Vec<u8> {
    let mut out = Cursor::new(Vec::new());
    image.write_to(&mut out, ImageFormat::Png).unwrap();
    out.into_inner()
}

pub fn picture(side: u32) -> Vec<u8> {
    let inside = |x: u32, y: u32| !(x + y).is_multiple_of(3);
    png(&RgbaImage::from_fn(side, side, |x, y| Rgba(if inside(x, y) { [200, 100, x as u8, 255] } else { [0; 4] }))
        .into())
}

pub fn labels(side: u32) -> Vec<u8> {
    png(&GrayImage::from_fn(side, side, |x, y| Luma([((x / 3 + y / 3) % 3) as u8])).into())
}

/// Corrects the checksums of a PNG's chunks.
pub fn with_checksums(mut bytes: Vec<u8>) -> Vec<u8> {
    let mut at = 8;
    while let Some(head) = bytes.get(at..at + 8) {
        let length = u32::from_be_bytes([head[0], head[1], head[2], head[3]]) as usize;
        let end = at + 8 + length;
        if end + 4 > bytes.len() {
            break;
        }
        let mut sum = flate2::Crc::new();
        sum.update(&bytes[at + 4..end]);
        bytes[end..end + 4].copy_from_slice(&sum.sum().to_be_bytes());
        at = end + 4;
    }
    bytes
}

/// Writes a dataset with two training and two test views, and the ground truth of its segments.
pub fn dataset(scratch: &Scratch) {
    for split in ["train", "test"] {
        scratch.write(&format!("transforms_{split}.json"), json(split, angle()).as_bytes());
        for i in 0..2 {
            scratch.write(&format!("{split}/r_{i}.png"), &picture(SIZE));
            scratch.write(&format!("labels/{split}/r_{i}.png"), &labels(SIZE));
        }
    }
    scratch.write("segments.json", &segments());
}

fn segments() -> Vec<u8> {
    let frame = SegmentFrame {
        file_path: "./segments/a/r_0.png".into(),
        mask_path: "./segments/a/r_0_mask.png".into(),
        transform_matrix: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0], [0.0, 0.0, 0.0, 1.0]],
        time: 0.5,
        pixels: 7,
    };
    let file = SegmentFile {
        source: "labels".into(),
        mask_alpha: 0.5,
        camera_angle_x: 0.5,
        size: [SIZE; 2],
        label_images: vec!["./labels/train".into(), "./labels/test".into()],
        segments: vec![
            SegmentEntry { id: 1, name: "a".into(), frames: vec![frame] },
            SegmentEntry { id: 2, name: "b".into(), frames: Vec::new() },
        ],
        volumes: Vec::new(),
        lineage: Vec::new(),
    };
    volseggs::versioned::to_json_pretty(&file).unwrap()
}

#[test]
fn transforms() {
    fuzz("transforms", |_| {
        let read = |bytes: &[u8]| {
            let text = String::from_utf8_lossy(bytes);
            let Some(found) = accepted(Transforms::parse(Path::new("t.json"), &text)) else { return false };
            let again = Transforms::parse(Path::new("t.json"), &found.to_json()).unwrap();
            assert_eq!(again, found, "unchanged by writing and reading");
            let frames: Vec<Frame> = found
                .frames
                .iter()
                .map(|f| Frame {
                    name: f.name(),
                    path: f.image_path(Path::new("/root")),
                    camera: found.intrinsics.camera(SIZE, SIZE, f.camera_to_world),
                    time: f.time,
                })
                .collect();
            let _ = volseggs::data::camera::look_at_point(frames.iter().map(|f| &f.camera));
            let _ = volseggs::data::dataset::scene_extent(&frames);
            // a picture takes longer than everything else
            if bytes.len().is_multiple_of(16) {
                let _ = layout::layout_picture(&frames, &Aabb::cube(glam::DVec3::ZERO, 1.0));
            }
            true
        };
        Target::new(jsons(), read).tokens(TOKENS)
    });
}

/// Opens the whole dataset and inspects it.
fn open(root: &Path) -> bool {
    let options = OpenOptions { downscale: 2, splits: &[SplitName::Train, SplitName::Test], max_views: None };
    let opened = accepted(Dataset::open(root, &options));
    if let Some(dataset) = &opened {
        assert_eq!(dataset.train.images.len(), dataset.train.frames.len());
        let _ = (dataset.times(), dataset.scene_extent(), dataset.fingerprint());
        accepted(dataset.train.reduced(2));
        for i in 0..dataset.train.images.len() {
            let _ = dataset.train.images.composite_with_alpha(i, [1.0; 3]);
        }
    }
    let report = inspect::inspect(root);
    let _ = report.ok();
    opened.is_some()
}

#[test]
fn dataset_json() {
    fuzz("dataset-json", |scratch| {
        dataset(scratch);
        let (path, scratch) = (scratch.path("transforms_train.json"), scratch.clone());
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            open(scratch.root())
        };
        Target::new(jsons(), read).tokens(TOKENS)
    });
}

const CHUNKS: &[&str] =
    &["IHDR", "IDAT", "IEND", "PLTE", "tRNS", "gAMA", "acTL", "fcTL", "fdAT", "iCCP", "zTXt", "iTXt", "eXIf"];

/// Returns a PNG that claims to be huge and holds nothing.
fn huge(width: u32, height: u32, depth: u8, colour: u8) -> Vec<u8> {
    let mut bytes = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
    bytes.extend(width.to_be_bytes());
    bytes.extend(height.to_be_bytes());
    bytes.extend([depth, colour, 0, 0, 0, 0, 0, 0, 0]);
    bytes.extend(b"\0\0\0\x0aIDAT\x78\x9c\x63\x60\x00\x00\x00\x02\x00\x01\0\0\0\0\0\0\0\0IEND\0\0\0\0");
    with_checksums(bytes)
}

#[test]
fn dataset_png() {
    fuzz("dataset-png", |scratch| {
        dataset(scratch);
        let (paths, scratch) = (["train/r_0.png", "train/r_1.png"].map(|n| scratch.path(n)), scratch.clone());
        let read = move |bytes: &[u8]| {
            // both, so that they have the same size
            paths.iter().for_each(|path| scratch.overwrite(path, bytes));
            open(scratch.root())
        };
        let sixteen = image::ImageBuffer::from_fn(SIZE, SIZE, |x, y| Rgba([x as u16 * 999, y as u16, 0, 65535]));
        let seeds = vec![
            picture(SIZE),
            labels(SIZE),
            png(&sixteen.into()),
            huge(4000, 2000, 8, 6),
            huge(60_000, 30_000, 16, 6),
        ];
        Target::new(seeds, read).tokens(CHUNKS).assemble(with_checksums).sizes(4 << 10, 64)
    });
}

/// Reads the ground truth of segments, and the label images.
fn truth(root: &Path) -> bool {
    let Some(truth) = accepted(Truth::read(root)) else { return false };
    for downscale in [1, 2] {
        for view in accepted(truth.views_near(0.4, 3, downscale)).unwrap_or_default() {
            if let Some(ids) = accepted(truth.labels(&view)) {
                assert_eq!(ids.len(), view.camera.width as usize * view.camera.height as usize);
            }
        }
    }
    true
}

#[test]
fn truth_json() {
    fuzz("truth-json", |scratch| {
        dataset(scratch);
        let (path, scratch) = (scratch.path("segments.json"), scratch.clone());
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            truth(scratch.root())
        };
        Target::new(vec![segments()], read).tokens(&[
            "\"label_images\"",
            "./labels/train",
            "/train",
            "\"size\"",
            "..",
            "\"id\"",
        ])
    });
}

#[test]
fn truth_png() {
    fuzz("truth-png", |scratch| {
        dataset(scratch);
        let (path, scratch) = (scratch.path("labels/train/r_0.png"), scratch.clone());
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            truth(scratch.root())
        };
        let sixteen = image::ImageBuffer::from_fn(SIZE, SIZE, |x, y| Luma([(x * 1000 + y) as u16]));
        let seeds = vec![labels(SIZE), png(&sixteen.into()), picture(SIZE), huge(20_000, 20_000, 8, 0)];
        Target::new(seeds, read).tokens(CHUNKS).assemble(with_checksums).sizes(4 << 10, 64)
    });
}

#[test]
fn prepare_json() {
    fuzz("prepare-json", |_| {
        let seed = r#"{"format": 1, "calibration": {}, "empty_times": [], "version": "0.1.0", "source": "jets", "transfer_function": "jets", "span": [0.0, 1.0], "dims": [8, 8, 8],
            "half_size": [1.0, 1.0, 1.0], "spacing": [1, 1, 1], "origin": [0, 0, 0], "side": 2,
            "directions": [[1, 0, 0], [0, -1, 0], [0, 0, 1]], "steps": 3, "step": 0.5, "train_views": 2,
            "test_views": 2, "size": [8, 8], "segments": ["a"], "seconds": 1.5, "load_seconds": 0.5, "peak_memory_bytes": 9}"#;
        let read = |bytes: &[u8]| accepted(volseggs::versioned::from_json::<PrepareRecord>(bytes)).is_some();
        Target::new(vec![seed.as_bytes().to_vec()], read)
    });
}
