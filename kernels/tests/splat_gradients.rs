//! Every entry of every gradient of splatting. The image without cutoffs is smooth, so there the gradient of the f64
//! reference is compared with difference quotients; the kernels are compared with that gradient with the op's cutoffs,
//! and, in scenes that meet none of them, with the difference quotients themselves. Errors are in units of the root
//! mean square of a gradient's entries.
#![allow(missing_docs, clippy::unwrap_used)]

mod common;

use common::{
    COEFFICIENTS, Numbers, Tested, by_covariances, camera, fields, highest_degree, random_scene_of, rounded, settings,
};
use volseggs_kernels::splat::contributors::reference::contributors;
use volseggs_kernels::splat::reference::{Cutoffs, ReferenceScene, backward, render};
use volseggs_kernels::splat::{DILATION, SplatSettings};

/// Returns the gradient of a loss with respect to the image, rounded to f32.
fn weights(settings: &SplatSettings, seed: u64) -> Vec<f64> {
    let mut r = Numbers(seed);
    (0..settings.camera.width * settings.camera.height * 4).map(|_| f64::from(r.normal() as f32)).collect()
}

fn loss(scene: &ReferenceScene, settings: &SplatSettings, cutoffs: Cutoffs, weights: &[f64]) -> f64 {
    render(scene, settings, cutoffs).iter().zip(weights).map(|(v, w)| v * w).sum()
}

/// Returns the gradient by difference quotients of fourth order, entry by entry.
fn quotients(scene: &ReferenceScene, settings: &SplatSettings, cutoffs: Cutoffs, weights: &[f64]) -> ReferenceScene {
    let mut out = scene.clone();
    for (name, field) in fields(scene) {
        // covariances are squared lengths, and small
        let step = if *name == "covariances" { 1e-6 } else { 1e-4 };
        let mut moved = scene.clone();
        for i in 0..field(&mut out).len() {
            let at = field(&mut moved)[i];
            let mut by = |steps: f64| {
                field(&mut moved)[i] = at + steps * step;
                loss(&moved, settings, cutoffs, weights)
            };
            let (near, far) = (by(1.0) - by(-1.0), by(2.0) - by(-2.0));
            field(&mut moved)[i] = at;
            field(&mut out)[i] = (8.0 * near - far) / (12.0 * step);
        }
    }
    out
}

