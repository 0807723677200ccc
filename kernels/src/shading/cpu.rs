//! The fast kernels over f32 arrays. Gaussians are independent except for the material's gradient, whose sums are added
//! in order, so the bits do not depend on the number of threads.

use super::{GRAZING, Light, MATERIAL, MIN_SQUARE, Material};
use crate::sh::C0;
use crate::turn::{Float3, dot, turn, turn_backward};
use rayon::prelude::*;

/// Gaussians per task.
const PIECE: usize = 1024;

/// The arrays of [`super::shaded`], row-major.
#[derive(Clone, Copy, Debug)]
pub struct ShadingArrays<'a> {
    /// `[N, 3]`
    pub means: &'a [f32],
    /// `[N, 4]`
    pub rotations: &'a [f32],
    /// `[N, K, 3]`
    pub sh: &'a [f32],
    /// `[N, 3]`
    pub normals: &'a [f32],
    /// The material as [`Material::to_trained`].
    pub material: [f32; MATERIAL],
    /// The light.
    pub light: Light,
    /// The eye, scene units.
    pub eye: Float3,
}

/// The shading of one Gaussian, with the values that its gradient needs.
struct ShadedGaussian {
    w: f32,
    u: Float3,
    normal: Float3,
    /// The rotated normal, scaled by the squared length of the quaternion.
    turned: Float3,
    to_eye: Float3,
    /// Not of unit length under a headlight.
    to_light: Float3,
    /// Any vector along the half direction.
    half: Float3,
    diffuse: SignedCosine,
    highlight: SignedCosine,
    glow: f32,
    shine: f32,
}

/// The signed cosine of the angle between two vectors.
#[derive(Clone, Copy)]
struct SignedCosine {
    value: f32,
    /// Squared lengths of the two vectors, at least [`MIN_SQUARE`].
    squares: [f32; 2],
}

impl SignedCosine {
    fn of(a: Float3, b: Float3) -> Self {
        let squares = [dot(a, a).max(MIN_SQUARE), dot(b, b).max(MIN_SQUARE)];
        Self { value: dot(a, b) / (squares[0].sqrt() * squares[1].sqrt()), squares }
    }

    /// Returns the gradients of the absolute value with respect to `a` and `b`, times `by`.
    fn slopes(self, a: Float3, b: Float3, by: f32) -> [Float3; 2] {
        let sign = if self.value > 0.0 { by } else { -by };
        let sign = if self.value == 0.0 { 0.0 } else { sign };
        let across = sign / (self.squares[0].sqrt() * self.squares[1].sqrt());
        let along = self.squares.map(|square| if square > MIN_SQUARE { sign * self.value / square } else { 0.0 });
        [
            std::array::from_fn(|i| across * b[i] - along[0] * a[i]),
            std::array::from_fn(|i| across * a[i] - along[1] * b[i]),
        ]
    }
}

fn see(lit: &ShadingArrays<'_>, material: &Material, i: usize) -> ShadedGaussian {
    let triple = |v: &[f32], at: usize| [v[at], v[at + 1], v[at + 2]];
    let (mean, normal) = (triple(lit.means, 3 * i), triple(lit.normals, 3 * i));
    let (w, u) = (lit.rotations[4 * i], triple(lit.rotations, 4 * i + 1));
    let turned = turn(w, u, normal);
    let to_eye: Float3 = std::array::from_fn(|c| lit.eye[c] - mean[c]);
    let (to_light, half) = match lit.light {
        Light::Head => (to_eye, to_eye),
        Light::Far(direction) => {
            let (to_light, view) = (unit(direction), unit(to_eye));
            (to_light, std::array::from_fn(|c| view[c] + to_light[c]))
        }
    };
    let (diffuse, highlight) = (SignedCosine::of(turned, to_light), SignedCosine::of(turned, half));
    let glow = material.ambient + (1.0 - material.ambient) * diffuse.value.abs();
    let shine = material.specular * highlight.value.abs().max(GRAZING).powf(material.exponent);
    ShadedGaussian { w, u, normal, turned, to_eye, to_light, half, diffuse, highlight, glow, shine }
}

/// Returns the coefficients `[N, K, 3]` whose first give the shaded colours.
pub fn forward(lit: &ShadingArrays<'_>) -> Vec<f32> {
    let n = lit.means.len() / 3;
    let width = lit.sh.len() / n.max(1);
    let material = Material::from_trained(lit.material);
    let mut out = lit.sh.to_vec();
    if width == 0 {
        return out;
    }
    out.par_chunks_mut(PIECE * width).enumerate().for_each(|(piece, rows)| {
        for (row, sh) in rows.chunks_exact_mut(width).enumerate() {
            let ShadedGaussian { glow, shine, .. } = see(lit, &material, piece * PIECE + row);
            for value in &mut sh[..3] {
                *value = ((0.5 + C0 * *value) * glow + shine - 0.5) / C0;
            }
        }
    });
    out
}

