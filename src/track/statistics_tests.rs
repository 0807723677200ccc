//! Tests of the statistics of a segment: geometry, non-finite values, velocities.

use super::*;
use crate::points::sampling::tests::generator;
use proptest::prelude::*;

struct Scene {
    means: Vec<f32>,
    opacity: Vec<f32>,
    log_scales: Vec<f32>,
    rotations: Vec<f32>,
    colours: Vec<f32>,
}

impl Scene {
    fn random(count: usize, seed: u64) -> Self {
        let mut u = generator(seed);
        Self {
            means: (0..count).flat_map(|_| [u() * 3.0, u() * 2.0, u()]).collect(),
            opacity: (0..count).map(|_| 0.2 + 0.7 * u()).collect(),
            log_scales: (0..3 * count).map(|_| -2.0 - u()).collect(),
            rotations: (0..4 * count).map(|_| u() - 0.5).collect(),
            colours: (0..3 * count).map(|_| u()).collect(),
        }
    }

    fn view(&self) -> Gaussians<'_> {
        Gaussians {
            means: &self.means,
            opacity: &self.opacity,
            log_scales: &self.log_scales,
            rotations: &self.rotations,
            colours: &self.colours,
        }
    }

    fn describe(&self) -> SegmentStatistics {
        let members: Vec<u32> = (0..self.opacity.len() as u32).collect();
        let config = StatisticsConfig { volume_cell: Some(0.05), ..StatisticsConfig::default() };
        segment_statistics(&self.view(), &members, "a", 0.0, &config).unwrap()
    }
}

fn close(a: [f64; 3], b: [f64; 3], tolerance: f64) -> bool {
    (0..3).all(|i| (a[i] - b[i]).abs() <= tolerance)
}

#[test]
fn one_gaussian_is_described_by_itself() {
    let scene = Scene {
        means: vec![1.0, 2.0, 3.0],
        opacity: vec![0.5],
        log_scales: vec![0.3f32.ln(), 0.1f32.ln(), 0.2f32.ln()],
        rotations: vec![2.0, 0.0, 0.0, 2.0],
        colours: vec![0.1, 0.2, 0.3],
    };
    let s = scene.describe();
    assert_eq!((s.visible, s.gaussians, s.opacity), (1, 1, 0.5));
    assert_eq!(s.centroid, Some([1.0, 2.0, 3.0]));
    // A quarter turn about z: the long axis points along y.
    assert!(close(s.box_min.unwrap(), [0.9, 1.7, 2.8], 1e-6) && close(s.box_max.unwrap(), [1.1, 2.3, 3.2], 1e-6));
    assert!(close(s.extents.unwrap(), [0.3, 0.2, 0.1], 1e-6) && close(s.axes.unwrap()[0], [0.0, 1.0, 0.0], 1e-6));
    let exact = 4.0 / 3.0 * std::f64::consts::PI * 0.006;
    assert!((s.volume / exact - 1.0).abs() < 0.1, "{}", s.volume);
    assert!(close(s.colour.unwrap(), [0.1, 0.2, 0.3], 1e-6));
}

#[test]
fn transparent_and_non_finite_gaussians_are_not_visible() {
    let mut scene = Scene::random(8, 1);
    scene.means[0] = f32::NAN;
    scene.opacity[1] = 0.003;
    scene.log_scales[6] = 400.0;
    scene.rotations[12] = f32::INFINITY;
    scene.opacity[4] = f32::NAN;
    scene.colours[15] = f32::NAN;
    let s = scene.describe();
    assert_eq!((s.gaussians, s.visible), (8, 3));
    assert!(s.centroid.unwrap().iter().chain(&s.colour.unwrap()).all(|v| v.is_finite()));
}

#[test]
fn empty_segments_and_equal_points_have_a_description() {
    let scene = Scene::random(3, 1);
    let none = segment_statistics(&scene.view(), &[], "a", 1.0, &StatisticsConfig::default()).unwrap();
    assert_eq!((none.visible, none.centroid, none.box_min, none.volume), (0, None, None, 0.0));
    let same = Scene {
        means: [0.5; 30].into(),
        opacity: [1.0; 10].into(),
        log_scales: [f32::NEG_INFINITY; 30].into(),
        rotations: [0.0; 40].into(),
        colours: vec![],
    };
    let s = segment_statistics(&same.view(), &[0, 5, 9], "a", 1.0, &StatisticsConfig::default()).unwrap();
    assert_eq!((s.visible, s.extents, s.box_min), (3, Some([0.0; 3]), Some([0.5; 3])));
    assert!(s.volume.is_finite() && s.colour.is_none());
}

