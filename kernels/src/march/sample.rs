//! Placement of the samples of rays: evenly spaced inside a box, except in places known to be empty.

use rayon::prelude::*;

/// Rays per task.
const TASK: usize = 64;

/// An axis-aligned box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Box3 {
    /// Its centre.
    pub centre: [f32; 3],
    /// Half of each side; each above 0.
    pub half: [f32; 3],
}

/// A ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Its origin.
    pub origin: [f32; 3],
    /// Its direction; distances are in units of its length.
    pub direction: [f32; 3],
    /// Position of its first sample, in steps from its entry into the box; in [0, 1).
    pub jitter: f32,
}

/// The samples of many rays, one ray after the other, each from the origin onwards.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Samples {
    /// Positions `[S, 3]` in the box, each coordinate in [-1, 1].
    pub points: Vec<f32>,
    /// Index of the first sample of each ray, then the number of samples: `[R + 1]`.
    pub offsets: Vec<u32>,
}

impl Box3 {
    /// Returns where the ray enters and leaves, or `None` if it misses the box or starts behind it; the entry is at or
    /// in front of the origin (0 where the ray starts inside).
    pub fn chord(&self, ray: &Ray) -> Option<[f32; 2]> {
        let (mut enter, mut leave) = (0.0f32, f32::INFINITY);
        for k in 0..3 {
            // a zero component gives infinities, which `min` and `max` order correctly, and NaN on a face, which they
            // ignore
            let at = |side: f32| (self.centre[k] + side * self.half[k] - ray.origin[k]) / ray.direction[k];
            let (a, b) = (at(-1.0), at(1.0));
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
        (enter < leave && leave.is_finite()).then_some([enter, leave])
    }
}

/// Samples the rays inside `within` at steps of `step` (above 0), at most `max_samples` per ray, and omits the
/// samples for which `keep(ray, point)` is false. The result does not depend on the number of threads.
pub fn sample(
    rays: &[Ray],
    within: Box3,
    step: f32,
    max_samples: usize,
    keep: impl Fn(usize, [f32; 3]) -> bool + Sync,
) -> Samples {
    let of_task = |(task, rays): (usize, &[Ray])| {
        let (mut points, mut counts) = (Vec::new(), Vec::with_capacity(rays.len()));
        for (k, ray) in rays.iter().enumerate() {
            let before = points.len();
            if let Some([enter, leave]) = within.chord(ray) {
                for i in 0..max_samples {
                    let t = enter + (i as f32 + ray.jitter) * step;
                    if t > leave {
                        break;
                    }
                    let at = |k: usize| (ray.origin[k] + t * ray.direction[k] - within.centre[k]) / within.half[k];
                    let point = [at(0), at(1), at(2)].map(|v| v.clamp(-1.0, 1.0));
                    if keep(task * TASK + k, point) {
                        points.extend(point);
                    }
                }
            }
            counts.push((points.len() - before) / 3);
        }
        (points, counts)
    };
    let parts: Vec<(Vec<f32>, Vec<usize>)> = rays.par_chunks(TASK).enumerate().map(of_task).collect();
    let mut out = Samples { points: Vec::new(), offsets: Vec::with_capacity(rays.len() + 1) };
    out.points.reserve_exact(parts.iter().map(|(points, _)| points.len()).sum());
    let mut count = 0;
    out.offsets.push(0);
    for (points, counts) in parts {
        out.points.extend(points);
        for n in counts {
            count += n as u32;
            out.offsets.push(count);
        }
    }
    out
}
