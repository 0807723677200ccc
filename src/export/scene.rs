//! A scene at one time as plain Gaussians for other programs.

use super::ply::PlyGaussians;
use crate::model::GaussiansAt;

/// `at` as a PLY file holds them, rotations normalised.
#[must_use]
pub fn to_ply(at: GaussiansAt) -> PlyGaussians {
    let triples = |v: &[f32]| v.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
    let rotations = at
        .rotations
        .chunks_exact(4)
        .map(|q| {
            let norm = q.iter().map(|v| v * v).sum::<f32>().sqrt();
            if norm > 1e-12 { [q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm] } else { [1.0, 0.0, 0.0, 0.0] }
        })
        .collect();
    PlyGaussians {
        means: triples(&at.means),
        log_scales: triples(&at.log_scales),
        rotations,
        opacity_logits: at.opacity_logits,
        sh: at.sh,
        sh_degree: at.sh_stride.isqrt() - 1,
    }
}
