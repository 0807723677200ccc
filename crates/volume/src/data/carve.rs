//! The two halves of carving: alpha masks that answer whether a point, or anything near it, is seen, and the grid of
//! surviving cells. Used by `hull` alone.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::dataset::Split;
use super::hull::Aabb;

/// One view, prepared for many projections.
struct CarveView {
    rotation: DMat3,
    translation: DVec3,
    focal: [f64; 2],
    centre: [f64; 2],
    frame: usize,
}

impl CarveView {
    /// Continuous pixel and depth; none behind the camera.
    fn project(&self, p: DVec3) -> Option<(f64, f64, f64)> {
        let q = self.rotation * p + self.translation;
        (q.z > 1e-9)
            .then(|| (self.focal[0] * q.x / q.z + self.centre[0], self.focal[1] * q.y / q.z + self.centre[1], q.z))
    }
}

/// The alpha masks of a split, its views grouped by time.
pub(super) struct AlphaMasks<'a> {
    split: &'a Split,
    groups: Vec<Vec<CarveView>>,
    threshold: u8,
    opaque: bool,
    width: usize,
    height: usize,
    /// Pixels per entry of the tables, per axis.
    pool: usize,
    /// Entries of a table's row.
    stride: usize,
    /// Per group and view, the summed-area table of the mask in blocks of `pool` x `pool` pixels.
    tables: Vec<Vec<Vec<u32>>>,
    /// Per frame, one bit per pixel, set where it is seen: small enough to stay in the processor's cache.
    bits: Vec<Vec<u64>>,
}

/// Approximate maximum width of a table, so that those of all views fit in memory.
const TABLE_SIDE: usize = 256;

impl<'a> AlphaMasks<'a> {
    /// `threshold` in [0, 1]: alpha above it counts as seen.
    pub(super) fn new(split: &'a Split, threshold: f32) -> Self {
        let threshold = (threshold.clamp(0.0, 1.0) * 255.0).floor() as u8;
        let loaded = split.images.len() == split.frames.len();
        let opaque = !loaded || split.images.pixels.par_chunks_exact(4).all(|p| p[3] > threshold);
        let times = split.times();
        let mut groups: Vec<Vec<CarveView>> = times.iter().map(|_| Vec::new()).collect();
        for (frame, f) in split.frames.iter().enumerate() {
            let group = times.partition_point(|t| *t < f.time);
            let (rotation, translation) = f.camera.world_to_camera_opencv();
            let (focal, centre) = ([f.camera.fx, f.camera.fy], [f.camera.cx, f.camera.cy]);
            groups[group].push(CarveView { rotation, translation, focal, centre, frame });
        }
        let (width, height) = (split.images.width as usize, split.images.height as usize);
        let pool = width.max(height).div_ceil(TABLE_SIDE).max(1);
        let (stride, tables) = (width.div_ceil(pool) + 1, Vec::new());
        let mut masks =
            Self { split, groups, threshold, opaque, width, height, pool, stride, tables, bits: Vec::new() };
        if !opaque {
            masks.bits = (0..split.frames.len()).into_par_iter().map(|f| masks.pack(f)).collect();
            let table = |group: &Vec<CarveView>| group.par_iter().map(|v| masks.table(v.frame)).collect();
            masks.tables = masks.groups.par_iter().map(table).collect();
        }
        masks
    }

    /// Whether there is nothing to carve with: no images, or no transparent pixel.
    pub(super) fn opaque(&self) -> bool {
        self.opaque
    }

    /// The index of the pixel at which a view sees a point; `None` outside its image.
    fn pixel_of(&self, view: &CarveView, p: DVec3) -> Option<usize> {
        let (x, y, _) = view.project(p)?;
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64;
        inside.then(|| y as usize * self.width + x as usize)
    }

    fn pack(&self, frame: usize) -> Vec<u64> {
        let word = |pixels: &[u8]| {
            let bit = |(i, p): (usize, &[u8])| u64::from(p[3] > self.threshold) << i;
            pixels.chunks_exact(4).enumerate().map(bit).fold(0, |a, b| a | b)
        };
        self.split.images.frame(frame).chunks(4 * 64).map(word).collect()
    }

    fn holds(&self, group: usize, p: DVec3) -> bool {
        let mut seen = 0;
        for view in &self.groups[group] {
            let Some(pixel) = self.pixel_of(view, p) else { continue };
            if self.bits[view.frame][pixel / 64] >> (pixel % 64) & 1 == 0 {
                return false;
            }
            seen += 1;
        }
        self.enough(group, seen)
    }

    /// At least half of a time's views must have the point in their image: far out along one camera's axis no other
    /// view would rule it out.
    fn enough(&self, group: usize, seen: usize) -> bool {
        2 * seen >= self.groups[group].len().max(1)
    }

    /// A time group whose hull holds `p`, trying `first` first.
    pub(super) fn group_holding(&self, p: DVec3, first: usize) -> Option<usize> {
        let n = self.groups.len();
        (0..n).map(|i| (first + i) % n).find(|g| self.holds(*g, p))
    }

