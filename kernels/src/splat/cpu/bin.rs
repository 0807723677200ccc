//! Assignment of Gaussians to the tiles that they touch, in depth order.
//!
//! It is exact: a tile is listed only if the ellipse alpha >= 1/255 reaches into it, determined row of tiles by row of
//! tiles. Depth order comes from one radix sort; ties keep the order of the indices. A row is listed in slabs of depth,
//! so that Gaussians behind finished tiles are never examined.

use super::TILE;
use super::lanes::wide;
use super::project::Splat2d;
use super::reach::{Reach, tile_box};
use crate::PinholeCamera;
use crate::backend::filled;
use rayon::prelude::*;

/// Number of Gaussians gathered from scattered memory before they are read, so that their cache misses overlap.
pub(crate) const GATHER: usize = 32;

/// The Gaussians that were drawn, by tile: one CSR block per row of tiles.
pub(crate) struct TileBins {
    pub tiles_x: usize,
    pub rows: Vec<TileRow<DrawnGaussian>>,
}

/// A Gaussian that a tile was drawn with.
#[derive(Clone, Copy)]
pub(crate) struct DrawnGaussian {
    pub rank: u32,
    /// Bit mask of the tile's rows in which it touched a pixel: at least one.
    pub rows: u32,
}

/// The tiles of one row, with something for each Gaussian of a tile.
#[derive(Default)]
pub(crate) struct TileRow<T> {
    /// `[tiles_x + 1]` offsets into `entries`.
    pub offsets: Vec<u32>,
    /// Nearest first within a tile.
    pub entries: Vec<T>,
}

impl TileBins {
    pub(crate) fn tile_count(&self) -> usize {
        self.rows.len() * self.tiles_x
    }

    /// Returns the Gaussians of tile `t` (row-major), nearest first.
    pub(crate) fn tile(&self, t: usize) -> &[DrawnGaussian] {
        let row = &self.rows[t / self.tiles_x];
        let x = t % self.tiles_x;
        &row.entries[row.offsets[x] as usize..row.offsets[x + 1] as usize]
    }
}

/// The drawn Gaussians, copied into depth order: later stages read them consecutively, a slab at a time, instead of
/// from scattered memory.
pub(crate) struct DepthOrder {
    /// Nearest first; a position here is a *rank*.
    pub splats: Vec<Splat2d>,
    /// The index of the Gaussian at each rank.
    pub indices: Vec<u32>,
    /// First row of tiles and one past the last, for each rank.
    rows: Vec<[u16; 2]>,
    /// The same for columns of tiles.
    columns: Vec<[u16; 2]>,
}

impl DepthOrder {
    pub(crate) fn new(splats: &[Splat2d], camera: &PinholeCamera) -> Self {
        let tiles = [camera.width.div_ceil(TILE), camera.height.div_ceil(TILE)];
        let indices = depth_order(splats);
        let mut sorted = filled(Splat2d::default(), indices.len());
        let (mut rows, mut columns) = (vec![[0; 2]; indices.len()], vec![[0; 2]; indices.len()]);
        const CHUNK: usize = 4096;
        let boxes = rows.par_chunks_mut(CHUNK).zip(columns.par_chunks_mut(CHUNK));
        (sorted.par_chunks_mut(CHUNK), boxes, indices.par_chunks(CHUNK)).into_par_iter().for_each(
            |(sorted, (rows, columns), indices)| {
                for (to, &i) in sorted.iter_mut().zip(indices) {
                    *to = splats[i as usize];
                }
                wide!(for ((rows, columns), s) in rows.iter_mut().zip(columns).zip(sorted) {
                    [*rows, *columns] = tile_box(s, tiles);
                });
            },
        );
        Self { splats: sorted, indices, rows, columns }
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
        let RowLists { hits, reach, spans, row: TileRow { offsets, entries }, next, open } = lists;
        open.clear();
        open.push(0);
        open.extend(takes.iter().scan(0, |sum, takes| {
            *sum += u32::from(*takes);
            Some(*sum)
        }));
        spans.clear();
        offsets.clear();
        offsets.resize(tiles_x + 1, 0);
        // both without a branch: few of very many pass, and no processor could predict which
        let row_u16 = row as u16;
        hits.resize(hits.len().max(slab.len()), 0);
        let hits = &mut hits[..slab.len()];
        let mut found = 0;
        for (rank, &[first, end]) in (slab.start as u32..).zip(&self.rows[slab]) {
            hits[found] = rank;
            found += usize::from(first <= row_u16 && row_u16 < end);
        }
        let candidates = found;
        found = 0;
        for k in 0..candidates {
            let rank = hits[k];
            let [first, end] = self.columns[rank as usize];
            hits[found] = rank;
            found += usize::from(open[first as usize] != open[end as usize]);
        }
        for ranks in hits[..found].chunks(GATHER) {
            reach.find(&self.splats, ranks, row, tiles_x);
            for (j, &rank) in ranks.iter().enumerate() {
                let tiles = reach.tiles(j);
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
    /// The first entries are the ranks whose boxes reach into the row's unfinished tiles.
    hits: Vec<u32>,
    reach: Reach,
    spans: Vec<(u32, u32, u32)>,
    /// The ranks of each tile's Gaussians.
    pub row: TileRow<u32>,
    next: Vec<u32>,
    /// Number of unfinished tiles before each tile.
    open: Vec<u32>,
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
