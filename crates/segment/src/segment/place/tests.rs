//! Tests of places on bodies of known shape made of Gaussians: their volume, edge and interior; competition, units,
//! degenerate Gaussians, threads.

use super::*;
use crate::segment::dice::Confusion;
use glam::{DVec3, Vec3};
use proptest::prelude::*;

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
    fn cloud(&self) -> Cloud<'_> {
        Cloud {
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

    /// Fills the places of a lattice of distance `step` for which `inside` holds with round Gaussians as wide as the
    /// lattice, such that the extinction density is `density`.
    fn fill(&mut self, step: f64, density: f64, label: u32, inside: impl Fn(DVec3) -> bool) {
        let n = (40.0 / step) as i32;
        let tau = density * step.powi(3) / (std::f64::consts::TAU * step * step);
        let mut u = uniform(u64::from(label) + 7);
        for code in 0..n.pow(3) {
            let mut jitter = || 0.3 * step * (f64::from(u()) - 0.5);
            let index = DVec3::new(f64::from(code % n), f64::from(code / n % n), f64::from(code / n / n));
            let place = index * step - DVec3::splat(20.0) + DVec3::new(jitter(), jitter(), jitter());
            if inside(place) {
                let opacity = (1.0 - (-tau).exp()) as f32;
                self.push(place.as_vec3().into(), [1.0, 0.0, 0.0, 0.0], [step as f32; 3], opacity, label);
            }
        }
    }
}

/// Cells of side `cell` over `[-20, 20]^3`.
fn grid(cell: f64) -> Grid {
    let n = (40.0 / cell).round() as usize;
    Grid::aligned([n; 3], [cell; 3], [0.5 * cell - 20.0; 3])
}

fn ball(radius: f64) -> f64 {
    4.0 / 3.0 * std::f64::consts::PI * radius.powi(3)
}

fn volumes(all: &Owned, grid: &Grid) -> Vec<f64> {
    let places = SegmentPlaces::new(all.cloud(), grid, SHARE).unwrap();
    let labels: Vec<u32> = (1..=all.labels.iter().copied().max().unwrap_or(0)).collect();
    places.measure(&labels).iter().map(|m| m.map_or(0.0, |m| m.volume)).collect()
}

#[test]
fn the_density_is_that_of_a_direct_sum_and_adds_up_to_the_content() {
    let grid = Grid::aligned([40, 50, 44], [0.5, 0.4, 0.45], [-5.0, -5.0, -5.0]);
    let all = Owned::random(200, 1, 10.0, 3);
    let bells = density::bells(&all.cloud(), &grid, 0.0);
    let density = Density::new(&bells, BellProfile::Content);
    let value = |c: [usize; 3]| {
        let [x, y, z] = std::array::from_fn(|k| c[k] - density.first[k]);
        f64::from(density.values[(z * density.dims[1] + y) * density.dims[0] + x])
    };
    let mut filled = 0;
    for cell in [[20, 25, 22], [14, 20, 30], [25, 31, 16]] {
        let at = DVec3::from(std::array::from_fn(|k| grid.origin[k] + grid.spacing[k] * cell[k] as f64));
        let mut sum = 0.0;
        for i in 0..200 {
            let q = &all.rotations[4 * i..4 * i + 4];
            let q = glam::DQuat::from_xyzw(q[1].into(), q[2].into(), q[3].into(), q[0].into()).normalize();
            let mean = DVec3::from(std::array::from_fn(|k| f64::from(all.means[3 * i + k])));
            let scales: [f64; 3] = std::array::from_fn(|k| f64::from(all.log_scales[3 * i + k].exp()));
            let local = q.inverse() * (at - mean);
            let m: f64 = (0..3).map(|k| (local[k] / scales[k]).powi(2)).sum();
            let (tau, product) = (-f64::from(1.0 - all.opacity[i].min(0.99)).ln(), scales.iter().product::<f64>());
            if m <= 9.0 && all.opacity[i] >= 1.0 / 255.0 {
                sum += tau * product.powf(2.0 / 3.0) / (std::f64::consts::TAU.sqrt() * product) * (-0.5 * m).exp();
            }
        }
        assert!((value(cell) - sum).abs() <= 1e-4 * sum, "{cell:?} {} {sum}", value(cell));
        filled += usize::from(sum > 0.0);
    }
    assert!(filled >= 2);
    // one Gaussian, wide and narrow: what it holds does not depend on the cells, but for the 3 % beyond 3 sigma
    for scale in [[1.0, 1.5, 2.0], [0.9, 0.02, 1.2]] {
        let mut one = Owned::default();
        one.push([0.1, 0.2, 0.3], [0.9, 0.1, -0.3, 0.2], scale, 0.6, 1);
        for cell in [0.25, 0.5] {
            let bells = density::bells(&one.cloud(), &super::tests::grid(cell), 0.5 * cell);
            let sum = Density::new(&bells, BellProfile::Content).values.iter().map(|v| f64::from(*v)).sum::<f64>()
                * cell.powi(3);
            assert!((sum / one.cloud().content(0) - 0.971).abs() < 0.03, "{scale:?} {cell}: {sum}");
        }
    }
}

