//! Connected parts of a volume, tracked through a series: labels for volumes that come without any. Voxels at or above
//! a value are connected through their faces (6 neighbours); a part continues the one of the previous step with which
//! it overlaps most.
//!
//! All steps are examined once, in order, before any is used; one number per part is kept of each. The labels of a step
//! are then recomputed from its values. Memory: one step's values and at most 10 bytes per voxel beside them.

use super::error::VolumeError;
use super::grid::{Grid, Volume, VolumeLabels};
use crate::points::union_find::UnionFind;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BTreeMap;
use thiserror::Error;

/// Bytes per voxel, beside its value, while parts are searched.
pub const VOXEL_BYTES: usize = 10;
/// Default minimum size of a part in voxels: a cube of four voxels a side.
pub const DEFAULT_MIN_VOXELS: usize = 64;

/// Which voxels form parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PartOptions {
    /// Minimum value of a part's voxels, data units.
    pub value: f32,
    /// Minimum number of voxels of a part; smaller ones are no segment, at this step.
    pub smallest: usize,
}

/// Why a series has no parts.
#[derive(Debug, Error)]
pub enum PartsError {
    /// A step cannot be read.
    #[error(transparent)]
    Volume(#[from] VolumeError),
    /// No part was found.
    #[error(
        "no part of {} or more voxels has values of {} or more at any of {steps} steps; the largest value is {largest}. \
         Choose a lower value or a smaller minimum size",
        options.smallest, options.value
    )]
    None {
        /// What was searched for.
        options: PartOptions,
        /// Steps of the series.
        steps: usize,
        /// Largest value of all steps.
        largest: f32,
    },
    /// There are more parts than ids.
    #[error(
        "more than 65535 parts of {} or more voxels with values of {} or more by step {step}. Choose another value or a \
         larger minimum size",
        options.smallest, options.value
    )]
    TooMany {
        /// What was searched for.
        options: PartOptions,
        /// The step at which the ids ran out.
        step: usize,
    },
    /// The volume has more voxels than can be numbered.
    #[error("{} voxels: parts are found in volumes of at most {} voxels", .0, u32::MAX - 1)]
    TooLarge(usize),
}

/// The end or the beginning of a part after the first step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PartChange {
    /// The first step at which it has happened.
    pub step: usize,
    /// The part that ends or begins.
    pub id: u16,
    /// Whether it ends; otherwise it begins.
    pub ends: bool,
    /// The part that continues, into which it merges or from which it splits: of those it overlaps with, the one
    /// with which it shares the most voxels; none where it vanishes or appears alone.
    pub other: Option<u16>,
}

/// The parts of a series and their ids over time.
///
/// Ids begin at 1. Those that appear at the same step are numbered from the largest to the smallest. Where parts merge,
/// the one that contributes the most voxels to the whole keeps its id and the others end; where one splits, the piece
/// with most of its voxels keeps the id and the others get new ones. An id that has ended is not reused.
#[derive(Clone, Debug, PartialEq)]
pub struct SeriesParts {
    options: PartOptions,
    /// For each step, the ids of its parts from the largest to the smallest.
    ids: Vec<Vec<u16>>,
    changes: Vec<PartChange>,
    count: u16,
}

/// The parts of one step: `[z, y, x]` their numbers from 1, largest first (among equals the one with the first voxel),
/// 0 for none; and their sizes in voxels.
fn parts_of(values: &[f32], dims: [usize; 3], options: PartOptions) -> (Vec<u32>, Vec<usize>) {
    let [nx, ny, _] = dims;
    let slice = (nx * ny).max(1);
    // NaN belongs to no part
    let inside = |i: usize| values[i] >= options.value;
    let sets = UnionFind::new(values.len());
    let slices = values.len() / slice;
    (0..slices).into_par_iter().for_each(|z| {
        for i in z * slice..(z + 1) * slice {
            if !inside(i) {
                continue;
            }
            let before = [(i % nx > 0, 1), (i / nx % ny > 0, nx), (z > 0, slice)];
            for (_, back) in before.into_iter().filter(|(there, back)| *there && inside(i - back)) {
                sets.union((i - back) as u32, i as u32);
            }
        }
    });
    // the root, which is the first voxel of its part, plus one
    let mut numbers: Vec<u32> =
        (0..values.len()).into_par_iter().map(|i| if inside(i) { sets.find(i as u32) + 1 } else { 0 }).collect();
    drop(sets);
    let mut sizes = vec![0_u32; values.len() + 1];
    numbers.iter().for_each(|root| sizes[*root as usize] += 1);
    let large = |root: &u32| sizes[*root as usize] as usize >= options.smallest.max(1);
    let mut kept: Vec<u32> = (1..sizes.len() as u32).filter(large).collect();
    kept.sort_by_key(|root| (Reverse(sizes[*root as usize]), *root));
    let found = kept.iter().map(|root| sizes[*root as usize] as usize).collect();
    // from here on, the number of each root
    sizes.fill(0);
    kept.iter().zip(1..).for_each(|(root, number)| sizes[*root as usize] = number);
    numbers.par_iter_mut().for_each(|number| *number = sizes[*number as usize]);
    (numbers, found)
}

