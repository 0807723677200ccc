//! The shaded colour of one Gaussian in f64, step by step: the oracle of the tests.

use super::Light;
use crate::splat::reference::rotation_matrix;

/// One Gaussian and its lighting.
#[derive(Clone, Copy, Debug)]
pub struct LitGaussian {
    /// Position, scene units.
    pub mean: [f64; 3],
    /// Quaternion w, x, y, z of any length.
    pub rotation: [f64; 4],
    /// First spherical-harmonics coefficient, RGB.
    pub sh: [f64; 3],
    /// Normal in its own frame.
    pub normal: [f64; 3],
    /// The material in its trained form.
    pub material: [f64; 3],
    /// The eye, scene units.
    pub eye: [f64; 3],
    /// The light.
    pub light: Light,
}

/// Returns the shaded colour, without the remainder in other coefficients.
pub fn colour(lit: &LitGaussian) -> [f64; 3] {
    let normal = unit(rotate(lit.rotation, lit.normal));
    let to_eye = unit(std::array::from_fn(|i| lit.eye[i] - lit.mean[i]));
    let (to_light, half) = match lit.light {
        Light::Head => (to_eye, to_eye),
        Light::Far(direction) => {
            let to_light = unit(direction.map(f64::from));
            (to_light, unit(std::array::from_fn(|i| to_eye[i] + to_light[i])))
        }
    };
    let [ambient, specular, exponent] = lit.material;
    let ambient = 1.0 / (1.0 + (-ambient).exp());
    let glow = ambient + (1.0 - ambient) * dot(normal, to_light).abs();
    let shine = specular.exp() * dot(normal, half).abs().powf(exponent.exp());
    lit.sh.map(|c| (0.5 + 0.282_094_791_773_878_14 * c) * glow + shine)
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = dot(v, v).sqrt();
    v.map(|c| c / length)
}

/// Rotates `v` by the rotation matrix of `q`.
fn rotate(q: [f64; 4], v: [f64; 3]) -> [f64; 3] {
    let length = q.iter().map(|c| c * c).sum::<f64>().sqrt();
    rotation_matrix(q.map(|c| c / length)).map(|row| dot(row, v))
}
