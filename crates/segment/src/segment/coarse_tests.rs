//! Coarse segments of two balls, of a thread, and of non-finite values.

use super::*;
use crate::model::fixture::scene;
use crate::model::sh::C0;
use crate::segment::test_support::add;

/// A red and a blue ball, a red stray in the blue one, and a transparent haze.
fn two_balls() -> (HostGaussians, Vec<u32>) {
    let mut rng = Rng::new(3, 0, Purpose::Custom(0));
    let (mut g, mut truth) = (HostGaussians { sh_stride: 4, ..HostGaussians::default() }, Vec::new());
    let mut add = |centre: f32, colour: [f32; 3], logit: f32, label: u32| {
        for _ in 0..3 {
            g.means.push(centre + 0.1 * rng.normal());
            g.log_scales.push(-3.0);
        }
        g.rotations.extend([1.0, 0.0, 0.0, 0.0]);
        g.opacity_logits.push(logit);
        g.sh.extend(colour.map(|c| (c + 0.03 * rng.normal() - 0.5) / C0));
        g.sh.extend((0..9).map(|_| 0.05 * rng.normal()));
        truth.push(label);
    };
    for k in 0..900 {
        match k % 3 {
            0 => add(-1.0, [0.9, 0.1, 0.1], 2.0, 2),
            1 => add(1.0, [0.1, 0.2, 0.9], 3.0, 1),
            _ => add(0.0, [0.5, 0.9, 0.5], -6.0, 0),
        }
    }
    add(1.0, [0.9, 0.1, 0.1], 2.0, 0);
    (g, truth)
}

/// Gaussians at rest with these opacities at another time.
fn of_space(space: ColourSpace) -> SegmentConfig {
    let mut config = SegmentConfig::default();
    config.colour.space = space;
    config
}

fn visible_later(opacity: Vec<f32>) -> OtherTimes {
    OtherTimes { means: Vec::new(), opacity }
}

#[test]
fn colours_are_separated_and_haze_belongs_to_none() {
    let (g, truth) = two_balls();
    for space in [ColourSpace::Rgb, ColourSpace::Lab, ColourSpace::Material] {
        let out = coarse(&g, None, &of_space(space), 0).unwrap();
        let names: Vec<&str> = out.palette.iter().map(|p| p.name.as_str()).collect();
        assert_eq!(names, ["blue", "red"], "{space:?}");
        let wrong = out.labels.iter().zip(&truth).filter(|(a, b)| a != b).count();
        assert!(wrong <= 9, "{wrong} wrong in {space:?}: only the rims of the balls may be");
        // with mean colours it is an outlier, with materials it takes the label of its neighbours
        let stray = if space == ColourSpace::Material { 1 } else { 0 };
        assert_eq!(out.labels.last(), Some(&stray), "the stray");
    }
    // haze that is opaque at another time joins the nearest colour
    let later = visible_later((0..truth.len()).map(|i| if i % 6 == 2 { 0.02 } else { 0.0 }).collect());
    for space in [ColourSpace::Rgb, ColourSpace::Material] {
        let options = of_space(space);
        let with = coarse(&g, Some(&later), &options, 0).unwrap();
        let without = coarse(&g, None, &options, 0).unwrap();
        for i in 0..900 {
            assert_eq!(with.labels[i] > 0, without.labels[i] > 0 || i % 6 == 2, "{i}");
        }
    }
    let mut kept = of_space(ColourSpace::Rgb);
    (kept.colour.outliers, kept.colour.clusters) = (false, 2);
    let out = coarse(&g, None, &kept, 0).unwrap();
    assert_eq!((out.outliers, out.labels.last()), (0, Some(&2)));
    assert_eq!(out.labels, coarse(&g, None, &kept, 0).unwrap().labels, "the same labels again");
}