#[test]
fn the_thread_count_never_changes_a_bit() {
    let scene = Scene::random(9000, 2);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| scene.describe())
    };
    assert_eq!(run(1), run(4));
}

#[test]
fn wrong_input_is_named() {
    let scene = Scene::random(3, 1);
    let config = StatisticsConfig::default();
    let outside = segment_statistics(&scene.view(), &[3], "a", 0.0, &config).unwrap_err();
    assert!(outside.to_string().contains("Gaussian 3"), "{outside}");
    let short = Gaussians { rotations: &scene.rotations[..4], ..scene.view() };
    assert!(segment_statistics(&short, &[0], "a", 0.0, &config).unwrap_err().to_string().contains("rotations"));
    let cell = StatisticsConfig { volume_cell: Some(0.0), ..config };
    assert!(segment_statistics(&scene.view(), &[0], "a", 0.0, &cell).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn a_shift_changes_only_positions(seed in 0u64..500, cells in -20i32..20) {
        let mut scene = Scene::random(60, seed);
        let before = scene.describe();
        let shift = cells as f32 * 0.25;
        scene.means.iter_mut().for_each(|v| *v += shift);
        let after = scene.describe();
        let moved = |p: Option<[f64; 3]>| p.unwrap().map(|v| v + f64::from(shift));
        prop_assert!(close(moved(before.centroid), after.centroid.unwrap(), 1e-5));
        prop_assert!(close(moved(before.box_max), after.box_max.unwrap(), 1e-5));
        prop_assert!(close(before.extents.unwrap(), after.extents.unwrap(), 1e-5));
        prop_assert!((before.volume - after.volume).abs() < 0.02 * before.volume);
    }

    #[test]
    fn a_turn_turns_the_axes_and_keeps_extents_and_volume(seed in 0u64..500) {
        let mut scene = Scene::random(60, seed);
        let before = scene.describe();
        // A quarter turn about z: (x, y) to (-y, x), and q to (1, 0, 0, 1) q.
        for p in scene.means.chunks_exact_mut(3) {
            (p[0], p[1]) = (-p[1], p[0]);
        }
        for q in scene.rotations.chunks_exact_mut(4) {
            let [w, x, y, z] = [q[0], q[1], q[2], q[3]];
            q.copy_from_slice(&[w - z, x - y, y + x, z + w]);
        }
        let after = scene.describe();
        let turned = |p: [f64; 3]| [-p[1], p[0], p[2]];
        prop_assert!(close(turned(before.centroid.unwrap()), after.centroid.unwrap(), 1e-5));
        prop_assert!(close(before.extents.unwrap(), after.extents.unwrap(), 1e-5));
        let (a, b) = (turned(before.axes.unwrap()[0]), after.axes.unwrap()[0]);
        let along: f64 = (0..3).map(|k| a[k] * b[k]).sum();
        prop_assert!((along.abs() - 1.0).abs() < 1e-4);
        prop_assert!((before.volume - after.volume).abs() < 0.02 * before.volume);
    }

    #[test]
    fn velocity_is_exact_for_constant_acceleration(h0 in 0.1f64..2.0, h1 in 0.1f64..2.0, v in -3f64..3.0, a in -3f64..3.0) {
        let entry = Scene::random(1, 1).describe();
        let place = |t: f64| [v * t + 0.5 * a * t * t, 0.0, 0.0];
        let mut series: Vec<_> = [-h0, 0.0, h1]
            .into_iter()
            .map(|time| SegmentStatistics { time, centroid: Some(place(time)), ..entry.clone() })
            .collect();
        fill_velocities(&mut series);
        prop_assert!((series[1].velocity.unwrap()[0] - v).abs() < 1e-9);
        prop_assert!((series[0].velocity.unwrap()[0] - (v - 0.5 * a * h0)).abs() < 1e-9);
    }
}

#[test]
fn velocity_does_not_bridge_times_without_visible_gaussians() {
    let entry = Scene::random(1, 1).describe();
    let at =
        |time: f64, x: Option<f64>| SegmentStatistics { time, centroid: x.map(|x| [x, 0.0, 0.0]), ..entry.clone() };
    let mut series = [at(0.0, Some(0.0)), at(2.0, Some(1.0)), at(3.0, None), at(4.0, Some(7.0)), at(4.0, Some(8.0))];
    fill_velocities(&mut series);
    let speeds: Vec<Option<f64>> = series.iter().map(|s| s.velocity.map(|v| v[0])).collect();
    assert_eq!(speeds, [Some(0.5), Some(0.5), None, None, None]);
    fill_velocities(&mut []);
}
