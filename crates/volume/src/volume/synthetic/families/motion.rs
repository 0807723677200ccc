//! Where a body is at a time: paths, turns and growth. Nothing here knows shapes.

use super::draw::Draw;
use crate::volume::synthetic::field::{P3, dot, lerp, norm, step};

/// A rotation, by rows.
pub(super) type M3 = [P3; 3];

/// The rotation by `angle` about the unit vector `axis`.
pub(super) fn rotation(axis: P3, angle: f64) -> M3 {
    let (sin, cos) = angle.sin_cos();
    let [x, y, z] = axis;
    let rest = 1.0 - cos;
    [
        [cos + x * x * rest, x * y * rest - z * sin, x * z * rest + y * sin],
        [y * x * rest + z * sin, cos + y * y * rest, y * z * rest - x * sin],
        [z * x * rest - y * sin, z * y * rest + x * sin, cos + z * z * rest],
    ]
}

/// `m p`.
pub(super) fn turned(m: &M3, p: P3) -> P3 {
    m.map(|row| dot(row, p))
}

/// `m^T p`: the inverse turn.
pub(super) fn turned_back(m: &M3, p: P3) -> P3 {
    std::array::from_fn(|a| m[0][a] * p[0] + m[1][a] * p[1] + m[2][a] * p[2])
}

/// `a b`.
fn product(a: &M3, b: &M3) -> M3 {
    a.map(|row| std::array::from_fn(|c| row[0] * b[0][c] + row[1] * b[1][c] + row[2] * b[2][c]))
}

/// A vector of this length.
pub(super) fn scaled(p: P3, by: f64) -> P3 {
    p.map(|c| c * by)
}

/// The sum of two vectors.
pub(super) fn sum(a: P3, b: P3) -> P3 {
    std::array::from_fn(|i| a[i] + b[i])
}

