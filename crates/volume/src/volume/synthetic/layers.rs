//! A translucent shell, a body in it and a core in the body, each with its own shape and centre: a lobed ellipsoid, a
//! bent peanut, a rod that slides along the body and turns. The value rises inwards in steps, so each layer is a band
//! of values that ends where the next layer begins.

use super::field::{P3, ellipsoid, step, sub};
use std::f64::consts::TAU;

/// Segment names by label.
pub(super) const NAMES: [&str; 3] = ["shell", "body", "core"];

/// Value inside the shell, on the flank of the body, at the peak of the body, on the flank of the core.
const SHELL: f64 = 0.30;
const BODY: f64 = 0.56;
const BODY_HEART: f64 = 0.62;
const CORE: f64 = 0.94;
/// Widths of the flanks: the shell is as thick as its flank.
const SHELL_WIDTH: f64 = 0.11;
const FLANK: f64 = 0.05;
/// Depth over which body and core rise slowly to their peaks.
const BODY_DEPTH: f64 = 0.22;
const CORE_DEPTH: f64 = 0.10;
/// Values at which one label ends and the next begins; between the first two lies the space inside the shell.
const SHELL_ENDS: f64 = 0.28;
const BODY_BEGINS: f64 = 0.40;
const CORE_BEGINS: f64 = 0.74;

/// The scene at one time.
pub(super) struct LayersFrame {
    phase: f64,
    shell: P3,
    shell_axes: P3,
    body: P3,
    /// Angle of the body about the z axis, as sine and cosine.
    turn: (f64, f64),
    /// Sideways bend of the body per square of the height.
    bend: f64,
    /// Centre of the core in the body's coordinates, and its angle.
    core: P3,
    core_turn: (f64, f64),
}

impl LayersFrame {
    pub(super) fn new(t: f64) -> Self {
        let phase = TAU * t;
        Self {
            phase,
            shell: [0.03 * phase.sin(), 0.02 * phase.cos(), -0.02 * phase.sin()],
            shell_axes: [
                0.72 * (1.0 + 0.03 * phase.sin()),
                0.80 * (1.0 - 0.04 * phase.cos()),
                0.84 * (1.0 + 0.02 * (phase + 1.0).sin()),
            ],
            body: [0.10 * (phase + 0.5).cos(), -0.06 + 0.08 * phase.sin(), 0.05 * (phase + 2.0).sin()],
            turn: (1.6 * t + 0.3).sin_cos(),
            bend: 0.45 * (phase + 0.7).sin(),
            core: [0.03, 0.02, 0.17 * (phase + 0.4).sin()],
            core_turn: (2.4 * t).sin_cos(),
        }
    }

    /// Value and label at one point, before the window of the box.
    pub(super) fn at(&self, p: P3) -> (f64, u16) {
        let shell = step(0.5 - self.shell(p) / SHELL_WIDTH);
        let q = self.in_body(p);
        // the body ends well before this, and the core within the body
        let (mut body, mut core) = (0.0, 0.0);
        if q.iter().all(|c| c.abs() < 0.75) {
            let outside = self.body(q);
            body = (BODY - SHELL) * step(0.5 - outside / FLANK) + (BODY_HEART - BODY) * step(-outside / BODY_DEPTH);
            let outside = self.core(q);
            core = (CORE - BODY_HEART) * step(0.5 - outside / FLANK) + (1.0 - CORE) * step(-outside / CORE_DEPTH);
        }
        let value = (SHELL * shell + body + core).min(1.0);
        let label = match value {
            v if v >= CORE_BEGINS => 3,
            v if v >= BODY_BEGINS => 2,
            v if v < SHELL_ENDS && shell > 0.1 => 1,
            _ => 0,
        };
        (value, label)
    }

    /// Approximate signed distance to the shell's middle surface.
    fn shell(&self, p: P3) -> f64 {
        let [x, y, z] = sub(p, self.shell);
        let lobes = (3.1 * x + self.phase).sin() * (2.7 * z - self.phase).cos() + (3.3 * y + 1.1).sin();
        ellipsoid([x, y, z], self.shell_axes) + 0.02 * lobes
    }

    /// A point in coordinates in which the body is upright and straight at the origin.
    fn in_body(&self, p: P3) -> P3 {
        let [x, y, z] = sub(p, self.body);
        let (sin, cos) = self.turn;
        [x * cos + y * sin - self.bend * (z * z - 0.08), y * cos - x * sin, z]
    }

    /// Approximate signed distance to the body: an ellipsoid with a waist.
    fn body(&self, q: P3) -> f64 {
        let waist = 0.035 * (7.0 * q[2] + 0.6 * self.phase.sin()).cos();
        ellipsoid(q, [0.31, 0.27, 0.47]) + waist
    }

    /// Approximate signed distance to the core.
    fn core(&self, q: P3) -> f64 {
        let [x, y, z] = sub(q, self.core);
        let (sin, cos) = self.core_turn;
        ellipsoid([x * cos + y * sin, y * cos - x * sin, z], [0.145, 0.095, 0.19])
    }
}
