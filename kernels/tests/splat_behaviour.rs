//! The splat op across devices and threads, on odd sizes, and on poisoned and empty scenes; for its gradients see
//! splat_gradients.rs.
#![allow(missing_docs, clippy::unwrap_used)]

mod common;

use common::{Numbers, Tested, by_covariances, camera, cpu, fields, random_scene, settings};
use volseggs_kernels::splat::reference::{Cutoffs, render};

fn weights(len: usize, seed: u64) -> Vec<f32> {
    let mut r = Numbers(seed);
    (0..len).map(|_| r.normal() as f32).collect()
}

fn bits_match_the_first_device(on: Tested) {
    let scene = random_scene(400, 3, 11);
    let s = settings(camera(50, 37), 3);
    let w = weights(50 * 37 * 4, 1);
    for scene in [scene.clone(), by_covariances(scene)] {
        let (ours, first) = [&on.device, &cpu()].map(|device| common::gradients(&scene, s, &w, device)).into();
        assert_eq!(ours.0, first.0);
        assert_eq!(ours.1, first.1);
    }
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let scene = random_scene(3000, 2, 17);
    let s = settings(camera(90, 70), 2);
    let w = weights(90 * 70 * 4, 2);
    for scene in [scene.clone(), by_covariances(scene)] {
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| common::gradients(&scene, s, &w, &cpu()))
        };
        let one = run(1);
        for threads in [2, 3, 8] {
            let many = run(threads);
            assert!(one.0 == many.0 && one.1 == many.1, "{threads} threads");
        }
    }
}

fn rendering_agrees_with_the_reference_on_odd_sizes(on: Tested) {
    for (w, h) in [(1, 1), (1, 40), (17, 3), (16, 16), (33, 65), (100, 47)] {
        let scene = random_scene(300, 1, 7);
        let s = settings(camera(w, h), 1);
        for scene in [scene.clone(), by_covariances(scene)] {
            let expected = render(&scene, &s, Cutoffs::OP);
            let ours = common::image(&scene, s, &on.device);
            let worst = ours.iter().zip(&expected).map(|(&a, b)| (f64::from(a) - b).abs()).fold(0.0, f64::max);
            // a pixel may fall on the other side of the 1/255 or the 1e-4 cutoff
            let off = ours.iter().zip(&expected).filter(|(a, b)| (f64::from(**a) - **b).abs() > 1e-4).count();
            assert!(worst < 0.02 && off * 200 <= ours.len(), "{w}x{h}: worst {worst:.1e}, {off} of {}", ours.len());
        }
    }
}

fn poison_is_culled_and_never_spreads(on: Tested) {
    let bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, 1e30, -1e30, 1e-30, 88.0, -110.0, 1e8];
    let s = settings(camera(40, 30), 1);
    let w = weights(40 * 30 * 4, 4);
    let clean = random_scene(40, 1, 23);
    for clean in [clean.clone(), by_covariances(clean.clone())] {
        for (name, field) in fields(&clean) {
            for value in bad {
                for position in 0..6 {
                    let mut scene = clean.clone();
                    field(&mut scene)[position] = value;
                    let (image, gradients) = common::gradients(&scene, s, &w, &on.device);
                    assert!(image.iter().all(|v| v.is_finite()), "{name}[{position}] = {value}: image");
                    for g in &gradients {
                        assert!(g.iter().all(|v| v.is_finite()), "{name}[{position}] = {value}: gradient");
                    }
                }
            }
        }
    }
    // a zero quaternion means no rotation
    let mut scene = clean.clone();
    let mut identity = clean;
    scene.rotations[..4].fill(0.0);
    identity.rotations[..4].copy_from_slice(&[1.0, 0.0, 0.0, 0.0]);
    let (a, _) = common::gradients(&scene, s, &w, &on.device);
    let (b, _) = common::gradients(&identity, s, &w, &on.device);
    assert_eq!(a, b);
}

fn empty_scenes_and_scenes_behind_the_camera_show_the_background(on: Tested) {
    let s = settings(camera(20, 10), 0);
    let mut behind = random_scene(50, 0, 2);
    behind.means.chunks_exact_mut(3).for_each(|m| m[2] -= 20.0);
    let none =
        volseggs_kernels::splat::splat_covariances(common::covariance_inputs(&random_scene(0, 0, 1), &on.device), s);
    assert!(common::to_vec(none.image).chunks_exact(4).all(|p| p == [0.1, 0.2, 0.3, 0.0]));
    for scene in [random_scene(0, 0, 1), by_covariances(behind.clone()), behind] {
        let (image, gradients) = common::gradients(&scene, s, &weights(800, 1), &on.device);
        assert!(image.chunks_exact(4).all(|p| p == [0.1, 0.2, 0.3, 0.0]));
        assert!(gradients.iter().flatten().all(|&g| g == 0.0));
    }
}

volseggs_testing::on_every_device!(
    crate::common::open => rendering_agrees_with_the_reference_on_odd_sizes,
);
// gpu_parity.rs tests GPUs on poisoned and empty scenes, with fewer renderings
volseggs_testing::on_every_cpu_device!(
    crate::common::open =>
    bits_match_the_first_device,
    poison_is_culled_and_never_spreads,
    empty_scenes_and_scenes_behind_the_camera_show_the_background,
);
