//! Front-to-back blending, a task a tile, a row of pixels in SIMD lanes.

use super::TILE;
use super::bin::Bins;
use super::lanes::{any, exp2};
use super::project::Splat2d;
use crate::splat::{ALPHA_MAX, ALPHA_MIN, SplatSettings, TRANSMITTANCE_MIN};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Pixels of a tile.
const AREA: usize = TILE * TILE;

/// A per-pixel quantity of a tile, row-major, aligned for the widest vectors.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub(super) struct Plane(pub [f32; AREA]);

impl Plane {
    pub(super) const ZERO: Plane = Plane([0.0; AREA]);
}

/// Where a tile lies in the image.
#[derive(Clone, Copy)]
pub(super) struct TileArea {
    pub x0: usize,
    pub y0: usize,
    pub columns: usize,
    pub rows: usize,
}

impl TileArea {
    pub(super) fn new(t: usize, tiles_x: usize, width: usize, height: usize) -> Self {
        let (x0, y0) = (t % tiles_x * TILE, t / tiles_x * TILE);
        Self { x0, y0, columns: TILE.min(width - x0), rows: TILE.min(height - y0) }
    }

    /// Initial transmittance: 1 inside the image, 0 in the part of the tile that hangs over its edge,
    /// where pixels count as finished from the start.
    pub(super) fn transmittance(&self) -> Plane {
        let mut t = Plane::ZERO;
        for row in 0..self.rows {
            t.0[row * TILE..][..self.columns].fill(1.0);
        }
        t
    }

    /// Bit mask of the rows that hold pixels.
    pub(super) fn live_rows(&self) -> u32 {
        (1u32 << self.rows) - 1
    }
}

/// Rows of the tile that the Gaussian can reach, as `first..=last` (empty if first > last).
#[inline(always)]
pub(super) fn row_range(s: &Splat2d, area: &TileArea) -> (usize, usize) {
    let low = (s.y - s.extent[1] - 0.5 - area.y0 as f32).ceil().max(0.0);
    let high = (s.y + s.extent[1] - 0.5 - area.y0 as f32).floor().min((area.rows - 1) as f32);
    if high < 0.0 { (1, 0) } else { (low as usize, high as usize) }
}

/// Horizontal pixel centres of a tile, relative to its left edge.
pub(super) const COLUMN_CENTRES: [f32; TILE] = {
    let mut c = [0.0; TILE];
    let mut i = 0;
    while i < TILE {
        c[i] = i as f32 + 0.5;
        i += 1;
    }
    c
};

/// Renders `[H, W, 4]`; also the number of entries each tile used before all its pixels were done.
pub(super) fn blend(splats: &[Splat2d], bins: &Bins, settings: &SplatSettings) -> (Vec<f32>, Vec<u32>) {
    let (width, height) = (settings.camera.width, settings.camera.height);
    let tiles_x = bins.tiles_x;
    let mut image = vec![0.0f32; width * height * 4];
    let mut used = vec![0u32; bins.tile_count()];
    let arch = Arch::new();
    // a chunk of the image a row of tiles; the tiles of a row write disjoint columns of it
    image.par_chunks_mut(width * TILE * 4).zip(used.par_chunks_mut(tiles_x)).enumerate().for_each(
        |(row, (strip, used))| {
            for x in 0..tiles_x {
                let t = row * tiles_x + x;
                let area = TileArea::new(t, tiles_x, width, height);
                let tile = Tile { splats, entries: bins.tile(t), area };
                let mut out = [Plane::ZERO; 3];
                let (n, transmittance) = arch.dispatch(BlendTile { tile: &tile, out: &mut out });
                used[x] = n;
                for r in 0..area.rows {
                    for c in 0..area.columns {
                        let p = r * TILE + c;
                        let f = transmittance.0[p];
                        let pixel = &mut strip[(r * width + area.x0 + c) * 4..][..4];
                        for channel in 0..3 {
                            pixel[channel] = out[channel].0[p] + f * settings.background[channel];
                        }
                        pixel[3] = 1.0 - f;
                    }
                }
            }
        },
    );
    (image, used)
}

