//! The tiles that Gaussians reach within a row of tiles, for a block of Gaussians at a time: an array for each number and
//! loops without branches, which the compiler makes into vectors.

use super::TILE;
use super::bin::GATHER;
use super::project::Splat2d;
use crate::splat::ALPHA_MIN;
use std::ops::Range;

/// Room for rounding, in pixels: a tile must never lose a pixel that blending would have accepted.
const ROOM: f32 = 0.01;

/// A number for each Gaussian of a block.
type Each = [f32; GATHER];

/// A block of Gaussians, and the tiles of a row that each of them reaches.
#[derive(Default)]
pub(crate) struct Reach {
    x: Each,
    y: Each,
    extent: [Each; 2],
    /// `a dx^2 + 2 b dx dy + c dy^2 <= k` inside the ellipse alpha >= 1/255.
    ellipse: [Each; 4],
    /// First tile and one past the last.
    tiles: [[u32; GATHER]; 2],
}

impl Reach {
    /// Finds the tiles of `row` that are reached by up to [`GATHER`] Gaussians, given by rank.
    #[inline(always)]
    pub(crate) fn find(&mut self, splats: &[Splat2d], ranks: &[u32], row: usize, tiles_x: usize) {
        let [a, b, c, k] = &mut self.ellipse;
        for (j, &rank) in ranks.iter().enumerate() {
            let s = &splats[rank as usize];
            (self.x[j], self.y[j]) = (s.x, s.y);
            (self.extent[0][j], self.extent[1][j]) = (s.extent[0], s.extent[1]);
            (a[j], b[j], c[j], k[j]) = (-s.qa, -0.5 * s.qb, -s.qc, s.log2_opacity - ALPHA_MIN.log2());
        }
        let (top, bottom) = ((row * TILE) as f32 + 0.5, (row * TILE + TILE) as f32 - 0.5);
        for j in 0..GATHER {
            let (x, y, [ex, ey]) = (self.x[j], self.y[j], [self.extent[0][j], self.extent[1][j]]);
            let (left, right) = chord([a[j], b[j], c[j], k[j]], [ex, ey], [top - y, bottom - y]);
            let (first, end) = tile_span(x + left - ROOM, x + right + ROOM, tiles_x);
            (self.tiles[0][j], self.tiles[1][j]) = (first, end);
        }
    }

    /// Returns the tiles that the Gaussian at `j` reaches.
    #[inline(always)]
    pub(crate) fn tiles(&self, j: usize) -> Range<usize> {
        self.tiles[0][j] as usize..self.tiles[1][j] as usize
    }
}

/// Returns the rows and the columns of tiles, first and one past the last, that hold the Gaussian's box.
#[inline(always)]
pub(crate) fn tile_box(s: &Splat2d, [tiles_x, tiles_y]: [usize; 2]) -> [[u16; 2]; 2] {
    let (top, bottom) = tile_span(s.y - s.extent[1], s.y + s.extent[1], tiles_y);
    let (left, right) = tile_span(s.x - s.extent[0] - ROOM, s.x + s.extent[0] + ROOM, tiles_x);
    // an image has at most 65535 tiles a side
    [[top as u16, bottom as u16], [left as u16, right as u16]]
}

/// Returns the first tile that holds a pixel centre between `low` and `high`, and one past the last.
#[inline(always)]
fn tile_span(low: f32, high: f32, tiles: usize) -> (u32, u32) {
    // pixel k has its centre at k + 0.5; images are far smaller than what f32 counts exactly
    let limit = (tiles * TILE) as f32;
    let first = (low - 0.5).ceil().max(0.0).min(limit) as u32 / TILE as u32;
    let end = ((high - 0.5).floor() + TILE as f32).max(0.0).min(limit) as u32 / TILE as u32;
    (first.min(end), end)
}

/// Returns the leftmost and rightmost dx of the ellipse within the band `y0 <= dy <= y1`.
#[inline(always)]
fn chord([a, b, c, k]: [f32; 4], [ex, ey]: [f32; 2], [y0, y1]: [f32; 2]) -> (f32, f32) {
    // the rightmost point of the whole ellipse lies at dy = -b/c * extent, the leftmost opposite to it
    let dy_right = -b / c * ex;
    let (inside_right, inside_left) = (y0 <= dy_right && dy_right <= y1, y0 <= -dy_right && -dy_right <= y1);
    let slope = b * b - a * c;
    let inverse = 1.0 / a;
    let (d0, d1) = (y0.max(-ey).min(ey), y1.max(-ey).min(ey));
    let (root0, root1) = ((slope * d0 * d0 + a * k).max(0.0).sqrt(), (slope * d1 * d1 + a * k).max(0.0).sqrt());
    let (right0, right1) = ((root0 - b * d0) * inverse, (root1 - b * d1) * inverse);
    let (left0, left1) = ((-b * d0 - root0) * inverse, (-b * d1 - root1) * inverse);
    let right = if inside_right { ex } else { right0.max(right1) };
    let left = if inside_left { -ex } else { left0.min(left1) };
    // what overflowed is not cut
    let finite = left.is_finite() && right.is_finite();
    (if finite { left.max(-ex) } else { -ex }, if finite { right.min(ex) } else { ex })
}
