//! Vortex tubes inside two breathing, translucent shells. Tube a splits in two and tube b's two strands join, each like
//! a zip; c vanishes, d appears, e is a ring that stays. The shells take up the low values, the tubes the high ones,
//! and a tube rises from the value inside both shells, so no tube has a surface layer of shell values.

use super::field::{P3, ellipsoid, smooth_max, step};
use super::strand::{Chunk, StrandPoint, chunks, outside};
use std::f64::consts::{PI, TAU};

/// Segment names by label.
pub(super) const NAMES: [&str; 7] = ["tube-a", "tube-b", "tube-c", "tube-d", "tube-e", "shell-inner", "shell-outer"];
const SHELL_INNER: u16 = 6;
const SHELL_OUTER: u16 = 7;

/// Each shell raises the value by this; the tubes start from twice this.
const SHELL_RISE: f64 = 0.16;
/// Width over which a shell raises the value.
const SHELL_WIDTH: f64 = 0.09;
/// Width of a tube's steep flank, and the slow rise inside it that keeps the gradient above zero for shading.
const FLANK: f64 = 0.045;
const HEART: f64 = 0.05;
/// Number of pieces of a strand, and of pieces under one bound.
const PIECES: usize = 48;
const CHUNK: usize = 6;
/// Full radius of a tube, and the distance of a tube's two strands from the middle.
const RADIUS: f64 = 0.082;
const APART: f64 = 0.17;

/// The scene at one time.
pub(super) struct VorticesFrame {
    chunks: Vec<Chunk>,
    outer: P3,
    inner: P3,
}

/// The scene at one time and height: the chunks that reach it.
pub(super) struct VorticesSlice<'a> {
    frame: &'a VorticesFrame,
    z: f64,
    chunks: Vec<&'a Chunk>,
}

/// Peak values of the tubes.
const PEAKS: [f64; 5] = [1.0, 1.0, 0.58, 0.58, 0.79];

/// How far the zip that opens at the end `s = 0` has opened at `s`.
fn zip(s: f64, t: f64) -> f64 {
    step((1.6 * t - 0.35 - 0.5 * s) / 0.5)
}

/// Turns a point about the z axis.
fn turn(p: P3, angle: f64) -> P3 {
    let (sin, cos) = angle.sin_cos();
    [p[0] * cos - p[1] * sin, p[0] * sin + p[1] * cos, p[2]]
}

/// The point of a strand of tube a (`side` is -1 or 1) at `s` in `[0, 1]`, from its lower end up.
fn tube_a(s: f64, t: f64, side: f64) -> StrandPoint {
    let shift = side * APART * zip(s, t);
    let x = 0.30 + 0.16 * (PI * s).sin() + 0.05 * (4.0 * s + 2.5 * t).cos() + 0.25 * shift;
    let y = 0.15 * (5.0 * s + 2.0 * t).sin() + 0.97 * shift;
    ([x, y, 0.86 * s - 0.43], RADIUS * (1.0 - 0.15 * zip(s, t)))
}

/// The point of a strand of tube b, from its upper end down.
fn tube_b(s: f64, t: f64, side: f64) -> StrandPoint {
    let open = 1.0 - zip(s, t);
    let shift = side * APART * open;
    let x = -0.31 - 0.15 * (PI * s).sin() + 0.05 * (4.0 * s - 2.0 * t).sin() - 0.25 * shift;
    let y = 0.15 * (4.5 * s - 2.5 * t).cos() + 0.97 * shift;
    ([x, y, 0.42 - 0.84 * s], RADIUS * (1.0 - 0.15 * open))
}

/// The point of an arch near the top (`pole` 1) or the bottom (-1), thinner and shorter as `life` goes to 0.
fn arch(s: f64, t: f64, pole: f64, life: f64) -> StrandPoint {
    let along = (s - 0.5) * (0.3 + 0.7 * life);
    let p = [0.64 * along, 0.10 * (7.0 * along + 3.0 * t * pole).sin(), pole * (0.55 - 0.35 * along * along)];
    // a radius below 0 fades the tube out instead of leaving a thread
    (turn(p, 1.6 + 0.3 * pole), (RADIUS + FLANK) * life - FLANK)
}

