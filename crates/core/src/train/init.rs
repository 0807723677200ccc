//! Initial Gaussians and bounding box of the deformation field.

use crate::config::types::{Bounds, Config, D3dgsConfig, Placement};
use crate::data::Split;
use crate::data::error::DataError;
use crate::data::hull::{Aabb, HullOptions, VisualHull, sample_coloured};
use crate::model::{HostGaussians, SceneSpec, size};
use crate::rng::{Purpose, Rng};
use glam::DVec3;
use volseggs_kernels::activation::logit_f64;
use volseggs_kernels::sh::C0;

/// Returns the initial Gaussians of a scene and its spec.
///
/// # Errors
/// If the visual hull is empty: no point lies inside the alpha masks of all views of any time.
pub fn initialise(
    split: &Split,
    config: &Config,
    background: [f32; 3],
) -> Result<(HostGaussians, SceneSpec), DataError> {
    let n = config.init.points;
    let needs_hull = config.init.placement == Placement::Hull || config.model.bounds == Bounds::Hull;
    let hull = if needs_hull { Some(VisualHull::carve(split, &HullOptions::default())?) } else { None };
    let (points, colours, volume) = match (&hull, config.init.placement) {
        (Some(hull), Placement::Hull) => {
            let (points, colours) = sample_coloured(split, hull.bounds, n, config.seed);
            let size = hull.bounds.size();
            (points, colours, hull.filled * size.x * size.y * size.z)
        }
        _ => {
            let half = config.init.box_half_size;
            let mut rng = Rng::new(config.seed, 0, Purpose::Points);
            let mut axis = || (half * f64::from(2.0 * rng.uniform() - 1.0)) as f32;
            ((0..n).map(|_| [axis(), axis(), axis()]).collect(), vec![[0.5; 3]; n], (2.0 * half).powi(3))
        }
    };
    let spacing = (volume / n as f64).cbrt();
    let k = size::coefficients(&config.model) as usize;
    let mut sh = vec![0.0; 3 * k * n];
    for (row, colour) in sh.chunks_exact_mut(3 * k).zip(&colours) {
        for c in 0..3 {
            row[c] = (colour[c] - 0.5) / C0;
        }
    }
    let opacity = config.init.opacity;
    let gaussians = HostGaussians {
        rotations: [1.0, 0.0, 0.0, 0.0].repeat(n),
        log_scales: vec![(config.init.scale * spacing).ln() as f32; 3 * n],
        opacity_logits: vec![logit_f64(opacity) as f32; n],
        sh,
        sh_stride: k,
        means: points.iter().flatten().copied().collect(),
        ..HostGaussians::default()
    };
    let gaussians = gaussians.completed(&config.model, config.seed);
    let bounds = match (config.model.bounds, &hull) {
        (Bounds::Hull, Some(hull)) => hull.bounds,
        _ => points_box(&points),
    };
    let bounds = bounds.grown(config.model.bounds_margin);
    let spec = SceneSpec {
        model: config.model.clone(),
        centre: bounds.centre().as_vec3().to_array(),
        half_size: (0.5 * bounds.size()).max(DVec3::splat(1e-6)).as_vec3().to_array(),
        background,
        deformed: false,
        sh_degree: 0,
        d3dgs: config.sections.get::<D3dgsConfig>().ok().flatten(),
        packed_from: None,
    };
    Ok((gaussians, spec))
}

fn points_box(points: &[[f32; 3]]) -> Aabb {
    let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (min, max) = points.iter().fold(start, |(min, max), p| {
        let p = DVec3::from_array(p.map(f64::from));
        (min.min(p), max.max(p))
    });
    Aabb { min, max }
}
