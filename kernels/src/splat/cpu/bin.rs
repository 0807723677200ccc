//! Which Gaussians touch which tile, in depth order.
//!
//! Exact: a tile is listed only if the ellipse alpha >= 1/255 reaches into it, found row of tiles by
//! row of tiles. Depth order comes from one radix sort; ties keep the order of the indices.

use super::TILE;
use super::project::Splat2d;
use rayon::prelude::*;

/// Gaussians per tile: `entries[rows[r].start..]`, one CSR block a row of tiles.
pub(super) struct Bins {
    pub tiles_x: usize,
    pub rows: Vec<TileRow>,
}

/// The tiles of one row.
#[derive(Default)]
pub(super) struct TileRow {
    /// `[tiles_x + 1]` offsets into `entries`.
    pub offsets: Vec<u32>,
    /// Indices of Gaussians, nearest first within a tile.
    pub entries: Vec<u32>,
}

impl Bins {
    pub(super) fn tile_count(&self) -> usize {
        self.rows.len() * self.tiles_x
    }

    /// Gaussians of tile `t` (row-major), nearest first.
    pub(super) fn tile(&self, t: usize) -> &[u32] {
        let row = &self.rows[t / self.tiles_x];
        let x = t % self.tiles_x;
        &row.entries[row.offsets[x] as usize..row.offsets[x + 1] as usize]
    }
}

pub(super) fn bin(splats: &[Splat2d], width: usize, height: usize) -> Bins {
    let (tiles_x, tiles_y) = (width.div_ceil(TILE), height.div_ceil(TILE));
    let order = depth_order(splats);

    // rows of tiles that each Gaussian touches
    let span = |s: &Splat2d| tile_span(s.y - s.extent[1], s.y + s.extent[1], tiles_y);
    let mut starts = vec![0u32; tiles_y + 1];
    for &i in &order {
        for row in span(&splats[i as usize]) {
            starts[row + 1] += 1;
        }
    }
    for row in 0..tiles_y {
        starts[row + 1] += starts[row];
    }
    let mut next = starts.clone();
    let mut by_row = vec![0u32; starts[tiles_y] as usize];
    for &i in &order {
        for row in span(&splats[i as usize]) {
            by_row[next[row] as usize] = i;
            next[row] += 1;
        }
    }

    let rows = (0..tiles_y)
        .into_par_iter()
        .map(|row| bin_row(splats, &by_row[starts[row] as usize..starts[row + 1] as usize], row, tiles_x))
        .collect();
    Bins { tiles_x, rows }
}

/// Tiles that hold pixel centres between `low` and `high`.
fn tile_span(low: f32, high: f32, tiles: usize) -> std::ops::Range<usize> {
    // pixel k has its centre at k + 0.5; `as usize` saturates, so that huge extents are harmless
    let first = ((low - 0.5).ceil().max(0.0) as usize) / TILE;
    let last = (high - 0.5).floor();
    let end = if last < 0.0 { 0 } else { (last as usize / TILE + 1).min(tiles) };
    first.min(end)..end
}

fn bin_row(splats: &[Splat2d], members: &[u32], row: usize, tiles_x: usize) -> TileRow {
    let mut spans = Vec::with_capacity(members.len());
    let mut offsets = vec![0u32; tiles_x + 1];
    let (top, bottom) = ((row * TILE) as f32 + 0.5, (row * TILE + TILE) as f32 - 0.5);
    for &i in members {
        let s = &splats[i as usize];
        let (left, right) = chord(s, top - s.y, bottom - s.y);
        // a hair wider than exact: rounding must never lose a pixel that blending would have tested in
        let tiles = tile_span(s.x + left - 0.01, s.x + right + 0.01, tiles_x);
        for x in tiles.clone() {
            offsets[x + 1] += 1;
        }
        spans.push((i, tiles.start as u32, tiles.end as u32));
    }
    for x in 0..tiles_x {
        offsets[x + 1] += offsets[x];
    }
    let mut next = offsets.clone();
    let mut entries = vec![0u32; offsets[tiles_x] as usize];
    for (i, start, end) in spans {
        for x in start..end {
            entries[next[x as usize] as usize] = i;
            next[x as usize] += 1;
        }
    }
    TileRow { offsets, entries }
}

/// Leftmost and rightmost dx of the ellipse within the band `dy` in `[y0, y1]`.
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

/// Indices of the drawn Gaussians, nearest first: a stable radix sort of the depth's bits.
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