/// The point of the ring.
fn ring(s: f64, t: f64) -> StrandPoint {
    let turn = TAU * s;
    let r = 0.30 * (1.0 + 0.10 * (3.0 * turn - 3.0 * t).sin());
    let p = [0.10 * (turn + 4.0 * t).sin(), 0.08 * (TAU * t).sin() + r * turn.cos(), r * turn.sin()];
    (p, 0.85 * RADIUS * (1.0 + 0.18 * (2.0 * turn - 5.0 * t).sin()))
}

/// Thins a strand towards its ends and lets bulges travel along it.
fn shape(bead: StrandPoint, s: f64, t: f64) -> StrandPoint {
    let ends = 1.0 - 0.35 * (2.0 * s - 1.0).powi(4);
    let bulge = 1.0 + 0.12 * (12.0 * s - 6.0 * t).sin();
    (bead.0, if bead.1 > 0.0 { bead.1 * ends * bulge } else { bead.1 })
}

impl VorticesFrame {
    pub(super) fn new(t: f64) -> Self {
        let mut frame = Self {
            chunks: Vec::new(),
            outer: [0.88, 0.82, 0.86].map(|a| a * (1.0 + 0.025 * (TAU * t).sin())),
            inner: [0.73, 0.68, 0.72],
        };
        frame.inner[2] *= 1.0 + 0.035 * (TAU * t + 1.0).sin();
        frame.inner[0] *= 1.0 - 0.025 * (TAU * t + 1.0).sin();
        for side in [-1.0, 1.0] {
            frame.strand(0, t, |s| shape(tube_a(s, t, side), s, t));
            frame.strand(1, t, |s| shape(tube_b(s, t, side), s, t));
        }
        let (fading, growing) = (1.0 - step((t - 0.10) / 0.45), step((t - 0.40) / 0.45));
        frame.strand(2, t, |s| shape(arch(s, t, 1.0, fading), s, t));
        frame.strand(3, t, |s| shape(arch(s, t, -1.0, growing), s, t));
        frame.strand(4, t, |s| ring(s, t));
        frame
    }

    /// Adds a strand in chunks that share their end beads.
    fn strand(&mut self, tube: usize, t: f64, bead: impl Fn(f64) -> StrandPoint) {
        let beads: Vec<StrandPoint> = (0..=PIECES)
            .map(|i| {
                let (p, radius) = bead(i as f64 / PIECES as f64);
                (turn(p, 0.9 * t), radius)
            })
            .collect();
        self.chunks.extend(chunks(tube, &beads, CHUNK, FLANK));
    }

    pub(super) fn slice(&self, z: f64) -> VorticesSlice<'_> {
        let chunks = self.chunks.iter().filter(|chunk| chunk.reaches(z)).collect();
        VorticesSlice { frame: self, z, chunks }
    }
}

impl VorticesSlice<'_> {
    /// Value and label at one point of the slice, before the window of the box.
    pub(super) fn at(&self, x: f64, y: f64) -> (f64, u16) {
        let p = [x, y, self.z];
        let outside: [f64; PEAKS.len()] = outside(&self.chunks, p);
        let outer = step(0.5 - ellipsoid(p, self.frame.outer) / SHELL_WIDTH);
        let inner = step(0.5 - ellipsoid(p, self.frame.inner) / SHELL_WIDTH);
        let mut tubes = 0.0;
        let (mut highest, mut label) = (0.0, 0);
        for (tube, (&peak, &d)) in PEAKS.iter().zip(&outside).enumerate() {
            let rise = peak - 2.0 * SHELL_RISE - HEART;
            let own = rise * step(0.5 - d / FLANK) + HEART * step((0.02 - d) / 0.09);
            tubes = smooth_max(tubes, own, own.min(0.02));
            if own > highest {
                (highest, label) = (own, tube as u16 + 1);
            }
        }
        if highest < 0.05 {
            // a shell is where the value rises; the space between them is no segment
            label = match (rising(inner), rising(outer)) {
                (true, _) => SHELL_INNER,
                (false, true) => SHELL_OUTER,
                (false, false) => 0,
            };
        }
        ((SHELL_RISE * (outer + inner) + tubes).min(1.0), label)
    }
}

/// True within the flank of a step.
fn rising(s: f64) -> bool {
    (0.1..0.9).contains(&s)
}
