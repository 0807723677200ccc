//! Assignment of Gaussians to the tiles that they touch, in depth order.
//!
//! The Gaussians are sorted by depth once; each then writes one entry per tile that its ellipse alpha >= 1/255 reaches
//! into, in depth order, and a stable sort by tile leaves each tile's list in that order. Ties in depth keep the order
//! of the indices, as both sorts are stable.

use super::TILE;
use super::project::CULLED;
use crate::cube::prelude::*;
use crate::cube::{UNITS, Words, cubes, is_finite, scan, sort};
use crate::splat::ALPHA_MIN;

/// The entries of all tiles.
#[derive(Clone, Debug)]
pub(in crate::splat) struct TileEntries {
    /// Gaussians by depth, `[N]`.
    pub order: Words,
    /// Where the entries of each position in `order` start, `[N + 1]`; the last is their number.
    pub starts: Words,
    /// The Gaussian of each entry, in the order in which they were written.
    pub gaussians: Words,
    /// Entries by tile, nearest first.
    pub sorted: Words,
    /// Where each tile starts in `sorted`, `[tiles + 1]`.
    pub tiles: Words,
    /// Number of entries there is room for.
    pub capacity: usize,
}

/// Returns the Gaussians by depth, and where their entries start.
pub(super) fn order(
    client: &Client,
    screen: &Words,
    keys: Words,
    indices: Words,
    n: usize,
    tiles: [usize; 2],
) -> (Words, Words) {
    let len = Words::u32s(client, &[n as u32]);
    let (keys, order) = sort::by_key(client, keys, indices, &len, 32);
    let starts = Words::empty(client, n + 1);
    count_tiles::launch(
        client,
        cubes(n + 1, UNITS),
        CubeDim::new_1d(UNITS),
        screen.arg(),
        keys.arg(),
        order.arg(),
        starts.arg(),
        n as u32,
        tiles[0] as u32,
        tiles[1] as u32,
    );
    scan::exclusive(client, &starts);
    (order, starts)
}

/// Lists the entries, sorts them by tile and finds where each tile starts.
pub(super) fn list(
    client: &Client,
    screen: &Words,
    order: Words,
    starts: Words,
    n: usize,
    tiles: [usize; 2],
    capacity: usize,
) -> TileEntries {
    let dim = CubeDim::new_1d(UNITS);
    let (keys, entries) = (Words::empty(client, capacity), Words::empty(client, capacity));
    let gaussians = Words::empty(client, capacity);
    let total = Words::empty(client, 1);
    emit::launch(
        client,
        cubes(n, UNITS),
        dim,
        screen.arg(),
        order.arg(),
        starts.arg(),
        keys.arg(),
        entries.arg(),
        gaussians.arg(),
        total.arg(),
        n as u32,
        tiles[0] as u32,
        tiles[1] as u32,
        capacity as u32,
    );
    let count = tiles[0] * tiles[1];
    let bits = usize::BITS - count.leading_zeros();
    let (keys, sorted) = sort::by_key(client, keys, entries, &total, bits);
    let starts_of_tiles = Words::empty(client, count + 1);
    find_tiles::launch(
        client,
        cubes(count + 1, UNITS),
        dim,
        keys.arg(),
        total.arg(),
        starts_of_tiles.arg(),
        count as u32,
        capacity as u32,
    );
    TileEntries { order, starts, gaussians, sorted, tiles: starts_of_tiles, capacity }
}

/// First tile and one past the last.
#[derive(CubeType)]
struct TileSpan {
    first: u32,
    end: u32,
}

/// Returns the tiles that hold pixel centres between `low` and `high`; pixel k has its centre at k + 0.5.
#[cube]
fn tile_span(low: f32, high: f32, tiles: u32) -> TileSpan {
    let tile = comptime!(TILE as f32);
    let most = f32::cast_from(tiles) * tile;
    let first = u32::cast_from(clamp(f32::ceil(low - 0.5f32), 0.0f32, most)) / comptime!(TILE as u32);
    let last = f32::floor(high - 0.5f32);
    let mut end = 0u32;
    if last >= 0.0f32 {
        end = min(u32::cast_from(min(last, most)) / comptime!(TILE as u32) + 1u32, tiles);
    }
    TileSpan { first: min(first, end), end }
}

/// Returns dx of the ellipse's edge at `dy`, on the side of `sign`.
#[cube]
fn edge(a: f32, b: f32, c: f32, k: f32, dy: f32, sign: f32) -> f32 {
    let disc = (b * b - a * c) * dy * dy + a * k;
    (-b * dy + sign * f32::sqrt(max(disc, 0.0f32))) / a
}