/// A unit vector at right angles to the unit vector `axis`.
pub(super) fn across(axis: P3) -> P3 {
    let other = if axis[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let along = dot(axis, other);
    let side: P3 = std::array::from_fn(|a| other[a] - along * axis[a]);
    scaled(side, 1.0 / norm(side))
}

/// A smooth rise from 0 to 1 or fall back to 0, or one after the other. Each is the middle of the change and its
/// duration, in [0, 1] of the series.
#[derive(Clone, Copy, Default)]
pub(super) struct Pulse {
    /// When it rises; from the start if `None`.
    pub up: Option<(f64, f64)>,
    /// When it falls; never if `None`.
    pub down: Option<(f64, f64)>,
}

impl Pulse {
    /// The value at `t`: half at the middle of a change.
    pub fn at(self, t: f64) -> f64 {
        let rise = |(middle, duration): (f64, f64)| step((t - middle) / duration + 0.5);
        self.up.map_or(1.0, rise) * (1.0 - self.down.map_or(0.0, rise))
    }
}

/// A factor that changes from `before` to `after` as its pulse rises, and back as it falls.
#[derive(Clone, Copy)]
pub(super) struct Ramp {
    /// The factor while the pulse is 0.
    pub before: f64,
    /// The factor while it is 1.
    pub after: f64,
    /// When it changes.
    pub pulse: Pulse,
}

impl Ramp {
    /// Always 1.
    pub const NONE: Self = Self { before: 1.0, after: 1.0, pulse: Pulse { up: None, down: None } };

    /// A change around the time `at` that lasts `duration`.
    pub fn once(before: f64, after: f64, at: f64, duration: f64) -> Self {
        Self { before, after, pulse: Pulse { up: Some((at, duration)), down: None } }
    }

    /// The factor at `t`.
    pub fn at(self, t: f64) -> f64 {
        lerp(self.before, self.after, self.pulse.at(t))
    }
}

/// A displacement that depends on time.
#[derive(Clone)]
pub(super) enum Motion {
    /// By this vector over the whole series, at constant speed; zero in the middle.
    Drift(P3),
    /// To and fro: `by sin(rate t + phase)`.
    Sway {
        /// Greatest displacement.
        by: P3,
        /// Radians over the series.
        rate: f64,
        /// Radians.
        phase: f64,
    },
    /// By a vector that turns and changes its length.
    Arm {
        /// The vector at `t = 0` for a length factor of 1.
        by: P3,
        /// Unit vector about which it turns.
        axis: P3,
        /// Radians over the series.
        rate: f64,
        /// Factor of its length.
        length: Ramp,
    },
}

impl Motion {
    fn at(&self, t: f64) -> P3 {
        match self {
            Self::Drift(by) => scaled(*by, t - 0.5),
            Self::Sway { by, rate, phase } => scaled(*by, (rate * t + phase).sin()),
            Self::Arm { by, axis, rate, length } => turned(&rotation(*axis, rate * t), scaled(*by, length.at(t))),
        }
    }
}

/// The path of a body.
#[derive(Clone)]
pub(super) struct Path {
    /// Where it would be without motions.
    pub start: P3,
    /// What displaces it, added up.
    pub motions: Vec<Motion>,
    /// Its orientation at `t = 0`.
    pub tilt: M3,
    /// The unit vector about which it turns, and how far over the series, radians.
    pub spin: (P3, f64),
    /// Factor of its size.
    pub size: Ramp,
}

/// A body's place at one time.
pub(super) struct Pose {
    /// The origin of its own coordinates.
    pub centre: P3,
    /// From its own coordinates to those of the box.
    pub turn: M3,
    /// Lengths of the box per length of its own coordinates.
    pub size: f64,
}

impl Path {
    /// At rest, upright.
    pub fn at_rest(start: P3) -> Self {
        let tilt = rotation([0.0, 0.0, 1.0], 0.0);
        Self { start, motions: Vec::new(), tilt, spin: ([0.0, 0.0, 1.0], 0.0), size: Ramp::NONE }
    }

    /// The same with one more motion.
    pub fn with(mut self, motion: Motion) -> Self {
        self.motions.push(motion);
        self
    }

    /// The same in any orientation, turning at up to `rate` radians over the series.
    pub fn tumbling(mut self, draw: &mut Draw, rate: f64) -> Self {
        let axis = draw.direction();
        self.tilt = rotation(axis, draw.angle());
        self.spin = (draw.direction(), draw.signed(0.3 * rate, rate));
        self
    }

    /// The place at `t`.
    pub fn at(&self, t: f64) -> Pose {
        let centre = self.motions.iter().fold(self.start, |p, motion| sum(p, motion.at(t)));
        let turn = product(&rotation(self.spin.0, self.spin.1 * t), &self.tilt);
        Pose { centre, turn, size: self.size.at(t) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_keeps_lengths_and_turns_back() {
        let axis = scaled([1.0, 2.0, -2.0], 1.0 / 3.0);
        let (m, p) = (rotation(axis, 1.1), [0.3, -0.7, 0.2]);
        let q = turned(&m, p);
        assert!((norm(q) - norm(p)).abs() < 1e-12 && (dot(q, axis) - dot(p, axis)).abs() < 1e-12);
        assert!(norm(sum(turned_back(&m, q), scaled(p, -1.0))) < 1e-12);
        assert!(dot(across(axis), axis).abs() < 1e-12);
    }

    #[test]
    fn pulses_are_half_at_their_times() {
        let pulse = Pulse { up: Some((0.3, 0.2)), down: Some((0.7, 0.2)) };
        assert_eq!([0.0, 0.19, 0.3, 0.5, 0.7, 0.81].map(|t| pulse.at(t)), [0.0, 0.0, 0.5, 1.0, 0.5, 0.0]);
        assert_eq!(Pulse::default().at(0.4), 1.0);
        assert_eq!(Ramp::once(2.0, 1.0, 0.5, 0.4).at(0.5), 1.5);
    }
}
