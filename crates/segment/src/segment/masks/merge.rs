//! The merge tree of basins: neighbours join over the weakest boundary first, which gives nested regions of all sizes.
//!
//! Works on labels and a relief alone; which of the tree's regions become masks is decided in `regions`.

use std::{cmp::Reverse, collections::BTreeMap, collections::BinaryHeap};

use super::{
    edges::{ForegroundWindow, sides},
    watershed::NONE,
};

/// A region: a basin, or two regions joined.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MergeNode {
    /// Strength of the strongest boundary inside; 0 for a basin.
    pub born: f32,
    /// The region that this one becomes part of, if any; its `born` is the strength of this one's outer boundary.
    pub parent: Option<u32>,
    /// Pixels.
    pub area: u32,
    /// Sum of the relief over the pixels.
    pub relief: f64,
    /// Pixel sides along the outline, holes and the silhouette included.
    pub outline: u32,
    /// The two regions joined.
    pub children: Option<[u32; 2]>,
    /// Box of the pixels, `[left, top, right, bottom]`, right and bottom past the end.
    pub bounds: [u32; 4],
}

impl MergeNode {
    /// Width in pixels of a long strip of this area and outline; for a disc three quarters of its radius.
    pub fn thickness(&self) -> f32 {
        2.0 * self.area as f32 / self.outline.max(1) as f32
    }
}

/// Sizes from which a region counts in full; the boundaries of smaller ones are weakened, so that specks and the
/// slivers along thick edges go first.
#[derive(Debug, Clone, Copy)]
pub(super) struct Full {
    /// Pixels.
    pub area: f32,
    /// [`MergeNode::thickness`] in pixels.
    pub thickness: f32,
}

impl Full {
    fn share(self, node: &MergeNode) -> f32 {
        let thin = (node.thickness() / self.thickness).min(1.0);
        (node.area as f32 / self.area).min(1.0).sqrt() * thin * thin
    }
}

/// Boundary between two regions: sum of the relief along it, and its length in pixel sides.
type Boundary = (f64, u32);

/// Joins basins until only the components are left. The strength of a boundary is the mean relief along it minus that
/// of its rougher side, reduced for small regions. Basins are nodes 0 to `count - 1`; joined ones follow.
pub(super) fn tree(
    window: &ForegroundWindow,
    labels: &[u32],
    count: usize,
    relief: &[f32],
    full: Full,
) -> Vec<MergeNode> {
    let mut nodes = leaves(window, labels, count, relief);
    let mut around = adjacency(window, labels, count, relief);
    // a joined region keeps the slot of its part with more neighbours; `node_of` gives the current node of a slot
    let mut node_of: Vec<u32> = (0..count as u32).collect();
    let mut alive = vec![true; count];
    let strength = |nodes: &[MergeNode], node_of: &[u32], a: u32, b: u32, (sum, length): Boundary| {
        let [a, b] = [a, b].map(|slot| &nodes[node_of[slot as usize] as usize]);
        // A boundary counts by how far it stands out from what is on its rougher side.
        let rough = (a.relief / f64::from(a.area)).max(b.relief / f64::from(b.area));
        (sum / f64::from(length) - rough).max(0.0) as f32 * full.share(a).min(full.share(b))
    };
    // Strengths are not negative, so their bits order as they do.
    let mut heap = BinaryHeap::new();
    for a in 0..count as u32 {
        for (&b, &boundary) in around[a as usize].range(a + 1..) {
            heap.push(Reverse((strength(&nodes, &node_of, a, b, boundary).to_bits(), a, b)));
        }
    }
    while let Some(Reverse((bits, a, b))) = heap.pop() {
        if !(alive[a as usize] && alive[b as usize]) {
            continue;
        }
        let Some(&boundary) = around[a as usize].get(&b) else { continue };
        let now = strength(&nodes, &node_of, a, b, boundary);
        if now.to_bits() != bits {
            // the sizes or the boundary have changed since: it is queued again with its current strength
            heap.push(Reverse((now.to_bits(), a, b)));
            continue;
        }
        let (keep, gone) = if around[a as usize].len() >= around[b as usize].len() { (a, b) } else { (b, a) };
        let joined = nodes.len() as u32;
        let [left, right] = [keep, gone].map(|slot| node_of[slot as usize]);
        nodes[left as usize].parent = Some(joined);
        nodes[right as usize].parent = Some(joined);
        let (l, r) = (&nodes[left as usize], &nodes[right as usize]);
        nodes.push(MergeNode {
            born: now.max(l.born).max(r.born),
            parent: None,
            area: l.area + r.area,
            relief: l.relief + r.relief,
            outline: l.outline + r.outline - 2 * boundary.1,
            children: Some([left, right]),
            bounds: union(l.bounds, r.bounds),
        });
        node_of[keep as usize] = joined;
        alive[gone as usize] = false;
        around[keep as usize].remove(&gone);
        for (other, (sum, length)) in std::mem::take(&mut around[gone as usize]) {
            if other == keep {
                continue;
            }
            let total = around[keep as usize].entry(other).or_insert((0.0, 0));
            *total = (total.0 + sum, total.1 + length);
            let total = *total;
            around[other as usize].remove(&gone);
            around[other as usize].insert(keep, total);
            let key = strength(&nodes, &node_of, keep, other, total).to_bits();
            heap.push(Reverse((key, keep.min(other), keep.max(other))));
        }
    }
    nodes
}

