//! Finding the contributors in host memory: one task per tile, its pixels packed into SIMD lanes.
//!
//! The compositing code is that of blending, so the weights are bit-identical to those of the image.

use super::{Contributors, ContributorsError};
use crate::splat::SplatSettings;
use crate::splat::cpu::TILE;
use crate::splat::cpu::bin::{DepthOrder, DrawnGaussian, TileBins};
use crate::splat::cpu::blend::{TileArea, blend_rows};
use crate::splat::cpu::lanes::any;
use crate::splat::cpu::rule::Rule;
use pulp::{Simd, WithSimd, bytemuck};
use rayon::prelude::*;

/// Rows that one task copies into the result.
const COPY_ROWS: usize = 1024;

/// As [`contributors`], after blending the rows of tiles that hold a requested pixel, which finds where each tile ends
/// and thus which Gaussians matter.
///
/// # Errors
/// As [`contributors`].
pub(crate) fn of_pixels(
    order: &DepthOrder,
    settings: &SplatSettings,
    pixels: &[u32],
) -> Result<Contributors, ContributorsError> {
    super::check_pixels(pixels, settings)?;
    let mut rows = vec![false; settings.camera.height.div_ceil(TILE)];
    pixels.iter().for_each(|pixel| rows[*pixel as usize / settings.camera.width / TILE] = true);
    let (_, bins) = blend_rows(order, settings, |row| rows[row]);
    contributors(order, &bins, settings, pixels)
}

/// Lists the Gaussians that are blended into each pixel, nearest first, with their weights `alpha * T`.
///
/// `pixels` holds `y * width + x` in any order, repeats allowed; the lists are in that order. `order` and `bins` are
/// those left by blending the view of `settings`. The result does not depend on the number of threads.
///
/// # Errors
/// [`ContributorsError::PixelOutOfImage`] for the first pixel outside the image; [`ContributorsError::TooMany`] if the
/// contributions exceed what 32 bits can count.
pub(crate) fn contributors(
    order: &DepthOrder,
    bins: &TileBins,
    settings: &SplatSettings,
    pixels: &[u32],
) -> Result<Contributors, ContributorsError> {
    let (width, height) = (settings.camera.width, settings.camera.height);
    super::check_pixels(pixels, settings)?;
    let groups = Groups::new(pixels, width, height);
    let arch = crate::arch();
    let tasks: Vec<usize> = (0..bins.tile_count()).filter(|&t| !groups.tile(t).is_empty()).collect();
    let lists: Vec<TileLists> = tasks
        .into_par_iter()
        .map(|t| {
            let area = TileArea::new(t, bins.tiles_x, width, height);
            let mut slots: Vec<PixelSlot> = groups
                .tile(t)
                .iter()
                .map(|&list| {
                    let pixel = pixels[list as usize] as usize;
                    let (row, column) = (pixel / width - area.y0, pixel % width - area.x0);
                    PixelSlot { place: (row * TILE + column) as u32, list }
                })
                .collect();
            slots.sort_unstable_by_key(|s| (s.place, s.list));
            let events = arch.dispatch(Walk { order, entries: bins.tile(t), area, slots: &slots });
            TileLists::new(slots, &events)
        })
        .collect();
    assemble(pixels.len(), &lists)
}

/// A requested pixel of a tile.
#[derive(Clone, Copy)]
struct PixelSlot {
    /// `row * TILE + column` within the tile.
    place: u32,
    /// Its position in the list of pixels.
    list: u32,
}

/// A contribution, in the order it was found.
#[derive(Clone, Copy)]
struct Contribution {
    slot: u32,
    index: u32,
    weight: f32,
}

/// Positions in the list of pixels, by tile (a counting sort).
struct Groups {
    starts: Vec<u32>,
    members: Vec<u32>,
}

