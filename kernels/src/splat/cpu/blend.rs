//! Front-to-back blending: one task per row of tiles, a row of pixels in SIMD lanes.

use super::TILE;
use super::bin::{DepthOrder, DrawnGaussian, GATHER, RowLists, TileBins, TileRow};
use super::lanes::{any, bits, wide};
use super::project::Splat2d;
use super::rows::{CENTRES, RowTerms};
use super::rule::Rule;
use crate::backend::zeros;
use crate::splat::SplatSettings;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

/// Pixels per tile.
const AREA: usize = TILE * TILE;

/// A per-pixel quantity of a tile, row-major, aligned for the widest vectors.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub(crate) struct Plane(pub [f32; AREA]);

impl Plane {
    pub(crate) const ZERO: Plane = Plane([0.0; AREA]);
}

/// Location of a tile in the image.
#[derive(Clone, Copy)]
pub(crate) struct TileArea {
    pub x0: usize,
    pub y0: usize,
    pub columns: usize,
    pub rows: usize,
}

impl TileArea {
    pub(crate) fn new(t: usize, tiles_x: usize, width: usize, height: usize) -> Self {
        let (x0, y0) = (t % tiles_x * TILE, t / tiles_x * TILE);
        Self { x0, y0, columns: TILE.min(width - x0), rows: TILE.min(height - y0) }
    }

    /// Returns the initial transmittance: 1 inside the image, 0 in the part of the tile beyond its edge, where pixels
    /// count as finished from the start.
    pub(crate) fn transmittance(&self) -> Plane {
        let mut t = Plane::ZERO;
        for row in 0..self.rows {
            t.0[row * TILE..][..self.columns].fill(1.0);
        }
        t
    }

    /// Returns the bit mask of the rows that hold pixels.
    pub(crate) fn live_rows(&self) -> u32 {
        (1u32 << self.rows) - 1
    }
}

/// State of a tile while it is drawn.
struct TileState {
    /// Transmittance while a pixel is unfinished; negated once it is finished.
    left: Plane,
    colour: [Plane; 3],
    /// Bit mask of the unfinished rows.
    live: u32,
}

/// Renders `[H, W, 4]`; also returns the Gaussians that each tile was drawn with, and the rows that they touched.
///
/// One task per row of tiles lists and draws slab by slab of depth until its tiles are finished.
pub(crate) fn blend(order: &DepthOrder, settings: &SplatSettings) -> (Vec<f32>, TileBins) {
    blend_rows(order, settings, |_| true)
}

/// As [`blend`], but only for the rows of tiles that are `wanted`; the others stay empty.
pub(crate) fn blend_rows(
    order: &DepthOrder,
    settings: &SplatSettings,
    wanted: impl Fn(usize) -> bool + Sync,
) -> (Vec<f32>, TileBins) {
    let (width, height) = (settings.camera.width, settings.camera.height);
    let tiles_x = width.div_ceil(TILE);
    let mut image = zeros(width * height * 4);
    let rows = image
        .par_chunks_mut(width * TILE * 4)
        .enumerate()
        .map(|(row, strip)| match wanted(row) {
            true => blend_row(order, settings, row, tiles_x, strip),
            false => TileRow { offsets: vec![0; tiles_x + 1], entries: Vec::new() },
        })
        .collect();
    (image, TileBins { tiles_x, rows })
}

fn blend_row(
    order: &DepthOrder,
    settings: &SplatSettings,
    row: usize,
    tiles_x: usize,
    strip: &mut [f32],
) -> TileRow<DrawnGaussian> {
    let (width, height) = (settings.camera.width, settings.camera.height);
    let arch = crate::arch();
    let mut states: Vec<Option<Box<TileState>>> = (0..tiles_x).map(|_| None).collect();
    let mut used: Vec<Vec<DrawnGaussian>> = vec![Vec::new(); tiles_x];
    let mut takes = vec![true; tiles_x];
    let mut lists = RowLists::default();
    for slab in order.slabs() {
        wide!(order.list(slab, row, &takes, &mut lists));
        for x in 0..tiles_x {
            let entries = &lists.row.entries[lists.row.offsets[x] as usize..lists.row.offsets[x + 1] as usize];
            if entries.is_empty() {
                continue;
            }
            let area = TileArea::new(row * tiles_x + x, tiles_x, width, height);
            let state = states[x].get_or_insert_with(|| {
                Box::new(TileState { left: area.transmittance(), colour: [Plane::ZERO; 3], live: area.live_rows() })
            });
            arch.dispatch(BlendTile { splats: &order.splats, entries, area, state, used: &mut used[x] });
            takes[x] = state.live != 0;
        }
        if !takes.contains(&true) {
            break;
        }
    }
    for (x, state) in states.iter().enumerate() {
        let area = TileArea::new(row * tiles_x + x, tiles_x, width, height);
        write_tile(state.as_deref(), &area, width, settings.rendering.background, strip);
    }
    let mut offsets = vec![0u32];
    let mut entries = Vec::with_capacity(used.iter().map(Vec::len).sum());
    for list in &used {
        entries.extend_from_slice(list);
        offsets.push(entries.len() as u32);
    }
    TileRow { offsets, entries }
}