/// Radius at which a picture of the round Gaussians of `label` around `centre` has an alpha of one half: the mean over
/// rays that pass the centre at that distance in all directions.
fn silhouette(all: &Owned, label: u32, centre: DVec3) -> f64 {
    let mut u = uniform(5);
    let mut direction = || DVec3::from([0; 3].map(|_| f64::from(u()) - 0.5)).normalize();
    let rays: Vec<(DVec3, DVec3)> = (0..60)
        .map(|_| {
            let (away, other) = (direction(), direction());
            (away, away.cross(other).normalize())
        })
        .collect();
    let alpha = |radius: f64| {
        let of = |(away, along): &(DVec3, DVec3)| {
            let mut depth = 0.0;
            for i in (0..all.labels.len()).filter(|i| all.labels[*i] == label) {
                let mean = DVec3::from(std::array::from_fn(|k| f64::from(all.means[3 * i + k])));
                let off = (mean - centre - radius * *away).cross(*along).length();
                let curve = (-0.5 * (off / f64::from(all.log_scales[3 * i].exp())).powi(2)).exp();
                depth -= (-f64::from(all.opacity[i]) * curve).ln_1p();
            }
            1.0 - (-depth).exp()
        };
        rays.iter().map(of).sum::<f64>() / rays.len() as f64
    };
    let (mut low, mut high) = (1.0, 20.0);
    while high - low > 0.01 {
        let middle = 0.5 * (low + high);
        if alpha(middle) > 0.5 { low = middle } else { high = middle }
    }
    low
}

#[test]
fn a_thin_ball_has_the_volume_of_the_medium_and_an_opaque_one_that_of_its_silhouette() {
    for density in [0.03, 0.06, 2.0, 5.0] {
        let mut all = Owned::default();
        all.fill(1.0, density, 1, |p| p.length() < 10.0);
        let exact = ball(if density < 0.1 { 10.0 } else { silhouette(&all, 1, DVec3::ZERO) });
        let [fine, coarse] = [0.25, 0.5].map(|cell| volumes(&all, &grid(cell))[0]);
        assert!((fine / exact - 1.0).abs() < 0.1, "density {density}: {}", fine / exact);
        assert!((coarse / fine - 1.0).abs() < 0.03, "half the cell, density {density}: {coarse} {fine}");
    }
}

#[test]
fn an_opaque_surface_is_full_and_a_translucent_one_is_not() {
    let measured = |density: f64, inner: f64| {
        let mut all = Owned::default();
        all.fill(0.5, density, 1, |p| (inner..=10.0).contains(&p.length()));
        let places = SegmentPlaces::new(all.cloud(), &grid(0.4), SHARE).unwrap();
        (places.measure(&[1])[0].unwrap(), silhouette(&all, 1, DVec3::ZERO))
    };
    let (opaque, radius) = measured(20.0, 9.0);
    assert!((opaque.volume / ball(radius) - 1.0).abs() < 0.08, "{}", opaque.volume / ball(radius));
    assert!(opaque.hidden_volume > 0.5 * opaque.volume && opaque.centroid.iter().all(|c| c.abs() < 0.2));
    let (thin, _) = measured(0.06, 7.0);
    let exact = ball(10.0) - ball(7.0);
    assert!(thin.hidden_volume == 0.0 && (thin.volume / exact - 1.0).abs() < 0.2, "{} {exact}", thin.volume);
}

#[test]
fn the_place_of_an_opaque_core_is_not_that_of_the_translucent_shell_around_it() {
    let mut all = Owned::default();
    all.fill(1.0, 0.03, 1, |p| (7.0..14.0).contains(&p.length()));
    // nobody sees what is in the core, so it may be of any segment
    all.fill(1.0, 0.03, 1, |p| p.length() < 4.0);
    all.fill(0.5, 10.0, 2, |p| (5.0..=6.0).contains(&p.length()));
    let core = silhouette(&all, 2, DVec3::ZERO);
    let found = volumes(&all, &grid(0.4));
    assert!((found[1] / ball(core) - 1.0).abs() < 0.1, "{} {core}", found[1] / ball(core));
    let exact = ball(14.0) - ball(core.max(7.0));
    assert!((found[0] / exact - 1.0).abs() < 0.12, "{}", found[0] / exact);
}

