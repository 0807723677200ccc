//! The ray caster: a volume, a transfer function and a camera -> an image with alpha.
//!
//! Casts each pixel's central ray front to back in steps of fixed length: trilinear values, the transfer function
//! integrated over the values of each step, Blinn-Phong shading by the gradient with a headlight. Empty space is
//! skipped without moving the steps, so that the result stays bit-identical. Each pixel is computed independently:
//! results do not depend on threads. Rays are turned into the box of the volume, whose axes may be permuted, mirrored
//! or oblique in the scene. The plain f64 version is in `reference`.

mod cells;
mod field;
mod occupancy;
mod picture;
#[cfg(test)]
mod reference;
mod table;
#[cfg(test)]
mod tests;

pub use cells::SceneCells;
pub use picture::{RaycastPicture, SegmentShares};

use crate::data::Camera;
use crate::volume::grid::{Volume, VolumeLabels};
use crate::volume::placement::VoxelPlacement;
use crate::volume::transfer::{Shading, TransferFunction};
use field::PaddedField;
use glam::{DMat3, DVec3};
use occupancy::{BRICK, BrickDistances};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};
use table::TransferTable;

/// Side of a tile in pixels; a tile is one task.
const TILE: usize = 16;
/// Minimum number of tiles whose rays are held at a time: enough for all threads, however large the image is.
const MIN_TILES: usize = 1024;
/// A ray ends when less light than this remains: below half a level of eight bits.
const OPAQUE: f32 = 1e-3;
/// Number of entries of the table of highlights.
const SHINE: usize = 4096;
/// Gradients below this fraction of the span per two voxels have no direction.
const FLAT: f32 = 1e-6;

/// Length of a step, in units of the smallest voxel spacing.
pub const DEFAULT_STEP: f64 = 0.5;
/// The shortest step: below it an image takes hours and looks the same.
pub const SHORTEST_STEP: f64 = 1.0 / 64.0;
/// The longest step.
pub const LONGEST_STEP: f64 = 16.0;

/// A volume ready to be rendered.
#[derive(Debug)]
pub struct RayCaster {
    field: PaddedField,
    labels: Option<VolumeLabels>,
    table: TransferTable,
    shading: Shading,
    /// `specular * cos^power` by cosine.
    shine: Vec<f32>,
    placement: VoxelPlacement,
    occupancy: BrickDistances,
    flat: f32,
    /// A power of two that brings gradients near 1, so that their squares neither overflow nor vanish in single precision
    /// whatever the unit of the data.
    gradient_unit: f32,
    step: f64,
}

/// One segment to show alone.
#[derive(Debug)]
pub struct IsolatedSegment {
    segment: u16,
    occupancy: BrickDistances,
}

impl RayCaster {
    /// Lays out a volume for rendering.
    ///
    /// `labels` (same dimensions) give the segment of each voxel; without them the transfer function's named ranges do.
    /// `span` is the range of data values that the transfer function's fractions refer to. `step` is the distance
    /// between samples in units of the smallest voxel spacing. Each axis needs at least two voxels.
    pub fn new(
        volume: &Volume,
        labels: Option<VolumeLabels>,
        transfer: &TransferFunction,
        span: [f64; 2],
        placement: VoxelPlacement,
        step: f64,
    ) -> Self {
        debug_assert!(volume.grid.dims.iter().all(|n| *n > 1));
        let field = PaddedField::new(volume);
        let step = step * placement.spacing().min_element();
        let table = TransferTable::new(transfer, span, step / (transfer.unit_length * placement.side()));
        let occupancy = BrickDistances::new(field.dims, |from| {
            let (low, high) = field.extremes(from, BRICK);
            table.any_opaque(0, low, high)
        });
        let (shading, last) = (transfer.shading, (SHINE - 1) as f32);
        let shine_at = |i: usize| shading.specular * (i as f32 / last).powf(shading.power);
        let shine = std::iter::once(0.0).chain((1..SHINE).map(shine_at)).collect();
        let flat = FLAT * (span[1] - span[0]) as f32;
        let width = (span[1] - span[0]).max(f64::MIN_POSITIVE);
        let gradient_unit = (-width.log2().round()).clamp(-90.0, 90.0).exp2() as f32;
        Self { field, labels, table, shading, shine, placement, occupancy, flat, gradient_unit, step }
    }

    /// Prepares to show `segment` (an id, from 1) alone.
    pub fn isolate(&self, segment: u16) -> IsolatedSegment {
        let [nx, ny, _] = self.field.dims;
        let occupancy = BrickDistances::new(self.field.dims, |from| {
            let (low, high) = self.field.extremes(from, BRICK);
            let Some(labels) = &self.labels else { return self.table.any_opaque(segment, low, high) };
            let end = |a: usize| (from[a] + BRICK).min(self.field.dims[a] - 1);
            self.table.any_opaque(0, low, high)
                && (from[2]..=end(2)).any(|z| {
                    (from[1]..=end(1)).any(|y| {
                        let row = &labels.ids[(z * ny + y) * nx..][from[0]..=end(0)];
                        row.contains(&segment)
                    })
                })
        });
        IsolatedSegment { segment, occupancy }
    }

