//! How many of one component's Gaussians another component contains at a later time, and the links that this makes.
//! Which links are events is decided in `events`.

use super::event::SegmentAtTime;
use crate::points::chunks::map_chunks;

/// One component at one time that is large enough to matter.
#[derive(Debug, Clone)]
pub(crate) struct OverlapNode {
    pub(crate) time: usize,
    pub(crate) label: u32,
    /// Sum of the opacities of its Gaussians.
    pub(crate) weight: f64,
    /// Lowest index of its Gaussians, which breaks ties.
    pub(crate) first: u32,
}

/// All nodes, ordered by time and label, and which of them are kept.
pub(crate) struct OverlapNodes {
    pub(crate) list: Vec<OverlapNode>,
    pub(crate) kept: Vec<bool>,
    /// Node number + 1 by time and label; 0 for labels that are not a node.
    by_label: Vec<Vec<u32>>,
}

/// Gaussians shared by a node and a later one: their opacity at the earlier and at the later time.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SharedOpacity {
    pub(crate) other: usize,
    pub(crate) before: f64,
    pub(crate) after: f64,
}

/// Accepted links, by node.
pub(crate) struct Graph {
    pub(crate) children: Vec<Vec<SharedOpacity>>,
    pub(crate) parents: Vec<Vec<SharedOpacity>>,
}

/// Opacities are rounded up to multiples of one part in this many. Sums of up to 2^23 opacities are then exact, so they do
/// not depend on their order, and ties are decided alike forward and backward in time.
const STEPS: f64 = (1u64 << 30) as f64;

/// Returns the opacity that counts: 0 for anything not positive and finite.
pub(crate) fn usable(opacity: f32) -> f64 {
    if opacity.is_finite() { (f64::from(opacity.max(0.0)) * STEPS).ceil() / STEPS } else { 0.0 }
}

/// Sums of one label.
#[derive(Clone, Copy)]
pub(crate) struct LabelSum {
    pub(crate) weight: f64,
    pub(crate) first: u32,
}

/// Returns the weight and lowest member of each label of a frame; index 0 stays empty. Labels without visible members
/// weigh 0.
pub(crate) fn label_sums(frame: &SegmentAtTime<'_>) -> Vec<LabelSum> {
    let most = frame.labels.iter().copied().max().unwrap_or(0) as usize;
    let mut sums = vec![LabelSum { weight: 0.0, first: u32::MAX }; most + 1];
    for (i, (&label, &opacity)) in frame.labels.iter().zip(frame.opacity).enumerate() {
        let weight = usable(opacity);
        if label > 0 && weight > 0.0 {
            let sum = &mut sums[label as usize];
            sum.weight += weight;
            sum.first = sum.first.min(i as u32);
        }
    }
    sums
}

impl OverlapNodes {
    /// Creates nodes for the labels that hold at least `min_share` of their time's weight, at the times `present`.
    pub(crate) fn new(sums: &[Vec<LabelSum>], present: &[bool], min_share: f64) -> Self {
        let mut list = Vec::new();
        let mut by_label = Vec::with_capacity(sums.len());
        for (time, labels) in sums.iter().enumerate() {
            let total: f64 = labels.iter().map(|s| s.weight).sum();
            let mut numbers = vec![0u32; labels.len()];
            for (label, sum) in labels.iter().enumerate().filter(|(_, s)| present[time] && s.weight > 0.0) {
                if sum.weight >= min_share * total {
                    list.push(OverlapNode { time, label: label as u32, weight: sum.weight, first: sum.first });
                    numbers[label] = list.len() as u32;
                }
            }
            by_label.push(numbers);
        }
        Self { kept: vec![true; list.len()], list, by_label }
    }

    /// Returns the node that contains a Gaussian with this label and opacity.
    pub(crate) fn at(&self, time: usize, label: u32, opacity: f32) -> Option<usize> {
        let number = self.by_label[time][label as usize];
        (number > 0 && usable(opacity) > 0.0).then(|| number as usize - 1)
    }

