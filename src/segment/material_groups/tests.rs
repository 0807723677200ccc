//! Clouds of known materials, shaded and with the noise of trained Gaussians.

use crate::config::types::SegmentConfig;
use crate::model::sh::{C0, basis};
use crate::model::{HostGaussians, OtherTimes};
use crate::rng::{Purpose, Rng};
use crate::segment::coarse::{Coarse, coarse, hidden};
use std::f32::consts::PI;
use volseggs_kernels::activation::logit;

fn with(outliers: bool, clusters: usize) -> SegmentConfig {
    let mut config = SegmentConfig::default();
    (config.colour.outliers, config.colour.clusters) = (outliers, clusters);
    config
}

/// One material: its colour, where it lies, its size, how opaque it is and how many Gaussians it has.
#[derive(Clone, Copy)]
struct Body {
    base: [f32; 3],
    centre: [f32; 3],
    radius: f32,
    opacity: f32,
    count: usize,
}

/// How it is lit.
#[derive(Clone, Copy)]
struct Light {
    ambient: f32,
    diffuse: f32,
    specular: f32,
    /// Share of Gaussians at dark rims.
    rims: f32,
    /// Noise of each coefficient.
    noise: f32,
}

const PLAIN: Light = Light { ambient: 0.3, diffuse: 0.6, specular: 0.1, rims: 0.3, noise: 0.08 };

/// Gaussians on spheres, and which body each belongs to; a tenth have a random colour. Light falls off with the square
/// of the cosine, which harmonics of degree 2 represent exactly: `(n.d)^2 = 1/3 + 8 pi / 15 sum_m Y_2m(n) Y_2m(d)`.
fn cloud(bodies: &[Body], light: &Light, seed: u64) -> (HostGaussians, Vec<u32>) {
    let mut rng = Rng::new(seed, 0, Purpose::Custom(0));
    let (mut g, mut truth) = (HostGaussians { sh_stride: 16, ..HostGaussians::default() }, Vec::new());
    for (k, body) in bodies.iter().enumerate() {
        for _ in 0..body.count {
            let v = [rng.normal(), rng.normal(), rng.normal()];
            let length = v.iter().map(|v| v * v).sum::<f32>().sqrt();
            let normal = v.map(|v| v / length);
            g.means.extend((0..3).map(|a| body.centre[a] + body.radius * normal[a] + 0.01 * rng.normal()));
            g.log_scales.extend([-4.0; 3]);
            g.rotations.extend([1.0, 0.0, 0.0, 0.0]);
            let logit = logit(body.opacity) + 0.5 * rng.normal();
            g.opacity_logits.push(logit);
            let lit = if rng.uniform() < light.rims { 0.2 + 0.5 * rng.uniform() } else { 1.0 };
            let stray = rng.uniform() < 0.1;
            let base = if stray { [0; 3].map(|_| rng.uniform()) } else { body.base };
            let mut sh = [[0f32; 3]; 16];
            for c in 0..3 {
                let (flat, square) = (lit * base[c] * light.ambient, lit * (base[c] * light.diffuse + light.specular));
                sh[0][c] = (flat + square / 3.0 - 0.5) / C0;
                for (m, y) in basis(normal).iter().enumerate().take(9).skip(4) {
                    sh[m][c] = square * 8.0 * PI / 15.0 * y;
                }
                sh.iter_mut().for_each(|s| s[c] += light.noise * rng.normal());
            }
            g.sh.extend(sh.iter().flatten());
            truth.push(if stray { 0 } else { k as u32 + 1 });
        }
    }
    (g, truth)
}

