//! Assignment of Gaussians to the tiles that they touch, in depth order.
//!
//! It is exact: a tile is listed only if the ellipse alpha >= 1/255 reaches into it, determined row of tiles by row of
//! tiles. Depth order comes from one radix sort; ties keep the order of the indices. A row is listed in slabs of depth,
//! so that Gaussians behind finished tiles are never examined.

use super::TILE;
use super::lanes::wide;
use super::project::Splat2d;
use crate::backend::filled;
use rayon::prelude::*;

/// Number of Gaussians gathered from scattered memory before they are read, so that their cache misses overlap.
pub(crate) const GATHER: usize = 32;

/// Ranks of the Gaussians that were drawn, by tile: one CSR block per row of tiles.
pub(crate) struct Bins {
    pub tiles_x: usize,
    pub rows: Vec<TileRow>,
}

/// The tiles of one row.
#[derive(Default)]
pub(crate) struct TileRow {
    /// `[tiles_x + 1]` offsets into `entries`.
    pub offsets: Vec<u32>,
    /// Ranks of Gaussians, nearest first within a tile.
    pub entries: Vec<u32>,
}

impl Bins {
    pub(crate) fn tile_count(&self) -> usize {
        self.rows.len() * self.tiles_x
    }

    /// Returns the ranks of the Gaussians of tile `t` (row-major), nearest first.
    pub(crate) fn tile(&self, t: usize) -> &[u32] {
        let row = &self.rows[t / self.tiles_x];
        let x = t % self.tiles_x;
        &row.entries[row.offsets[x] as usize..row.offsets[x + 1] as usize]
    }
}

/// The drawn Gaussians, copied into depth order: later stages read them consecutively, a slab at a time, instead of
/// from scattered memory.
pub(crate) struct Order {
    /// Nearest first; a position here is a *rank*.
    pub splats: Vec<Splat2d>,
    /// The index of the Gaussian at each rank.
    pub indices: Vec<u32>,
    /// First row of tiles and one past the last, for each rank.
    spans: Vec<[u16; 2]>,
}

impl Order {
    pub(crate) fn new(splats: &[Splat2d], height: usize) -> Self {
        let tiles_y = height.div_ceil(TILE);
        let indices = depth_order(splats);
        let mut sorted = filled(Splat2d::default(), indices.len());
        let mut spans = vec![[0; 2]; indices.len()];
        let arch = crate::arch();
        const CHUNK: usize = 4096;
        let chunks = (sorted.par_chunks_mut(CHUNK), spans.par_chunks_mut(CHUNK), indices.par_chunks(CHUNK));
        chunks.into_par_iter().for_each(|(sorted, spans, indices)| {
            for (to, &i) in sorted.iter_mut().zip(indices) {
                *to = splats[i as usize];
            }
            wide(
                arch,
                #[inline(always)]
                || {
                    for (span, s) in spans.iter_mut().zip(sorted) {
                        let rows = tile_span(s.y - s.extent[1], s.y + s.extent[1], tiles_y);
                        // an image has fewer than 65536 rows of tiles
                        *span = [rows.start as u16, rows.end as u16];
                    }
                },
            );
        });
        Self { splats: sorted, indices, spans }
    }

    /// Returns the rank of each of `n` Gaussians; `u32::MAX` for those that are not drawn.
    pub(crate) fn ranks(&self, n: usize) -> Vec<u32> {
        let mut ranks = vec![u32::MAX; n];
        for (rank, &i) in self.indices.iter().enumerate() {
            ranks[i as usize] = rank as u32;
        }
        ranks
    }

    /// Returns the slabs of depth: an eighth, an eighth, a quarter and the rest, with small ones merged into the next.
    pub(crate) fn slabs(&self) -> impl Iterator<Item = std::ops::Range<usize>> {
        const MIN_SLAB: usize = 2048;
        let n = self.indices.len();
        let mut cuts = [0, n / 8, n / 4, n / 2, n];
        for k in 1..4 {
            if cuts[k] - cuts[k - 1] < MIN_SLAB {
                cuts[k] = cuts[k - 1];
            }
        }
        (0..4).map(move |k| cuts[k]..cuts[k + 1]).filter(|r| !r.is_empty())
    }

