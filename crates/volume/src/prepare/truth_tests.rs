//! The ground truth of a dataset: when and from where segments are shown alone, and their volumes of ids.

use super::tests::{make_with, options};
use super::*;
use crate::data::truth::FILE;
use crate::data::{Camera, Truth};
use crate::volume::synthetic::Synthetic;
use glam::{DMat4, DVec3};

/// The pixel onto which a point projects.
fn pixel(camera: &Camera, p: DVec3) -> Option<usize> {
    let (rotation, translation) = camera.world_to_camera_opencv();
    let q = rotation * p + translation;
    let x = camera.fx * q.x / q.z + camera.cx;
    let y = camera.fy * q.y / q.z + camera.cy;
    let inside =
        q.z > 0.0 && (0.0..f64::from(camera.width)).contains(&x) && (0.0..f64::from(camera.height)).contains(&y);
    inside.then(|| y as usize * camera.width as usize + x as usize)
}

#[test]
fn volumes_of_ids_lie_where_the_pictures_show_the_segments() {
    let folder = tempfile::tempdir().unwrap();
    for (scene, threshold) in [(Synthetic::Shells, 0.05), (Synthetic::Layers, 0.05), (Synthetic::Beads, 0.3)] {
        let out = folder.path().join(scene.name());
        let record = make_with(scene, &out, &options(96)).unwrap();
        let truth = Truth::read(&out).unwrap();
        assert_eq!(truth.volume_times(), [0.0, 1.0]);
        let mut found = 0;
        for time in [0.0, 1.0] {
            let volume = truth.volume(time).unwrap();
            assert_eq!((volume.time, volume.dims), (time, [48; 3]));
            for a in 0..3 {
                let edge = volume.origin[a] - 0.5 * volume.spacing[a];
                assert!((edge + record.half_size[a]).abs() < 1e-9);
            }
            let cells: Vec<(DVec3, u16)> = (0..volume.ids.len())
                .filter(|i| volume.opacity[*i] > threshold && volume.ids[*i] > 0)
                .map(|i| {
                    let index = [i % 48, i / 48 % 48, i / (48 * 48)];
                    (DVec3::from_array(volume.centre(index)), volume.ids[i])
                })
                .collect();
            for segment in &truth.file.segments {
                let own: Vec<DVec3> = cells.iter().filter(|(_, id)| *id == segment.id).map(|(p, _)| *p).collect();
                for frame in segment.frames.iter().filter(|f| f.time == time) {
                    let pose = DMat4::from_cols_array_2d(&frame.transform_matrix).transpose();
                    let camera = Camera::from_fov_x(truth.file.camera_angle_x, 96, 96, pose);
                    let mask = image::open(out.join(&frame.mask_path)).unwrap().to_luma8().into_raw();
                    // the edge of a segment is a voxel wide, and a voxel here about a pixel
                    let near = |i: usize| {
                        let (x, y) = (i % 96, i / 96);
                        (y.saturating_sub(1)..=(y + 1).min(95))
                            .any(|v| (x.saturating_sub(1)..=(x + 1).min(95)).any(|u| mask[v * 96 + u] > 0))
                    };
                    let hits = own.iter().filter(|p| pixel(&camera, **p).is_some_and(near)).count();
                    assert!(
                        hits as f64 >= 0.95 * own.len() as f64,
                        "{scene} {}: {hits} of {}",
                        segment.name,
                        own.len()
                    );
                    // and all of the mask belongs to these cells: none is larger than three pixels across
                    let mut covered = vec![false; 96 * 96];
                    for at in own.iter().filter_map(|p| pixel(&camera, *p)) {
                        for (dx, dy) in (0..25).map(|k| (k % 5, k / 5)) {
                            let (x, y) =
                                ((at % 96 + dx).saturating_sub(2).min(95), (at / 96 + dy).saturating_sub(2).min(95));
                            covered[y * 96 + x] = true;
                        }
                    }
                    let seen = (0..mask.len()).filter(|i| mask[*i] > 0 && covered[*i]).count();
                    assert!(
                        seen as f64 >= 0.9 * frame.pixels as f64,
                        "{scene} {}: {seen} of {}",
                        segment.name,
                        frame.pixels
                    );
                    found += usize::from(!own.is_empty());
                }
            }
        }
        assert!(found >= 6, "{scene}: {found} pictures compared");
    }
}

