//! Beads of one colour that touch, merge, separate and split: the first two merge for a while, the seventh emerges from
//! the third, the fourth and the fifth brush past each other, the sixth is on its own. Where beads form one body, each
//! point belongs to the bead in whose surface it lies deepest, so identities last through a merge.

use super::field::{P3, dot, lerp, norm, smooth_min, step, sub};
use std::f64::consts::TAU;

/// Segment names by label.
pub(super) const NAMES: [&str; 7] = ["bead-1", "bead-2", "bead-3", "bead-4", "bead-5", "bead-6", "bead-7"];

/// Distance between two surfaces at which a neck begins to form.
const NECK: f64 = 0.07;
/// Width of the flank, and the slow rise inside, over `DEPTH`, that keeps the gradient above zero for shading.
const FLANK: f64 = 0.05;
const HEART: f64 = 0.25;
const DEPTH: f64 = 0.12;
/// Amplitude of the bumps.
const ROUGH: f64 = 0.012;

/// A bead at one time.
struct Bead {
    centre: P3,
    radius: f64,
}

/// The scene at one time.
pub(super) struct BeadsFrame {
    t: f64,
    beads: [Bead; 7],
}

/// The scene at one time and height: the beads that reach it, with their labels.
pub(super) struct BeadsSlice<'a> {
    t: f64,
    z: f64,
    beads: Vec<(&'a Bead, u16)>,
}

/// `centre` moved by `way` along the unit vector of `along`.
fn moved(centre: P3, along: P3, way: f64) -> P3 {
    let scale = way / norm(along);
    std::array::from_fn(|a| centre[a] + scale * along[a])
}

impl BeadsFrame {
    pub(super) fn new(t: f64) -> Self {
        let w = TAU * t;
        // the pair comes together, stays merged for a while and separates
        let together = step((t - 0.12) / 0.28) * (1.0 - step((t - 0.62) / 0.28));
        let apart = 0.5 * lerp(0.56, 0.22, together);
        let pair = [-0.30 + 0.05 * w.sin(), 0.36, 0.32 + 0.05 * w.cos()];
        let along = [(1.1 * t).cos(), 0.25, (1.1 * t).sin()];
        // the child leaves its parent, in which it hides at first
        let out = step((t - 0.30) / 0.5);
        let family = [0.42, 0.36 + 0.04 * w.sin(), -0.25];
        let away = [-0.35, 0.25, 0.9];
        // two go past each other
        let past = lerp(-0.42, 0.42, t);
        let orbit = 0.4 + 2.6 * t;
        let bead = |centre: P3, radius: f64| Bead { centre, radius };
        let beads = [
            bead(moved(pair, along, -apart), 0.175),
            bead(moved(pair, along, apart), 0.150),
            bead(moved(family, away, -0.18 * out), lerp(0.195, 0.160, out)),
            bead([past, -0.52, -0.42 + 0.03 * w.sin()], 0.150),
            bead([-past, -0.225, -0.40], 0.140),
            bead([0.40 + 0.18 * orbit.cos(), -0.34 + 0.18 * orbit.sin(), 0.50 + 0.06 * w.sin()], 0.165),
            bead(moved(family, away, 0.27 * out), lerp(0.100, 0.140, out)),
        ];
        Self { t, beads }
    }

    pub(super) fn slice(&self, z: f64) -> BeadsSlice<'_> {
        let reach = |bead: &Bead| bead.radius + NECK + FLANK + ROUGH;
        let beads = self.beads.iter().zip(1..).filter(|(b, _)| (b.centre[2] - z).abs() < reach(b)).collect();
        BeadsSlice { t: self.t, z, beads }
    }
}

impl BeadsSlice<'_> {
    /// Value and label at one point of the slice, before the window of the box.
    pub(super) fn at(&self, x: f64, y: f64) -> (f64, u16) {
        let p = [x, y, self.z];
        let (mut outside, mut nearest, mut label) = (f64::INFINITY, f64::INFINITY, 0);
        for (bead, id) in &self.beads {
            let from = sub(p, bead.centre);
            let reach = bead.radius + NECK + FLANK + ROUGH;
            if dot(from, from) >= reach * reach {
                continue;
            }
            let own = norm(from) - bead.radius;
            outside = if outside.is_finite() { smooth_min(outside, own, NECK) } else { own };
            if own < nearest {
                (nearest, label) = (own, *id);
            }
        }
        if !outside.is_finite() {
            return (0.0, 0);
        }
        let w = TAU * self.t;
        outside += ROUGH * (9.0 * x + w).sin() * (8.0 * y - w).cos() * (8.5 * self.z).sin();
        let value = (1.0 - HEART) * step(0.5 - outside / FLANK) + HEART * step(-outside / DEPTH);
        (value, if value > 0.05 { label } else { 0 })
    }
}
