//! Tests of the vote against a direct sum over all Gaussians, on balls with known labels, and on degenerate Gaussians.

use super::*;
use crate::segment::dice::Confusion;

/// Uniform numbers in `[0, 1)` from a fixed sequence.
fn uniform(seed: u64) -> impl FnMut() -> f32 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u64 << 24) as f32
    }
}

#[derive(Clone, Debug, Default)]
struct Owned {
    means: Vec<f32>,
    rotations: Vec<f32>,
    log_scales: Vec<f32>,
    opacity: Vec<f32>,
    labels: Vec<u32>,
}

impl Owned {
    fn cloud(&self) -> LabelledCloud<'_> {
        LabelledCloud {
            means: &self.means,
            rotations: &self.rotations,
            log_scales: &self.log_scales,
            opacity: &self.opacity,
            labels: &self.labels,
        }
    }

    fn push(&mut self, mean: [f32; 3], rotation: [f32; 4], scale: [f32; 3], opacity: f32, label: u32) {
        self.means.extend(mean);
        self.rotations.extend(rotation);
        self.log_scales.extend(scale.map(f32::ln));
        self.opacity.push(opacity);
        self.labels.push(label);
    }

    fn random(n: usize, labels: u32, size: f32, seed: u64) -> Self {
        let (mut u, mut all) = (uniform(seed), Self::default());
        for _ in 0..n {
            let mean = [0; 3].map(|_| u() * size);
            let rotation = [0; 4].map(|_| u() - 0.5);
            let scale = [0; 3].map(|_| size * (0.01 + 0.1 * u() * u()));
            let (opacity, label) = (u(), (u() * labels as f32) as u32);
            all.push(mean, rotation, scale, opacity, label);
        }
        all
    }
}

/// Density of every label at a voxel centre, by the definition.
fn direct(all: &Owned, at: [f64; 3], labels: u32) -> Vec<f64> {
    let mut sums = vec![0.0; labels as usize];
    for i in 0..all.labels.len() {
        let q = &all.rotations[4 * i..4 * i + 4];
        let q = glam::DQuat::from_xyzw(q[1].into(), q[2].into(), q[3].into(), q[0].into()).normalize();
        let mean = glam::DVec3::from(std::array::from_fn(|k| f64::from(all.means[3 * i + k])));
        let local = q.inverse() * (glam::DVec3::from(at) - mean);
        let m: f64 = (0..3).map(|k| (local[k] / f64::from(all.log_scales[3 * i + k].exp())).powi(2)).sum();
        if m <= 9.0 && all.opacity[i] >= 1.0 / 255.0 {
            sums[all.labels[i] as usize] += f64::from(all.opacity[i]) * (-0.5 * m).exp();
        }
    }
    sums
}

#[test]
fn the_vote_is_that_of_a_direct_sum() {
    let grid = Grid::aligned([13, 10, 11], [0.8, 1.1, 0.9], [0.3, -0.4, 0.1]);
    let all = Owned::random(1500, 5, 10.0, 3);
    let vote = Vote { threshold: 0.2, smallest_sigma: 0.0 };
    let labels = label_voxels(&all.cloud(), &grid, &vote).unwrap();
    let mut close = 0;
    for (i, &label) in labels.iter().enumerate() {
        let index = [i % 13, i / 13 % 10, i / 130];
        let at = std::array::from_fn(|k| grid.origin[k] + grid.spacing[k] * index[k] as f64);
        let sums = direct(&all, at, 5);
        let total: f64 = sums.iter().sum();
        let best = (0..5).fold(0, |b, l| if sums[l] > sums[b] { l } else { b });
        let second = (0..5).filter(|l| *l != best).map(|l| sums[l]).fold(0.0, f64::max);
        if (total - 0.2).abs() < 1e-4 || (total > 0.2 && sums[best] - second < 1e-4) {
            close += 1;
        } else {
            assert_eq!(usize::from(label), if total > 0.2 { best } else { 0 }, "{index:?} {sums:?}");
        }
    }
    let labelled = labels.iter().filter(|l| **l > 0).count();
    assert!(close < 20 && (300..1200).contains(&labelled), "{close} {labelled}");
}

const BALLS: [([f32; 3], f32); 3] = [([20.0, 22.0, 24.0], 11.0), ([41.0, 25.0, 27.0], 9.0), ([30.0, 46.0, 40.0], 6.0)];