#[test]
fn the_same_scene_in_other_units_and_split_into_more_gaussians_has_the_same_places() {
    let mut all = Owned::default();
    all.fill(1.0, 0.1, 1, |p| p.length() < 8.0);
    let volume = volumes(&all, &grid(0.5))[0];
    for scale in [1e-4f32, 1e4] {
        let mut other = all.clone();
        other.means.iter_mut().for_each(|v| *v *= scale);
        other.log_scales.iter_mut().for_each(|v| *v += scale.ln());
        let Grid { dims, spacing, origin, .. } = grid(0.5);
        let by = f64::from(scale);
        let grid = Grid::aligned(dims, spacing.map(|v| v * by), origin.map(|v| v * by));
        assert!((volumes(&other, &grid)[0] / by.powi(3) / volume - 1.0).abs() < 1e-3, "{scale}");
    }
    let mut finer = Owned::default();
    finer.fill(0.8, 0.1, 1, |p| p.length() < 8.0);
    assert!((volumes(&finer, &grid(0.5))[0] / volume - 1.0).abs() < 0.05);
}

#[test]
fn labels_on_other_voxels_are_those_of_the_cells() {
    let mut all = Owned::default();
    let centres = [DVec3::new(-7.0, 0.0, 0.0), DVec3::new(7.0, 1.0, 0.0)];
    all.fill(0.5, 20.0, 1, |p| (4.0..5.0).contains(&p.distance(centres[0])));
    all.fill(1.0, 0.05, 2, |p| p.distance(centres[1]) < 6.0);
    let radii = [silhouette(&all, 1, centres[0]), 6.0];
    let places = SegmentPlaces::new(all.cloud(), &grid(0.4), SHARE).unwrap();
    assert_eq!(places.labels_on(all.cloud(), &grid(0.4), |p| p).unwrap(), places.labels());
    let voxels = Grid::aligned([30, 37, 27], [1.1, 0.9, 1.3], [-15.0, -16.0, -17.0]);
    let found = places.labels_on(all.cloud(), &voxels, |p| p).unwrap();
    let truth: Vec<u16> = (0..voxels.len())
        .map(|v| {
            let index = [v % 30, v / 30 % 37, v / (30 * 37)];
            let p = DVec3::from(std::array::from_fn(|k| voxels.origin[k] + voxels.spacing[k] * index[k] as f64));
            (0..2).find(|k| p.distance(centres[*k]) < radii[*k]).map_or(0, |k| k as u16 + 1)
        })
        .collect();
    let pairs = Confusion::new(&truth, &found).unwrap();
    for label in [1, 2] {
        assert!(pairs.overlap(label, label).dice() > 0.92, "{label}: {}", pairs.overlap(label, label).dice());
    }
    let shares = places.shares();
    assert!(shares[0].is_none() && shares[1].unwrap() > 0.9 && shares[2].unwrap() > 0.8, "{shares:?}");
    assert!(places.within(2).iter().all(|i| all.labels[*i as usize] == 2));
}

#[test]
fn flat_gaussians_leave_no_holes() {
    let (mut u, mut all) = (uniform(8), Owned::default());
    while all.labels.len() < 4000 {
        let p = Vec3::from([0; 3].map(|_| 2.0 * u() - 1.0));
        if p.length() <= 1.0 && p.length() > 0.1 {
            let n = p.normalize();
            let q = glam::Quat::from_rotation_arc(Vec3::Z, n);
            all.push((12.0 * n).into(), [q.w, q.x, q.y, q.z], [0.7, 0.7, 0.07], 0.6, 1);
        }
    }
    let labels = SegmentPlaces::new(all.cloud(), &grid(0.7), SHARE).unwrap();
    let (dims, cell) = (labels.grid().dims, 0.7);
    let labels = labels.labels();
    let away = |c: usize| {
        let index = DVec3::new((c % dims[0]) as f64, (c / dims[0] % dims[1]) as f64, (c / dims[0] / dims[1]) as f64);
        ((index + 0.5) * cell - DVec3::splat(20.0)).length() - 12.0
    };
    let near: Vec<usize> = (0..labels.len()).filter(|c| away(*c).abs() < 0.35).collect();
    let held = near.iter().filter(|c| labels[**c] == 1).count();
    assert!(held as f64 > 0.98 * near.len() as f64, "{held} of {}", near.len());
    assert!((0..labels.len()).all(|c| labels[c] == 0 || away(c) < 1.4));
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let all = Owned::random(3000, 9, 15.0, 11);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let places = SegmentPlaces::new(all.cloud(), &grid(0.5), SHARE).unwrap();
            (places.labels(), places.measure(&[1, 5, 8]), places.shares())
        })
    };
    let one = on(1);
    assert!(one.0.contains(&8));
    assert_eq!(one, on(3));
}