/// Intersection over union of each body with the group that fits it best.
fn overlaps(found: &Coarse, truth: &[u32], bodies: usize) -> Vec<f64> {
    let iou = |body: u32, label: u32| {
        let count = |f: &dyn Fn(u32, u32) -> bool| {
            truth.iter().zip(&found.labels).filter(|(t, l)| **t > 0 && f(**t, **l)).count()
        };
        count(&|t, l| t == body && l == label) as f64 / count(&|t, l| t == body || l == label).max(1) as f64
    };
    let labels = 1..=found.palette.len() as u32;
    (1..=bodies as u32).map(|b| labels.clone().map(|l| iou(b, l)).fold(0.0, f64::max)).collect()
}

fn names(found: &Coarse) -> Vec<&str> {
    found.palette.iter().map(|p| p.name.as_str()).collect()
}

/// A translucent blue shell around a green and a red body.
fn nested() -> [Body; 3] {
    let body = |base, centre, radius, opacity, count| Body { base, centre, radius, opacity, count };
    [
        body([0.25, 0.5, 0.9], [0.0; 3], 1.2, 0.1, 2500),
        body([0.2, 0.7, 0.25], [0.2, 0.0, 0.0], 0.6, 0.8, 1200),
        body([0.85, 0.15, 0.15], [-0.1, 0.1, 0.0], 0.25, 0.9, 300),
    ]
}

#[test]
fn a_shell_a_body_and_a_core_are_three_materials_in_any_light() {
    for (ambient, diffuse, specular, rims) in [(0.1, 0.8, 0.0, 0.4), (0.3, 0.6, 0.3, 0.3), (0.8, 0.2, 0.1, 0.0)] {
        let light = Light { ambient, diffuse, specular, rims, ..PLAIN };
        let (g, truth) = cloud(&nested(), &light, 1);
        let found = coarse(&g, None, &SegmentConfig::default(), 0).unwrap();
        let iou = overlaps(&found, &truth, 3);
        assert_eq!(found.palette.len(), 3, "{ambient}: {:?} {iou:?}", names(&found));
        assert!(iou.iter().all(|v| *v > 0.9), "{ambient}: {iou:?}");
        for hue in ["blue", "green", "red"] {
            assert!(names(&found).iter().any(|n| n.ends_with(hue)), "{ambient}: {:?}", names(&found));
        }
    }
}

#[test]
fn one_hue_is_split_into_distant_pale_and_deep_colours_and_greys_by_lightness() {
    let body = |base, x: f32, count| Body { base, centre: [x, 0.0, 0.0], radius: 0.4, opacity: 0.5, count };
    let (g, truth) = cloud(&[body([0.65, 0.8, 0.95], -1.0, 900), body([0.1, 0.25, 0.85], 1.0, 500)], &PLAIN, 2);
    let found = coarse(&g, None, &SegmentConfig::default(), 0).unwrap();
    let all = names(&found);
    assert!(all.len() == 2 && all.iter().all(|n| n.contains("blue")), "{all:?}");
    assert!(overlaps(&found, &truth, 2).iter().all(|v| *v > 0.9));
    let light = Light { rims: 0.1, specular: 0.0, ..PLAIN };
    let greys = [body([0.95; 3], -1.0, 900), body([0.35; 3], 1.0, 500), body([0.9, 0.2, 0.2], 3.0, 300)];
    let (g, truth) = cloud(&greys, &light, 3);
    let found = coarse(&g, None, &SegmentConfig::default(), 0).unwrap();
    assert!(names(&found).len() == 3 && overlaps(&found, &truth, 3).iter().all(|v| *v > 0.85), "{:?}", names(&found));
    // rims and light sides of one grey are one material
    let (g, _) = cloud(&[body([0.7; 3], 0.0, 1500)], &PLAIN, 4);
    assert_eq!(coarse(&g, None, &SegmentConfig::default(), 0).unwrap().palette.len(), 1);
}

