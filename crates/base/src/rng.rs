//! Counter-based random numbers (Philox4x32-10): a draw depends only on its key, never on the thread count, on the
//! order of calls elsewhere, or on whether a run was resumed.

mod permutation;

pub use permutation::Permutation;
use std::f64::consts::TAU;

/// A stream of random numbers keyed by `(seed, step, purpose)`.
///
/// The 64-bit Philox key mixes `seed` and `purpose`; the 128-bit counter holds the block number and `step`. Two
/// streams that differ in any of the three are independent for every practical use. Each use has a [`Purpose`] (one for
/// view order, one for background colours, ...); `step` is the iteration or element index.
#[derive(Debug, Clone)]
pub struct Rng {
    key: [u32; 2],
    step: u64,
    block: u64,
    words: [u32; 4],
    used: usize,
    spare: Option<f32>,
}

impl Rng {
    /// Starts the stream of `(seed, step, purpose)` at its beginning.
    pub fn new(seed: u64, step: u64, purpose: Purpose) -> Self {
        // two rounds, asymmetric in the arguments, so that (a, b) and (b, a) get different keys
        let mixed = mix(mix(seed).wrapping_add(purpose.number()).wrapping_add(0x9E37_79B9_7F4A_7C15));
        Self { key: [low(mixed), high(mixed)], step, block: 0, words: [0; 4], used: 4, spare: None }
    }

    /// The next 32 uniform bits.
    pub fn next_u32(&mut self) -> u32 {
        if self.used == 4 {
            let counter = [low(self.block), high(self.block), low(self.step), high(self.step)];
            self.words = philox(counter, self.key);
            self.block = self.block.wrapping_add(1);
            self.used = 0;
        }
        self.used += 1;
        self.words[self.used - 1]
    }

    /// The next 64 uniform bits.
    pub fn next_u64(&mut self) -> u64 {
        let bits = u64::from(self.next_u32());
        (u64::from(self.next_u32()) << 32) | bits
    }

    /// Uniform in `[0, 1)`, a multiple of 2^-24 (every value exact in `f32`).
    pub fn uniform(&mut self) -> f32 {
        (self.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0)
    }

    /// Standard normal (mean 0, variance 1), by Box-Muller; always finite.
    pub fn normal(&mut self) -> f32 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        // (0, 1], so that the logarithm is finite
        let radius = (-2.0 * ((f64::from(self.next_u32()) + 1.0) / 4_294_967_296.0).ln()).sqrt();
        let angle = TAU * f64::from(self.next_u32()) / 4_294_967_296.0;
        self.spare = Some((radius * angle.sin()) as f32);
        (radius * angle.cos()) as f32
    }

    /// Uniform integer in `0..n`, without modulo bias; 0 when `n` is 0.
    pub fn below(&mut self, n: usize) -> usize {
        let n = n as u64;
        if n == 0 {
            return 0;
        }
        let threshold = n.wrapping_neg() % n;
        loop {
            let wide = u128::from(self.next_u64()) * u128::from(n);
            if wide as u64 >= threshold {
                return (wide >> 64) as usize;
            }
        }
    }

    /// Shuffles in place (Fisher-Yates); every order is equally likely.
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for i in (1..items.len()).rev() {
            let j = self.below(i + 1);
            items.swap(i, j);
        }
    }
}

fn low(x: u64) -> u32 {
    x as u32
}

fn high(x: u64) -> u32 {
    (x >> 32) as u32
}

/// The splitmix64 finaliser.
fn mix(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9E37_79B9_7F4A_7C15);
    x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^ (x >> 31)
}

/// Philox4x32-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011).
fn philox(mut c: [u32; 4], mut k: [u32; 2]) -> [u32; 4] {
    for _ in 0..10 {
        let a = u64::from(c[0]) * 0xD251_1F53;
        let b = u64::from(c[2]) * 0xCD9E_8D57;
        c = [high(b) ^ c[1] ^ k[0], low(b), high(a) ^ c[3] ^ k[1], low(a)];
        k = [k[0].wrapping_add(0x9E37_79B9), k[1].wrapping_add(0xBB67_AE85)];
    }
    c
}

/// The use of a stream of random numbers; streams of different purposes never overlap.
///
/// Its number is part of the key, so changing a number changes every run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Initial planes, lines and weights of encoders.
    EncoderInit,
    /// Initial weights of the decoder.
    DecoderInit,
    /// Positions of the initial Gaussians.
    Points,
    /// The order of training views.
    Views,
    /// Random backgrounds.
    Background,
    /// Positions of split Gaussians.
    Split,
    /// Which Gaussians relocation copies.
    Relocation,
    /// Initial cluster centres.
    Clusters,
    /// Initial weights of the affinity field.
    AffinityInit,
    /// The pixels of each view on which the affinity field is trained.
    AffinityPixels,
    /// Points of random sweeps.
    Sweep,
    /// Features, views, scales and pixels of the per-Gaussian features (SAGA).
    GaussianFeatures,
    /// The pixels by which the selection of a click is evaluated.
    PromptPixels,
    /// Views, scales and pixels of each step of the affinity field's training.
    AffinitySteps,
    /// Points inside the visual hull.
    HullPoints,
    /// The assignment of training views to times.
    ViewTimes,
    /// The subset of training views used in an evaluation.
    MeasuredViews,
    /// Initial normals of shaded Gaussians.
    Normals,
    /// Noise on the time of a step.
    TimeNoise,
    /// Initial weights and grids of the other methods.
    MethodInit,
    /// The pixels of the training views that a step of these methods uses.
    MethodPixels,
    /// The offsets of samples along rays in such a step.
    MethodJitter,
    /// Peak times of the initial 4D Gaussians.
    PeakTimes,
    /// The order of views in refitting.
    Refit,
    /// What the scenes of a family differ in.
    Scenes,
    /// For tests and custom programs. The number is used unchanged: one of those above gives the same stream.
    Custom(u64),
}

