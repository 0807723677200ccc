//! Gaussians refitted to how other programs draw them.
//!
//! A file of Gaussians holds one opacity for each and harmonics of all bands, and its readers widen each Gaussian by
//! [`volseggs_kernels::splat::DILATION`]. A scene trained with `model.path_opacity`, another dilation, a headlight or band 4 looks different
//! there, its outlines above all. Refitting trains opacities, scales and colours until the Gaussians, drawn as other
//! programs draw them, look as the scene does here. The scene's own pictures from all around are the targets, so
//! neither the dataset nor the volume is needed. Means and rotations stay.

use crate::data::Surroundings;
use crate::data::hull::Aabb;
use crate::data::paths::{Sphere, training_cameras};
use crate::metrics::psnr::psnr;
use crate::model::params::to_vec;
use crate::model::{Gaussians, HostGaussians, Model, Rendering, Scene, ToKernel};
use crate::rng::{Purpose, Rng};
use crate::run::{OpenRun, RunError};
use crate::train::optimizer::{AdamConstants, Optimizer};
use burn::module::Module;
use burn::tensor::{Device, Tensor};
use glam::DVec3;
use serde::Serialize;
use volseggs_kernels::PinholeCamera;
use volseggs_kernels::photometric::{Distance, photometric_loss};
use volseggs_kernels::sh::Bands;
use volseggs_kernels::splat::splat;

/// Steps that suffice for most scenes.
const STEPS: usize = 300;

/// Views by which the result is measured, from other directions.
pub const MEASURED: usize = 8;

/// Weight of alpha: that of one colour channel, as other programs have backgrounds of their own.
const ALPHA: f32 = 1.0 / 3.0;

/// The views are chosen to show Gaussians of at least this opacity, but for [`OUTLIERS`] of them.
const VISIBLE: f32 = 0.1;

/// Fraction of the Gaussians at either end of an axis that may lie outside the views, as outliers would otherwise determine
/// them.
const OUTLIERS: f64 = 1e-3;

/// Room on every side of what is shown, as a fraction of its size.
const MARGIN: f64 = 0.1;

/// Learning rates fall to this fraction by the last step.
const FINAL: f64 = 0.1;

/// How close Gaussians drawn as other programs do come to the scene: mean PSNR over eight views that were not refitted,
/// in dB.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Refit {
    /// As they would have been written.
    pub psnr_before: f64,
    /// Refitted.
    pub psnr_after: f64,
}

/// How to refit.
#[derive(Debug, Clone, PartialEq)]
pub struct RefitPlan {
    /// Number of steps, of one view each; at least 1.
    pub steps: usize,
    /// Lens and distance of the views.
    pub around: Surroundings,
    /// Half the side of the trained scene, scene units.
    pub half_size: f64,
}

impl RefitPlan {
    /// Plans `steps` steps for files of `run`; `None` for 0 steps. Without a number, there are none if other programs draw
    /// them as this one does, and otherwise 300.
    pub fn new(run: &OpenRun, steps: Option<usize>) -> Option<Self> {
        if steps == Some(0) || steps.is_none() && drawn_alike(&run.scene) {
            return None;
        }
        let around = run.record.surroundings;
        let (_, half_size) = run.scene.place();
        Some(Self { steps: steps.unwrap_or(STEPS), around, half_size })
    }

    /// Returns the sphere on which cameras see `shown`: that of the dataset's cameras or, if edits have moved or scaled
    /// Gaussians out of their sight, one around what is shown, with a radius larger in proportion.
    fn sphere(&self, shown: &HostGaussians) -> Sphere {
        let Surroundings { lens, sphere, .. } = &self.around;
        let sees = sphere.radius * (0.5 * lens.fov_x).tan() * (f64::from(lens.height) / f64::from(lens.width)).min(1.0);
        let sees = sees.max(self.half_size);
        let seen = Aabb::cube(sphere.centre, sees);
        let Some(shown) = visible_box(shown) else { return *sphere };
        if seen.contains(shown.min) && seen.contains(shown.max) {
            return *sphere;
        }
        let half = 0.5 * shown.grown(MARGIN).size().max_element();
        Sphere { centre: shown.centre(), radius: sphere.radius * (half / sees).max(1.0) }
    }
}