/// Returns the largest error of an entry of `ours`, in units of the root mean square of `exact`.
fn worst(ours: &[f64], exact: &[f64]) -> f64 {
    assert_eq!(ours.len(), exact.len());
    let square = exact.iter().map(|v| v * v).sum::<f64>() / exact.len() as f64;
    let largest = ours.iter().zip(exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(square > 0.0, "the exact gradient is zero, so nothing is tested");
    // NaN would be lost in a maximum
    if ours.iter().all(|v| v.is_finite()) { largest / square.sqrt() } else { f64::INFINITY }
}

/// Returns the position of Gaussian `i` in camera space.
fn in_camera(scene: &ReferenceScene, settings: &SplatSettings, i: usize) -> [f64; 3] {
    let camera = &settings.camera;
    std::array::from_fn(|r| {
        let turned: f64 = (0..3).map(|k| f64::from(camera.rotation[r][k]) * scene.means[3 * i + k]).sum();
        turned + f64::from(camera.translation[r])
    })
}

/// Returns the scene by rotations and scales, and by covariances; both rounded to f32.
fn both_kinds(scene: &ReferenceScene) -> [(&'static str, ReferenceScene); 2] {
    [("factored", rounded(scene.clone())), ("entries", rounded(by_covariances(scene.clone())))]
}

/// Returns the smallest distance between two depths, to rule out that a step changes their order.
fn depth_gap(scene: &ReferenceScene, settings: &SplatSettings) -> f64 {
    let mut depths: Vec<f64> = (0..scene.opacity_logits.len()).map(|i| in_camera(scene, settings, i)[2]).collect();
    depths.sort_by(f64::total_cmp);
    depths.windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min)
}

/// Returns a scene that has, besides random Gaussians, two so far off the axis that their slopes are clamped, one with
/// a clamped colour channel, one with an opacity above 0.99, and offsets on screen.
fn with_everything(n: usize, coefficients: usize, seed: u64) -> ReferenceScene {
    let mut scene = random_scene_of(n, coefficients, seed);
    let mut r = Numbers(seed + 100);
    scene.means[..6].copy_from_slice(&[2.0, 0.2, -0.3, 0.1, -1.9, 0.4]);
    scene.log_scales[..6].iter_mut().for_each(|s| *s += 2.0);
    scene.sh[3 * scene.sh_stride * 2] = -6.0;
    scene.opacity_logits[3] = 6.0;
    scene.screen_offsets.iter_mut().for_each(|o| *o = 0.7 * r.normal());
    rounded(scene)
}

#[test]
fn the_reference_gradient_matches_the_image_without_cutoffs() {
    for coefficients in COEFFICIENTS {
        let degree = highest_degree(coefficients);
        for (seed, dilation) in [(1, DILATION), (2, 0.1), (3, 0.0)] {
            let scene = with_everything(12, coefficients, seed);
            let mut settings = settings(camera(21, 17), degree);
            settings.rendering.dilation = dilation;
            let slopes = [0, 1].map(|i| {
                let [x, y, z] = in_camera(&scene, &settings, i);
                (x / z * f64::from(settings.camera.fx) / 21.0, y / z * f64::from(settings.camera.fy) / 17.0)
            });
            assert!(slopes[0].0 > 0.66 && slopes[1].1 < -0.66, "no slope is clamped: {slopes:?}");
            assert!(depth_gap(&scene, &settings) > 1e-3, "seed {seed}: two depths are almost equal");
            let by_image = weights(&settings, seed + 10);
            for (kind, scene) in both_kinds(&scene) {
                let mut ours = backward(&scene, &settings, Cutoffs::NONE, &by_image);
                let mut exact = quotients(&scene, &settings, Cutoffs::NONE, &by_image);
                assert_eq!(ours.sh[3 * scene.sh_stride * 2], 0.0, "its colour is clamped");
                for (name, field) in fields(&scene) {
                    let error = worst(field(&mut ours), field(&mut exact));
                    println!("{kind} {coefficients} coefficients seed {seed} {name}: {error:.1e}");
                    assert!(error < 1e-8, "{kind} {coefficients} coefficients seed {seed} {name}: off by {error:.1e}");
                }
            }
        }
    }
}

/// Compares the kernels' gradients with `exact`.
fn check(
    on: &Tested,
    scene: &ReferenceScene,
    settings: SplatSettings,
    by_image: &[f64],
    mut exact: ReferenceScene,
    tolerance: f64,
    what: &str,
) {
    let by_image: Vec<f32> = by_image.iter().map(|&v| v as f32).collect();
    let (_, ours) = common::gradients(scene, settings, &by_image, &on.device);
    assert_eq!(ours.len(), fields(scene).len());
    for ((name, field), ours) in fields(scene).iter().zip(&ours) {
        let ours: Vec<f64> = ours.iter().map(|&v| f64::from(v)).collect();
        let error = worst(&ours, field(&mut exact));
        println!("{what} {name} on {}: {error:.1e}", on.name);
        assert!(error < tolerance, "{what} {name}: off by {error:.1e}");
    }
}

/// Large, half-transparent Gaussians, all of them in every pixel: compared with difference quotients of the image with
/// the op's cutoffs.
fn gradients_without_cutoffs_match_difference_quotients(on: Tested) {
    for coefficients in COEFFICIENTS {
        let degree = highest_degree(coefficients);
        for (seed, dilation) in [(1, DILATION), (2, 0.1), (3, 0.0)] {
            let mut scene = random_scene_of(8, coefficients, seed);
            scene.means.iter_mut().for_each(|v| *v *= 0.5);
            scene.log_scales.iter_mut().for_each(|s| *s = 0.3 * (*s + 2.6));
            scene.opacity_logits.iter_mut().for_each(|o| *o = 0.5 * *o - 0.5);
            let mut settings = settings(camera(21, 17), degree);
            settings.rendering.dilation = dilation;
            for (kind, scene) in both_kinds(&scene) {
                let smooth = render(&scene, &settings, Cutoffs::NONE);
                assert_eq!(render(&scene, &settings, Cutoffs::OP), smooth, "seed {seed} meets a cutoff");
                assert!(depth_gap(&scene, &settings) > 1e-3, "seed {seed}: two depths are almost equal");
                let by_image = weights(&settings, seed + 10);
                let exact = quotients(&scene, &settings, Cutoffs::OP, &by_image);
                let what = format!("{kind} {coefficients} coefficients seed {seed}");
                check(&on, &scene, settings, &by_image, exact, on.within(2e-5, 2e-3), &what);
            }
        }
    }
}

/// Small Gaussians that end within the image, pixels that saturate, alpha above its clamp.
fn gradients_with_cutoffs_match_the_reference(on: Tested) {
    for coefficients in COEFFICIENTS {
        let degree = highest_degree(coefficients);
        for (seed, opaque, dilation) in [(1, 0.0, DILATION), (2, 0.0, 0.1), (3, 4.0, DILATION), (4, 4.0, 0.1)] {
            let mut scene = with_everything(60, coefficients, seed);
            scene.opacity_logits.iter_mut().for_each(|o| *o += opaque);
            scene.log_scales.iter_mut().for_each(|s| *s += 0.1 * opaque);
            let mut settings = settings(camera(43, 37), degree);
            settings.rendering.dilation = dilation;
            for (kind, scene) in both_kinds(&scene) {
                // a decision that f32 could reverse would say nothing about gradients
                let pixels: Vec<u32> = (0..43 * 37).collect();
                let lists = contributors(&scene, &settings, &pixels);
                let margin = lists.iter().map(|p| p.margin).fold(f64::INFINITY, f64::min);
                let what = format!("{kind} {coefficients} coefficients seed {seed}");
                println!("{what}: margin {margin:.1e}, depth gap {:.1e}", depth_gap(&scene, &settings));
                assert!(margin > 1e-5 && depth_gap(&scene, &settings) > 1e-5, "{what}: choose another seed");
                let (all, image) = (render(&scene, &settings, Cutoffs::NONE), render(&scene, &settings, Cutoffs::OP));
                assert_ne!(all, image, "{what}: meets no cutoff");
                let ended = image.chunks_exact(4).filter(|p| p[3] > 0.99).count();
                assert!(opaque == 0.0 || ended > 43 * 37 / 10, "{what}: {ended} pixels end early");
                let by_image = weights(&settings, seed + 10);
                let exact = backward(&scene, &settings, Cutoffs::OP, &by_image);
                check(&on, &scene, settings, &by_image, exact, on.within(4e-5, 4e-3), &what);
            }
        }
    }
}

/// Coefficients beyond the degree in use change nothing and get no gradient, whichever bands they are of.
fn coefficients_beyond_the_degree_in_use_do_not_count(on: Tested) {
    for (coefficients, degree, used) in [(16, 1, 4), (15, 0, 1), (15, 2, 6), (15, 3, 6), (6, 1, 1)] {
        let scene = random_scene_of(20, coefficients, 3);
        let settings = settings(camera(21, 17), degree);
        let by_image: Vec<f32> = weights(&settings, 13).iter().map(|&v| v as f32).collect();
        let mut other = scene.clone();
        other.sh.chunks_exact_mut(3 * coefficients).for_each(|row| row[3 * used..].fill(7.0));
        let [(image, ours), (of_other, _)] =
            [scene, other].map(|scene| common::gradients(&scene, settings, &by_image, &on.device));
        assert_eq!(image, of_other, "{coefficients} coefficients, degree {degree}");
        let sh = &ours[4];
        assert_eq!(sh.len(), 20 * 3 * coefficients);
        for row in sh.chunks_exact(3 * coefficients) {
            assert!(row[3 * used..].iter().all(|v| *v == 0.0));
        }
        assert!(sh.chunks_exact(3 * coefficients).any(|row| row[3 * used - 1] != 0.0));
    }
}

volseggs_testing::on_every_device!(
    crate::common::open =>
    coefficients_beyond_the_degree_in_use_do_not_count,
    gradients_without_cutoffs_match_difference_quotients,
    gradients_with_cutoffs_match_the_reference,
);
