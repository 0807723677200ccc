//! Tightens a carved box: with few views per time the hull has spikes where viewing cones cross beyond the data; the
//! silhouettes of all times together show where the box of the data can end. Used by `hull` alone.

use glam::DVec3;
use rayon::prelude::*;

use super::dataset::Split;
use super::hull::Aabb;

/// With fewer views the silhouettes say too little about depth, and the carved box is kept.
const MIN_VIEWS: usize = 48;
/// Maximum distance by which one side may move inwards, as a fraction of the box.
const MAX_INSET: f64 = 0.06;
/// Number of steps over that distance.
const STEPS: usize = 24;
/// Views per parallel piece.
const PIECE: usize = 8;

/// The ends of every silhouette row of a view: camera centre and ray directions (any length).
struct Outline {
    eye: DVec3,
    rays: Vec<DVec3>,
}

/// Moves the sides of `bounds` inwards, in turn and by small steps, as long as every silhouette stays inside the
/// projection of the box (the ray of each seen pixel still hits it).
pub(super) fn shrink_to_silhouettes(split: &Split, bounds: Aabb, threshold: f32) -> Aabb {
    if split.frames.len() < MIN_VIEWS || split.images.len() != split.frames.len() {
        return bounds;
    }
    let outlines: Vec<Outline> =
        (0..split.frames.len()).into_par_iter().map(|i| outline(split, i, threshold)).collect();
    // rays that already miss (stray pixels, the border of coarse masks) are ignored, and those that hit even the
    // smallest box need no further test
    let smallest = bounds.grown(-MAX_INSET);
    let outlines: Vec<Outline> = outlines
        .into_par_iter()
        .map(|mut o| {
            o.rays.retain(|r| hits(&bounds, o.eye, *r) && !hits(&smallest, o.eye, *r));
            o
        })
        .collect();
    let covers = |b: &Aabb| outlines.par_iter().with_min_len(PIECE).all(|o| o.rays.iter().all(|r| hits(b, o.eye, *r)));
    let step = bounds.size() * (MAX_INSET / STEPS as f64);
    let (mut best, mut free) = (bounds, [true; 6]);
    for _ in 0..STEPS {
        for side in 0..6 {
            if !free[side] {
                continue;
            }
            let mut tried = best;
            let axis = side / 2;
            if side % 2 == 0 {
                tried.min[axis] += step[axis]
            } else {
                tried.max[axis] -= step[axis]
            }
            // the box only shrinks, so a side that is stuck stays stuck
            free[side] = covers(&tried);
            if free[side] {
                best = tried;
            }
        }
    }
    best
}

/// The rays at the ends of each silhouette row: the box's projection is convex, so they stand for all between.
fn outline(split: &Split, frame: usize, threshold: f32) -> Outline {
    let (camera, width) = (&split.frames[frame].camera, split.images.width as usize);
    let threshold = (threshold.clamp(0.0, 1.0) * 255.0).floor() as u8;
    let mut rays = Vec::new();
    for (y, row) in split.images.frame(frame).chunks_exact(width.max(1) * 4).enumerate() {
        let seen = |p: &[u8]| p[3] > threshold;
        let first = row.chunks_exact(4).position(seen);
        let last = row.chunks_exact(4).rposition(seen);
        for x in first.into_iter().chain(last.filter(|l| Some(*l) != first)) {
            let u = (x as f64 + 0.5 - camera.cx) / camera.fx;
            let v = (y as f64 + 0.5 - camera.cy) / camera.fy;
            rays.push(camera.camera_to_world.transform_vector3(DVec3::new(u, -v, -1.0)));
        }
    }
    Outline { eye: camera.position(), rays }
}

/// Whether the ray hits the box (slab test). Division by a zero component gives infinities, which `min` and `max` order
/// correctly.
fn hits(b: &Aabb, eye: DVec3, ray: DVec3) -> bool {
    let (a, c) = ((b.min - eye) / ray, (b.max - eye) / ray);
    a.min(c).max_element().max(0.0) <= a.max(c).min_element()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slab_test() {
        let b = Aabb::cube(DVec3::ZERO, 1.0);
        let eye = DVec3::new(4.0, 0.0, 0.0);
        assert!(hits(&b, eye, -DVec3::X) && !hits(&b, eye, DVec3::X) && !hits(&b, eye, DVec3::Z));
        assert!(hits(&b, eye, DVec3::new(-3.0, 0.99, 0.0)) && !hits(&b, eye, DVec3::new(-3.0, 1.01, 0.0)));
        assert!(hits(&b, DVec3::ZERO, DVec3::X));
    }
}