    /// Renders the volume, or one segment of it alone.
    pub fn render(&self, camera: &Camera, only: Option<&IsolatedSegment>) -> RaycastPicture {
        self.paint(camera, only, None).0
    }

    /// Like [`RayCaster::render`], but returns `None` early once `stop` is set.
    pub fn render_until(
        &self,
        camera: &Camera,
        only: Option<&IsolatedSegment>,
        stop: &AtomicBool,
    ) -> Option<RaycastPicture> {
        let (picture, whole) = self.paint(camera, only, Some(stop));
        whole.then_some(picture)
    }

    /// The picture, and whether it is complete.
    fn paint(
        &self,
        camera: &Camera,
        only: Option<&IsolatedSegment>,
        stop: Option<&AtomicBool>,
    ) -> (RaycastPicture, bool) {
        let mut picture = RaycastPicture::new(camera.width as usize, camera.height as usize);
        let whole = self.tiles(camera, only, false, stop, |x, y, ray| picture.set(x, y, ray.color));
        (picture, whole)
    }

    /// Renders the volume and, for each pixel, the segment with the largest share of its colour (`[H, W]`, 0 where no
    /// segment shows or alpha is below `min_alpha`). Returns `None` early once `stop` is set.
    pub fn render_with_labels(
        &self,
        camera: &Camera,
        min_alpha: f32,
        stop: &AtomicBool,
    ) -> Option<(RaycastPicture, Vec<u16>)> {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let mut picture = RaycastPicture::new(width, height);
        let mut labels = vec![0; width * height];
        let whole = self.tiles(camera, None, true, Some(stop), |x, y, ray| {
            picture.set(x, y, ray.color);
            if ray.color[3] >= min_alpha {
                labels[y * width + x] = ray.shares.largest();
            }
        });
        whole.then_some((picture, labels))
    }

    /// Casts all rays, tile by tile in parallel, and passes the results on in order of tiles, some rows of tiles at a
    /// time. Returns false if `stop` was set before the end: some rays are then missing.
    fn tiles(
        &self,
        camera: &Camera,
        only: Option<&IsolatedSegment>,
        shares: bool,
        stop: Option<&AtomicBool>,
        mut put: impl FnMut(usize, usize, RayResult),
    ) -> bool {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let rays = Rays::new(camera, &self.placement);
        let columns = width.div_ceil(TILE);
        let count = columns * height.div_ceil(TILE);
        let block = columns * MIN_TILES.div_ceil(columns.max(1));
        let cast = |tile: usize| -> Option<Vec<RayResult>> {
            if stop.is_some_and(|s| s.load(Ordering::Relaxed)) {
                return None;
            }
            let (x0, y0) = (tile % columns * TILE, tile / columns * TILE);
            let mut out = Vec::with_capacity(TILE * TILE);
            for y in y0..(y0 + TILE).min(height) {
                for x in x0..(x0 + TILE).min(width) {
                    out.push(self.cast(&rays, x, y, only, shares));
                }
            }
            Some(out)
        };
        for first in (0..count).step_by(block.max(1)) {
            let tiles: Option<Vec<Vec<RayResult>>> =
                (first..(first + block).min(count)).into_par_iter().map(cast).collect();
            let Some(tiles) = tiles else { return false };
            for (tile, rays) in (first..).zip(tiles) {
                let (x0, y0) = (tile % columns * TILE, tile / columns * TILE);
                let w = TILE.min(width - x0);
                for (i, ray) in rays.into_iter().enumerate() {
                    put(x0 + i % w, y0 + i / w, ray);
                }
            }
        }
        true
    }