/// Writes a tile's pixels over the background into the strip of its row of tiles.
fn write_tile(state: Option<&TileState>, area: &TileArea, width: usize, background: [f32; 3], strip: &mut [f32]) {
    for r in 0..area.rows {
        for c in 0..area.columns {
            let p = r * TILE + c;
            let pixel = &mut strip[(r * width + area.x0 + c) * 4..][..4];
            match state {
                Some(state) => {
                    let left = state.left.0[p].abs();
                    for channel in 0..3 {
                        pixel[channel] = state.colour[channel].0[p] + left * background[channel];
                    }
                    pixel[3] = 1.0 - left;
                }
                None => pixel[..3].copy_from_slice(&background),
            }
        }
    }
}

/// Calls `draw` with each listed Gaussian until it returns false. They are copied some at a time, so that their cache
/// misses overlap.
#[inline(always)]
pub(crate) fn each<E>(
    splats: &[Splat2d],
    entries: &[E],
    rank: impl Fn(&E) -> u32,
    mut draw: impl FnMut(usize, &E, &Splat2d) -> bool,
) {
    let mut near = [Splat2d::default(); GATHER];
    for (block, entries) in entries.chunks(GATHER).enumerate() {
        for (to, entry) in near.iter_mut().zip(entries) {
            *to = splats[rank(entry) as usize];
        }
        for (k, (splat, entry)) in near.iter().zip(entries).enumerate() {
            if !draw(block * GATHER + k, entry, splat) {
                return;
            }
        }
    }
}

struct BlendTile<'a> {
    splats: &'a [Splat2d],
    /// Ranks of the Gaussians to draw.
    entries: &'a [u32],
    area: TileArea,
    state: &'a mut TileState,
    /// Where those are added that touched a pixel.
    used: &'a mut Vec<DrawnGaussian>,
}

impl WithSimd for BlendTile<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { splats, entries, area, state, used } = self;
        let vectors = TILE / S::F32_LANES;
        let TileState { left, colour: [red, green, blue], live: live_rows } = state;
        let mut live = *live_rows;
        let (red, green, blue) = (
            S::as_mut_simd_f32s(&mut red.0).0,
            S::as_mut_simd_f32s(&mut green.0).0,
            S::as_mut_simd_f32s(&mut blue.0).0,
        );
        let open = S::as_mut_simd_f32s(&mut left.0).0;
        let centres = S::as_simd_f32s(&CENTRES.0).0;
        let rule = Rule::new(simd);
        let zero = simd.splat_f32s(0.0);
        let mut terms = RowTerms::default();

        each(
            splats,
            entries,
            |rank| *rank,
            |_, &rank, s| {
                let mut rows = terms.set(simd, s, &area) & live;
                let offset = simd.splat_f32s(area.x0 as f32 - s.x);
                let qa = simd.splat_f32s(s.qa);
                let colour = s.colour.map(|c| simd.splat_f32s(c));
                let (mut hit, mut finished) = (0, 0);
                // where a row is one vector, without a branch on what it holds, which no processor could predict
                while rows != 0 {
                    let row = rows.trailing_zeros() as usize % TILE;
                    rows &= rows - 1;
                    let (qb, constant) = (simd.splat_f32s(terms.qb.0[row]), simd.splat_f32s(terms.constant.0[row]));
                    let (mut touches, mut takes) = (0, 0);
                    for v in 0..vectors {
                        let at = row * vectors + v;
                        let dx = simd.add_f32s(centres[v], offset);
                        let power = rule.power(simd, dx, [qa, qb, constant]);
                        let t = open[at];
                        let touched = rule.touched(simd, power, t);
                        if vectors > 1 && !any(simd, touched) {
                            takes |= bits(simd, simd.greater_than_f32s(t, zero));
                            continue;
                        }
                        let effect = rule.evaluate(simd, power, t, touched);
                        red[at] = simd.mul_add_e_f32s(effect.weight, colour[0], red[at]);
                        green[at] = simd.mul_add_e_f32s(effect.weight, colour[1], green[at]);
                        blue[at] = simd.mul_add_e_f32s(effect.weight, colour[2], blue[at]);
                        let after = rule.left(simd, t, &effect, touched);
                        open[at] = after;
                        touches |= bits(simd, touched);
                        takes |= bits(simd, simd.greater_than_f32s(after, zero));
                    }
                    hit |= u32::from(touches != 0) << row;
                    finished |= u32::from(takes == 0) << row;
                }
                live &= !finished;
                if hit != 0 {
                    used.push(DrawnGaussian { rank, rows: hit });
                }
                live != 0
            },
        );
        *live_rows = live;
    }
}
