//! Ray compositing as plain f64 loops, from the sum of the depths before each sample: the oracle of the fast kernels.

use super::rays::RaySamples;

/// Returns the colour over the background and the alpha of each ray, `[R, 4]`, from optical depths `[S]` and colours
/// `[C, 3]`.
pub fn composite(rays: &RaySamples, depths: &[f64], colours: &[f64], background: [f64; 3]) -> Vec<f64> {
    let mut out = Vec::with_capacity(4 * rays.rays());
    for ray in 0..rays.rays() {
        let mut seen = [0.0; 4];
        let mut before = 0.0f64;
        for s in rays.of(ray) {
            if let Some(row) = rays.row(s) {
                let weight = (-before).exp() * (1.0 - (-depths[s]).exp());
                for k in 0..3 {
                    seen[k] += weight * colours[3 * row + k];
                }
            }
            before += depths[s];
        }
        let through = (-before).exp();
        for k in 0..3 {
            seen[k] += through * background[k];
        }
        seen[3] = 1.0 - through;
        out.extend(seen);
    }
    out
}
