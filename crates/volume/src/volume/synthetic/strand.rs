//! Curved tubes as runs of beads, each run with a sphere that bounds its effect on the field. Nothing here knows a
//! scene.

use super::field::{P3, dot, norm, sub};

/// A point of a strand: position and radius. A radius of minus the flank or less leaves no trace in the field.
pub(super) type StrandPoint = (P3, f64);

/// A run of beads and the sphere that bounds its effect on the field.
pub(super) struct Chunk {
    beads: Vec<StrandPoint>,
    centre: P3,
    reach: f64,
    /// The tube it belongs to.
    tube: usize,
}

/// Cuts a strand into chunks of `length` pieces that share their end beads; `flank` is how far beyond its radius a
/// tube raises the field. The number of pieces must be a multiple of `length`.
pub(super) fn chunks(tube: usize, beads: &[StrandPoint], length: usize, flank: f64) -> impl Iterator<Item = Chunk> {
    (0..beads.len().saturating_sub(1)).step_by(length).map(move |start| {
        let beads = beads[start..=start + length].to_vec();
        let centre = beads[length / 2].0;
        let reach = beads.iter().map(|(p, radius)| norm(sub(*p, centre)) + radius + flank).fold(0.0, f64::max);
        Chunk { beads, centre, reach, tube }
    })
}

impl Chunk {
    /// Whether the chunk can affect the field at the height `z`.
    pub fn reaches(&self, z: f64) -> bool {
        (self.centre[2] - z).abs() < self.reach
    }

    /// Signed distance to the chunk, negative inside; `None` where it has no effect.
    pub fn outside(&self, p: P3) -> Option<f64> {
        let from = sub(p, self.centre);
        (dot(from, from) < self.reach * self.reach)
            .then(|| self.beads.windows(2).map(|w| piece(p, &w[0], &w[1])).fold(f64::INFINITY, f64::min))
    }
}

/// Signed distance to each of `N` tubes, negative inside; infinite for those of which no chunk has an effect at `p`.
pub(super) fn outside<const N: usize>(chunks: &[&Chunk], p: P3) -> [f64; N] {
    let mut outside = [f64::INFINITY; N];
    for chunk in chunks {
        if let Some(nearest) = chunk.outside(p) {
            outside[chunk.tube] = outside[chunk.tube].min(nearest);
        }
    }
    outside
}

/// Signed distance to the cone between two beads, negative inside.
fn piece(p: P3, a: &StrandPoint, b: &StrandPoint) -> f64 {
    let (from, along) = (sub(p, a.0), sub(b.0, a.0));
    let s = (dot(from, along) / dot(along, along).max(1e-12)).clamp(0.0, 1.0);
    norm(sub(from, along.map(|c| c * s))) - (a.1 + (b.1 - a.1) * s)
}