/// For each node the half-open range of its basins in an order in which every region is contiguous, and each basin's
/// place in that order.
pub(super) fn ranges(nodes: &[MergeNode], count: usize) -> (Vec<[u32; 2]>, Vec<u32>) {
    let mut range = vec![[0, 0]; nodes.len()];
    let mut place = vec![0; count];
    let mut next = 0;
    // Parents come after their children, so going down the list meets each parent before its children.
    let size: Vec<u32> = nodes.iter().fold(Vec::with_capacity(nodes.len()), |mut size, node| {
        size.push(node.children.map_or(1, |[left, right]| size[left as usize] + size[right as usize]));
        size
    });
    for (index, node) in nodes.iter().enumerate().rev() {
        if node.parent.is_none() {
            range[index] = [next, next + size[index]];
            next += size[index];
        }
        let [start, end] = range[index];
        match node.children {
            Some([left, right]) => {
                let middle = start + size[left as usize];
                range[left as usize] = [start, middle];
                range[right as usize] = [middle, end];
            }
            None => place[index] = start,
        }
    }
    (range, place)
}

fn leaves(window: &ForegroundWindow, labels: &[u32], count: usize, relief: &[f32]) -> Vec<MergeNode> {
    let empty = MergeNode {
        born: 0.0,
        parent: None,
        area: 0,
        relief: 0.0,
        outline: 0,
        children: None,
        bounds: [u32::MAX, u32::MAX, 0, 0],
    };
    let mut nodes = vec![empty; count];
    for (pixel, &label) in labels.iter().enumerate() {
        if label != NONE {
            let node = &mut nodes[label as usize];
            let (x, y) = ((pixel % window.width) as u32, (pixel / window.width) as u32);
            node.area += 1;
            node.relief += f64::from(relief[pixel]);
            let sides = sides(pixel, window.width, labels.len());
            node.outline += sides.iter().filter(|side| side.is_none_or(|side| labels[side] != label)).count() as u32;
            node.bounds = union(node.bounds, [x, y, x + 1, y + 1]);
        }
    }
    nodes
}

fn adjacency(window: &ForegroundWindow, labels: &[u32], count: usize, relief: &[f32]) -> Vec<BTreeMap<u32, Boundary>> {
    let mut borders: Vec<(u32, u32, f32)> = Vec::new();
    for pixel in 0..labels.len() {
        let [_, right, _, below] = sides(pixel, window.width, labels.len());
        for other in [right, below].into_iter().flatten() {
            let (a, b) = (labels[pixel], labels[other]);
            if a != b && a != NONE && b != NONE {
                borders.push((a.min(b), a.max(b), relief[pixel].max(relief[other])));
            }
        }
    }
    let mut around = vec![BTreeMap::new(); count];
    for (a, b, strength) in borders {
        for (from, to) in [(a, b), (b, a)] {
            let total: &mut Boundary = around[from as usize].entry(to).or_insert((0.0, 0));
            *total = (total.0 + f64::from(strength), total.1 + 1);
        }
    }
    around
}

fn union(a: [u32; 4], b: [u32; 4]) -> [u32; 4] {
    [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weakest_boundary_goes_first() {
        // Three basins in a row with a weak boundary at the left and a strong one at the right, and one apart.
        let labels = [0, 0, 1, 1, 2, 2, NONE, 3];
        let relief = [0.0, 0.1, 0.1, 0.0, 0.6, 0.0, 0.0, 0.0];
        let window =
            ForegroundWindow { width: 8, height: 1, inside: labels.iter().map(|&label| label != NONE).collect() };
        let nodes = tree(&window, &labels, 4, &relief, Full { area: 1.0, thickness: 0.1 });
        assert_eq!(nodes.len(), 6);
        assert_eq!(nodes[0].parent, Some(4));
        assert_eq!(nodes[1].parent, Some(4));
        assert_eq!((nodes[4].born, nodes[4].area, nodes[4].bounds), (0.05, 4, [0, 0, 4, 1]));
        assert_eq!((nodes[5].born, nodes[5].area, nodes[5].parent), (0.3, 6, None));
        assert_eq!(nodes[3].parent, None);
        let (range, place) = ranges(&nodes, 4);
        for (index, node) in nodes.iter().enumerate().take(4) {
            assert_eq!(range[index], [place[index], place[index] + 1]);
            if let Some(parent) = node.parent {
                assert!(range[parent as usize][0] <= place[index] && place[index] < range[parent as usize][1]);
            }
        }
        assert_eq!(range[5][1] - range[5][0], 3);
    }

    #[test]
    fn born_never_falls_towards_the_root() {
        let (width, height) = (9, 9);
        let labels: Vec<u32> = (0..81).map(|pixel| (pixel / 27) * 3 + (pixel % 9) / 3).collect();
        let relief: Vec<f32> =
            (0..81_u32).map(|pixel| ((pixel + 1).wrapping_mul(2_654_435_761) % 97) as f32 / 97.0).collect();
        let window = ForegroundWindow { width, height, inside: vec![true; 81] };
        let nodes = tree(&window, &labels, 9, &relief, Full { area: 20.0, thickness: 3.0 });
        assert_eq!(nodes.len(), 17);
        for node in &nodes {
            if let Some(parent) = node.parent {
                assert!(nodes[parent as usize].born >= node.born);
            }
        }
        assert_eq!((nodes[16].area, nodes[16].outline), (81, 36));
    }
}