    /// Lists the Gaussians of a slab for the unfinished tiles of a row.
    #[inline(always)]
    pub(crate) fn list(&self, slab: std::ops::Range<usize>, row: usize, takes: &[bool], lists: &mut RowLists) {
        let tiles_x = takes.len();
        let RowLists { hits, spans, row: TileRow { offsets, entries }, next, open } = lists;
        open.clear();
        open.push(0);
        open.extend(takes.iter().scan(0, |sum, takes| {
            *sum += u32::from(*takes);
            Some(*sum)
        }));
        spans.clear();
        offsets.clear();
        offsets.resize(tiles_x + 1, 0);
        // branch-free: few of very many hit, and no processor could predict which
        let row_u16 = row as u16;
        hits.resize(hits.len().max(slab.len()), 0);
        let mut found = 0;
        for (rank, &[first, end]) in (slab.start as u32..).zip(&self.spans[slab]) {
            hits[found] = rank;
            found += usize::from(first <= row_u16 && row_u16 < end);
        }
        let (top, bottom) = ((row * TILE) as f32 + 0.5, (row * TILE + TILE) as f32 - 0.5);
        let mut near = [Splat2d::default(); GATHER];
        for ranks in hits[..found].chunks(GATHER) {
            for (to, &rank) in near.iter_mut().zip(ranks) {
                *to = self.splats[rank as usize];
            }
            for (s, &rank) in near.iter().zip(ranks) {
                let coarse = tile_span(s.x - s.extent[0] - 0.01, s.x + s.extent[0] + 0.01, tiles_x);
                if open[coarse.start] == open[coarse.end] {
                    continue;
                }
                let (left, right) = chord(s, top - s.y, bottom - s.y);
                // slightly wider than exact: rounding must never lose a pixel that blending would have accepted
                let tiles = tile_span(s.x + left - 0.01, s.x + right + 0.01, tiles_x);
                let mut any = false;
                for x in tiles.clone() {
                    offsets[x + 1] += u32::from(takes[x]);
                    any |= takes[x];
                }
                if any {
                    spans.push((rank, tiles.start as u32, tiles.end as u32));
                }
            }
        }
        for x in 0..tiles_x {
            offsets[x + 1] += offsets[x];
        }
        next.clear();
        next.extend_from_slice(offsets);
        entries.resize(offsets[tiles_x] as usize, 0);
        for &(rank, start, end) in spans.iter() {
            for x in (start as usize..end as usize).filter(|x| takes[*x]) {
                entries[next[x] as usize] = rank;
                next[x] += 1;
            }
        }
    }
}

/// The lists of one slab of one row, with reusable buffers.
#[derive(Default)]
pub(crate) struct RowLists {
    /// The first entries are the ranks whose boxes reach into the row.
    hits: Vec<u32>,
    spans: Vec<(u32, u32, u32)>,
    /// The Gaussians of each tile.
    pub row: TileRow,
    next: Vec<u32>,
    /// Number of unfinished tiles before each tile.
    open: Vec<u32>,
}

/// Returns the tiles that hold pixel centres between `low` and `high`.
#[inline(always)]
fn tile_span(low: f32, high: f32, tiles: usize) -> std::ops::Range<usize> {
    // pixel k has its centre at k + 0.5; `as usize` saturates, so that huge extents are harmless
    let first = ((low - 0.5).ceil().max(0.0) as usize) / TILE;
    let last = (high - 0.5).floor();
    let end = if last < 0.0 { 0 } else { (last as usize / TILE + 1).min(tiles) };
    first.min(end)..end
}

/// Returns the leftmost and rightmost dx of the ellipse within the band `dy` in `[y0, y1]`.
#[inline(always)]
fn chord(s: &Splat2d, y0: f32, y1: f32) -> (f32, f32) {
    // q(dx, dy) = a dx^2 + 2 b dx dy + c dy^2 <= k, with a = -qa and so on
    let (a, b, c) = (-s.qa, -0.5 * s.qb, -s.qc);
    let k = s.log2_opacity - crate::splat::ALPHA_MIN.log2();
    let extreme = s.extent[0];
    // the rightmost point of the whole ellipse lies at dy = -b/c * extent, the leftmost opposite to it
    let dy_right = -b / c * extreme;
    let at = |dy: f32, sign: f32| {
        let dy = dy.clamp(-s.extent[1], s.extent[1]);
        let disc = (b * b - a * c) * dy * dy + a * k;
        (-b * dy + sign * disc.max(0.0).sqrt()) / a
    };
    let right = if (y0..=y1).contains(&dy_right) { extreme } else { at(y0, 1.0).max(at(y1, 1.0)) };
    let left = if (y0..=y1).contains(&-dy_right) { -extreme } else { at(y0, -1.0).min(at(y1, -1.0)) };
    if left.is_finite() && right.is_finite() { (left.max(-extreme), right.min(extreme)) } else { (-extreme, extreme) }
}

/// Returns the indices of the drawn Gaussians, nearest first: a stable radix sort of the depth's bits.
fn depth_order(splats: &[Splat2d]) -> Vec<u32> {
    // depths are positive, so their bits sort as integers
    let mut pairs: Vec<(u32, u32)> =
        splats.iter().enumerate().filter(|(_, s)| s.radius > 0).map(|(i, s)| (s.depth.to_bits(), i as u32)).collect();
    let mut other = vec![(0, 0); pairs.len()];
    for shift in [0, 11, 22] {
        let mut counts = [0u32; 2048];
        for &(key, _) in &pairs {
            counts[(key >> shift) as usize & 2047] += 1;
        }
        let mut sum = 0;
        for c in &mut counts {
            (*c, sum) = (sum, sum + *c);
        }
        for &pair in &pairs {
            let slot = &mut counts[(pair.0 >> shift) as usize & 2047];
            other[*slot as usize] = pair;
            *slot += 1;
        }
        std::mem::swap(&mut pairs, &mut other);
    }
    pairs.into_iter().map(|(_, i)| i).collect()
}