#[test]
fn every_gaussian_is_accounted_for_and_no_colour_is_empty() {
    let (mut g, _) = two_balls();
    g.means[0] = f32::NAN;
    let numbers = [0, 2, 40];
    for (clusters, space) in numbers.into_iter().flat_map(|k| [(k, ColourSpace::Rgb), (k, ColourSpace::Material)]) {
        let mut config = of_space(space);
        config.colour.clusters = clusters;
        let out = coarse(&g, None, &config, 0).unwrap();
        let mut counts = vec![0; out.palette.len()];
        out.labels.iter().filter(|l| **l > 0).for_each(|l| counts[*l as usize - 1] += 1);
        assert!(counts.iter().all(|n| *n > 0), "{counts:?}");
        let inside: usize = counts.iter().sum();
        assert_eq!(inside + out.outliers + out.transparent + out.not_finite, g.len());
        assert_eq!(out.not_finite, 1);
        assert!(space == ColourSpace::Material || out.outliers > 0, "{space:?}: the stray");
        assert!(out.transparent >= 300, "{}", out.transparent);
    }
    // every Gaussian is isolated, so all are removed
    g.log_scales.fill(-20.0);
    let mut config = of_space(ColourSpace::Rgb);
    config.colour.outlier_radius = 1e-6;
    let out = coarse(&g, None, &config, 0).unwrap();
    assert!(out.palette.is_empty() && out.labels.iter().all(|l| *l == 0));
    let mut labels = [0, 3, 1, 3];
    assert_eq!(without_empty(&[1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 3.0, 3.0, 3.0], &mut labels)[3..], [3.0; 3]);
    assert_eq!(labels, [0, 2, 1, 2]);
}

#[test]
fn a_thin_thread_is_kept_only_where_its_gaussians_touch() {
    let (mut g, truth) = two_balls();
    let ball = g.len();
    for k in 0..60 {
        g.means.extend([1.0 + 0.1 * k as f32, 3.0, 0.0]);
        g.log_scales.extend([0.03f32.ln(), -5.0, -5.0]);
        g.rotations.extend([1.0, 0.0, 0.0, 0.0]);
        g.opacity_logits.push(2.0);
        g.sh.extend([0.9, 0.1, 0.1].map(|c: f32| (c - 0.5) / C0).iter().chain(&[0.0; 9]));
    }
    for space in [ColourSpace::Rgb, ColourSpace::Material] {
        let options = of_space(space);
        let red = coarse(&g, None, &options, 0).unwrap().labels[truth.iter().position(|t| *t == 2).unwrap()];
        assert_eq!(coarse(&g, None, &options, 0).unwrap().labels[ball..], [red; 60], "{space:?}");
        let mut apart = g.clone();
        apart.log_scales[3 * ball..].fill(-5.0);
        assert_eq!(coarse(&apart, None, &options, 0).unwrap().labels[ball..], [0; 60], "{space:?}");
    }
}

#[test]
fn empty_and_non_finite_inputs_are_accepted() {
    let (mut g, _) = two_balls();
    (g.means[0], g.sh[20], g.opacity_logits[6]) = (f32::NAN, f32::INFINITY, f32::NAN);
    let out = coarse(&g, None, &SegmentConfig::default(), 0).unwrap();
    assert_eq!((out.labels[0], out.labels[6]), (0, 0));
    let none = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
    for clusters in [0, 3] {
        let mut config = SegmentConfig::default();
        config.colour.clusters = clusters;
        let out = coarse(&none, None, &config, 0).unwrap();
        assert!(out.palette.is_empty() && out.labels.is_empty());
    }
}

#[test]
fn a_surface_layer_joins_its_body_with_what_is_visible_later_unless_it_is_to_be_kept() {
    let mut g = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
    let mut sphere = |x: f32, radius: f32, colour: [f32; 3], logit: f32| {
        for place in fibonacci_sphere(1800) {
            add(&mut g, [x + radius * place[0], radius * place[1], radius * place[2]], [-2.6; 3]);
        }
        let first = g.len() - 1800;
        g.opacity_logits[first..].fill(logit);
        g.sh[3 * first..].chunks_exact_mut(3).for_each(|sh| sh.copy_from_slice(&colour.map(|c| (c - 0.5) / C0)));
    };
    let (red, blue) = ([0.9, 0.1, 0.1], [0.1, 0.2, 0.9]);
    sphere(-3.0, 1.0, red, 3.0);
    sphere(-3.0, 1.1, blue, 2.0);
    sphere(3.0, 1.0, blue, 2.0);
    sphere(-3.0, 1.15, blue, -9.0); // visible later
    let later = visible_later((0..g.len()).map(|i| if i < 5400 { 0.0 } else { 0.5 }).collect());
    let labels = |join: bool| {
        let mut config = SegmentConfig::default();
        config.layers.join = join;
        let out = coarse(&g, Some(&later), &config, 0).unwrap();
        let of = |sphere: usize| out.labels[1800 * sphere..][..1800].to_vec();
        let all_of = [0, 1, 2, 3].map(|sphere| of(sphere)[0]);
        (0..4).for_each(|sphere| assert_eq!(of(sphere), [all_of[sphere]; 1800], "sphere {sphere}"));
        all_of.map(|label| out.palette[label as usize - 1].name.clone())
    };
    assert_eq!(labels(false), ["red", "blue", "blue", "blue"]);
    assert_eq!(labels(true), ["red", "red", "blue", "red"]);
}