/// Returns the tiles of row `row` that the Gaussian at `at` in `screen` reaches into.
#[cube]
fn row_span(screen: &[f32], at: usize, row: u32, tiles_x: u32) -> TileSpan {
    let (x, y) = (screen[at], screen[at + 1]);
    let (a, b, c) = (-screen[at + 2], -0.5f32 * screen[at + 3], -screen[at + 4]);
    let k = screen[at + 5] - comptime!(ALPHA_MIN.ln());
    let (extent_x, extent_y) = (screen[at + 9], screen[at + 10]);
    let tile = comptime!(TILE as f32);
    let top = f32::cast_from(row) * tile + 0.5f32 - y;
    let bottom = top + tile - 1.0f32;
    // the rightmost point of the whole ellipse lies at dy = -b/c * extent, the leftmost opposite to it
    let dy_right = -b / c * extent_x;
    let (y0, y1) = (clamp(top, -extent_y, extent_y), clamp(bottom, -extent_y, extent_y));
    let mut right = extent_x;
    if !(dy_right >= top && dy_right <= bottom) {
        right = max(edge(a, b, c, k, y0, 1.0f32), edge(a, b, c, k, y1, 1.0f32));
    }
    let mut left = -extent_x;
    if !(-dy_right >= top && -dy_right <= bottom) {
        left = min(edge(a, b, c, k, y0, -1.0f32), edge(a, b, c, k, y1, -1.0f32));
    }
    if is_finite(left + right) {
        left = max(left, -extent_x);
        right = min(right, extent_x);
    } else {
        left = -extent_x;
        right = extent_x;
    }
    // slightly wider than exact: rounding must never lose a pixel that blending would have accepted
    tile_span(x + left - 0.01f32, x + right + 0.01f32, tiles_x)
}

#[cube(launch)]
fn count_tiles(screen: &[f32], keys: &[u32], order: &[u32], counts: &mut [u32], n: u32, tiles_x: u32, tiles_y: u32) {
    let rank = ABSOLUTE_POS as u32;
    if rank <= n {
        let mut count = 0u32;
        if rank < n && keys[rank as usize] != comptime!(CULLED) {
            let at = order[rank as usize] as usize * 12;
            let rows = tile_span(screen[at + 1] - screen[at + 10], screen[at + 1] + screen[at + 10], tiles_y);
            for row in rows.first..rows.end {
                let span = row_span(screen, at, row, tiles_x);
                count += span.end - span.first;
            }
        }
        counts[rank as usize] = count;
    }
}

#[cube(launch)]
fn emit(
    screen: &[f32],
    order: &[u32],
    starts: &[u32],
    keys: &mut [u32],
    entries: &mut [u32],
    gaussians: &mut [u32],
    total: &mut [u32],
    n: u32,
    tiles_x: u32,
    tiles_y: u32,
    capacity: u32,
) {
    let rank = ABSOLUTE_POS as u32;
    if rank == 0u32 {
        total[0] = min(starts[n as usize], capacity);
    }
    if rank < n {
        let mut next = starts[rank as usize];
        let end = min(starts[rank as usize + 1], capacity);
        if end > next {
            let gaussian = order[rank as usize];
            let at = gaussian as usize * 12;
            let rows = tile_span(screen[at + 1] - screen[at + 10], screen[at + 1] + screen[at + 10], tiles_y);
            for row in rows.first..rows.end {
                let span = row_span(screen, at, row, tiles_x);
                for column in span.first..span.end {
                    if next < end {
                        keys[next as usize] = row * tiles_x + column;
                        entries[next as usize] = next;
                        gaussians[next as usize] = gaussian;
                        next += 1u32;
                    }
                }
            }
            // two compilations of the same arithmetic may round differently: entries that were counted but not found
            // again go behind all tiles
            while next < end {
                keys[next as usize] = tiles_x * tiles_y;
                entries[next as usize] = next;
                gaussians[next as usize] = gaussian;
                next += 1u32;
            }
        }
    }
}

/// Finds where each tile's entries start: at the first whose key is not below the tile.
#[cube(launch)]
fn find_tiles(keys: &[u32], total: &[u32], starts: &mut [u32], tiles: u32, capacity: u32) {
    let tile = ABSOLUTE_POS as u32;
    if tile <= tiles {
        let mut low = 0u32;
        let mut high = min(total[0], capacity);
        while low < high {
            let middle = (low + high) / 2u32;
            if keys[middle as usize] < tile {
                low = middle + 1u32;
            } else {
                high = middle;
            }
        }
        starts[tile as usize] = low;
    }
}
