//! A union-find that several threads may use at once. The resulting sets depend on the unions alone, never on their
//! order, so a parallel caller stays deterministic.

use std::sync::atomic::{AtomicU32, Ordering};

/// Disjoint sets over `0..len`; every set's root is its smallest member.
pub struct UnionFind {
    parents: Vec<AtomicU32>,
}

impl UnionFind {
    /// Each item of `0..len` in a set of its own.
    pub fn new(len: usize) -> Self {
        Self { parents: (0..len as u32).map(AtomicU32::new).collect() }
    }

    /// The smallest member known so far of the set of `item`.
    pub fn find(&self, item: u32) -> u32 {
        let mut at = item;
        loop {
            let parent = self.parents[at as usize].load(Ordering::Relaxed);
            if parent == at {
                return at;
            }
            let above = self.parents[parent as usize].load(Ordering::Relaxed);
            if above != parent {
                // Path halving; a lost race only leaves the path a little longer.
                let _ = self.parents[at as usize].compare_exchange_weak(
                    parent,
                    above,
                    Ordering::Relaxed,
                    Ordering::Relaxed,
                );
            }
            at = above;
        }
    }

    /// Joins the sets of `a` and `b`.
    pub fn union(&self, a: u32, b: u32) {
        let (mut a, mut b) = (self.find(a), self.find(b));
        while a != b {
            if a > b {
                std::mem::swap(&mut a, &mut b);
            }
            // Parents always point to smaller numbers, so no cycle can arise whatever the interleaving.
            match self.parents[b as usize].compare_exchange(b, a, Ordering::Relaxed, Ordering::Relaxed) {
                Ok(_) => return,
                Err(_) => (a, b) = (self.find(a), self.find(b)),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;

    #[test]
    fn parallel_unions_give_the_smallest_member_as_root() {
        let sets = UnionFind::new(10_000);
        (0..9_990u32).into_par_iter().for_each(|i| sets.union(i, i + 10));
        assert!((0..10_000).all(|i| sets.find(i) == i % 10));
    }
}