    /// Mean straight RGB in [0, 1], weighted by alpha, over the views of `group`; mid-grey if none.
    pub(super) fn mean_colour(&self, group: usize, p: DVec3) -> [f32; 3] {
        let (mut sum, mut weight) = ([0u64; 3], 0u64);
        if self.split.images.len() == self.split.frames.len() {
            for view in self.groups.get(group).into_iter().flatten() {
                let Some(pixel) = self.pixel_of(view, p) else { continue };
                let pixel = &self.split.images.frame(view.frame)[4 * pixel..4 * pixel + 4];
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

    /// The summed-area table `[height / pool + 1, width / pool + 1]` of one mask; a block counts if any of its pixels
    /// is seen.
    fn table(&self, frame: usize) -> Vec<u32> {
        let (pool, stride) = (self.pool, self.stride);
        let mut sums = vec![0u32; stride];
        sums.reserve_exact(stride * self.height.div_ceil(pool));
        let mut seen = vec![0u8; stride - 1];
        for rows in self.split.images.frame(frame).chunks(self.width * 4 * pool) {
            seen.fill(0);
            for row in rows.chunks_exact(self.width * 4) {
                for (block, seen) in row.chunks(4 * pool).zip(&mut seen) {
                    for pixel in block.chunks_exact(4) {
                        *seen |= u8::from(pixel[3] > self.threshold);
                    }
                }
            }
            let (above, mut along) = (sums.len() - stride, 0);
            sums.push(0);
            for (x, seen) in seen.iter().enumerate() {
                along += u32::from(*seen);
                sums.push(sums[above + x + 1] + along);
            }
        }
        sums
    }

    /// Whether every view of `group` with `p` in its image has a seen pixel within `radius` (scene units).
    fn near(&self, group: usize, p: DVec3, radius: f64) -> bool {
        let (stride, mut seen) = (self.stride, 0);
        let (w, h) = (self.width as f64, self.height as f64);
        for (view, sums) in self.groups[group].iter().zip(&self.tables[group]) {
            let Some((x, y, depth)) = view.project(p) else {
                continue;
            };
            let (rx, ry) = (radius * view.focal[0] / depth, radius * view.focal[1] / depth);
            let (x0, x1, y0, y1) = (x - rx, x + rx, y - ry, y + ry);
            if x0 < 0.0 || y0 < 0.0 || x1 >= w || y1 >= h {
                // What leaves the image is unknown there, neither empty nor seen.
                continue;
            }
            let [x0, y0] = [x0, y0].map(|v| v as usize / self.pool);
            let [x1, y1] = [x1, y1].map(|v| v as usize / self.pool + 1);
            let inside = sums[y1 * stride + x1] + sums[y0 * stride + x0];
            if inside == sums[y0 * stride + x1] + sums[y1 * stride + x0] {
                return false;
            }
            seen += 1;
        }
        self.enough(group, seen)
    }
}

/// A surviving cell, and the first time group that keeps it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct HullCell {
    pub(super) index: [u32; 3],
    pub(super) group: usize,
}

/// The surviving cells of an `n * n * n` grid over a box.
pub(super) struct HullGrid {
    bounds: Aabb,
    n: usize,
    pub(super) cells: Vec<HullCell>,
}

impl HullGrid {
    /// One cell, the whole box.
    pub(super) fn full(bounds: Aabb) -> Self {
        Self { bounds, n: 1, cells: vec![HullCell { index: [0; 3], group: 0 }] }
    }

    /// Tests all cells; `reach`, in cell sides, is the maximum distance of a seen pixel from a cell's centre (0.87
    /// covers the whole cell).
    pub(super) fn carve(masks: &AlphaMasks<'_>, bounds: Aabb, n: usize, reach: f64) -> Self {
        let index = |i: usize| [(i % n) as u32, (i / n % n) as u32, (i / n / n) as u32];
        let all = (0..n * n * n).map(|i| HullCell { index: index(i), group: 0 }).collect();
        Self::keep(masks, bounds, n, reach, all)
    }

    /// The grid of half the cell side, testing only inside surviving cells: a time that rejected a whole cell is not
    /// tested on its parts.
    pub(super) fn refine(&self, masks: &AlphaMasks<'_>, reach: f64) -> Self {
        let child =
            |c: &HullCell, k: u32| HullCell { index: [0, 1, 2].map(|a| 2 * c.index[a] + (k >> a & 1)), group: c.group };
        let children = self.cells.iter().flat_map(|c| (0..8u32).map(move |k| child(c, k))).collect();
        Self::keep(masks, self.bounds, 2 * self.n, reach, children)
    }

    /// The candidates kept by some time from their `group` on.
    fn keep(masks: &AlphaMasks<'_>, bounds: Aabb, n: usize, reach: f64, mut left: Vec<HullCell>) -> Self {
        let mut grid = Self { bounds, n, cells: Vec::new() };
        let radius = reach * grid.cell().max_element();
        // time by time rather than cell by cell: the tables of one time fit in the processor's cache, those of all
        // times do not
        for group in 0..masks.groups.len() {
            let kept: Vec<bool> = left
                .par_iter()
                .with_min_len(256)
                .map(|c| c.group <= group && masks.near(group, grid.point(c.index, DVec3::splat(0.5)), radius))
                .collect();
            let both = left.iter().zip(&kept).filter(|(_, k)| **k);
            grid.cells.extend(both.map(|(c, _)| HullCell { index: c.index, group }));
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
