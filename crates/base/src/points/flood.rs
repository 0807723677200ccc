//! Peaks of a landscape of cells, filled from its highest cell downwards; the caller decides which of them stay
//! separate. The heights are defined elsewhere: densities in `modes`, depths inside a body in `segment`.

/// A peak: its summit and the cells assigned to it so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DensityPeak {
    /// Its highest cell.
    pub summit: usize,
    /// Sum of the masses of its cells.
    pub mass: f64,
}

/// Returns the peak of each cell (`usize::MAX` for none) and the peaks, highest summit first. Peaks merged into another
/// are not listed, and no cell refers to them.
///
/// `order` lists the cells to visit, highest first. Each cell joins the highest of the peaks it touches (`around`
/// appends the neighbours of a cell to a list), or starts a new one. Where peaks meet in a cell, each lower one is
/// merged into the highest unless `parted(lower, highest, cell)` (mode seeking by persistence: Chazal, Guibas, Oudot
/// and Skraba, *Persistence-based clustering in Riemannian manifolds*, 2013).
pub fn flood(
    order: &[usize],
    cells: usize,
    mass: impl Fn(usize) -> f64,
    mut around: impl FnMut(usize, &mut Vec<usize>),
    parted: impl Fn(&DensityPeak, &DensityPeak, usize) -> bool,
) -> (Vec<usize>, Vec<DensityPeak>) {
    // peaks in the order of their summits; `part_of` of a merged one is the peak it was merged into
    let (mut part_of, mut modes): (Vec<usize>, Vec<DensityPeak>) = (Vec::new(), Vec::new());
    let mut of_cell = vec![usize::MAX; cells];
    let (mut near, mut met) = (Vec::new(), Vec::new());
    for &c in order {
        near.clear();
        met.clear();
        around(c, &mut near);
        met.extend(near.iter().map(|&n| of_cell[n]).filter(|h| *h != usize::MAX).map(|h| root(&part_of, h)));
        met.sort_unstable();
        met.dedup();
        let Some(&top) = met.first() else {
            of_cell[c] = modes.len();
            part_of.push(modes.len());
            modes.push(DensityPeak { summit: c, mass: mass(c) });
            continue;
        };
        of_cell[c] = top;
        modes[top].mass += mass(c);
        for &low in &met[1..] {
            if !parted(&modes[low], &modes[top], c) {
                part_of[low] = top;
                modes[top].mass += modes[low].mass;
            }
        }
    }
    let mut numbers = vec![usize::MAX; modes.len()];
    let mut kept = Vec::new();
    for mode in (0..modes.len()).filter(|&h| part_of[h] == h) {
        numbers[mode] = kept.len();
        kept.push(modes[mode]);
    }
    for mode in of_cell.iter_mut().filter(|h| **h != usize::MAX) {
        *mode = numbers[root(&part_of, *mode)];
    }
    (of_cell, kept)
}

fn root(part_of: &[usize], mut mode: usize) -> usize {
    while part_of[mode] != mode {
        mode = part_of[mode];
    }
    mode
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_meet_in_the_pass_and_merge_unless_separated() {
        let heights = [0.0, 3.0, 5.0, 4.0, 1.0, 4.0, 3.5, 6.0, 0.5];
        let mut order: Vec<usize> = (0..heights.len()).filter(|&c| heights[c] > 0.0).collect();
        order.sort_by(|&a, &b| f64::total_cmp(&heights[b], &heights[a]));
        let around = |c: usize, near: &mut Vec<usize>| near.extend([c.saturating_sub(1), (c + 1).min(8)]);
        let deep = |low: &DensityPeak, _: &DensityPeak, cell: usize| heights[cell] < 0.5 * heights[low.summit];
        let (of_cell, modes) = flood(&order, 9, |_| 1.0, around, deep);
        assert_eq!(modes.iter().map(|h| (h.summit, h.mass)).collect::<Vec<_>>(), [(7, 5.0), (2, 3.0)]);
        assert_eq!(of_cell, [usize::MAX, 1, 1, 1, 0, 0, 0, 0, 0]);
        let (of_cell, modes) = flood(&order, 9, |_| 1.0, around, |_, _, _| false);
        assert_eq!((modes.len(), of_cell[2], of_cell[7]), (1, 0, 0));
    }
}