/// Pairs of ids of the previous step and numbers of this one, with the voxels they share, largest overlap first.
fn overlaps(before: &[u16], now: &[u32]) -> Vec<(usize, u16, u32)> {
    let mut shared: BTreeMap<(u16, u32), usize> = BTreeMap::new();
    let (mut last, mut run) = ((0, 0), 0);
    let mut note = |pair: (u16, u32), run: usize| {
        if pair.0 > 0 && pair.1 > 0 && run > 0 {
            *shared.entry(pair).or_default() += run;
        }
    };
    for pair in before.iter().copied().zip(now.iter().copied()) {
        if pair != last {
            note(last, run);
            (last, run) = (pair, 0);
        }
        run += 1;
    }
    note(last, run);
    let mut pairs: Vec<(usize, u16, u32)> = shared.into_iter().map(|((id, number), n)| (n, id, number)).collect();
    pairs.sort_by_key(|(n, id, number)| (Reverse(*n), *id, *number));
    pairs
}

impl SeriesParts {
    /// Tracks the parts through `steps` steps of a grid; `load` returns the values of a step and is called once for
    /// each, in order.
    ///
    /// # Errors
    /// A step that cannot be read; no part at all; more parts or voxels than can be numbered.
    pub fn follow(
        grid: &Grid,
        steps: usize,
        options: PartOptions,
        mut load: impl FnMut(usize) -> Result<Volume, VolumeError>,
    ) -> Result<Self, PartsError> {
        if grid.len() >= u32::MAX as usize {
            return Err(PartsError::TooLarge(grid.len()));
        }
        let mut out = Self { options, ids: Vec::with_capacity(steps), changes: Vec::new(), count: 0 };
        let mut before: Vec<u16> = Vec::new();
        let mut largest = f32::NEG_INFINITY;
        for step in 0..steps {
            let volume = load(step)?;
            largest = volume.values.iter().copied().fold(largest, f32::max);
            let (numbers, sizes) = parts_of(&volume.values, grid.dims, options);
            drop(volume);
            let mut ids = vec![0; sizes.len()];
            let mut taken = vec![false; usize::from(out.count) + 1];
            let shared = overlaps(&before, &numbers);
            for &(_, id, number) in &shared {
                let own = &mut ids[number as usize - 1];
                if *own == 0 && !taken[usize::from(id)] {
                    *own = id;
                    taken[usize::from(id)] = true;
                }
            }
            let known = out.count;
            for id in ids.iter_mut().filter(|id| **id == 0) {
                out.count = out.count.checked_add(1).ok_or(PartsError::TooMany { options, step })?;
                *id = out.count;
            }
            let mut reported = vec![false; usize::from(out.count) + 1];
            for (_, id, number) in shared {
                let now = ids[number as usize - 1];
                let ended = (!taken[usize::from(id)]).then_some((id, true, now));
                let begun = (now > known).then_some((now, false, id));
                // largest overlap first
                for (id, ends, other) in [ended, begun].into_iter().flatten() {
                    if !std::mem::replace(&mut reported[usize::from(id)], true) {
                        out.changes.push(PartChange { step, id, ends, other: Some(other) });
                    }
                }
            }
            if let Some(last) = out.ids.last() {
                let ended = last.iter().filter(|id| !taken[usize::from(**id)]).map(|id| (*id, true));
                let begun = ids.iter().filter(|id| **id > known).map(|id| (*id, false));
                let alone = ended.chain(begun).filter(|(id, _)| !reported[usize::from(*id)]);
                out.changes.extend(alone.map(|(id, ends)| PartChange { step, id, ends, other: None }));
            }
            before.clear();
            before.extend(numbers.iter().map(|n| if *n == 0 { 0 } else { ids[*n as usize - 1] }));
            out.ids.push(ids);
        }
        if out.count == 0 {
            return Err(PartsError::None { options, steps, largest });
        }
        Ok(out)
    }

    /// Number of ids over all steps; they run from 1 to this.
    pub fn count(&self) -> u16 {
        self.count
    }

    /// The ends and beginnings after the first step, by step.
    pub fn changes(&self) -> &[PartChange] {
        &self.changes
    }

    /// Which voxels form parts.
    pub fn options(&self) -> PartOptions {
        self.options
    }

    /// The labels of a tracked step, from its values; a step beyond the last has none.
    pub fn labels(&self, step: usize, volume: &Volume) -> VolumeLabels {
        let ids = self.ids.get(step).map_or(&[][..], Vec::as_slice);
        let (numbers, _) = parts_of(&volume.values, volume.grid.dims, self.options);
        let id = |n: &u32| n.checked_sub(1).and_then(|n| ids.get(n as usize)).copied().unwrap_or(0);
        VolumeLabels { grid: volume.grid, ids: numbers.par_iter().map(id).collect() }
    }
}

/// The name of a part: `part-1` and so on.
pub fn part_name(id: u16) -> String {
    format!("part-{id}")
}

#[cfg(test)]
#[path = "components_tests.rs"]
mod tests;