/// Returns the box of the visible Gaussians, without outliers; `None` if there are none.
fn visible_box(shown: &HostGaussians) -> Option<Aabb> {
    let visible: Vec<usize> = (0..shown.len()).filter(|i| shown.opacity_of(*i) >= VISIBLE).collect();
    let last = visible.len().checked_sub(1)?;
    let outliers = (OUTLIERS * visible.len() as f64) as usize;
    let mut bounds = Aabb::cube(DVec3::ZERO, 0.0);
    for axis in 0..3 {
        let mut along: Vec<f32> = visible.iter().map(|i| shown.means[3 * i + axis]).collect();
        along.sort_unstable_by(f32::total_cmp);
        bounds.min[axis] = f64::from(along[outliers]);
        bounds.max[axis] = f64::from(along[last - outliers]);
    }
    Some(bounds)
}

/// The same, but as 3DGS draws, as other programs do.
fn in_3dgs(Rendering { background, sh_degree, .. }: Rendering) -> Rendering {
    Rendering { background, sh_degree, ..Rendering::default() }
}

/// Whether other programs draw the scene as this one does.
fn drawn_alike(scene: &Scene) -> bool {
    let (ours, gaussians) = (scene.spec.rendering(), &scene.gaussians);
    let plain = gaussians.headlight.is_none() && Bands::of_any(gaussians.sh.dims()[1]) == Bands::All;
    plain && ours == in_3dgs(ours)
}

/// Refits the Gaussians `shown` at one time, which the run draws with `rendering`, as planned; `None` if `goes_on`, called after each step, stopped it. The same arguments give the same bits on a CPU.
///
/// # Errors
/// If a number is not finite.
pub(super) fn refit(
    shown: &HostGaussians,
    rendering: Rendering,
    plan: &RefitPlan,
    device: &Device,
    mut goes_on: impl FnMut() -> bool,
) -> Result<Option<(HostGaussians, Refit)>, RunError> {
    let RefitPlan { steps, around, .. } = plan;
    let sphere = plan.sphere(shown);
    let plain = shown.baked();
    let elsewhere = Rendering { sh_degree: plain.sh_degree(), ..in_3dgs(rendering) };
    let scene = shown.to_splat(device);
    let target = |camera: &PinholeCamera| splat(scene.clone(), rendering.seen_by(*camera)).image;

    // spheres of as many views would be the same
    let views = if *steps == MEASURED { steps + 1 } else { *steps };
    let mut cameras = training_cameras(views, sphere, around.lens);
    Rng::new(0, 0, Purpose::Refit).shuffle(&mut cameras);
    cameras.truncate(*steps);
    let mut gaussians = Gaussians::from_host(plain.clone(), &device.clone().autodiff());
    let mut optimizer = Optimizer::new(AdamConstants { betas: [0.9, 0.99], epsilon: 1e-15, sh_rest: 1.0 });
    for (step, camera) in cameras.iter().enumerate() {
        let camera = camera.to_kernel();
        let image = splat(gaussians.val(), elsewhere.seen_by(camera)).image;
        let loss = photometric_loss(image, Tensor::from_inner(target(&camera)), Distance::Squared, ALPHA).loss;
        let mut gradients = loss.backward();
        let slower = FINAL.powf(step as f64 / *steps as f64);
        let (stepped, bad) = optimizer.step(gaussians, &mut gradients, |name| rate(name).map(|rate| rate * slower));
        gaussians = stepped;
        if let Some(bad) = bad {
            return Err(RunError::failure(format!("refitting, step {step}: {bad} is not finite; export without it")));
        }
        if !goes_on() {
            return Ok(None);
        }
    }
    let refitted = gaussians.valid().to_host();
    let both = [&plain, &refitted].map(|gaussians| gaussians.to_splat(device));
    let mut sums = [0.0; 2];
    for camera in training_cameras(MEASURED, sphere, around.lens) {
        let camera = camera.to_kernel();
        let scene = colours(target(&camera));
        for (sum, inputs) in sums.iter_mut().zip(&both) {
            let there = colours(splat(inputs.clone(), elsewhere.seen_by(camera)).image);
            *sum += psnr(&scene, &there).map_err(RunError::failure)?;
        }
    }
    let [psnr_before, psnr_after] = sums.map(|sum| sum / MEASURED as f64);
    Ok(Some((refitted, Refit { psnr_before, psnr_after })))
}

/// The learning rate of an attribute in the first step, as in training; `None` if it stays.
fn rate(name: &str) -> Option<f64> {
    match name {
        "opacity_logits" => Some(0.05),
        "log_scales" | "sh" => Some(0.005),
        _ => None,
    }
}

