//! How fast each Gaussian moves, as the trained deformation says. Edits are not known here, nor colours (see
//! `segment::paint`).

/// Half the time between the two positions that a velocity is taken from.
pub const STEP: f32 = 0.01;

/// Gaussians less opaque than this do not set the scale, as hardly anyone sees them.
const MIN_OPACITY: f32 = 0.05;

/// A number made of a velocity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Component {
    /// Along x.
    X,
    /// Along y.
    Y,
    /// Along z.
    Z,
    /// Its length.
    Speed,
}

impl Component {
    /// The component of each row of `velocities` `[N, 3]`, in their unit.
    #[must_use]
    pub fn of(self, velocities: &[f32]) -> Vec<f32> {
        let one = |v: &[f32]| match self {
            Self::X => v[0],
            Self::Y => v[1],
            Self::Z => v[2],
            Self::Speed => v[0].hypot(v[1]).hypot(v[2]),
        };
        velocities.chunks_exact(3).map(one).collect()
    }
}

/// Velocities at `time` in [0, 1], `[N, 3]`, in world units per unit of time (the whole series lasts 1).
///
/// `means` gives the positions `[N, 3]` at a time. They are asked for [`STEP`] before and after; where that leaves
/// [0, 1], at the end itself, so that differences at the ends are one-sided.
pub fn velocities(mut means: impl FnMut(f32) -> Vec<f32>, time: f32) -> Vec<f32> {
    let (before, after) = ((time - STEP).max(0.0), (time + STEP).min(1.0));
    let (from, to) = (means(before), means(after));
    let between = f64::from(after) - f64::from(before);
    from.iter().zip(&to).map(|(a, b)| ((f64::from(*b) - f64::from(*a)) / between) as f32).collect()
}

/// The size that is exceeded by 1 % of `values` `[N]` alone, of Gaussians of the given linear `opacity` `[N]` that
/// can be seen. A few that fly off do not set it. `None` if nothing differs from 0.
#[must_use]
pub fn robust_size(values: &[f32], opacity: &[f32]) -> Option<f32> {
    let seen = values.iter().zip(opacity).filter(|(v, o)| v.is_finite() && **o >= MIN_OPACITY);
    let mut sizes: Vec<f32> = seen.map(|(v, _)| v.abs()).collect();
    sizes.sort_by(f32::total_cmp);
    let last = sizes.len().checked_sub(1)?;
    // where fewer move than that, the largest
    [sizes[last * 99 / 100], sizes[last]].into_iter().find(|v| *v > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motion_of_second_degree_is_exact_but_at_the_ends() {
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
    fn only_times_of_the_series_are_asked_for() {
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
        assert_eq!(Component::X.of(&v), [3.0, 0.0]);
        assert_eq!(Component::Y.of(&v), [-4.0, 0.0]);
        assert_eq!(Component::Z.of(&v), [12.0, 0.0]);
        assert_eq!(Component::Speed.of(&v), [13.0, 0.0]);
    }

    #[test]
    fn the_scale_is_that_of_most_and_of_those_seen() {
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
        // few that move
        let mut still = vec![0.0; 1000];
        still[3] = -2.0;
        assert_eq!(robust_size(&still, &opacity), Some(2.0));
        still[3] = 0.0;
        assert_eq!(robust_size(&still, &opacity), None);
        assert_eq!(robust_size(&[], &[]), None);
    }
}
