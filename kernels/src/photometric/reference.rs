//! The distance as plain f64 loops: the oracle of the fast kernel, gradient included.

use super::Distance;

/// Returns the mean over pixels and colours of the distance, plus `alpha` times that of the fourth channel, of images
/// `[pixels, 4]`; its gradient with respect to `image`; and the mean squared difference of the colours.
pub fn photometric(image: &[f64], target: &[f64], kind: Distance, alpha: f64) -> (f64, Vec<f64>, f64) {
    let pixels = (image.len() / 4) as f64;
    let (mut value, mut squared) = (0.0, 0.0);
    let mut grad = Vec::with_capacity(image.len());
    for (i, (a, b)) in image.iter().zip(target).enumerate() {
        let weight = if i % 4 < 3 { 1.0 / (3.0 * pixels) } else { alpha / pixels };
        let difference = a - b;
        let (distance, slope) = match kind {
            Distance::Absolute if difference == 0.0 => (0.0, 0.0),
            Distance::Absolute => (difference.abs(), difference.signum()),
            Distance::Squared => (difference * difference, 2.0 * difference),
        };
        value += weight * distance;
        grad.push(weight * slope);
        if i % 4 < 3 {
            squared += difference * difference / (3.0 * pixels);
        }
    }
    (value, grad, squared)
}