/// Returns the gradients of a loss whose gradient with respect to the result of [`forward`] is `grad` `[N, K, 3]`: those
/// with respect to means `[N, 3]`, rotations `[N, 4]`, coefficients `[N, K, 3]`, normals `[N, 3]` and the material `[3]`.
pub fn backward(lit: &ShadingArrays<'_>, grad: &[f32]) -> [Vec<f32>; 5] {
    let n = lit.means.len() / 3;
    let width = lit.sh.len() / n.max(1);
    let material = Material::from_trained(lit.material);
    let zeros = |count: usize| vec![0.0; count];
    let mut out = [zeros(3 * n), zeros(4 * n), grad.to_vec(), zeros(3 * n), zeros(MATERIAL)];
    if width == 0 {
        return out;
    }
    let [means, rotations, sh, normals, of_material] = &mut out;
    let pieces = (means.par_chunks_mut(3 * PIECE))
        .zip(rotations.par_chunks_mut(4 * PIECE))
        .zip(sh.par_chunks_mut(width * PIECE))
        .zip(normals.par_chunks_mut(3 * PIECE));
    let sums: Vec<[f64; MATERIAL]> = pieces
        .enumerate()
        .map(|(piece, (((means, rotations), sh), normals))| {
            let mut sum = [0.0; MATERIAL];
            for row in 0..means.len() / 3 {
                let i = piece * PIECE + row;
                let base = &lit.sh[width * i..][..3];
                let (slopes, of_material) =
                    slopes(&see(lit, &material, i), &material, lit.light, base, &mut sh[width * row..][..3]);
                means[3 * row..][..3].copy_from_slice(&slopes.mean);
                rotations[4 * row..][..4].copy_from_slice(&slopes.rotation);
                normals[3 * row..][..3].copy_from_slice(&slopes.normal);
                sum.iter_mut().zip(of_material).for_each(|(sum, v)| *sum += f64::from(v));
            }
            sum
        })
        .collect();
    for (c, value) in of_material.iter_mut().enumerate() {
        *value = sums.iter().map(|sum| sum[c]).sum::<f64>() as f32;
    }
    out
}

/// Gradients with respect to the inputs of one Gaussian.
struct ShadingGradients {
    mean: Float3,
    rotation: [f32; 4],
    normal: Float3,
}

/// Returns the gradients of one Gaussian, and its share of the material's. `grad` is with respect to the shaded
/// coefficients `[3]` on entry, and with respect to the `base` ones on return.
fn slopes(
    seen: &ShadedGaussian,
    material: &Material,
    light: Light,
    base: &[f32],
    grad: &mut [f32],
) -> (ShadingGradients, [f32; MATERIAL]) {
    let Material { ambient, specular: _, exponent } = *material;
    let (mut by_glow, mut by_shine) = (0.0, 0.0);
    for (grad, base) in grad.iter_mut().zip(base) {
        by_glow += *grad / C0 * (0.5 + C0 * base);
        by_shine += *grad / C0;
        *grad *= seen.glow;
    }
    let (diffuse, highlight) = (seen.diffuse.value.abs(), seen.highlight.value.abs());
    let lit = highlight > GRAZING;
    let of_material = [
        by_glow * (1.0 - diffuse) * ambient * (1.0 - ambient),
        by_shine * seen.shine,
        by_shine * seen.shine * exponent * highlight.max(GRAZING).ln(),
    ];
    let by_highlight = if lit { by_shine * seen.shine * exponent / highlight } else { 0.0 };
    let [a, by_light] = seen.diffuse.slopes(seen.turned, seen.to_light, by_glow * (1.0 - ambient));
    let [b, by_half] = seen.highlight.slopes(seen.turned, seen.half, by_highlight);
    let by_eye: Float3 = match light {
        Light::Head => std::array::from_fn(|c| by_light[c] + by_half[c]),
        Light::Far(_) => {
            // back through the normalisation of the direction to the eye
            let square = dot(seen.to_eye, seen.to_eye).max(MIN_SQUARE);
            let along = dot(by_half, seen.to_eye) / square;
            std::array::from_fn(|c| (by_half[c] - along * seen.to_eye[c]) / square.sqrt())
        }
    };
    let d: Float3 = std::array::from_fn(|c| a[c] + b[c]);
    let (w, u) = (seen.w, seen.u);
    let (by_w, by_u) = turn_backward(w, u, seen.normal, d);
    let slopes = ShadingGradients {
        mean: by_eye.map(|v| -v),
        rotation: [by_w, by_u[0], by_u[1], by_u[2]],
        // the inverse rotation
        normal: turn(w, u.map(|v| -v), d),
    };
    (slopes, of_material)
}

fn unit(v: Float3) -> Float3 {
    let length = dot(v, v).max(MIN_SQUARE).sqrt();
    v.map(|c| c / length)
}