    fn cast(&self, rays: &Rays, x: usize, y: usize, only: Option<&IsolatedSegment>, shares: bool) -> RayResult {
        let mut ray = RayResult::default();
        let direction = rays.direction(x, y);
        let Some((near, far)) = self.placement.clip(rays.eye, direction) else { return ray };
        let length = (far - near) / self.step;
        let count = length.ceil() as u32;
        let entry = self.placement.box_to_voxel(rays.eye + near * direction).as_vec3().to_array();
        let delta = (direction * self.step * self.placement.voxels_per_unit).as_vec3().to_array();
        let inverse = delta.map(f32::recip);
        let end = self.field.dims.map(|n| (n - 1) as f32);
        let light = (-direction).as_vec3().to_array();
        let to_box = self.placement.voxels_per_unit.as_vec3().to_array().map(|v| v * self.gradient_unit);
        let (occupancy, wanted) = match only {
            Some(isolated) => (&isolated.occupancy, isolated.segment),
            None => (&self.occupancy, 0),
        };
        // with labels a segment is selected by voxel, without by value
        let by_value = if self.labels.is_none() { wanted } else { 0 };
        let position = |k: f32| -> [f32; 3] { std::array::from_fn(|a| (entry[a] + k * delta[a]).clamp(0.0, end[a])) };
        let mut through = 1.0f32;
        let mut k = 0;
        // the value at the start of step k, if step k - 1 computed it
        let mut front = None;
        while k < count {
            let start = position(k as f32);
            let next = occupancy.next(k, start, entry, inverse);
            if next > k {
                k = next;
                front = None;
                continue;
            }
            // the last step may be shorter than the others
            let part = if k + 1 == count { (length - f64::from(k)) as f32 } else { 1.0 };
            let from = front.unwrap_or_else(|| self.field.sample(start));
            let to = self.field.sample(position(k as f32 + part));
            front = Some(to);
            let middle = k as f32 + 0.5 * part;
            k += 1;
            let [r, g, b, extinction] = self.table.step(from, to, by_value);
            if extinction <= 0.0 {
                continue;
            }
            let p = position(middle);
            if shares || (wanted != 0 && by_value == 0) {
                let segment = self.segment(p, from, to);
                if wanted != 0 && segment != wanted {
                    continue;
                }
                ray.segment = segment;
            }
            let alpha = -(-extinction * part).exp_m1();
            let color = if self.shading.enabled { self.shade([r, g, b], p, light, to_box) } else { [r, g, b] };
            let weight = through * alpha;
            for c in 0..3 {
                ray.color[c] += weight * color[c];
            }
            if shares {
                ray.shares.add(ray.segment, weight);
            }
            through *= 1.0 - alpha;
            if through < OPAQUE {
                through = 0.0;
                break;
            }
        }
        ray.color[3] = 1.0 - through;
        ray
    }

    /// The segment at voxel coordinates `p`: that of the nearest voxel, or of the mean value.
    fn segment(&self, p: [f32; 3], from: f32, to: f32) -> u16 {
        match &self.labels {
            None => self.table.segment(0.5 * (from + to)),
            Some(labels) => {
                let [nx, ny, _] = self.field.dims;
                let i = p.map(|v| (v + 0.5) as usize);
                let end = self.field.dims.map(|n| n - 1);
                labels.ids[(i[2].min(end[2]) * ny + i[1].min(end[1])) * nx + i[0].min(end[0])]
            }
        }
    }

    /// Blinn-Phong with a headlight: light and eye coincide, so the half vector is the light's direction, and both
    /// sides of a surface are lit. Where the field is flat only ambient light remains.
    #[inline(always)]
    fn shade(&self, color: [f32; 3], p: [f32; 3], light: [f32; 3], to_box: [f32; 3]) -> [f32; 3] {
        let s = &self.shading;
        let gradient = self.field.gradient(p);
        let n: [f32; 3] = std::array::from_fn(|a| gradient[a] * to_box[a]);
        let square = n.iter().map(|v| v * v).sum::<f32>();
        let flat = gradient.iter().all(|g| g.abs() <= self.flat);
        let cos = if flat { 0.0 } else { (n[0] * light[0] + n[1] * light[1] + n[2] * light[2]).abs() / square.sqrt() };
        let glow = s.ambient + s.diffuse * cos;
        let shine = self.shine[((cos * (SHINE - 1) as f32 + 0.5) as usize).min(SHINE - 1)];
        color.map(|c| (c * glow + shine).min(1.0))
    }
}

/// The result of a ray.
#[derive(Clone, Copy, Default)]
struct RayResult {
    /// Colour times alpha, alpha.
    color: [f32; 4],
    shares: SegmentShares,
    segment: u16,
}

/// The rays of a camera along the axes of a volume's box: unit directions through pixel centres.
struct Rays {
    eye: DVec3,
    to_box: DMat3,
    focal: [f64; 2],
    centre: [f64; 2],
}

impl Rays {
    fn new(camera: &Camera, placement: &VoxelPlacement) -> Self {
        let (rotation, _) = camera.world_to_camera_opencv();
        let to_scene = rotation.transpose();
        Self {
            eye: placement.to_box(camera.position()),
            // an identity is not multiplied: pictures of aligned volumes keep their bits
            to_box: placement.turn().map_or(to_scene, |turn| turn.transpose() * to_scene),
            focal: [camera.fx, camera.fy],
            centre: [camera.cx, camera.cy],
        }
    }

    fn direction(&self, x: usize, y: usize) -> DVec3 {
        let local = DVec3::new(
            (x as f64 + 0.5 - self.centre[0]) / self.focal[0],
            (y as f64 + 0.5 - self.centre[1]) / self.focal[1],
            1.0,
        );
        (self.to_box * local).normalize()
    }
}
