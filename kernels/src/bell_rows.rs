//! Sums of bell curves along rows of voxels: how a Gaussian is added to a density on a grid.

use crate::arch;
use crate::log_exp::{exp, ln};

/// A Gaussian along a row of voxels: its squared distance from the place of voxel `i`, in its standard deviations, is
/// `lowest + curvature (start + i)^2`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BellSection {
    /// The smallest squared distance along the row's line.
    pub lowest: f32,
    /// Growth of the squared distance with the square of the distance along the row, in voxels.
    pub curvature: f32,
    /// The first voxel's place, in voxels from where the distance is smallest.
    pub start: f32,
}

/// Adds `factor e` to each voxel, where `e` is the Gaussian's bell curve there.
pub fn add_bell(row: &mut [f32], section: BellSection, factor: f32) {
    arch().dispatch(|| add(row, section, |e| factor * e));
}

/// Adds `-factor ln(1 - opacity e)` to each voxel, where `e` is the Gaussian's bell curve there: its optical depth for a
/// ray at that distance, times `factor`. The opacity is below 1.
pub fn add_depth(row: &mut [f32], section: BellSection, opacity: f32, factor: f32) {
    arch().dispatch(|| {
        add(row, section, |e| {
            let alpha = opacity * e;
            let rest = 1.0 - alpha;
            // what was lost in rounding the rest counts where alpha is small
            -factor * (ln(rest) + ((1.0 - rest) - alpha) / rest)
        });
    });
}

#[inline(always)]
fn add(row: &mut [f32], BellSection { lowest, curvature, start }: BellSection, value: impl Fn(f32) -> f32) {
    for (i, out) in (0i32..).zip(row) {
        let along = start + i as f32;
        *out += value(exp(-0.5 * (lowest + curvature * along * along)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_those_of_double_precision() {
        for (lowest, curvature, start) in [(0.0f32, 0.3f32, -2.5f32), (4.0, 0.002, -40.0), (8.9, 1.0, -0.1)] {
            let section = BellSection { lowest, curvature, start };
            for opacity in [1.0f32 / 255.0, 0.3, 0.99] {
                let [mut bell, mut depth] = [0; 2].map(|_| vec![1.0f32; 37]);
                add_bell(&mut bell, section, 3.0);
                add_depth(&mut depth, section, opacity, 3.0);
                for i in 0..37 {
                    let along = f64::from(start) + i as f64;
                    let e = (-0.5 * (f64::from(lowest) + f64::from(curvature) * along * along)).exp();
                    assert!((f64::from(bell[i]) - 1.0 - 3.0 * e).abs() < 1e-5 * e + 1e-7, "{section:?} {i}");
                    let exact = -3.0 * (-f64::from(opacity) * e).ln_1p();
                    assert!((f64::from(depth[i]) - 1.0 - exact).abs() < 1e-5 * exact + 1e-7, "{section:?} {i}");
                }
            }
        }
    }

    #[test]
    fn small_opacities_keep_their_precision() {
        let mut row = [0.0f32; 3];
        let section = BellSection { lowest: 9.0, curvature: 0.01, start: 0.0 };
        add_depth(&mut row, section, 0.004, 1.0);
        let exact = -(-0.004 * (-4.5f64).exp()).ln_1p();
        assert!((f64::from(row[0]) / exact - 1.0).abs() < 1e-5, "{} {exact}", row[0]);
    }
}
