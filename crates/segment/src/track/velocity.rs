//! Velocity of each Gaussian under the trained deformation. Edits are not considered here, and neither are colours (see
//! `segment::paint`).

/// Half the time between the two positions that a velocity is computed from.
pub const STEP: f32 = 0.01;

/// Gaussians less opaque than this do not set the scale, as they are hardly visible.
const MIN_OPACITY: f32 = 0.05;

/// A scalar computed from a velocity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Component {
    /// Along x.
    X,
    /// Along y.
    Y,
    /// Along z.
    Z,
    /// Its magnitude.
    Speed,
}

impl Component {
    /// Returns the component of each row of `velocities` `[N, 3]`, in their unit.
    pub fn values(self, velocities: &[f32]) -> Vec<f32> {
        let one = |v: &[f32]| match self {
            Self::X => v[0],
            Self::Y => v[1],
            Self::Z => v[2],
            Self::Speed => v[0].hypot(v[1]).hypot(v[2]),
        };
        velocities.chunks_exact(3).map(one).collect()
    }
}

/// Returns the velocities at `time` in [0, 1], `[N, 3]`, in scene units per unit of time (the whole series lasts 1).
///
/// `means` returns the positions `[N, 3]` at a time. It is called for the times [`STEP`] before and after, clamped to
/// [0, 1], so that differences at the ends are one-sided.
pub fn velocities(mut means: impl FnMut(f32) -> Vec<f32>, time: f32) -> Vec<f32> {
    let (before, after) = ((time - STEP).max(0.0), (time + STEP).min(1.0));
    let (from, to) = (means(before), means(after));
    let between = f64::from(after) - f64::from(before);
    from.iter().zip(&to).map(|(a, b)| ((f64::from(*b) - f64::from(*a)) / between) as f32).collect()
}

/// Returns the magnitude that only 1 % of `values` `[N]` exceed, among visible Gaussians, given the linear `opacity`
/// `[N]`. A few that fly off do not affect it. `None` if nothing differs from 0.
pub fn robust_size(values: &[f32], opacity: &[f32]) -> Option<f32> {
    let seen = values.iter().zip(opacity).filter(|(v, o)| v.is_finite() && **o >= MIN_OPACITY);
    let mut sizes: Vec<f32> = seen.map(|(v, _)| v.abs()).collect();
    sizes.sort_by(f32::total_cmp);
    let last = sizes.len().checked_sub(1)?;
    // if fewer move than that, the largest
    [sizes[last * 99 / 100], sizes[last]].into_iter().find(|v| *v > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quadratic_motion_is_exact_except_at_the_ends() {
        let means = |t: f32| vec![2.0 * t, t * t, -0.5];
        for t in [0.01, 0.3, 0.5, 0.99] {
            let v = velocities(means, t);
            for (got, want) in v.iter().zip([2.0, 2.0 * t, 0.0]) {
                assert!((got - want).abs() < 1e-4, "{t}: {v:?}");
            }
        }
        // one-sided: half a step from the end
        assert!((velocities(means, 0.0)[1] - 0.01).abs() < 1e-4);
        assert!((velocities(means, 1.0)[1] - 1.99).abs() < 1e-4);
        assert!((velocities(means, 0.005)[1] - 0.015).abs() < 1e-4);
    }

    #[test]
    fn only_times_within_the_series_are_requested() {
        for t in [0.0, 0.004, 0.5, 1.0] {
            velocities(
                |at| {
                    assert!((0.0..=1.0).contains(&at));
                    vec![0.0; 3]
                },
                t,
            );
        }
    }

    #[test]
    fn components() {
        let v = [3.0, -4.0, 12.0, 0.0, 0.0, 0.0];
        assert_eq!(Component::X.values(&v), [3.0, 0.0]);
        assert_eq!(Component::Y.values(&v), [-4.0, 0.0]);
        assert_eq!(Component::Z.values(&v), [12.0, 0.0]);
        assert_eq!(Component::Speed.values(&v), [13.0, 0.0]);
    }

    #[test]
    fn the_scale_ignores_outliers_and_invisible_gaussians() {
        let mut values: Vec<f32> = (0..1000).map(|i| if i % 2 == 0 { -1.0 } else { 0.5 }).collect();
        let opacity = vec![0.5; 1000];
        assert_eq!(robust_size(&values, &opacity), Some(1.0));
        values[7] = 1e6;
        values[8] = f32::NAN;
        values[9] = f32::NEG_INFINITY;
        assert_eq!(robust_size(&values, &opacity), Some(1.0));
        let mut unseen = opacity.clone();
        unseen.iter_mut().step_by(2).for_each(|o| *o = 0.01);
        assert_eq!(robust_size(&values, &unseen), Some(0.5));
        // only a few move
        let mut still = vec![0.0; 1000];
        still[3] = -2.0;
        assert_eq!(robust_size(&still, &opacity), Some(2.0));
        still[3] = 0.0;
        assert_eq!(robust_size(&still, &opacity), None);
        assert_eq!(robust_size(&[], &[]), None);
    }
}
