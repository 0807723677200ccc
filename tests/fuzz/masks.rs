//! Masks: this project's files, those of other programs, and the list of pictures that are handed out.

use crate::data::{labels, png, with_checksums};
use crate::driver::{Target, accepted, fuzz};
use image::Luma;
use std::path::Path;
use volseggs::model::ToKernel;
use volseggs::segment::masks::handout::{self, PictureList};
use volseggs::segment::masks::source::dir::ForeignMasks;
use volseggs::segment::masks::source::{MaskInput, MaskSource};
use volseggs::segment::masks::{Annotation, Mask, MaskFileHeader, MaskReader, MaskView, MaskWriter, rle};
use volseggs::segment::pictures::GaussianPicture;

/// Masks with more pixels are not expanded into rows: checking their size is left to the program.
const PIXELS: u64 = 1 << 16;

/// Uses masks in every way.
fn mask(mask: &Mask, other: &Mask) {
    mask.validate().unwrap();
    let [x, y, w, h] = mask.bbox();
    assert!(
        u64::from(x) + u64::from(w) <= u64::from(mask.width) && u64::from(y) + u64::from(h) <= u64::from(mask.height)
    );
    if mask.area() > 0 {
        assert!(w > 0 && h > 0);
    }
    let _ = (mask.contains(0, 0), mask.contains(x, y), mask.contains(u32::MAX, 0));
    accepted(mask.iou(other));
    if let Some(both) = accepted(mask.intersection(other)) {
        both.validate().unwrap();
    }
    assert_eq!(rle::decode(&rle::encode(&mask.counts)).as_ref(), Ok(&mask.counts));
    if u64::from(mask.width) * u64::from(mask.height) <= PIXELS {
        let again = Mask::from_rows(mask.width, mask.height, &mask.to_rows()).unwrap();
        assert_eq!(again.area(), mask.area());
    }
}

fn square() -> Mask {
    let rows: Vec<bool> = (0..8).map(|i| i % 4 > 1).collect();
    Mask::from_rows(4, 2, &rows).unwrap()
}

#[test]
fn jsonl() {
    fuzz("masks-jsonl", |scratch| {
        let path = scratch.path("masks.jsonl");
        let pose = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 4.0, 0.0, 0.0, 0.0, 1.0];
        let view = |i: u32| MaskView { file: format!("view-{i:03}"), camera_to_world: pose, fov_x: 0.5 };
        let header =
            MaskFileHeader::new(4, 2, 0.5, vec![view(0), view(1)], vec!["red".into(), "blue".into()], "regions".into());
        let mut writer = MaskWriter::create(&path, header).unwrap();
        for image_id in 0..2 {
            let mask = square();
            let found = Annotation { image_id, segment: 1, mask, predicted_iou: 0.9, stability_score: 0.8, scale: 0.1 };
            writer.write(&found).unwrap();
        }
        writer.finish().unwrap();
        let seed = std::fs::read(&path).unwrap();
        let scratch = scratch.clone();
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            let Some(reader) = accepted(MaskReader::open(&path)) else { return false };
            let header = reader.header();
            let views = header.views.len();
            assert_eq!((0..views).map(|v| reader.view_len(v)).sum::<usize>(), reader.len());
            for view in 0..=views {
                let found = accepted(reader.view(view)).unwrap_or_default();
                found.iter().for_each(|a| mask(&a.mask, &found[0].mask));
            }
            for view in &header.views {
                let _ = view.camera(header.width, header.height);
            }
            true
        };
        Target::new(vec![seed], read).tokens(&[
            "\"image_id\":",
            "\"segment\":",
            "\"counts\":\"",
            "\"size\":[",
            "\"area\":",
            "\"bbox\":[",
            "\"views\":[]",
            "oooooooo",
            "PPPP",
            "\"width\":65535",
            "\"height\":65535",
            "\n{}\n",
            "\n\n",
        ])
    });
}

fn picture() -> GaussianPicture {
    GaussianPicture { width: 4, height: 2, rgba: vec![0.0; 32], depth: vec![0.0; 8] }
}

/// Opens masks of other programs for two views of two groups, and requests all of them; returns their number.
fn foreign(path: &Path) -> Option<usize> {
    let (groups, views) = (["a", "b"].map(str::to_owned), ["view-000.png", "view-001.png"].map(str::to_owned));
    let source = accepted(ForeignMasks::open(path, &groups, &[], &views, [4, 2]))?;
    let mut count = 0;
    let picture = picture();
    for (group, view) in [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (0, 2)] {
        let seen = MaskInput { view, group, picture: &picture, front: None };
        for found in accepted(source.find(&seen)).unwrap_or_default() {
            mask(&found.mask, &square());
            assert!(found.predicted_iou.is_finite());
            count += 1;
        }
    }
    Some(count)
}