/// 64^3 voxels that hold three balls, two of them nearly touching, and their true labels.
fn truth(scale: f32) -> (Grid, Vec<u16>) {
    let grid = Grid::aligned([64; 3], [f64::from(scale); 3], [0.0; 3]);
    let inside = |i: usize| {
        let p = [i % 64, i / 64 % 64, i / 4096].map(|v| v as f32);
        BALLS.iter().position(|(c, r)| (0..3).map(|k| (p[k] - c[k]).powi(2)).sum::<f32>() <= r * r)
    };
    (grid, (0..64 * 64 * 64).map(|i| inside(i).map_or(0, |b| b as u16 + 1)).collect())
}

/// The balls filled with Gaussians of about `sigma` voxels, one per `volume` voxels, whose centres stay at least
/// `margin` sigma inside the surface; in world units of `scale` per voxel.
fn balls(scale: f32, sigma: f32, volume: f32, margin: f32, opacity: f32) -> Owned {
    let (mut u, mut all) = (uniform(5), Owned::default());
    for ((centre, radius), label) in BALLS.iter().zip(1..) {
        for _ in 0..(4.19 * radius.powi(3) / volume) as usize {
            let s = [0; 3].map(|_| sigma * (0.6 + 0.8 * u()));
            let inner = 1.0 - margin * sigma / radius;
            let p = loop {
                let p = [0; 3].map(|_| 2.0 * u() - 1.0);
                if p.iter().map(|c| c * c).sum::<f32>() <= inner * inner {
                    break p;
                }
            };
            let mean = std::array::from_fn(|k| scale * (centre[k] + radius * p[k]));
            all.push(mean, [0; 4].map(|_| u() - 0.5), s.map(|s| s * scale), opacity * (0.2 + 1.6 * u()), label);
        }
    }
    all
}

fn score(all: &Owned, scale: f32, vote: &Vote) -> f64 {
    let (grid, truth) = truth(scale);
    let found = label_voxels(&all.cloud(), &grid, vote).unwrap();
    let pairs = Confusion::new(&truth, &found).unwrap();
    let labels = 1..=BALLS.len() as u32;
    labels.map(|l| pairs.overlap(l, l).dice()).sum::<f64>() / BALLS.len() as f64
}

/// A spherical shell of flat Gaussians, `thick` voxels thick.
fn shell(thick: f32) -> Owned {
    let (mut u, mut all) = (uniform(8), Owned::default());
    while all.labels.len() < 4000 {
        let p = glam::Vec3::from([0; 3].map(|_| 2.0 * u() - 1.0));
        if p.length() <= 1.0 && p.length() > 0.1 {
            let n = p.normalize();
            let q = glam::Quat::from_rotation_arc(glam::Vec3::Z, n);
            all.push((32.0 + 18.0 * n).into(), [q.w, q.x, q.y, q.z], [1.0, 1.0, thick], 0.6, 1);
        }
    }
    all
}

/// The share of the voxels within half a voxel of the sphere that are labelled, and the share of those labelled that
/// are within 1.5.
fn shell_found(floor: f32, threshold: f32) -> (f64, f64) {
    let vote = Vote { threshold, smallest_sigma: floor };
    let labels = label_voxels(&shell(0.1).cloud(), &truth(1.0).0, &vote).unwrap();
    let off = |i: usize| {
        let p = glam::Vec3::from([i % 64, i / 64 % 64, i / 4096].map(|v| v as f32 - 32.0));
        (p.length() - 18.0).abs()
    };
    let all: Vec<usize> = (0..labels.len()).collect();
    let share = |of: &dyn Fn(usize) -> bool, with: &dyn Fn(usize) -> bool| {
        let of: Vec<_> = all.iter().filter(|i| of(**i)).collect();
        of.iter().filter(|i| with(***i)).count() as f64 / of.len() as f64
    };
    (share(&|i| off(i) < 0.5, &|i| labels[i] == 1), share(&|i| labels[i] == 1, &|i| off(i) < 1.5))
}