impl Groups {
    fn new(pixels: &[u32], width: usize, height: usize) -> Self {
        let tiles_x = width.div_ceil(TILE);
        let tile_of = |pixel: u32| (pixel as usize / width / TILE) * tiles_x + pixel as usize % width / TILE;
        let tiles: Vec<u32> = pixels.par_iter().map(|&p| tile_of(p) as u32).collect();
        let mut starts = vec![0u32; tiles_x * height.div_ceil(TILE) + 1];
        for &t in &tiles {
            starts[t as usize + 1] += 1;
        }
        for t in 1..starts.len() {
            starts[t] += starts[t - 1];
        }
        let mut next = starts.clone();
        let mut members = vec![0u32; pixels.len()];
        for (list, &t) in tiles.iter().enumerate() {
            members[next[t as usize] as usize] = list as u32;
            next[t as usize] += 1;
        }
        Self { starts, members }
    }

    fn tile(&self, t: usize) -> &[u32] {
        &self.members[self.starts[t] as usize..self.starts[t + 1] as usize]
    }
}

/// The lists of the pixels of one tile, in the order of its slots.
struct TileLists {
    slots: Vec<PixelSlot>,
    /// `[slots + 1]`
    offsets: Vec<usize>,
    indices: Vec<u32>,
    weights: Vec<f32>,
}

impl TileLists {
    /// Sorts the events by slot; within a slot they keep their order.
    fn new(slots: Vec<PixelSlot>, events: &[Contribution]) -> Self {
        let mut offsets = vec![0usize; slots.len() + 1];
        for e in events {
            offsets[e.slot as usize + 1] += 1;
        }
        for s in 0..slots.len() {
            offsets[s + 1] += offsets[s];
        }
        let mut next = offsets.clone();
        let (mut indices, mut weights) = (vec![0u32; events.len()], vec![0.0f32; events.len()]);
        for e in events {
            let at = &mut next[e.slot as usize];
            indices[*at] = e.index;
            weights[*at] = e.weight;
            *at += 1;
        }
        Self { slots, offsets, indices, weights }
    }
}

/// Arranges the lists of all tiles in the order of the requested pixels.
fn assemble(pixels: usize, lists: &[TileLists]) -> Result<Contributors, ContributorsError> {
    let count: u64 = lists.iter().map(|l| l.indices.len() as u64).sum();
    let total = u32::try_from(count).map_err(|_| ContributorsError::TooMany { count })? as usize;
    let mut offsets = vec![0u32; pixels + 1];
    // the tile's lists, and the offset within them
    let mut sources = vec![(0u32, 0usize); pixels];
    for (k, lists) in lists.iter().enumerate() {
        for (slot, range) in lists.slots.iter().zip(lists.offsets.windows(2)) {
            sources[slot.list as usize] = (k as u32, range[0]);
            offsets[slot.list as usize + 1] = (range[1] - range[0]) as u32;
        }
    }
    for p in 0..pixels {
        offsets[p + 1] += offsets[p];
    }
    let (mut indices, mut weights) = (vec![0u32; total], vec![0.0f32; total]);
    let mut jobs = Vec::with_capacity(pixels.div_ceil(COPY_ROWS));
    let (mut rest_indices, mut rest_weights) = (indices.as_mut_slice(), weights.as_mut_slice());
    for first in (0..pixels).step_by(COPY_ROWS) {
        let rows = first..pixels.min(first + COPY_ROWS);
        let size = (offsets[rows.end] - offsets[rows.start]) as usize;
        let (head_indices, tail_indices) = rest_indices.split_at_mut(size);
        let (head_weights, tail_weights) = rest_weights.split_at_mut(size);
        (rest_indices, rest_weights) = (tail_indices, tail_weights);
        jobs.push((rows, head_indices, head_weights));
    }
    jobs.into_par_iter().for_each(|(rows, indices, weights)| {
        let mut at = 0;
        for p in rows {
            let (k, start) = sources[p];
            let size = (offsets[p + 1] - offsets[p]) as usize;
            let lists = &lists[k as usize];
            indices[at..at + size].copy_from_slice(&lists.indices[start..start + size]);
            weights[at..at + size].copy_from_slice(&lists.weights[start..start + size]);
            at += size;
        }
    });
    Ok(Contributors { offsets, indices, weights })
}

/// Walks a tile's Gaussians once, for all its slots; the slots are sorted by place.
struct Walk<'a> {
    order: &'a DepthOrder,
    entries: &'a [DrawnGaussian],
    area: TileArea,
    slots: &'a [PixelSlot],
}