#[test]
fn the_requested_number_of_groups_is_made_reproducibly() {
    let (g, truth) = cloud(&nested(), &PLAIN, 5);
    for clusters in [1, 2, 3, 5, 12] {
        let options = with(true, clusters);
        let found = coarse(&g, None, &options, 0).unwrap();
        assert_eq!(found.palette.len(), clusters, "{:?} {}", names(&found), found.outliers);
        assert_eq!(found.labels, coarse(&g, None, &options, 0).unwrap().labels);
        if clusters == 3 {
            assert!(overlaps(&found, &truth, 3).iter().all(|v| *v > 0.9));
        }
    }
}

#[test]
fn threads_change_nothing() {
    let (g, _) = cloud(&nested(), &PLAIN, 6);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| coarse(&g, None, &SegmentConfig::default(), 0).unwrap())
    };
    let (one, three) = (run(1), run(3));
    assert_eq!((one.labels, one.palette), (three.labels, three.palette));
}

#[test]
fn black_non_finite_and_single_gaussians_are_accepted() {
    let body = Body { base: [0.0; 3], centre: [0.0; 3], radius: 0.5, opacity: 0.5, count: 60 };
    let (black, _) = cloud(&[body], &Light { specular: 0.0, noise: 0.0, ..PLAIN }, 7);
    let found = coarse(&black, None, &SegmentConfig::default(), 0).unwrap();
    assert!(!found.palette.is_empty() && found.labels.iter().any(|l| *l > 0));
    let (mut g, _) = cloud(&nested(), &PLAIN, 8);
    (g.sh[7], g.sh[48], g.means[6], g.opacity_logits[3]) = (f32::NAN, f32::INFINITY, f32::NAN, f32::NAN);
    g.sh[48 * 4..48 * 5].fill(f32::MAX);
    let found = coarse(&g, None, &SegmentConfig::default(), 0).unwrap();
    assert_eq!((found.labels[0], found.labels[1], found.labels[2], found.labels[3], found.not_finite), (0, 0, 0, 0, 4));
    let options = with(false, 0);
    let found = coarse(&g.subset(&[9]), None, &options, 0).unwrap();
    assert_eq!((found.labels, found.palette.len()), (vec![1], 1));
}

#[test]
fn gaussians_of_another_time_join_the_material_of_their_colour() {
    let (mut g, truth) = cloud(&nested(), &PLAIN, 9);
    (0..g.len()).filter(|i| i % 7 == 0).for_each(|i| g.opacity_logits[i] = -9.0);
    let options = with(false, 0);
    let opacity = hidden(&g, &options).iter().map(|h| if *h { 0.9 } else { 0.0 }).collect();
    let later = OtherTimes { means: Vec::new(), opacity };
    let found = coarse(&g, Some(&later), &options, 0).unwrap();
    assert_eq!(found.transparent, 0);
    let later: Vec<usize> = (0..g.len()).filter(|i| i % 7 == 0 && truth[*i] > 0).collect();
    let of_truth = |t: u32| {
        let rows = (0..g.len()).filter(|i| i % 7 != 0 && truth[*i] == t);
        let mut counts = [0; 16];
        rows.for_each(|i| counts[found.labels[i] as usize] += 1);
        (0..16).max_by_key(|l| counts[*l]).unwrap() as u32
    };
    let labels: Vec<u32> = (0..4).map(of_truth).collect();
    let right = later.iter().filter(|&&i| found.labels[i] == labels[truth[i] as usize]).count();
    assert!(right * 10 > later.len() * 8, "{right} of {}", later.len());
}