#[test]
fn coco() {
    fuzz("masks-coco", |scratch| {
        let seed = serde_json::json!({
            "images": [{ "id": 7, "file_name": "a/view-000.png", "width": 4, "height": 2 },
                       { "id": 8, "file_name": "b/view-001.jpg", "width": 4, "height": 2 }],
            "annotations": [
                { "image_id": 7, "segmentation": { "size": [2, 4], "counts": [4, 4] }, "category_id": 1, "score": 0.5 },
                { "image_id": 8, "segmentation": { "size": [2, 4], "counts": rle::encode(&square().counts) }, "stability_score": 0.9 },
                { "image_id": 8, "segmentation": [[0, 0, 1, 0, 1, 1]] }],
        });
        let (path, scratch) = (scratch.path("masks.json"), scratch.clone());
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            foreign(&path).is_some()
        };
        Target::new(vec![seed.to_string().into_bytes()], read).tokens(&[
            "\"images\"",
            "\"annotations\"",
            "\"counts\":[",
            "\"counts\":\"04\"",
            "\"size\":[0,0]",
            "\"width\":0",
            "\"image_id\":7",
            "\"score\":",
        ])
    });
}

#[test]
fn folder() {
    fuzz("masks-png", |scratch| {
        scratch.write("a/view-001_2.png", &png(&image::GrayImage::new(4, 2).into())); // an empty mask does not count
        let path = scratch.write("a/view-000.png", b"");
        scratch.write("b/view-000_0.png", b"no picture");
        let scratch = scratch.clone();
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            // a folder opens whatever its files contain
            foreign(scratch.root()).unwrap() > 0
        };
        let sixteen = image::ImageBuffer::from_fn(4, 2, |x, y| Luma([(x * 1000 + y) as u16]));
        let eight = image::GrayImage::from_fn(4, 2, |x, _| Luma([x as u8]));
        Target::new(vec![png(&sixteen.into()), png(&eight.into()), labels(8)], read)
            .tokens(&["IHDR", "IDAT", "PLTE", "tRNS", "IEND"])
            .assemble(with_checksums)
            .sizes(4 << 10, 64)
    });
}

#[test]
fn pictures() {
    fuzz("handout", |scratch| {
        let cameras = volseggs::data::paths::training_cameras(
            2,
            4.0,
            volseggs::data::paths::Lens { fov_x: 0.5, width: 8, height: 8 },
        );
        let list = PictureList {
            scene: "0123456789abcdef".into(),
            time: 0.5,
            groups: vec![handout::HandoutGroup { name: "red".into(), gaussians: 7, members: String::new() }],
            views: volseggs::segment::masks::make::MaskShot::numbered(cameras),
        };
        let (path, scratch) = (scratch.path(handout::FILE), scratch.clone());
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            let Some(list) = accepted(PictureList::read(scratch.root())) else { return false };
            for view in &list.views {
                let _ =
                    (view.camera.fov_x(), view.camera.to_kernel(), view.camera.downscaled(0), view.camera.forward());
            }
            true
        };
        Target::new(vec![volseggs::versioned::to_json_pretty(&list).unwrap()], read)
    });
}

#[test]
fn run_lengths() {
    fuzz("rle", |_| {
        let read = |bytes: &[u8]| {
            let text = String::from_utf8_lossy(bytes);
            let Some(counts) = accepted(rle::decode(&text)) else { return false };
            assert_eq!(rle::decode(&rle::encode(&counts)).as_ref(), Ok(&counts));
            for (width, height) in [(4, 2), (0, 0), (65535, 65535), (u32::MAX, 2)] {
                if let Some(found) = accepted(Mask::from_counts(width, height, counts.clone())) {
                    mask(&found, &square());
                }
            }
            true
        };
        let seeds = [vec![0, 8], vec![2, 2, 2, 2], vec![u32::MAX, 1, 0, 4_000_000_000], vec![65535 * 65535]];
        Target::new(seeds.map(|c| rle::encode(&c).into_bytes()).to_vec(), read)
            .tokens(&["o", "P", "0", "~", "_ooooooo"])
    });
}
