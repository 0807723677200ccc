//! Where a segment ends: the density at its edge.

use super::bell::Bell;
use super::density::Density;
use crate::volume::grid::Grid;

/// Rounds in which volume and length of path are fitted to each other. The length enters by the root of its logarithm,
/// so that the second changes the volume of a ball by less than 1 %.
const ROUNDS: usize = 4;
/// Bits of a number that its bin does not tell: 7 bits of the mantissa are left.
const BIN_BITS: u32 = 16;

/// Where one segment ends.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SegmentEdge {
    /// The density at its edge, per unit of length.
    pub density: f32,
    /// The length `L_S`.
    pub path: f64,
    /// Its typical local opacity.
    pub typical: f64,
}

impl SegmentEdge {
    /// Where the segment of `party` ends, whose density is `density`: where its local opacity is `share` of the typical
    /// one.
    pub fn new(density: &Density, party: &[Bell], grid: &Grid, share: f32) -> Self {
        let content: f64 = party.iter().map(|bell| bell.content).sum();
        let size = party.iter().map(|bell| bell.content * bell.size).sum::<f64>() / content;
        let cell = grid.spacing.iter().product::<f64>();
        let bins = bins(&density.values);
        let mut edge = Self { density: f32::MIN_POSITIVE, ..Self::default() };
        for _ in 0..ROUNDS {
            let cells: f64 = bins.iter().filter(|bin| bin[1] >= f64::from(edge.density)).map(|bin| bin[0]).sum();
            let radius = (0.75 / std::f64::consts::PI * cells * cell).cbrt();
            edge.path = (std::f64::consts::TAU * radius * size).sqrt();
            let [mut sum, mut squares] = [0.0; 2];
            for [cells, density] in &bins {
                let alpha = -(-density * edge.path).exp_m1();
                sum += cells * alpha;
                squares += cells * alpha * alpha;
            }
            edge.typical = if sum > 0.0 { squares / sum } else { 0.0 };
            // below 1, which no density reaches
            let alpha = (f64::from(share) * edge.typical).min(1.0 - f64::EPSILON);
            edge.density = ((-(-alpha).ln_1p() / edge.path) as f32).max(f32::MIN_POSITIVE);
        }
        edge
    }
}

/// Positive values in bins that are narrower than 1 %: the number of values and their mean, ascending.
fn bins(values: &[f32]) -> Vec<[f64; 2]> {
    let mut bins = vec![[0.0; 2]; (f32::INFINITY.to_bits() >> BIN_BITS) as usize + 1];
    for value in values.iter().filter(|value| **value > 0.0) {
        let bin = &mut bins[(value.to_bits() >> BIN_BITS) as usize];
        *bin = [bin[0] + 1.0, bin[1] + f64::from(*value)];
    }
    bins.into_iter().filter(|bin| bin[0] > 0.0).map(|[n, sum]| [n, sum / n]).collect()
}
