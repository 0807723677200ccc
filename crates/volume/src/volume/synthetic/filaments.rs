//! Thin curved filaments, a few voxels thick at 128 voxels a side, that turn, sway and bend: three of a lower value and
//! two of a higher one, so that a transfer function shows them in two colours. Filaments of one colour differ in
//! position alone.

use super::field::{P3, smooth_max, step};
use super::strand::{Chunk, StrandPoint, chunks, outside};
use std::f64::consts::TAU;

/// Segment names by label.
pub(super) const NAMES: [&str; 5] = ["filament-1", "filament-2", "filament-3", "filament-4", "filament-5"];

/// Peak values of the filaments.
const PEAKS: [f64; 5] = [0.5, 0.5, 0.5, 1.0, 1.0];
/// Full radius, and width of the flank around it.
const RADIUS: f64 = 0.030;
const FLANK: f64 = 0.035;
/// The last part of a filament's value, which rises slowly inside it and keeps the gradient above zero for shading.
const HEART: f64 = 0.05;
/// Number of pieces of a filament, and of pieces under one bound.
const PIECES: usize = 48;
const CHUNK: usize = 6;

/// The scene at one time.
pub(super) struct FilamentsFrame {
    chunks: Vec<Chunk>,
}

/// The scene at one time and height: the chunks that reach it.
pub(super) struct FilamentsSlice<'a> {
    z: f64,
    chunks: Vec<&'a Chunk>,
}

/// The centre line of a filament at `u` in `[-1, 1]`. No two come closer than three radii.
fn line(filament: usize, u: f64, t: f64) -> P3 {
    match filament {
        0 => {
            let turn = 2.2 * u + 1.3 * t;
            [0.55 * turn.cos(), 0.55 * turn.sin(), 0.72 * u]
        }
        1 => {
            let sag = 0.70 - 0.30 * u * u + 0.06 * (TAU * t).sin();
            [0.62 * u, 0.12 * (3.0 * u + 2.5 * t).sin() - 0.1, sag]
        }
        2 => {
            let x = -0.40 + 0.12 * (4.0 * u - 2.5 * t).sin();
            [x, 0.72 * u, -0.60 + 0.10 * (3.0 * u + 2.5 * t).cos()]
        }
        3 => {
            let turn = 3.5 * u + 2.2 * t;
            [0.42 * u - 0.05, 0.13 * turn.sin(), -0.05 + 0.13 * turn.cos()]
        }
        _ => {
            let x = 0.45 + 0.10 * (3.0 * u + 2.0 * t).sin();
            [x, -0.66 + 0.08 * (2.0 * u - 2.0 * t).cos(), 0.55 * u - 0.1]
        }
    }
}

impl FilamentsFrame {
    pub(super) fn new(t: f64) -> Self {
        let strand = |filament: usize| {
            let bead = |i: usize| -> StrandPoint {
                let u = 2.0 * i as f64 / PIECES as f64 - 1.0;
                // thinner towards the ends
                (line(filament, u, t), RADIUS * (1.0 - 0.3 * u.powi(4)))
            };
            let beads: Vec<StrandPoint> = (0..=PIECES).map(bead).collect();
            chunks(filament, &beads, CHUNK, FLANK).collect::<Vec<_>>()
        };
        Self { chunks: (0..PEAKS.len()).flat_map(strand).collect() }
    }

    pub(super) fn slice(&self, z: f64) -> FilamentsSlice<'_> {
        FilamentsSlice { z, chunks: self.chunks.iter().filter(|chunk| chunk.reaches(z)).collect() }
    }
}

impl FilamentsSlice<'_> {
    /// Value and label at one point of the slice, before the window of the box.
    pub(super) fn at(&self, x: f64, y: f64) -> (f64, u16) {
        let p = [x, y, self.z];
        let outside: [f64; PEAKS.len()] = outside(&self.chunks, p);
        let mut value = 0.0;
        let (mut nearest, mut label) = (FLANK, 0);
        for (k, (&peak, &d)) in PEAKS.iter().zip(&outside).enumerate() {
            let own = (peak - HEART) * step(0.5 - d / FLANK) + HEART * step(-d / RADIUS);
            value = smooth_max(value, own, own.min(0.02));
            if own > 0.0 && d < nearest {
                (nearest, label) = (d, k as u16 + 1);
            }
        }
        (value, label)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::synthetic::field::{norm, sub};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn filaments_stay_apart(t in 0.0..1.0_f64) {
            let lines: Vec<Vec<P3>> =
                (0..PEAKS.len()).map(|k| (0..=96).map(|i| line(k, f64::from(i) / 48.0 - 1.0, t)).collect()).collect();
            for (k, a) in lines.iter().enumerate() {
                prop_assert!(a.iter().flatten().all(|c| c.abs() < 0.85));
                for b in &lines[..k] {
                    let gap = a.iter().flat_map(|p| b.iter().map(move |q| norm(sub(*p, *q)))).fold(f64::INFINITY, f64::min);
                    prop_assert!(gap > 3.0 * RADIUS, "{k}: {gap}");
                }
            }
        }
    }
}
