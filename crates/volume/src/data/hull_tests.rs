//! Carving a sphere whose hull is known, and the published data.

use super::*;
use crate::data::dataset::tests::dataset;
use crate::data::dataset::{SplitName, read_split, test_data};
use crate::data::fixture::write_sphere_split;

#[test]
fn a_sphere_is_found() {
    let folder = dataset(24, 64);
    let split = read_split(folder.path(), SplitName::Train, 1, None, None).unwrap();
    let hull = VisualHull::carve(&split, &HullOptions::default()).unwrap();
    for x in hull.bounds.min.to_array().into_iter().chain(hull.bounds.max.to_array()) {
        assert!((0.49..0.58).contains(&x.abs()), "{:?}", hull.bounds);
    }
    // A sphere fills 0.52 of its cube; twelve cones leave a little more.
    assert!(hull.carved && (0.4..0.75).contains(&hull.filled), "{}", hull.filled);
    let (points, colours) = sample_coloured(&split, hull.bounds, 2000, 5);
    assert_eq!(points, sample(&split, hull.bounds, 2000, 5));
    assert_ne!(points, sample(&split, hull.bounds, 2000, 6));
    let mean = points.iter().fold(DVec3::ZERO, |m, p| m + glam::Vec3::from_array(*p).as_dvec3() / 2000.0);
    assert!(mean.length() < 0.03, "{mean}");
    for (p, c) in points.iter().zip(&colours) {
        let p = glam::Vec3::from_array(*p).as_dvec3();
        assert!(p.length() < 0.7 && hull.bounds.contains(p), "{p}");
        assert!((c[0] - 200.0 / 255.0).abs() < 1e-6 && (c[2] - 50.0 / 255.0).abs() < 1e-6);
    }
    let inner = points.iter().filter(|p| glam::Vec3::from_array(**p).length() < 0.25).count();
    assert!((150..360).contains(&inner), "an eighth of the sphere's points lie within half its radius: {inner}");
}

#[test]
fn thread_count_does_not_matter() {
    let folder = dataset(8, 32);
    let split = read_split(folder.path(), SplitName::Train, 1, None, None).unwrap();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let hull = VisualHull::carve(&split, &HullOptions::default()).unwrap();
            let points = sample_coloured(&split, hull.bounds, 3000, 1);
            (hull, points)
        })
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn opaque_empty_and_unloaded_images() {
    let folder = tempfile::tempdir().unwrap();
    write_sphere_split(folder.path(), SplitName::Train, 6, 16).unwrap();
    let mut split = read_split(folder.path(), SplitName::Train, 1, None, None).unwrap();
    let start = view_box(&split);
    assert!((start.max.x - 4.0 * 0.25f64.tan()).abs() < 1e-6 && start.centre().length() < 1e-6);

    // cropped on one side, so that the axis is at a border: the picture reaches twice as far to the other
    let mut cropped = split.clone();
    cropped.frames.iter_mut().for_each(|f| f.camera.cx = 0.0);
    assert!((view_box(&cropped).max.x - 8.0 * 0.25f64.tan()).abs() < 1e-6);

    split.images.pixels.chunks_exact_mut(4).for_each(|p| p[3] = 0);
    let text = VisualHull::carve(&split, &HullOptions::default()).unwrap_err().to_string();
    assert!(text.contains("split `train`") && text.contains("6 alpha masks"), "{text}");
    let points = sample(&split, start, 100, 1);
    assert!(points.iter().all(|p| start.contains(glam::Vec3::from_array(*p).as_dvec3())));

    split.images.pixels.chunks_exact_mut(4).for_each(|p| p[3] = 255);
    let hull = VisualHull::carve(&split, &HullOptions::default()).unwrap();
    assert!(!hull.carved && hull.bounds == start && hull.filled == 1.0);

    split.images.pixels.clear();
    assert_eq!(bounds(&split).unwrap(), start);
    assert_eq!(sample_coloured(&split, start, 3, 1).1, [[0.5; 3]; 3]);
    split.frames.truncate(1);
    assert!(view_box(&split).size().min_element() > 0.0);
    split.frames.clear();
    assert!(view_box(&split).size().is_finite());
}

#[test]
fn published_dataset() {
    let Some(root) = test_data() else { return };
    let split = read_split(&root, SplitName::Train, 1, None, None).unwrap();
    let clock = std::time::Instant::now();
    let hull = VisualHull::carve(&split, &HullOptions::default()).unwrap();
    let carving = clock.elapsed();
    let points = sample(&split, hull.bounds, 10_000, 1);
    println!("{hull:?}: {carving:?}, with 10000 points {:?}", clock.elapsed());
    for x in hull.bounds.min.to_array().into_iter().chain(hull.bounds.max.to_array()) {
        assert!((x.abs() - 0.5401).abs() < 0.012, "{:?}", hull.bounds);
    }
    assert!((0.2..0.4).contains(&hull.filled), "{}", hull.filled);
    assert!(points.iter().all(|p| p.iter().all(|x| x.abs() < 0.56)));
}