/// A tile and what is to be drawn in it.
pub(super) struct Tile<'a> {
    pub splats: &'a [Splat2d],
    pub entries: &'a [u32],
    pub area: TileArea,
}

struct BlendTile<'a> {
    tile: &'a Tile<'a>,
    out: &'a mut [Plane; 3],
}

impl WithSimd for BlendTile<'_> {
    type Output = (u32, Plane);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> (u32, Plane) {
        let Tile { splats, entries, area } = self.tile;
        let lanes = S::F32_LANES;
        let vectors = TILE / lanes;
        // `open` is the transmittance while a pixel takes more, 0 once it is done; `rest` is what is left for the background
        let mut open = area.transmittance();
        let mut rest = open;
        let mut live = area.live_rows();
        let [red, green, blue] = self.out;
        let (red, green, blue) = (
            S::as_mut_simd_f32s(&mut red.0).0,
            S::as_mut_simd_f32s(&mut green.0).0,
            S::as_mut_simd_f32s(&mut blue.0).0,
        );
        let open = S::as_mut_simd_f32s(&mut open.0).0;
        let rest_lanes = S::as_mut_simd_f32s(&mut rest.0).0;
        let centres = S::as_simd_f32s(&COLUMN_CENTRES).0;
        let threshold = simd.splat_f32s(ALPHA_MIN.log2());
        let floor = simd.splat_f32s(-16.0);
        let alpha_max = simd.splat_f32s(ALPHA_MAX);
        let t_min = simd.splat_f32s(TRANSMITTANCE_MIN);
        let zero = simd.splat_f32s(0.0);

        for (n, &index) in entries.iter().enumerate() {
            let s = &splats[index as usize];
            let (first, last) = row_range(s, area);
            let offset = simd.splat_f32s(area.x0 as f32 - s.x);
            let (qa, lo) = (simd.splat_f32s(s.qa), simd.splat_f32s(s.log2_opacity));
            let colour = s.colour.map(|c| simd.splat_f32s(c));
            for row in first..=last {
                if live >> row & 1 == 0 {
                    continue;
                }
                let dy = (area.y0 + row) as f32 + 0.5 - s.y;
                let (qb, qc) = (simd.splat_f32s(s.qb * dy), simd.splat_f32s(s.qc * dy * dy));
                let mut row_live = false;
                for v in 0..vectors {
                    let at = row * vectors + v;
                    let dx = simd.add_f32s(centres[v], offset);
                    let inner = simd.mul_add_e_f32s(qa, dx, qb);
                    let power = simd.mul_add_e_f32s(inner, dx, simd.add_f32s(qc, lo));
                    let t = open[at];
                    let pixel_open = simd.greater_than_f32s(t, zero);
                    let touched = simd.and_m32s(simd.greater_than_or_equal_f32s(power, threshold), pixel_open);
                    if !any(simd, touched) {
                        row_live |= any(simd, pixel_open);
                        continue;
                    }
                    let alpha = simd.min_f32s(exp2(simd, simd.max_f32s(power, floor)), alpha_max);
                    let weight = simd.mul_f32s(t, alpha);
                    let after = simd.sub_f32s(t, weight);
                    let blended = simd.and_m32s(touched, simd.greater_than_f32s(after, t_min));
                    let weight = simd.select_f32s(blended, weight, zero);
                    red[at] = simd.mul_add_e_f32s(weight, colour[0], red[at]);
                    green[at] = simd.mul_add_e_f32s(weight, colour[1], green[at]);
                    blue[at] = simd.mul_add_e_f32s(weight, colour[2], blue[at]);
                    rest_lanes[at] = simd.select_f32s(blended, after, rest_lanes[at]);
                    let t = simd.select_f32s(touched, simd.select_f32s(blended, after, zero), t);
                    open[at] = t;
                    row_live |= any(simd, simd.greater_than_f32s(t, zero));
                }
                if !row_live {
                    live &= !(1 << row);
                }
            }
            if live == 0 {
                return (n as u32 + 1, rest);
            }
        }
        (entries.len() as u32, rest)
    }
}
