//! The logit of one Gaussian in f64, step by step: the oracle of the tests.

use crate::splat::reference::rotation_matrix;

/// One Gaussian and the eye.
#[derive(Clone, Copy, Debug)]
pub struct SeenGaussian {
    /// Position, scene units.
    pub mean: [f64; 3],
    /// Quaternion w, x, y, z of any length; of length 0 for no rotation.
    pub rotation: [f64; 4],
    /// Natural logarithms of the standard deviations.
    pub log_scales: [f64; 3],
    /// Base opacity before the sigmoid.
    pub logit: f64,
    /// The eye, scene units.
    pub eye: [f64; 3],
    /// The exponent p.
    pub exponent: f64,
}

/// Returns the logit of the opacity as the eye sees it.
pub fn logit(seen: &SeenGaussian) -> f64 {
    let SeenGaussian { mean, rotation, log_scales, logit, eye, exponent } = *seen;
    let d: [f64; 3] = std::array::from_fn(|i| mean[i] - eye[i]);
    let distance = d.iter().map(|v| v * v).sum::<f64>().sqrt();
    let length = rotation.iter().map(|v| v * v).sum::<f64>().sqrt();
    let unit = if length > 1e-12 { rotation.map(|v| v / length) } else { [1.0, 0.0, 0.0, 0.0] };
    let rows = rotation_matrix(unit);
    // the axes of the Gaussian
    let axes = [0, 1, 2].map(|column| rows.map(|row| row[column]));
    let middle = log_scales.iter().sum::<f64>() / 3.0;
    let square: f64 = (axes.iter().zip(log_scales))
        .map(|(axis, s)| {
            let along = axis.iter().zip(d).map(|(a, d)| a * d / distance).sum::<f64>();
            (along * (middle - s).clamp(-10.0, 10.0).exp()).powi(2)
        })
        .sum();
    let depth = logit.exp().ln_1p() * square.powf(-0.5 * exponent);
    depth.exp_m1().ln()
}
