//! The ray caster in plain f64 loops: no tables, no skipping, no early end. The reference for the tests.

use crate::data::Camera;
use crate::volume::grid::Volume;
use crate::volume::placement::VoxelPlacement;
use crate::volume::transfer::TransferFunction;
use glam::DVec3;

/// Number of parts into which the values of a step are divided to integrate the transfer function.
const PARTS: usize = 256;

/// The value at voxel coordinates `p`, clamped to the grid.
fn sample(volume: &Volume, p: DVec3) -> f64 {
    let dims = volume.grid.dims;
    let base: [usize; 3] = std::array::from_fn(|a| (p[a].max(0.0) as usize).min(dims[a] - 1));
    let mut sum = 0.0;
    for corner in 0..8 {
        let mut weight = 1.0;
        let mut at = [0; 3];
        for a in 0..3 {
            let f = (p[a] - base[a] as f64).clamp(0.0, 1.0);
            let upper = corner >> a & 1 == 1;
            weight *= if upper { f } else { 1.0 - f };
            at[a] = (base[a] + usize::from(upper)).min(dims[a] - 1);
        }
        sum += weight * f64::from(volume.values[(at[2] * dims[1] + at[1]) * dims[0] + at[0]]);
    }
    sum
}

/// Colour times alpha, and alpha, of one pixel.
pub fn trace(
    volume: &Volume,
    transfer: &TransferFunction,
    span: [f64; 2],
    placement: &VoxelPlacement,
    step: f64,
    camera: &Camera,
    pixel: [usize; 2],
) -> [f64; 4] {
    let (rotation, _) = camera.world_to_camera_opencv();
    let local = DVec3::new(
        (pixel[0] as f64 + 0.5 - camera.cx) / camera.fx,
        (pixel[1] as f64 + 0.5 - camera.cy) / camera.fy,
        1.0,
    );
    let direction = placement.to_box((rotation.transpose() * local).normalize());
    let eye = placement.to_box(camera.position());
    let mut out = [0.0; 4];
    let Some((near, far)) = placement.clip(eye, direction) else { return out };
    let step = step * placement.spacing().min_element();
    let unit = transfer.unit_length * placement.side();
    let shading = &transfer.shading;
    let mut through = 1.0;
    let mut t = near;
    while t < far {
        let length = step.min(far - t);
        let p = placement.box_to_voxel(eye + (t + 0.5 * length) * direction);
        let fraction = |t: f64| {
            let value = sample(volume, placement.box_to_voxel(eye + t * direction));
            (value - span[0]) / (span[1] - span[0])
        };
        let (from, to) = (fraction(t), fraction(t + length));
        let (mut extinction, mut color) = (0.0, [0.0; 3]);
        for part in 0..PARTS {
            let f = from + (to - from) * (part as f64 + 0.5) / PARTS as f64;
            let e = -(1.0 - f64::from(transfer.opacity_at(f)).min(0.999_999)).ln() / PARTS as f64;
            extinction += e;
            let c = transfer.color_at(f);
            (0..3).for_each(|i| color[i] += e * f64::from(c[i]));
        }
        t += step;
        if extinction <= 0.0 {
            continue;
        }
        color = color.map(|c| c / extinction);
        let alpha = 1.0 - (-extinction * length / unit).exp();
        if shading.enabled {
            let end = DVec3::from_array(volume.grid.dims.map(|n| (n - 1) as f64));
            let difference = |axis: DVec3| {
                // differences of neighbouring voxels, interpolated: at the border the missing neighbour is the border
                let mut sum = 0.0;
                let base = p.max(DVec3::ZERO).floor().min(end);
                let f = p - base;
                for corner in 0..8u32 {
                    let offset =
                        DVec3::new(f64::from(corner & 1), f64::from(corner >> 1 & 1), f64::from(corner >> 2 & 1));
                    let weight: f64 = (0..3).map(|a| if offset[a] > 0.0 { f[a] } else { 1.0 - f[a] }).product();
                    let at = base + offset;
                    let clamp = |q: DVec3| q.clamp(DVec3::ZERO, end);
                    sum += weight * (sample(volume, clamp(at + axis)) - sample(volume, clamp(at - axis)));
                }
                sum
            };
            let gradient = DVec3::new(difference(DVec3::X), difference(DVec3::Y), difference(DVec3::Z));
            let flat = gradient.abs().max_element() <= 1e-6 * (span[1] - span[0]);
            let cos = if flat { 0.0 } else { (gradient * placement.voxels_per_unit).normalize().dot(direction).abs() };
            let shine = if cos > 0.0 { f64::from(shading.specular) * cos.powf(f64::from(shading.power)) } else { 0.0 };
            let glow = f64::from(shading.ambient) + f64::from(shading.diffuse) * cos;
            color = color.map(|c| (c * glow + shine).min(1.0));
        }
        for c in 0..3 {
            out[c] += through * alpha * color[c];
        }
        through *= 1.0 - alpha;
    }
    out[3] = 1.0 - through;
    out
}