/// The colours `[H * W * 3]` of a picture `[H, W, 4]`.
fn colours(image: Tensor<3>) -> Vec<f32> {
    to_vec(image).chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::paths::{Lens, Sphere};
    use crate::device::DeviceName;

    /// Flat discs, turned all ways, which a path length makes much denser along their edges.
    fn discs() -> HostGaussians {
        let n = 40;
        let at = |i: usize, k: f32| (i as f32 * k).sin();
        HostGaussians {
            means: (0..n).flat_map(|i| [0.7 * at(i, 1.3), 0.7 * at(i, 2.1), 0.7 * at(i, 3.7)]).collect(),
            rotations: (0..n).flat_map(|i| [1.0, at(i, 0.9), at(i, 1.7), at(i, 2.9)]).collect(),
            log_scales: (0..n).flat_map(|_| [-1.5, -1.5, -4.5]).collect(),
            opacity_logits: vec![-0.5; n],
            sh: (0..18 * n).map(|i| 0.3 * at(i, 0.37)).collect(),
            sh_stride: 6,
            ..HostGaussians::default()
        }
        .with_unit_rotations()
    }

    fn plan(steps: usize) -> RefitPlan {
        let around = Surroundings { lens: Lens { fov_x: 0.5, width: 40, height: 32 }, sphere: Sphere::from(4.0) };
        RefitPlan { steps, around, half_size: 0.7 }
    }

    fn rendering() -> Rendering {
        let ours = Rendering { dilation: 0.05, path_opacity: 1.0, ..Rendering::default() };
        Rendering { background: [1.0; 3], sh_degree: 2, ..ours }
    }

    #[test]
    fn drawn_as_others_do_they_look_more_as_they_do_here_whatever_the_thread_count() {
        let device = DeviceName::all()[0].open().unwrap();
        let fit = || refit(&discs(), rendering(), &plan(120), &device, || true).unwrap().unwrap();
        let (refitted, gain) = fit();
        assert!(gain.psnr_after > gain.psnr_before + 3.0, "{gain:?}");
        assert_eq!((refitted.sh_stride, refitted.mismatched_column()), (9, None));
        assert_eq!((&refitted.means, &refitted.rotations), (&discs().means, &discs().rotations));
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert_eq!(one.install(fit), (refitted, gain));
    }

    /// The discs, moved by `by` along x.
    fn moved(by: f32) -> HostGaussians {
        let mut moved = discs();
        moved.means.iter_mut().step_by(3).for_each(|x| *x += by);
        moved
    }

    #[test]
    fn what_edits_moved_out_of_sight_is_refitted_like_what_stayed() {
        let device = DeviceName::all()[0].open().unwrap();
        let sphere = |shown: &HostGaussians| plan(9).sphere(shown);
        assert_eq!(sphere(&discs()), Sphere::from(4.0));
        let Sphere { centre, radius } = sphere(&moved(5.0));
        assert!((centre.x - 5.0).abs() < 0.1 && centre.y.abs() < 0.1, "{centre}");
        assert!((4.0..4.6).contains(&radius), "{radius}: as far away as before, or nearly so");
        let gain = refit(&moved(5.0), rendering(), &plan(120), &device, || true).unwrap().unwrap().1;
        assert!(gain.psnr_after > gain.psnr_before + 3.0, "{gain:?}");
        let mut both = discs().subset(&(0..80).map(|i| i % 40).collect::<Vec<_>>());
        both.means[120..].copy_from_slice(&moved(5.0).means);
        assert!(sphere(&both).radius > 10.0, "{:?}", sphere(&both));
        let mut hidden = moved(5.0);
        hidden.opacity_logits.fill(-9.0);
        assert_eq!(sphere(&hidden), Sphere::from(4.0));
    }

    #[test]
    fn what_others_draw_alike_stays_and_a_stop_is_heard() {
        let device = DeviceName::all()[0].open().unwrap();
        let alike = in_3dgs(rendering());
        let plain = discs().baked();
        let (same, gain) = refit(&plain, alike, &plan(3), &device, || true).unwrap().unwrap();
        assert_eq!((same, gain.psnr_before), (plain.clone(), f64::INFINITY));
        let mut steps = 0;
        let stopped = refit(&plain, rendering(), &plan(9), &device, || {
            steps += 1;
            steps < 4
        });
        assert_eq!((stopped.unwrap(), steps), (None, 4));
    }

    #[test]
    fn a_number_that_is_not_finite_is_an_error() {
        let device = DeviceName::all()[0].open().unwrap();
        let mut discs = discs();
        discs.sh[4] = f32::NAN;
        let error = refit(&discs, rendering(), &plan(2), &device, || true).unwrap_err().to_string();
        assert!(error.contains("refitting, step 0") && error.contains("not finite"), "{error}");
    }
}
