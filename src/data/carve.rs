//! The two halves of carving: alpha masks that answer "is this point, or anything near it, seen?", and the grid
//! of cells that survive. Used by `hull` alone.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::dataset::Split;
use super::hull::Aabb;

/// One view, ready to be projected into many times.
struct View {
    rotation: DMat3,
    translation: DVec3,
    focal: [f64; 2],
    centre: [f64; 2],
    frame: usize,
}

impl View {
    /// Continuous pixel and depth; none behind the camera.
    fn project(&self, p: DVec3) -> Option<(f64, f64, f64)> {
        let q = self.rotation * p + self.translation;
        (q.z > 1e-9).then(|| {
            (self.focal[0] * q.x / q.z + self.centre[0], self.focal[1] * q.y / q.z + self.centre[1], q.z)
        })
    }
}

/// The alpha masks of a split, its views grouped by time.
pub(super) struct Masks<'a> {
    split: &'a Split,
    groups: Vec<Vec<View>>,
    threshold: u8,
    opaque: bool,
    width: usize,
    height: usize,
}

impl<'a> Masks<'a> {
    /// `threshold` in [0, 1]: alpha above it counts.
    pub(super) fn new(split: &'a Split, threshold: f32) -> Self {
        let threshold = (threshold.clamp(0.0, 1.0) * 255.0).floor() as u8;
        let loaded = split.images.len() == split.frames.len();
        let opaque = !loaded || split.images.pixels.par_chunks_exact(4).all(|p| p[3] > threshold);
        let times = split.times();
        let mut groups: Vec<Vec<View>> = times.iter().map(|_| Vec::new()).collect();
        for (frame, f) in split.frames.iter().enumerate() {
            let group = times.partition_point(|t| *t < f.time);
            let (rotation, translation) = f.camera.world_to_camera_opencv();
            let (focal, centre) = ([f.camera.fx, f.camera.fy], [f.camera.cx, f.camera.cy]);
            groups[group].push(View { rotation, translation, focal, centre, frame });
        }
        let (width, height) = (split.images.width as usize, split.images.height as usize);
        Self { split, groups, threshold, opaque, width, height }
    }

    /// Whether there is nothing to carve with: no image, or no transparent pixel.
    pub(super) fn opaque(&self) -> bool {
        self.opaque
    }

    /// The RGBA bytes of a pixel; none outside the image.
    fn pixel(&self, frame: usize, x: f64, y: f64) -> Option<&[u8]> {
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64;
        inside.then(|| {
            let at = (y as usize * self.width + x as usize) * 4;
            &self.split.images.frame(frame)[at..at + 4]
        })
    }

    fn holds(&self, group: usize, p: DVec3) -> bool {
        let mut seen = false;
        for view in &self.groups[group] {
            let Some((x, y, _)) = view.project(p) else { continue };
            let Some(pixel) = self.pixel(view.frame, x, y) else { continue };
            if pixel[3] <= self.threshold {
                return false;
            }
            seen = true;
        }
        seen
    }

    /// A time group whose hull holds `p`, looking at `first` first.
    pub(super) fn group_holding(&self, p: DVec3, first: usize) -> Option<usize> {
        let n = self.groups.len();
        (0..n).map(|i| (first + i) % n).find(|g| self.holds(*g, p))
    }

    /// Mean straight RGB in [0, 1], weighted by alpha, over the views of `group`; mid-grey if none.
    pub(super) fn mean_colour(&self, group: usize, p: DVec3) -> [f32; 3] {
        let (mut sum, mut weight) = ([0u64; 3], 0u64);
        if self.split.images.len() == self.split.frames.len() {
            for view in self.groups.get(group).into_iter().flatten() {
                let Some((x, y, _)) = view.project(p) else { continue };
                let Some(pixel) = self.pixel(view.frame, x, y) else { continue };
                let a = u64::from(pixel[3]);
                weight += a;
                (0..3).for_each(|c| sum[c] += a * u64::from(pixel[c]));
            }
        }
        match weight {
            0 => [0.5; 3],
            w => sum.map(|s| (s as f64 / (255.0 * w as f64)) as f32),
        }
    }

    /// Summed-area tables `[(height + 1) * (width + 1)]` of the masks of one group.
    fn tables(&self, group: usize) -> Vec<Vec<u32>> {
        let stride = self.width + 1;
        let table = |view: &View| {
            let image = self.split.images.frame(view.frame);
            let mut sums = vec![0u32; stride * (self.height + 1)];
            for (y, row) in image.chunks_exact(self.width * 4).enumerate() {
                let mut along = 0;
                for (x, pixel) in row.chunks_exact(4).enumerate() {
                    along += u32::from(pixel[3] > self.threshold);
                    sums[(y + 1) * stride + x + 1] = sums[y * stride + x + 1] + along;
                }
            }
            sums
        };
        self.groups[group].par_iter().map(table).collect()
    }

