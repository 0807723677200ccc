//! Tests of what a segment's Gaussians are like, without their place: visibility, colour, non-finite values.

use super::*;
use volseggs_testing::generator;

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

    fn view(&self) -> Cloud<'_> {
        let Self { means, opacity, log_scales, rotations, .. } = self;
        Cloud { means, opacity, log_scales, rotations, labels: &[] }
    }

    fn describe(&self) -> SegmentStatistics {
        let members: Vec<u32> = (0..self.opacity.len() as u32).collect();
        segment_statistics(&self.view(), &self.colours, &members, "a", 0.0, 0.05).unwrap()
    }
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
    assert_eq!((s.visible, s.gaussians, s.opacity, s.status), (1, 1, 0.5, RowStatus::Tracked));
    let exact = 4.0 / 3.0 * std::f64::consts::PI * 0.006;
    assert!((s.opaque_core_volume / exact - 1.0).abs() < 0.1, "{}", s.opaque_core_volume);
    let content = 2.0f64.ln() * std::f64::consts::TAU * 0.006f64.powf(2.0 / 3.0);
    assert!((s.extinction / content - 1.0).abs() < 1e-5, "{} {content}", s.extinction);
    let colour = s.colour.unwrap();
    assert!((0..3).all(|k| (colour[k] - [0.1, 0.2, 0.3][k]).abs() < 1e-6));
    assert_eq!((s.centroid, s.volume), (None, 0.0), "where it is, its place says");
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
    assert!(s.extinction.is_finite() && s.colour.unwrap().iter().all(|v| v.is_finite()));
}

#[test]
fn empty_segments_have_a_description() {
    let scene = Scene::random(3, 1);
    let none = segment_statistics(&scene.view(), &scene.colours, &[], "a", 1.0, 0.1).unwrap();
    assert_eq!((none.visible, none.extinction, none.opaque_core_volume, none.colour), (0, 0.0, 0.0, None));
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
    let describe = |scene: &Cloud<'_>, members: &[u32], cell: f64| {
        segment_statistics(scene, &[], members, "a", 0.0, cell).unwrap_err().to_string()
    };
    assert!(describe(&scene.view(), &[3], 0.1).contains("Gaussian 3"));
    let short = Cloud { rotations: &scene.rotations[..4], ..scene.view() };
    assert!(describe(&short, &[0], 0.1).contains("rotations"));
    assert!(describe(&scene.view(), &[0], 0.0).contains("cell"));
}