#[test]
fn by_default_ten_views_at_each_of_five_trained_steps() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("data");
    let wanted = PrepareOptions {
        segments: SegmentOptions::default(),
        views: ViewOptions {
            times: views::TrainingTimes::Count(10),
            views_per_time: 1,
            test_views: 21,
            ..options(12).views
        },
        ..options(12)
    };
    let source = PrepareSource::Synthetic { scene: Synthetic::Layers, dims: [24; 3], steps: 40 };
    let transfer = Synthetic::Layers.transfer_function().unwrap();
    prepare(&source, &transfer, &wanted, &out, &|_| {}, &AtomicBool::new(false)).unwrap();
    let truth = Truth::read(&out).unwrap();
    let trained: Vec<f64> =
        read_split(&out, SplitName::Train, 1, None, None).unwrap().frames.iter().map(|f| f.time).collect();
    let times = truth.volume_times();
    assert_eq!((times.len(), times[0], times[4]), (5, 0.0, 1.0));
    for time in &times {
        assert!(trained.contains(time), "{time} was not trained on: {trained:?}");
        for segment in &truth.file.segments {
            assert_eq!(segment.frames.iter().filter(|f| f.time == *time).count(), 10, "{} {time}", segment.name);
        }
    }
    // none of it without views
    let out = folder.path().join("none");
    let without = PrepareOptions { segments: SegmentOptions { views: 0, ..SegmentOptions::default() }, ..options(12) };
    prepare(&source, &transfer, &without, &out, &|_| {}, &AtomicBool::new(false)).unwrap();
    assert!(Truth::read(&out).unwrap().volume_times().is_empty() && !out.join("volumes").exists());
    assert!(!std::fs::read_to_string(out.join(FILE)).unwrap().contains("safetensors"));
}

#[test]
fn labels_of_a_scene_hold_under_other_transfer_functions() {
    let folder = tempfile::tempdir().unwrap();
    for scene in Synthetic::ALL {
        for name in ["ramp", "density", "fire"] {
            let out = folder.path().join(format!("{scene}-{name}"));
            let source = PrepareSource::Synthetic { scene, dims: [48; 3], steps: 3 };
            let transfer = TransferFunction::load(name).unwrap();
            let few = PrepareOptions {
                views: ViewOptions {
                    times: views::TrainingTimes::Steps(vec![1]),
                    views_per_time: 1,
                    test_views: 2,
                    ..options(48).views
                },
                segments: SegmentOptions { views: 2, steps: SegmentSteps::These(vec![1]), label_images: true },
                ..options(48)
            };
            let record = prepare(&source, &transfer, &few, &out, &|_| {}, &AtomicBool::new(false)).unwrap();
            assert!(record.segments.iter().all(|n| scene.segment_names().contains(n)), "{:?}", record.segments);
            let truth = Truth::read(&out).unwrap();
            let shown = |s: &&crate::data::truth::SegmentEntry| s.frames.iter().any(|f| f.pixels > 0);
            let shown = truth.file.segments.iter().filter(shown).count();
            assert!(2 * shown >= truth.file.segments.len(), "{scene} {name}: {shown} of {:?} show", record.segments);
        }
    }
}

#[test]
fn a_segment_that_appears_later_shows_nothing_until_then() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("data");
    let steps = SegmentSteps::These(vec![0, 2, 4]);
    let wanted = PrepareOptions { segments: SegmentOptions { steps, ..options(32).segments }, ..options(32) };
    make_with(Synthetic::Vortices, &out, &wanted).unwrap();
    let truth = Truth::read(&out).unwrap();
    let when = |s: &crate::data::truth::SegmentEntry| s.frames.iter().map(|f| f.time).collect::<Vec<_>>();
    let all = when(&truth.file.segments[0]);
    assert_eq!(all.len(), 9);
    let mut empty = 0;
    for segment in &truth.file.segments {
        assert_eq!(when(segment), all, "{}", segment.name);
        for frame in &segment.frames {
            let picture = image::open(out.join(&frame.file_path)).unwrap().to_rgba8();
            let mask = image::open(out.join(&frame.mask_path)).unwrap().to_luma8();
            assert_eq!(mask.pixels().filter(|p| p.0[0] > 0).count(), frame.pixels, "{}", frame.mask_path);
            if frame.pixels == 0 {
                assert!(picture.pixels().all(|p| f32::from(p.0[3]) < MASK_ALPHA * 255.0), "{}", frame.file_path);
                empty += 1;
            }
        }
    }
    assert!(empty > 0, "{:?}", truth.file.segments.iter().map(|s| &s.name).collect::<Vec<_>>());
}
