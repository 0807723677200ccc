//! Joins regions of a weighted graph until the borders between them are narrow: the pair with the largest normalised
//! cut first.
//!
//! The normalised cut of two regions is the weight of the edges between them, divided by the smaller of the two volumes
//! (the total weight of the edges at a region).

use std::collections::BTreeMap;

/// Two nodes and the weight of the edge between them, at least 0.
pub type WeightedEdge = (u32, u32, f64);

/// Joins regions of nodes, given as `of` `[N]` (any numbers): first each region of fewer than `tiny` nodes with the
/// neighbour to which it has the most edge weight, then repeatedly the pair with the largest normalised cut as long as
/// that is at least `cut`. Returns a label for each node `[N]` from 1, the largest region first.
///
/// # Panics
/// If an edge names a node that is not below N.
pub fn join(of: &[u32], edges: &[WeightedEdge], tiny: usize, cut: f64) -> Vec<u32> {
    let mut regions = RegionGraph::new(of, edges);
    regions.join_tiny(tiny);
    while let Some((a, b)) = regions.widest(cut) {
        regions.merge(a, b);
    }
    regions.labels()
}

struct RegionGraph {
    /// Region of each node.
    of: Vec<usize>,
    /// The region each was merged into; itself if it was not.
    into: Vec<usize>,
    sizes: Vec<usize>,
    /// Weight of the edges to each neighbour, in both directions; to itself, twice the weight of the edges within.
    near: Vec<BTreeMap<usize, f64>>,
    /// Total weight of the edges at each region, edges within counted twice.
    volumes: Vec<f64>,
}

impl RegionGraph {
    fn new(of: &[u32], edges: &[WeightedEdge]) -> Self {
        let mut numbers: BTreeMap<u32, usize> = BTreeMap::new();
        let of: Vec<usize> = of
            .iter()
            .map(|region| {
                let next = numbers.len();
                *numbers.entry(*region).or_insert(next)
            })
            .collect();
        let count = numbers.len();
        let (mut sizes, mut near) = (vec![0; count], vec![BTreeMap::new(); count]);
        of.iter().for_each(|&region| sizes[region] += 1);
        for &(a, b, weight) in edges {
            let (a, b) = (of[a as usize], of[b as usize]);
            *near[a].entry(b).or_default() += weight;
            *near[b].entry(a).or_default() += weight;
        }
        let volumes = near.iter().map(|near| near.values().sum()).collect();
        Self { of, into: (0..count).collect(), sizes, near, volumes }
    }

    fn is_root(&self, region: usize) -> bool {
        self.into[region] == region
    }

    /// Merges `b` into `a`.
    fn merge(&mut self, a: usize, b: usize) {
        let of_b = std::mem::take(&mut self.near[b]);
        let between = self.near[a].remove(&b).unwrap_or(0.0);
        *self.near[a].entry(a).or_default() += 2.0 * between + of_b.get(&b).copied().unwrap_or(0.0);
        for (&other, &weight) in of_b.iter().filter(|(other, _)| **other != a && **other != b) {
            self.near[other].remove(&b);
            *self.near[other].entry(a).or_default() += weight;
            *self.near[a].entry(other).or_default() += weight;
        }
        self.volumes[a] += std::mem::take(&mut self.volumes[b]);
        self.sizes[a] += std::mem::take(&mut self.sizes[b]);
        self.into[b] = a;
    }

    /// Joins the regions below `tiny`, smallest first; a region without neighbours stays.
    fn join_tiny(&mut self, tiny: usize) {
        let mut order: Vec<usize> = (0..self.sizes.len()).collect();
        order.sort_by_key(|&region| self.sizes[region]);
        for region in order {
            if !self.is_root(region) || self.sizes[region] >= tiny {
                continue;
            }
            let others = self.near[region].iter().filter(|(other, _)| **other != region);
            let strongest =
                others.map(|(other, weight)| (*other, *weight)).reduce(|a, b| if b.1 > a.1 { b } else { a });
            if let Some((other, _)) = strongest {
                self.merge(other, region);
            }
        }
    }