#[test]
fn a_material_invisible_at_this_time_is_found_from_another_time() {
    let (mut g, truth) = cloud(&nested(), &PLAIN, 10);
    let core = |i: usize| i >= 2500 + 1200;
    (0..g.len()).filter(|&i| core(i)).for_each(|i| g.opacity_logits[i] = -9.0);
    let opacity = (0..g.len()).map(|i| if core(i) { 0.9 } else { 0.0 }).collect();
    let later = OtherTimes { means: Vec::new(), opacity };
    let of = |later: Option<&OtherTimes>, clusters| coarse(&g, later, &with(false, clusters), 0).unwrap();
    let found = of(Some(&later), 0);
    assert!(found.palette.len() == 3 && names(&found)[2].ends_with("red"), "{:?}", names(&found));
    let right = (0..g.len()).filter(|&i| core(i) && truth[i] == 3 && found.labels[i] == 3).count();
    let all = (0..g.len()).filter(|&i| core(i) && truth[i] == 3).count();
    assert!(right * 10 > all * 9, "{right} of {all}");
    assert_eq!(of(None, 0).palette.len(), 2);
    assert_eq!(of(Some(&later), 2).palette.len(), 2, "the requested number");
    // too few and too faint Gaussians are outliers
    let opacity = (0..).zip(&later.opacity).map(|(i, o)| if i % 20 == 0 { 0.05 * o } else { 0.0 }).collect();
    let faint = OtherTimes { opacity, ..OtherTimes::default() };
    assert_eq!(of(Some(&faint), 0).palette.len(), 2);
}

/// Base colours that are easy to distinguish.
const BASES: [[f32; 3]; 12] = [
    [0.9, 0.1, 0.12],
    [0.96, 0.51, 0.08],
    [0.93, 0.87, 0.12],
    [0.12, 0.67, 0.16],
    [0.1, 0.8, 0.8],
    [0.1, 0.27, 0.86],
    [0.55, 0.7, 0.94],
    [0.5, 0.16, 0.7],
    [0.9, 0.1, 0.78],
    [0.9, 0.9, 0.9],
    [0.3, 0.3, 0.3],
    [0.59, 0.9, 0.59],
];

/// `--nocapture` prints a line for each cloud.
#[test]
fn the_number_of_materials_is_found_on_most_random_clouds() {
    let (mut right, mut clouds) = (0, 0);
    for seed in 0..12u64 {
        let mut rng = Rng::new(seed, 1, Purpose::Custom(0));
        let count = 1 + (seed % 6) as usize;
        let mut bases: Vec<usize> = Vec::new();
        while bases.len() < count {
            let k = (rng.uniform() * BASES.len() as f32) as usize % BASES.len();
            if !bases.contains(&k) {
                bases.push(k);
            }
        }
        let shares: Vec<f32> = bases.iter().map(|_| 0.03 + rng.uniform().powi(2)).collect();
        let opacities: Vec<f32> = bases.iter().map(|_| [0.1, 0.5, 0.9][(3.0 * rng.uniform()) as usize % 3]).collect();
        let counts: Vec<f32> = shares.iter().zip(&opacities).map(|(share, opacity)| share / opacity).collect();
        let all: f32 = counts.iter().sum();
        let bodies: Vec<Body> = (0..count)
            .map(|k| Body {
                base: BASES[bases[k]],
                centre: [0; 3].map(|_| 2.4 * rng.uniform() - 1.2),
                radius: 0.2 + 0.4 * rng.uniform(),
                opacity: opacities[k],
                count: ((3000.0 * counts[k] / all) as usize).max(60),
            })
            .collect();
        let ambient = 0.1 + 0.7 * rng.uniform();
        let light = Light {
            ambient,
            diffuse: 1.0 - ambient,
            specular: 0.2 * rng.uniform(),
            rims: 0.4 * rng.uniform(),
            noise: 0.05 + 0.05 * rng.uniform(),
        };
        let (g, truth) = cloud(&bodies, &light, seed);
        let found = coarse(&g, None, &SegmentConfig::default(), 0).unwrap();
        let iou = overlaps(&found, &truth, count);
        let mean = iou.iter().sum::<f64>() / count as f64;
        println!(
            "{seed:3} ambient {ambient:.2}: {count} materials, {} found, IoU {mean:.2} {:?}",
            found.palette.len(),
            names(&found)
        );
        clouds += 1;
        right += usize::from(found.palette.len() == count);
    }
    println!("{right} of {clouds}");
    assert!(right * 6 >= clouds * 5, "{right} of {clouds}");
}
