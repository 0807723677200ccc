//! Random choices of a scene: a stream of numbers by family and seed, the same on every machine.

use crate::rng::{Purpose, Rng};
use crate::volume::synthetic::field::P3;
use std::f64::consts::TAU;

/// The choices of one scene, in the order in which they are asked for.
pub(super) struct Draw(Rng);

impl Draw {
    /// The stream of the scene `seed` of the family with this number.
    pub fn new(family: u64, seed: u64) -> Self {
        Self(Rng::new(seed, family, Purpose::Scenes))
    }

    /// Uniform in `[low, high)`.
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * f64::from(self.0.uniform())
    }

    /// A whole number from `low` to `high`, both included.
    pub fn whole(&mut self, low: usize, high: usize) -> usize {
        low + self.0.below(high + 1 - low)
    }

    /// True with this probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.range(0.0, 1.0) < probability
    }

    /// Uniform in `[low, high)`, of either sign.
    pub fn signed(&mut self, low: f64, high: f64) -> f64 {
        let size = self.range(low, high);
        if self.chance(0.5) { -size } else { size }
    }

    /// An angle, radians.
    pub fn angle(&mut self) -> f64 {
        self.range(0.0, TAU)
    }

    /// A unit vector, uniform over the sphere.
    pub fn direction(&mut self) -> P3 {
        let (z, angle) = (self.range(-1.0, 1.0), self.angle());
        let across = (1.0 - z * z).sqrt();
        [across * angle.cos(), across * angle.sin(), z]
    }

    /// A point of the cube `[-side, side]^3`.
    pub fn point(&mut self, side: f64) -> P3 {
        [0; 3].map(|_| self.range(-side, side))
    }
}