#[test]
fn the_rest_occupies_places_too_and_equal_densities_go_to_the_smaller_label() {
    let row = Grid::aligned([4, 1, 1], [1.0; 3], [0.0; 3]);
    let mut all = Owned::default();
    for (x, opacity, label) in [(0.0, 0.5, 3), (0.0, 0.6, 0), (1.0, 0.5, 7), (1.0, 0.5, 5), (2.0, 0.05, 2)] {
        all.push([x, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.2; 3], opacity, label);
    }
    let places = SegmentPlaces::new(all.cloud(), &row, SHARE).unwrap();
    assert_eq!(places.labels(), [0, 5, 2, 0]);
}

#[test]
fn degenerate_gaussians_do_not_count() {
    let all = Owned::random(100, 4, 15.0, 2);
    let found = |all: &Owned| SegmentPlaces::new(all.cloud(), &grid(0.8), SHARE).unwrap().labels();
    let clean = found(&all);
    for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30, f32::MAX] {
        for array in 0..4 {
            let mut poisoned = all.clone();
            poisoned.push([3.0; 3], [1.0, 0.0, 0.0, 0.0], [4.0; 3], 0.9, 6);
            match array {
                0 => poisoned.means[301] = poison,
                1 => poisoned.rotations[400..].fill(if poison.is_finite() { 0.0 } else { poison }),
                2 => poisoned.log_scales[302] = poison,
                _ => poisoned.opacity[100] = if poison > 0.0 && poison.is_finite() { 0.0 } else { poison },
            }
            assert_eq!(found(&poisoned), clean, "{poison} in array {array}");
            assert!(poisoned.cloud().content(100).is_finite());
        }
    }
}

#[test]
fn impossible_input_is_refused() {
    let grid = grid(1.0);
    let all = Owned::random(3, 4, 60.0, 2);
    let error = |cloud, grid: Grid, share| SegmentPlaces::new(cloud, &grid, share).unwrap_err();
    let short = Cloud { opacity: &all.opacity[..2], ..all.cloud() };
    assert!(matches!(error(short, grid, 0.5), PlaceError::Shape { field: "opacity", expected: 3, found: 2 }));
    let high = Cloud { labels: &[0, 65_536, 1], ..all.cloud() };
    assert_eq!(error(high, grid, 0.5), PlaceError::Label { label: 65_536, index: 1 });
    for bad in [
        Grid { dims: [4, 0, 4], ..grid },
        Grid { dims: [usize::MAX, 2, 2], ..grid },
        Grid { spacing: [1.0, -1.0, 1.0], ..grid },
        Grid { origin: [f64::NAN; 3], ..grid },
    ] {
        assert!(matches!(error(all.cloud(), bad, 0.5), PlaceError::Grid { .. }));
    }
    assert!(matches!(error(all.cloud(), grid, f32::NAN), PlaceError::Share(_)));
    assert!(matches!(error(all.cloud(), grid, 1.5), PlaceError::Share(_)));
    let none = Owned::default();
    let places = SegmentPlaces::new(none.cloud(), &grid, SHARE).unwrap();
    assert!(places.labels().iter().all(|l| *l == 0) && places.measure(&[1]).iter().all(Option::is_none));
    assert_eq!(scene_grid([0.0; 3], [1.0, 0.5, 0.0]).dims[2], 1);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn a_ball_moves_and_grows_as_it_does(x in -6f64..6.0, y in -6f64..6.0, radius in 8f64..11.0, log in -1.5f64..-1.2) {
        let centre = DVec3::new(x, y, 1.5);
        let mut all = Owned::default();
        all.fill(1.0, 10f64.powf(log), 1, |p| p.distance(centre) < radius);
        let places = SegmentPlaces::new(all.cloud(), &grid(0.5), SHARE).unwrap();
        let found = places.measure(&[1])[0].unwrap();
        prop_assert!(DVec3::from(found.centroid).distance(centre) < 0.3, "{:?} {}", found.centroid, centre);
        prop_assert!((found.volume / ball(radius) - 1.0).abs() < 0.2, "{}", found.volume / ball(radius));
        let extent = found.covariance[0][0].sqrt() / (radius / 5f64.sqrt());
        prop_assert!((extent - 1.0).abs() < 0.1, "{extent}");
        for k in 0..3 {
            prop_assert!((found.box_max[k] - found.box_min[k] - 2.0 * radius).abs() < 3.0);
        }
    }

    #[test]
    fn a_lower_share_never_takes_a_place_away(seed in 0u64..50) {
        let mut all = Owned::random(60, 2, 15.0, seed);
        all.labels.fill(1);
        let labels = |share| SegmentPlaces::new(all.cloud(), &grid(1.0), share).unwrap().labels();
        let [loose, tight] = [0.3, 0.7].map(labels);
        for (loose, tight) in loose.iter().zip(&tight) {
            prop_assert!(*tight == 0 || *loose > 0);
        }
    }
}
