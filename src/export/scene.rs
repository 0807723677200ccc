//! A scene at one time as plain Gaussians for other programs.

use super::ply::PlyGaussians;
use crate::model::Scene;
use crate::model::params::to_vec;

/// The Gaussians at `time` in [0, 1], rotations normalised.
pub fn at_time(scene: &Scene, time: f32) -> PlyGaussians {
    let at = scene.at(time);
    let triples = |v: Vec<f32>| v.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
    let rotations = to_vec(at.rotations)
        .chunks_exact(4)
        .map(|q| {
            let norm = q.iter().map(|v| v * v).sum::<f32>().sqrt();
            if norm > 1e-12 { [q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm] } else { [1.0, 0.0, 0.0, 0.0] }
        })
        .collect();
    PlyGaussians {
        means: triples(to_vec(at.means)),
        log_scales: triples(to_vec(at.log_scales)),
        rotations,
        opacity_logits: to_vec(at.opacity_logits),
        sh: to_vec(scene.gaussians.sh.val()),
        sh_degree: scene.gaussians.sh_degree(),
    }
}