    /// Whether every view of `group` that has `p` in its image has a seen pixel within `radius` (world units).
    fn near(&self, group: usize, tables: &[Vec<u32>], p: DVec3, radius: f64) -> bool {
        let (stride, mut seen) = (self.width + 1, false);
        let (w, h) = (self.width as f64, self.height as f64);
        for (view, sums) in self.groups[group].iter().zip(tables) {
            let Some((x, y, depth)) = view.project(p) else { continue };
            let (rx, ry) = (radius * view.focal[0] / depth, radius * view.focal[1] / depth);
            let (x0, x1, y0, y1) = (x - rx, x + rx, y - ry, y + ry);
            if x0 < 0.0 || y0 < 0.0 || x1 >= w || y1 >= h {
                // What leaves the image is unknown there, not empty; in part inside counts as seen.
                seen |= x1 >= 0.0 && y1 >= 0.0 && x0 < w && y0 < h;
                continue;
            }
            let (x0, y0, x1, y1) = (x0 as usize, y0 as usize, x1 as usize + 1, y1 as usize + 1);
            let inside = sums[y1 * stride + x1] + sums[y0 * stride + x0];
            if inside == sums[y0 * stride + x1] + sums[y1 * stride + x0] {
                return false;
            }
            seen = true;
        }
        seen
    }
}

/// A cell that survives, and the first time group that keeps it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cell {
    pub(super) index: [u32; 3],
    pub(super) group: usize,
}

/// The surviving cells of an `n * n * n` grid over a box.
pub(super) struct Grid {
    bounds: Aabb,
    n: usize,
    pub(super) cells: Vec<Cell>,
}

impl Grid {
    /// One cell, the whole box.
    pub(super) fn full(bounds: Aabb) -> Self {
        Self { bounds, n: 1, cells: vec![Cell { index: [0; 3], group: 0 }] }
    }

    /// Tests all cells; `reach` in cell sides is how far from a cell's middle a seen pixel may be (0.87 covers the
    /// whole cell).
    pub(super) fn carve(masks: &Masks<'_>, bounds: Aabb, n: usize, reach: f64) -> Self {
        let all = (0..n * n * n).map(|i| [(i % n) as u32, (i / n % n) as u32, (i / n / n) as u32]).collect();
        Self::keep(masks, bounds, n, reach, all)
    }

    /// The grid of half the cell side, testing only inside surviving cells.
    pub(super) fn refine(&self, masks: &Masks<'_>, reach: f64) -> Self {
        let children = self
            .cells
            .iter()
            .flat_map(|c| (0..8u32).map(|k| [0, 1, 2].map(|axis| 2 * c.index[axis] + (k >> axis & 1))))
            .collect();
        Self::keep(masks, self.bounds, 2 * self.n, reach, children)
    }

    fn keep(masks: &Masks<'_>, bounds: Aabb, n: usize, reach: f64, candidates: Vec<[u32; 3]>) -> Self {
        let mut grid = Self { bounds, n, cells: Vec::new() };
        let radius = reach * grid.cell().max_element();
        let mut left = candidates;
        // Time by time, so that only one time's tables are in memory, and a kept cell is not asked again.
        for group in 0..masks.groups.len() {
            let tables = masks.tables(group);
            let kept: Vec<bool> = left
                .par_iter()
                .map(|c| masks.near(group, &tables, grid.point(*c, DVec3::splat(0.5)), radius))
                .collect();
            let split = left.iter().zip(&kept);
            grid.cells.extend(split.filter(|(_, k)| **k).map(|(c, _)| Cell { index: *c, group }));
            let mut kept = kept.iter();
            left.retain(|_| !kept.next().copied().unwrap_or(false));
        }
        grid
    }

    /// Side lengths of a cell.
    pub(super) fn cell(&self) -> DVec3 {
        self.bounds.size() / self.n as f64
    }

    /// The world point at `within` (`[0, 1]` per axis) of a cell.
    pub(super) fn point(&self, index: [u32; 3], within: DVec3) -> DVec3 {
        self.bounds.min + (DVec3::from_array(index.map(f64::from)) + within) * self.cell()
    }

    /// The box of the surviving cells; none if there are none.
    pub(super) fn bounds(&self) -> Option<Aabb> {
        let corner = |within: f64, pick: fn(DVec3, DVec3) -> DVec3| {
            self.cells.iter().map(|c| self.point(c.index, DVec3::splat(within))).reduce(pick)
        };
        Some(Aabb { min: corner(0.0, DVec3::min)?, max: corner(1.0, DVec3::max)? })
    }
}