#[test]
fn what_a_core_passes_by_stays_with_its_body() {
    let mut rng = Rng::new(5, 0, Purpose::Custom(0));
    let mut g = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
    let mut ball = |count: usize, radius: f32, colour: [f32; 3]| {
        for _ in 0..count {
            let place = [0; 3].map(|_| radius * rng.normal());
            add(&mut g, place, [-3.0; 3]);
            let first = g.sh.len() - 3;
            g.sh[first..].copy_from_slice(&colour.map(|c| (c + 0.02 * rng.normal() - 0.5) / C0));
        }
    };
    ball(2000, 0.5, [0.2, 0.7, 0.25]);
    ball(15, 0.1, [0.34, 0.46, 0.2]); // of the body, in a colour between those of body and core
    ball(300, 0.1, [0.9, 0.15, 0.15]);
    // the core goes to and fro
    let moved = |by: f32| -> Vec<f32> {
        let of = |(k, v): (usize, &f32)| if k >= 3 * 2015 && k % 3 == 0 { v + by } else { *v };
        g.means.iter().enumerate().map(of).collect()
    };
    let passing = OtherTimes { means: [-0.8, -0.4, 0.0, 0.4, 0.8].map(moved).into(), opacity: vec![0.0; g.len()] };
    let mut options = SegmentConfig::default();
    options.colour.outliers = false;
    let reds = |found: &Coarse| {
        let red = 1 + found.palette.iter().position(|p| p.name == "red").unwrap() as u32;
        [0..2000, 2000..2015, 2015..2315].map(|rows| found.labels[rows].iter().filter(|l| **l == red).count())
    };
    let at_once = reds(&coarse(&g, None, &options, 0).unwrap());
    let over_time = reds(&coarse(&g, Some(&passing), &options, 0).unwrap());
    assert!(at_once[1] >= 5, "by the neighbours of this time alone: {at_once:?}");
    assert!(over_time[0] == 0 && over_time[1] == 0 && over_time[2] == 300, "{over_time:?}");
}

#[test]
fn positions_at_other_times_are_computed_only_if_materials_are_grouped() {
    let scene = scene();
    let at = scene.host_at(0.3);
    let of = |space| other_times(&scene, &at, &of_space(space));
    let material = of(ColourSpace::Material);
    assert_eq!(material.means.iter().map(Vec::len).collect::<Vec<_>>(), [6; 5]);
    for space in [ColourSpace::Rgb, ColourSpace::Lab] {
        let other_times = of(space);
        assert_eq!((other_times.means.len(), other_times.opacity), (0, material.opacity.clone()), "{space:?}");
    }
}

#[test]
fn gaussians_visible_later_are_relabelled_once_with_their_nearest() {
    // on a line: two of material 1, one of them relabelled as 2; one of material 2, relabelled as 3; near them, four
    // that are visible later
    let x = [0.0, 1.0, 2.0, 0.1, 0.9, 2.1, 5.0];
    let at = HostGaussians { means: x.iter().flat_map(|x| [*x, 0.0, 0.0]).collect(), ..HostGaussians::default() };
    let mut later = [1, 1, 2, 3];
    follow_nearest(&at, [&[0, 1, 2], &[3, 4, 5, 6]], [&[1, 1, 2], &[1, 2, 3]], &mut later).unwrap();
    assert_eq!(later, [1, 2, 3, 3], "the second is relabelled only once, and material 3 is unchanged");
    let mut alone = [4];
    follow_nearest(&at, [&[0], &[3]], [&[1], &[2]], &mut alone).unwrap();
    assert_eq!(alone, [4]);
}
