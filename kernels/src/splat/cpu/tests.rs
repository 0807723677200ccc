//! The rows and tiles of a Gaussian against the compositing rule, pixel by pixel.

use super::TILE;
use super::bin::GATHER;
use super::blend::TileArea;
use super::project::Splat2d;
use super::reach::{Reach, tile_box};
use super::rows::RowTerms;
use crate::splat::ALPHA_MIN;
use proptest::prelude::*;
use pulp::{Arch, Simd, WithSimd};

/// Side of the image in pixels, and in tiles: the last tile lies half beyond the edge.
const SIDE: usize = 72;
const TILES: usize = SIDE.div_ceil(TILE);

/// A Gaussian with standard deviations `long` and `short` in pixels, turned by `angle`.
fn splat([x, y]: [f32; 2], [long, short]: [f32; 2], angle: f32, opacity: f32) -> Splat2d {
    let (sin, cos) = f64::from(angle).sin_cos();
    let (l, s) = (f64::from(long).powi(2), f64::from(short).powi(2));
    let (a, b, c) = (l * cos * cos + s * sin * sin, (l - s) * sin * cos, l * sin * sin + s * cos * cos);
    let half = 0.5 * std::f64::consts::LOG2_E / (l * s);
    let reach = 2.0 * f64::from(opacity / ALPHA_MIN).ln();
    Splat2d {
        x,
        y,
        qa: (-half * c) as f32,
        qb: (2.0 * half * b) as f32,
        qc: (-half * a) as f32,
        log2_opacity: opacity.log2(),
        extent: [(reach * a).sqrt() as f32, (reach * c).sqrt() as f32],
        radius: 1,
        ..Splat2d::default()
    }
}

fn splats() -> impl Strategy<Value = Splat2d> {
    let centre = [-20.0..SIDE as f32 + 20.0, -20.0..SIDE as f32 + 20.0];
    // thin ones lose digits where the terms of the power cancel
    let deviations = [0.2f32.ln()..40f32.ln(), 0.2f32.ln()..40f32.ln()];
    (centre, deviations, 0.0..std::f32::consts::PI, 0.005f32..1.0)
        .prop_map(|(centre, deviations, angle, opacity)| splat(centre, deviations.map(f32::exp), angle, opacity))
}

/// Returns whether alpha reaches 1/255 at a pixel, within the Gaussian's extent, in f64 but for a margin within which
/// rounding may decide either way.
fn reaches(s: &Splat2d, column: usize, row: usize) -> bool {
    let (dx, dy) = (column as f64 + 0.5 - f64::from(s.x), row as f64 + 0.5 - f64::from(s.y));
    let terms = [f64::from(s.qa) * dx * dx, f64::from(s.qb) * dx * dy, f64::from(s.qc) * dy * dy];
    let power = terms.iter().sum::<f64>() + f64::from(s.log2_opacity);
    let margin = 1e-4 + 1e-6 * terms.iter().map(|t| t.abs()).sum::<f64>();
    power >= f64::from(ALPHA_MIN.log2()) + margin && dy.abs() < f64::from(s.extent[1]) * (1.0 - 1e-6)
}

/// Returns the half width in pixels of the ellipse alpha >= 1/255 where it is narrowest.
fn short_half_axis(s: &Splat2d) -> f32 {
    let (a, b, c) = (-s.qa, -0.5 * s.qb, -s.qc);
    let steepest = 0.5 * (a + c) + (0.5 * (a - c)).hypot(b);
    ((s.log2_opacity - ALPHA_MIN.log2()) / steepest).sqrt()
}

struct Rows<'a> {
    splat: &'a Splat2d,
    area: TileArea,
}

impl WithSimd for Rows<'_> {
    type Output = u32;

    fn with_simd<S: Simd>(self, simd: S) -> u32 {
        RowTerms::default().set(simd, self.splat, &self.area)
    }
}

proptest! {
    #[test]
    fn no_row_is_missed(splat in splats()) {
        for t in 0..TILES * TILES {
            let area = TileArea::new(t, TILES, SIDE, SIDE);
            let (x0, y0) = (area.x0, area.y0);
            for arch in [Arch::Scalar, crate::arch()] {
                let found = arch.dispatch(Rows { splat: &splat, area: TileArea::new(t, TILES, SIDE, SIDE) });
                prop_assert_eq!(found >> TILE, 0);
                for row in 0..TILE {
                    let reached = (0..TILE).any(|column| reaches(&splat, x0 + column, y0 + row));
                    prop_assert!(!reached || found >> row & 1 == 1, "tile {}, row {} of {:?}", t, row, splat);
                }
            }
        }
    }

    #[test]
    fn few_rows_are_found_in_vain(splat in splats()) {
        // a thin one may cross many rows between their pixel centres
        if short_half_axis(&splat) <= 1.0 {
            return Ok(());
        }
        let (mut found, mut reached) = (0, 0);
        for t in 0..TILES * TILES {
            let area = TileArea::new(t, TILES, SIDE, SIDE);
            let (x0, y0) = (area.x0, area.y0);
            found += crate::arch().dispatch(Rows { splat: &splat, area }).count_ones();
            let any = |row: &usize| (0..TILE).any(|column| reaches(&splat, x0 + column, y0 + row));
            reached += (0..TILE).filter(any).count() as u32;
        }
        prop_assert!(found <= reached + reached / 2 + 16, "{} found, {} reached by {:?}", found, reached, splat);
    }

    #[test]
    fn no_tile_is_missed(some in prop::collection::vec(splats(), 1..GATHER + 1)) {
        let ranks: Vec<u32> = (0..some.len() as u32).collect();
        let mut reach = Reach::default();
        for row in 0..TILES {
            reach.find(&some, &ranks, row, TILES);
            for (j, splat) in some.iter().enumerate() {
                let tiles = reach.tiles(j);
                let [rows, columns] = tile_box(splat, [TILES, TILES]);
                prop_assert!(tiles.end <= TILES);
                for x in 0..TILES {
                    let any = |r: usize| (0..TILE).any(|c| reaches(splat, x * TILE + c, row * TILE + r));
                    if (0..TILE).any(any) {
                        prop_assert!(tiles.contains(&x), "tile {}, row {} of {:?}", x, row, splat);
                        prop_assert!((rows[0]..rows[1]).contains(&(row as u16)));
                        prop_assert!((columns[0]..columns[1]).contains(&(x as u16)));
                    }
                }
            }
        }
    }
}

#[test]
fn what_cannot_be_compared_is_not_ruled_out() {
    let flat = Splat2d { x: 8.0, y: 8.0, extent: [f32::MAX; 2], ..Splat2d::default() };
    for arch in [Arch::Scalar, crate::arch()] {
        assert_eq!(arch.dispatch(Rows { splat: &flat, area: TileArea::new(0, TILES, SIDE, SIDE) }), 0xffff);
    }
    // away from its row, both the power and its bound are infinite, and their sum is NaN
    let steep = Splat2d { y: -8.0, qa: -1.0, qc: -f32::MAX, ..flat };
    for arch in [Arch::Scalar, crate::arch()] {
        assert_eq!(arch.dispatch(Rows { splat: &steep, area: TileArea::new(0, TILES, SIDE, SIDE) }), 0xffff);
    }
    let mut reach = Reach::default();
    reach.find(&[flat], &[0], 0, TILES);
    assert_eq!(reach.tiles(0), 0..TILES);
}