    /// Returns the links between kept nodes.
    ///
    /// Each Gaussian connects the kept node it is in to the next kept node it is in, unless it is in no node at all
    /// (absent, or in a component that is too small) for `persistence` times in a row. Being in a node that is not kept
    /// breaks nothing. A pair is linked if its overlap is at least half of all that one side shares with others and at
    /// least `min_share` of all that the other side shares, and at least `min_share` of one side's whole weight. All of
    /// this is the same backward in time.
    pub(crate) fn links(&self, frames: &[SegmentAtTime<'_>], persistence: usize, min_share: f64) -> Graph {
        let shared = self.shared(frames, persistence);
        let out: Vec<f64> = shared.iter().map(|list| list.iter().map(|s| s.before).sum()).collect();
        let mut into = vec![0.0; self.list.len()];
        shared.iter().flatten().for_each(|s| into[s.other] += s.after);
        let mut graph =
            Graph { children: vec![Vec::new(); self.list.len()], parents: vec![Vec::new(); self.list.len()] };
        for (node, list) in shared.iter().enumerate() {
            for s in list {
                let (from, to) = (s.before / out[node], s.after / into[s.other]);
                let mutual = (from >= 0.5 && to >= min_share) || (to >= 0.5 && from >= min_share);
                let whole = (s.before / self.list[node].weight).max(s.after / self.list[s.other].weight);
                if mutual && whole >= min_share {
                    graph.children[node].push(*s);
                    graph.parents[s.other].push(SharedOpacity { other: node, ..*s });
                }
            }
        }
        graph
    }

    fn shared(&self, frames: &[SegmentAtTime<'_>], persistence: usize) -> Vec<Vec<SharedOpacity>> {
        let count = frames.first().map_or(0, |f| f.labels.len());
        let parts = map_chunks(count, |range| {
            let mut shared: Vec<Vec<SharedOpacity>> = vec![Vec::new(); self.list.len()];
            for i in range {
                let (mut last, mut gap) = (None, 0);
                for (time, frame) in frames.iter().enumerate() {
                    let opacity = frame.opacity[i];
                    match self.at(time, frame.labels[i], opacity) {
                        Some(node) if self.kept[node] => {
                            let after = usable(opacity);
                            if let Some((from, before)) = last {
                                add(&mut shared[from], SharedOpacity { other: node, before, after });
                            }
                            (last, gap) = (Some((node, after)), 0);
                        }
                        Some(_) => gap = 0,
                        None => {
                            gap += 1;
                            if gap >= persistence {
                                last = None;
                            }
                        }
                    }
                }
            }
            shared
        });
        let mut total: Vec<Vec<SharedOpacity>> = vec![Vec::new(); self.list.len()];
        for part in parts {
            for (list, more) in total.iter_mut().zip(part) {
                more.into_iter().for_each(|s| add(list, s));
            }
        }
        total.iter_mut().for_each(|list| list.sort_by_key(|s| s.other));
        total
    }

    /// Returns the number of times in the chain of each node, where `next` names a node's successor.
    pub(crate) fn chain_lengths(&self, next: &[Option<usize>]) -> Vec<usize> {
        let chains = self.chains(next);
        let mut lengths = vec![0; self.list.len()];
        chains.iter().for_each(|&head| lengths[head] += 1);
        chains.iter().map(|&head| lengths[head]).collect()
    }

    /// Returns the first node of each node's chain.
    pub(crate) fn chains(&self, next: &[Option<usize>]) -> Vec<usize> {
        let mut heads: Vec<usize> = (0..next.len()).collect();
        // Nodes are ordered by time, so a head is known before it is passed on.
        for node in 0..next.len() {
            if let Some(after) = next[node] {
                heads[after] = heads[node];
            }
        }
        heads
    }

    /// Returns each node's successor along a link that is the strongest of both its ends. Of equally strong links, the one
    /// to the node with the lowest Gaussian counts, then the one to the nearest time.
    pub(crate) fn strongest(&self, graph: &Graph) -> Vec<Option<usize>> {
        let best = |node: usize, list: &[SharedOpacity], size: fn(&SharedOpacity) -> f64| {
            let first = |s: &SharedOpacity| self.list[s.other].first;
            let distance = |s: &SharedOpacity| self.list[s.other].time.abs_diff(self.list[node].time);
            list.iter()
                .max_by(|a, b| {
                    let tie = || (first(b), distance(b)).cmp(&(first(a), distance(a)));
                    size(a).total_cmp(&size(b)).then_with(tie)
                })
                .map(|s| s.other)
        };
        (0..self.list.len())
            .map(|node| {
                let child = best(node, &graph.children[node], |s| s.before)?;
                (best(child, &graph.parents[child], |s| s.after) == Some(node)).then_some(child)
            })
            .collect()
    }

    /// Returns each node's successor if it is the only one and has no other predecessor.
    pub(crate) fn only(&self, graph: &Graph) -> Vec<Option<usize>> {
        (0..self.list.len())
            .map(|node| match graph.children[node].as_slice() {
                [one] if graph.parents[one.other].len() == 1 => Some(one.other),
                _ => None,
            })
            .collect()
    }
}

fn add(list: &mut Vec<SharedOpacity>, more: SharedOpacity) {
    match list.iter_mut().find(|s| s.other == more.other) {
        Some(s) => {
            s.before += more.before;
            s.after += more.after;
        }
        None => list.push(more),
    }
}