impl WithSimd for Walk<'_> {
    type Output = Vec<Contribution>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Vec<Contribution> {
        let Self { order: DepthOrder { splats, indices, .. }, entries, area, slots } = self;
        let mut events = Vec::new();
        let lanes = S::F32_LANES;
        let vectors = slots.len().div_ceil(lanes);
        let zero = simd.splat_f32s(0.0);
        // `rows` counts within the tile, `ys` are pixel centres in the image; the lanes beyond the last slot have
        // `open` = 0, like finished pixels
        let (mut columns, mut rows, mut ys, mut open) =
            (vec![zero; vectors], vec![zero; vectors], vec![zero; vectors], vec![zero; vectors]);
        // `[r]`: the first slot in row r or a later one
        let mut row_starts = [0usize; TILE + 1];
        for (k, slot) in slots.iter().enumerate() {
            let (row, column) = (slot.place as usize / TILE, slot.place as usize % TILE);
            let (v, lane) = (k / lanes, k % lanes);
            set(&mut columns[v], lane, column as f32 + 0.5);
            set(&mut rows[v], lane, row as f32);
            set(&mut ys[v], lane, (area.y0 + row) as f32 + 0.5);
            set(&mut open[v], lane, 1.0);
            row_starts[row + 1] = k + 1;
        }
        for r in 0..TILE {
            row_starts[r + 1] = row_starts[r + 1].max(row_starts[r]);
        }
        let mut done = vec![false; vectors];
        let mut live = vectors;
        let rule = Rule::new(simd);

        for &DrawnGaussian { rank, rows: touched_rows } in entries {
            let s = &splats[rank as usize];
            let (first, last) = (touched_rows.trailing_zeros() as usize, touched_rows.ilog2() as usize);
            if row_starts[first] == row_starts[last + 1] {
                continue;
            }
            let reached = row_starts[first] / lanes..row_starts[last + 1].div_ceil(lanes);
            let (first, last) = (simd.splat_f32s(first as f32), simd.splat_f32s(last as f32));
            let offset = simd.splat_f32s(area.x0 as f32 - s.x);
            let sy = simd.splat_f32s(s.y);
            let (qa, qb, qc) = (simd.splat_f32s(s.qa), simd.splat_f32s(s.qb), simd.splat_f32s(s.qc));
            let lo = simd.splat_f32s(s.log2_opacity);
            for v in reached {
                if done[v] {
                    continue;
                }
                let dy = simd.sub_f32s(ys[v], sy);
                let (qb, qc) = (simd.mul_f32s(qb, dy), simd.mul_f32s(simd.mul_f32s(qc, dy), dy));
                let dx = simd.add_f32s(columns[v], offset);
                let power = rule.power(simd, dx, [qa, qb, simd.add_f32s(qc, lo)]);
                let t = open[v];
                let in_rows = simd.and_m32s(
                    simd.greater_than_or_equal_f32s(rows[v], first),
                    simd.less_than_or_equal_f32s(rows[v], last),
                );
                let touched = simd.and_m32s(rule.touched(simd, power, t), in_rows);
                if !any(simd, touched) {
                    continue;
                }
                let effect = rule.evaluate(simd, power, t, touched);
                for (lane, &weight) in bytemuck::cast_slice::<S::f32s, f32>(&[effect.weight]).iter().enumerate() {
                    // a blended weight is at least 1e-4 / 255
                    if weight > 0.0 {
                        let index = indices[rank as usize];
                        events.push(Contribution { slot: (v * lanes + lane) as u32, index, weight });
                    }
                }
                let t = simd.select_f32s(touched, simd.select_f32s(effect.blended, effect.after, zero), t);
                open[v] = t;
                if !any(simd, simd.greater_than_f32s(t, zero)) {
                    done[v] = true;
                    live -= 1;
                }
            }
            if live == 0 {
                break;
            }
        }
        events
    }
}

/// Sets one lane of a vector.
#[inline(always)]
fn set<V: bytemuck::Pod>(vector: &mut V, lane: usize, value: f32) {
    bytemuck::cast_slice_mut::<V, f32>(std::slice::from_mut(vector))[lane] = value;
}
