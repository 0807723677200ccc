//! A random order of numbers that is never written out: which number stands at a place is computed from the key.

use super::{Purpose, Rng, mix};

/// Rounds of the network; four make it hard to tell from a random order, two more cost little.
const ROUNDS: usize = 6;

/// A random order of `0..n`, the same for the same key: a Feistel network over the smallest power of two that holds `n`,
/// walked on from results beyond `n` (Black and Rogaway, "Ciphers with arbitrary finite domains", CT-RSA 2002).
///
/// An epoch over some 10^8 pixels needs neither their list nor its shuffling, and a step finds its part by its number alone.
#[derive(Clone, Copy, Debug)]
pub struct Permutation {
    len: u64,
    /// Bits of the left and of the right half.
    bits: [u32; 2],
    keys: [u64; ROUNDS],
}

impl Permutation {
    /// The order of `0..len` for that key.
    pub fn new(len: u64, seed: u64, step: u64, purpose: Purpose) -> Self {
        let mut rng = Rng::new(seed, step, purpose);
        let bits = u64::BITS - len.saturating_sub(1).leading_zeros();
        Self { len, bits: [bits / 2, bits - bits / 2], keys: std::array::from_fn(|_| rng.next_u64()) }
    }

    /// The number at place `at`.
    ///
    /// # Panics
    /// If there is no such place.
    pub fn get(&self, at: u64) -> u64 {
        assert!(at < self.len, "place {at} of {}", self.len);
        let mut x = self.shuffled(at);
        // at most every second result is beyond the end, and the walk comes back below it
        while x >= self.len {
            x = self.shuffled(x);
        }
        x
    }

    fn shuffled(&self, x: u64) -> u64 {
        let mask = self.bits.map(|bits| (1u64 << bits) - 1);
        let mut halves = [x >> self.bits[1], x & mask[1]];
        for (round, key) in self.keys.iter().enumerate() {
            let (to, from) = (round % 2, 1 - round % 2);
            halves[to] ^= mix(halves[from].wrapping_add(*key)) & mask[to];
        }
        halves[0] << self.bits[1] | halves[1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_stands_at_one_place() {
        for len in [1u64, 2, 3, 7, 64, 65, 1000, 4097] {
            let order = Permutation::new(len, 3, len, Purpose::Custom(1));
            let mut seen: Vec<u64> = (0..len).map(|at| order.get(at)).collect();
            seen.sort_unstable();
            assert!(seen.into_iter().eq(0..len), "{len}");
        }
    }

    #[test]
    fn places_and_numbers_have_nothing_in_common() {
        let len = 10_000u64;
        let order = Permutation::new(len, 1, 2, Purpose::Custom(3));
        let other = Permutation::new(len, 1, 3, Purpose::Custom(3));
        let centred = |x: u64| x as f64 / (len - 1) as f64 - 0.5;
        let product = |f: &dyn Fn(u64) -> u64, g: &dyn Fn(u64) -> u64| {
            // 1/12 is the variance of uniform numbers
            (0..len).map(|at| centred(f(at)) * centred(g(at))).sum::<f64>() / len as f64 * 12.0
        };
        let correlations = [
            product(&|at| at, &|at| order.get(at)),
            product(&|at| order.get(at), &|at| order.get((at + 1) % len)),
            product(&|at| order.get(at), &|at| other.get(at)),
        ];
        // four standard deviations
        assert!(correlations.iter().all(|c| c.abs() < 0.04), "{correlations:?}");
        let same = (0..len).filter(|at| order.get(*at) == other.get(*at)).count();
        assert!(same < 10, "{same}");
    }
}
