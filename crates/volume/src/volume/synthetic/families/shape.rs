//! Implicit shapes of bodies: signed distances in their own coordinates. Nothing here knows where a body is, or what it
//! is made of.

use super::draw::Draw;
use super::motion::{Pose, scaled, sum, turned};
use crate::volume::synthetic::field::{P3, dot, smooth_max};
use crate::volume::synthetic::strand::StrandPoint;

/// A shape around the origin, with lengths of the box.
#[derive(Clone)]
pub(super) enum Shape {
    /// An ellipsoid with these semi-axes.
    Ball(P3),
    /// A curved tube.
    Tube(Tube),
    /// A curved sheet with a front and a back.
    Sheet(Sheet),
}

/// A wave that travels along a tube: it displaces the centre line by `by sin(number u + phase + rate t)`.
#[derive(Clone)]
pub(super) struct Wave {
    /// Greatest displacement.
    pub by: P3,
    /// Radians per unit of `u`, which goes from -1 to 1.
    pub number: f64,
    /// Radians.
    pub phase: f64,
    /// Radians over the series.
    pub rate: f64,
}

/// A tube around a line along z, bent by waves.
#[derive(Clone)]
pub(super) struct Tube {
    /// Half the length of the unbent line.
    pub half: f64,
    /// What bends it.
    pub waves: Vec<Wave>,
    /// Radius in the middle.
    pub radius: f64,
    /// How much thicker the upper end is, as a fraction of the radius.
    pub taper: f64,
}

/// Number of pieces of a tube.
const PIECES: usize = 48;

impl Tube {
    /// Points of the centre line in the box, with radii, from the lower end up.
    pub fn beads(&self, pose: &Pose, t: f64) -> Vec<StrandPoint> {
        let bead = |i: usize| {
            let u = 2.0 * i as f64 / PIECES as f64 - 1.0;
            let start = [0.0, 0.0, self.half * u];
            let bend = |p, wave: &Wave| sum(p, scaled(wave.by, (wave.number * u + wave.phase + wave.rate * t).sin()));
            let local = self.waves.iter().fold(start, bend);
            let radius = self.radius * (1.0 + self.taper * u) * (1.0 - 0.25 * u.powi(6));
            (sum(pose.centre, turned(&pose.turn, scaled(local, pose.size))), radius * pose.size)
        };
        (0..=PIECES).map(bead).collect()
    }
}

/// A ripple of a sheet: it lifts the sheet by `height sin(numbers . (x, y) + phase + rate t)`.
#[derive(Clone)]
pub(super) struct Ripple {
    /// Greatest lift.
    pub height: f64,
    /// Radians per length along x and y.
    pub numbers: [f64; 2],
    /// Radians.
    pub phase: f64,
    /// Radians over the series.
    pub rate: f64,
}

/// A sheet with rounded corners over the x-y plane, lifted by ripples.
#[derive(Clone)]
pub(super) struct Sheet {
    /// Half its extents along x and y.
    pub half: [f64; 2],
    /// From front to back.
    pub thickness: f64,
    /// What lifts it.
    pub ripples: Vec<Ripple>,
}

impl Sheet {
    /// Approximate signed distance, negative inside.
    pub fn outside(&self, q: P3, t: f64) -> f64 {
        let (mut lift, mut slopes) = (0.0, [0.0; 2]);
        for ripple in &self.ripples {
            let [kx, ky] = ripple.numbers;
            let (sin, cos) = (kx * q[0] + ky * q[1] + ripple.phase + ripple.rate * t).sin_cos();
            lift += ripple.height * sin;
            slopes[0] += ripple.height * kx * cos;
            slopes[1] += ripple.height * ky * cos;
        }
        let steep = (1.0 + slopes[0] * slopes[0] + slopes[1] * slopes[1]).sqrt();
        let [a, b] = self.half;
        let rim = (((q[0] / a).powi(4) + (q[1] / b).powi(4)).sqrt().sqrt() - 1.0) * a.min(b);
        smooth_max((q[2] - lift).abs() / steep - 0.5 * self.thickness, rim, 0.5 * self.thickness)
    }

    /// The farthest that any point is from the origin, at most.
    pub fn reach(&self) -> f64 {
        let lift: f64 = self.ripples.iter().map(|r| r.height).sum();
        let [a, b] = self.half;
        // the corners lie within the rectangle
        (a * a + b * b + lift * lift).sqrt() + self.thickness
    }
}

/// A smooth, moving noise in [-1, 1].
#[derive(Clone)]
pub(super) struct Noise {
    waves: [(P3, f64, f64); 6],
}

impl Noise {
    /// Of this many radians per length, changing at up to this many radians over the series.
    pub fn new(draw: &mut Draw, fineness: f64, rate: f64) -> Self {
        let mut octave = 0.8;
        let waves = [0; 6].map(|_| {
            octave *= 1.22;
            (scaled(draw.direction(), fineness * octave), draw.angle(), draw.signed(0.3 * rate, rate))
        });
        Self { waves }
    }

    /// The value at the point `q` and the time `t`.
    pub fn at(&self, q: P3, t: f64) -> f64 {
        let (mut total, mut last) = (0.0, 0.0);
        for (k, (number, phase, rate)) in self.waves.iter().enumerate() {
            // each wave bends the next one
            last = (dot(*number, q) + phase + rate * t + 1.4 * last).sin();
            total += if k < 3 { last } else { 0.6 * last };
        }
        total / 4.8
    }
}