#[test]
fn balls_come_back_with_the_defaults() {
    let all = balls(1.0, 1.0, 4.0, 1.0, 0.2);
    let dice = score(&all, 1.0, &Vote::default());
    assert!(dice > 0.92, "{dice}");
    // The same scene in other units has the same labels.
    let (metres, millimetres) = (balls(0.001, 1.0, 4.0, 1.0, 0.2), balls(8.0, 1.0, 4.0, 1.0, 0.2));
    for (all, scale) in [(metres, 0.001), (millimetres, 8.0)] {
        assert!((score(&all, scale, &Vote::default()) - dice).abs() < 1e-3);
    }
}

#[test]
fn flat_gaussians_leave_no_holes_with_the_defaults() {
    let Vote { threshold, smallest_sigma } = Vote::default();
    let (covered, near) = shell_found(smallest_sigma, threshold);
    assert!(covered > 0.999 && near > 0.999, "{covered} {near}");
    assert!(shell_found(0.0, threshold).0 < 0.7, "without a smallest scale the shell is full of holes");
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let (grid, _) = truth(1.0);
    let all = Owned::random(3000, 9, 60.0, 11);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| label_voxels(&all.cloud(), &grid, &Vote::default()).unwrap())
    };
    let one = on(1);
    assert!(one.contains(&8));
    assert_eq!(one, on(3));
}

#[test]
fn unlabelled_matter_outvotes_and_ties_go_to_the_smaller_label() {
    let grid = Grid::unit([3, 1, 1]);
    let mut all = Owned::default();
    for (x, opacity, label) in [(0.0, 0.5, 3), (0.0, 0.6, 0), (1.0, 0.5, 7), (1.0, 0.5, 5), (2.0, 0.09, 2)] {
        all.push([x, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.2; 3], opacity, label);
    }
    let vote = Vote { threshold: 0.1, smallest_sigma: 0.0 };
    assert_eq!(label_voxels(&all.cloud(), &grid, &vote).unwrap(), [0, 5, 0]);
    let faint = Vote { threshold: 0.08, ..vote };
    assert_eq!(label_voxels(&all.cloud(), &grid, &faint).unwrap(), [0, 5, 2]);
}

#[test]
fn degenerate_gaussians_do_not_vote() {
    let (grid, _) = truth(1.0);
    let all = Owned::random(100, 4, 60.0, 2);
    let vote = |all: &Owned| label_voxels(&all.cloud(), &grid, &Vote::default()).unwrap();
    let clean = vote(&all);
    for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30, f32::MAX] {
        for array in 0..4 {
            let mut poisoned = all.clone();
            poisoned.push([30.0; 3], [1.0, 0.0, 0.0, 0.0], [4.0; 3], 0.9, 6);
            match array {
                0 => poisoned.means[301] = poison,
                1 => poisoned.rotations[400..].fill(if poison.is_finite() { 0.0 } else { poison }),
                2 => poisoned.log_scales[302] = poison,
                _ => poisoned.opacity[100] = if poison > 0.0 && poison.is_finite() { 0.0 } else { poison },
            }
            assert_eq!(vote(&poisoned), clean, "{poison} in array {array}");
        }
    }
}

#[test]
fn impossible_input_is_refused() {
    let (grid, _) = truth(1.0);
    let all = Owned::random(3, 4, 60.0, 2);
    let vote = Vote::default();
    let error = |cloud, grid, vote| label_voxels(&cloud, &grid, &vote).unwrap_err();
    let short = LabelledCloud { opacity: &all.opacity[..2], ..all.cloud() };
    assert!(matches!(error(short, grid, vote), VoxelError::Shape { field: "opacity", expected: 3, found: 2 }));
    let high = LabelledCloud { labels: &[0, 65_536, 1], ..all.cloud() };
    assert_eq!(error(high, grid, vote), VoxelError::Label { label: 65_536, index: 1 });
    for bad in [
        Grid { dims: [4, 0, 4], ..grid },
        Grid { dims: [usize::MAX, 2, 2], ..grid },
        Grid { spacing: [1.0, -1.0, 1.0], ..grid },
        Grid { origin: [f64::NAN; 3], ..grid },
    ] {
        assert!(matches!(error(all.cloud(), bad, vote), VoxelError::Grid { .. }));
    }
    let nan = Vote { threshold: f32::NAN, ..vote };
    assert!(matches!(error(all.cloud(), grid, nan), VoxelError::Option { field: "threshold", .. }));
    let none = Owned::default();
    assert!(label_voxels(&none.cloud(), &grid, &vote).unwrap().iter().all(|l| *l == 0));
}
