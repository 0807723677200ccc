//! Closed layers nested around a moving centre: a translucent outer one, a lobed middle one, and inside it a core and a
//! small seed that orbits the core. The value rises inwards in steps, so each layer is a band of values.

use super::field::{P3, dot, norm, smooth_max, step, sub};
use std::f64::consts::TAU;

/// Segment names by label.
pub(super) const NAMES: [&str; 4] = ["outer", "middle", "core", "seed"];

/// Value between outer and middle, inside the middle, at the peaks of core and seed.
const OUTER: f64 = 0.26;
const MIDDLE: f64 = 0.54;
const CORE: f64 = 0.78;
const SEED: f64 = 1.0;
/// Widths of the steps.
const LAYER_WIDTH: f64 = 0.10;
const FLANK: f64 = 0.045;
/// Fraction of the core's and the seed's rise that is slow, for shading.
const HEART: f64 = 0.15;

/// The scene at one time.
pub(super) struct ShellsFrame {
    t: f64,
    centre: P3,
    seed: P3,
}

impl ShellsFrame {
    pub(super) fn new(t: f64) -> Self {
        let centre = [0.06 * (TAU * t).sin(), 0.05 * (TAU * t).cos() - 0.02, 0.05 * (TAU * t + 0.8).sin()];
        // a tilted orbit, slightly more than half a turn
        let angle = 0.6 + 3.6 * t;
        let (sin, cos) = angle.sin_cos();
        let orbit = [0.335 * cos, 0.335 * sin * 0.86, 0.335 * sin * 0.5];
        Self { t, centre, seed: std::array::from_fn(|a| centre[a] + orbit[a]) }
    }

    /// Value and label at one point, before the window of the box.
    pub(super) fn at(&self, p: P3) -> (f64, u16) {
        let q = sub(p, self.centre);
        let radius = norm(q);
        // The direction has no limit at the centre, where every layer is saturated anyway.
        let n = q.map(|c| c / radius.max(1e-6));
        let w = TAU * self.t;
        let [x, y, z] = n;
        let long = 1.5 * z * z - 0.5;
        // away from a layer's surface its step is 0 or 1 and its shape is not needed
        let layer = |min: f64, max: f64, shape: &dyn Fn() -> f64| {
            if radius < min {
                1.0
            } else if radius > max {
                0.0
            } else {
                step(0.5 + (shape() - radius) / LAYER_WIDTH)
            }
        };
        let outer = layer(0.64, 0.92, &|| {
            0.78 * (1.0 + 0.045 * (w.cos() * long + w.sin() * 1.5 * x * y) + 0.02 * (3.0 * x + w).sin())
        });
        let (a, b) = (0.55 * w, 0.8 * w);
        let middle = layer(0.42, 0.70, &|| {
            let lobes = (5.2 * x + 1.5 * (2.0 * y).sin() + a).sin() * (4.6 * y - a).cos() * (4.9 * z + b).cos();
            0.555 * (1.0 + 0.10 * lobes + 0.04 * (w + 1.0).sin() * long)
        });
        let core = if radius < 0.30 {
            let shape = 0.16 * (3.3 * x + w).sin() * (3.1 * z - w).cos() + 0.10 * (2.9 * y + 1.3 * w).sin();
            solid(radius - 0.185 * (1.0 + shape), 0.16) * (CORE - MIDDLE)
        } else {
            0.0
        };
        let from_seed = sub(p, self.seed);
        let stretch = 1.0 + 0.3 * dot(from_seed, n).powi(2) / dot(from_seed, from_seed).max(1e-9);
        let seed = solid(norm(from_seed) * stretch - 0.095, 0.07) * (SEED - MIDDLE);
        let value = OUTER * outer + (MIDDLE - OUTER) * middle + smooth_max(core, seed, core.min(seed).min(0.02));
        (value.min(1.0), label(outer, middle, core, seed))
    }
}

/// Rise of a solid with its surface at `outside = 0`: a steep flank, then a slow rise over `depth`.
fn solid(outside: f64, depth: f64) -> f64 {
    (1.0 - HEART) * step(0.5 - outside / FLANK) + HEART * step((0.02 - outside) / depth)
}

/// The layer that dominates: a solid where it rises, else the layer whose flank this is; the spaces between the layers
/// are no segment.
fn label(outer: f64, middle: f64, core: f64, seed: f64) -> u16 {
    let flank = |s: f64| (0.1..0.9).contains(&s);
    if core.max(seed) > 0.04 {
        if seed > core { 4 } else { 3 }
    } else if flank(middle) {
        2
    } else if flank(outer) {
        1
    } else {
        0
    }
}