impl Purpose {
    fn number(self) -> u64 {
        match self {
            Self::EncoderInit => 1,
            Self::DecoderInit => 2,
            Self::Points => 3,
            Self::Views => 4,
            Self::Background => 5,
            Self::Split => 6,
            Self::Relocation => 0x7265_6c6f,
            Self::Clusters => 7,
            Self::AffinityInit => 8,
            Self::AffinityPixels => 9,
            Self::Sweep => 10,
            Self::GaussianFeatures => 40,
            Self::PromptPixels => 1007,
            Self::AffinitySteps => 1009,
            Self::HullPoints => 0x6875_6c6c,
            Self::ViewTimes => 0x6465_616c,
            Self::MeasuredViews => 0x6d65_6173,
            Self::Normals => 0x6e6f_726d,
            Self::TimeNoise => 0x7469_6d65,
            Self::MethodInit => 0x6d69_6e69,
            Self::MethodPixels => 0x6d70_6978,
            Self::MethodJitter => 0x6d6a_6974,
            Self::PeakTimes => 0x7065_616b,
            Self::Refit => 0x7265_6669,
            Self::Scenes => 0x7363_656e,
            Self::Custom(number) => number,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn philox_known_answers() {
        let known = [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8];
        assert_eq!(philox([0; 4], [0; 2]), known);
        let known = [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd];
        assert_eq!(philox([u32::MAX; 4], [u32::MAX; 2]), known);
        let counter = [0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344];
        let known = [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1];
        assert_eq!(philox(counter, [0xa409_3822, 0x299f_31d0]), known);
    }

    #[test]
    fn every_part_of_the_key_matters() {
        let first = |seed, step, purpose| Rng::new(seed, step, Purpose::Custom(purpose)).next_u64();
        let base = first(1, 2, 3);
        assert_eq!(base, first(1, 2, 3));
        for other in [first(2, 2, 3), first(1, 3, 3), first(1, 2, 4), first(3, 2, 1)] {
            assert_ne!(base, other);
        }
    }

    #[test]
    fn purpose_numbers_are_unique_and_fixed() {
        let all = [
            (Purpose::EncoderInit, 1),
            (Purpose::DecoderInit, 2),
            (Purpose::Points, 3),
            (Purpose::Views, 4),
            (Purpose::Background, 5),
            (Purpose::Split, 6),
            (Purpose::Clusters, 7),
            (Purpose::AffinityInit, 8),
            (Purpose::AffinityPixels, 9),
            (Purpose::Sweep, 10),
            (Purpose::GaussianFeatures, 40),
            (Purpose::PromptPixels, 1007),
            (Purpose::AffinitySteps, 1009),
            (Purpose::HullPoints, u32::from_be_bytes(*b"hull").into()),
            (Purpose::ViewTimes, u32::from_be_bytes(*b"deal").into()),
            (Purpose::MeasuredViews, u32::from_be_bytes(*b"meas").into()),
            (Purpose::Normals, u32::from_be_bytes(*b"norm").into()),
            (Purpose::TimeNoise, u32::from_be_bytes(*b"time").into()),
            (Purpose::MethodInit, u32::from_be_bytes(*b"mini").into()),
            (Purpose::MethodPixels, u32::from_be_bytes(*b"mpix").into()),
            (Purpose::MethodJitter, u32::from_be_bytes(*b"mjit").into()),
            (Purpose::PeakTimes, u32::from_be_bytes(*b"peak").into()),
            (Purpose::Scenes, u32::from_be_bytes(*b"scen").into()),
        ];
        for (i, (purpose, number)) in all.into_iter().enumerate() {
            assert_eq!(Rng::new(1, 2, purpose).next_u64(), Rng::new(1, 2, Purpose::Custom(number)).next_u64());
            assert!(all[..i].iter().all(|(_, other)| *other != number), "{number}");
        }
    }

    #[test]
    fn uniform_and_normal_have_the_right_moments() {
        let mut rng = Rng::new(7, 0, Purpose::Custom(0));
        let n = 100_000;
        let (mut mean, mut square) = (0.0, 0.0);
        for _ in 0..n {
            let u = rng.uniform();
            assert!((0.0..1.0).contains(&u));
            mean += f64::from(u) / f64::from(n);
        }
        assert!((mean - 0.5).abs() < 0.005, "{mean}");
        mean = 0.0;
        for _ in 0..n {
            let z = f64::from(rng.normal());
            mean += z / f64::from(n);
            square += z * z / f64::from(n);
        }
        assert!(mean.abs() < 0.02 && (square - 1.0).abs() < 0.02, "{mean} {square}");
    }

    #[test]
    fn below_is_in_range_and_uniform() {
        let mut rng = Rng::new(1, 1, Purpose::Custom(1));
        let mut counts = [0; 5];
        for _ in 0..50_000 {
            counts[rng.below(5)] += 1;
        }
        assert!(counts.iter().all(|c| (9_500..10_500).contains(c)), "{counts:?}");
        assert_eq!((rng.below(0), rng.below(1)), (0, 0));
        assert!(rng.below(usize::MAX) < usize::MAX);
    }

    #[test]
    fn shuffle_is_a_permutation() {
        let mut items: Vec<usize> = (0..100).collect();
        Rng::new(1, 2, Purpose::Custom(3)).shuffle(&mut items);
        assert!(items.iter().enumerate().any(|(i, x)| i != *x));
        items.sort_unstable();
        assert!(items.iter().enumerate().all(|(i, x)| i == *x));
        Rng::new(1, 2, Purpose::Custom(3)).shuffle::<u8>(&mut []);
    }
}