    /// Returns the pair with the largest normalised cut, if that is at least `cut`; the first among equals.
    fn widest(&self, cut: f64) -> Option<(usize, usize)> {
        let mut best: Option<(f64, (usize, usize))> = None;
        for (a, near) in self.near.iter().enumerate() {
            for (&b, weight) in near.range(a + 1..) {
                let share = weight / self.volumes[a].min(self.volumes[b]).max(f64::MIN_POSITIVE);
                if share >= cut && best.is_none_or(|(most, _)| share > most) {
                    best = Some((share, (a, b)));
                }
            }
        }
        best.map(|(_, pair)| pair)
    }

    fn labels(&self) -> Vec<u32> {
        let root = |mut region: usize| {
            while !self.is_root(region) {
                region = self.into[region];
            }
            region
        };
        let roots: Vec<usize> = self.of.iter().map(|&region| root(region)).collect();
        let mut order: Vec<usize> = (0..self.sizes.len()).filter(|&region| self.is_root(region)).collect();
        order.sort_by_key(|&region| std::cmp::Reverse(self.sizes[region]));
        let mut label = vec![0; self.sizes.len()];
        order.iter().zip(1..).for_each(|(&region, n)| label[region] = n);
        roots.into_iter().map(|region| label[region]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of `length` columns of four nodes, with edges to the right and down of weight 1. Between the columns
    /// `at` and `at + 1` only the first `wide` rows have an edge, of weight `weak`.
    fn strip(length: u32, at: u32, wide: u32, weak: f64) -> Vec<WeightedEdge> {
        let mut edges = Vec::new();
        for (x, y) in (0..length).flat_map(|x| (0..4).map(move |y| (x, y))) {
            if y < 3 {
                edges.push((4 * x + y, 4 * x + y + 1, 1.0));
            }
            if x + 1 < length && (x != at || y < wide) {
                edges.push((4 * x + y, 4 * x + y + 4, if x == at { weak } else { 1.0 }));
            }
        }
        edges
    }

    fn pieces(labels: &[u32]) -> Vec<usize> {
        let most = labels.iter().max().copied().unwrap_or(0);
        (1..=most).map(|label| labels.iter().filter(|l| **l == label).count()).collect()
    }

    #[test]
    fn regions_joined_by_a_narrow_border_stay_apart_and_others_merge() {
        // patches of five columns; the narrow place lies between two of them
        let of: Vec<u32> = (0..160).map(|node| 7 + node / 20).collect();
        let parted = join(&of, &strip(40, 19, 1, 0.5), 0, 0.01);
        assert_eq!(pieces(&parted), [80, 80]);
        assert!(parted[..80].iter().all(|l| *l == parted[0]));
        let whole = join(&of, &strip(40, 19, 4, 1.0), 0, 0.01);
        assert_eq!(pieces(&whole), [160]);
    }

    #[test]
    fn tiny_regions_join_their_strongest_neighbour_and_isolated_ones_stay() {
        let mut of: Vec<u32> = (0..160).map(|node| node / 80).collect();
        (of[3], of[100]) = (8, 9);
        let mut edges = strip(40, 19, 0, 0.0);
        assert_eq!(pieces(&join(&of, &edges, 5, 2.0)), [80, 80]);
        assert_eq!(pieces(&join(&of, &edges, 0, 2.0)), [79, 79, 1, 1]);
        edges.retain(|(a, b, _)| *a != 3 && *b != 3);
        assert_eq!(pieces(&join(&of, &edges, 5, 2.0)), [80, 79, 1]);
    }

    #[test]
    fn no_nodes_and_no_edges() {
        assert_eq!(join(&[], &[], 3, 0.1), [0u32; 0]);
        assert_eq!(join(&[4, 4, 2], &[], 3, 0.1), [1, 1, 2]);
    }

    #[test]
    fn joining_in_any_order_of_edges_gives_the_same() {
        let of: Vec<u32> = (0..160).map(|node| node / 8).collect();
        let edges = strip(40, 19, 1, 0.25);
        let mut turned = edges.clone();
        turned.reverse();
        turned.iter_mut().for_each(|(a, b, _)| std::mem::swap(a, b));
        // weights are sums of quarters: exact in any order
        assert_eq!(join(&of, &edges, 2, 0.05), join(&of, &turned, 2, 0.05));
    }
}
