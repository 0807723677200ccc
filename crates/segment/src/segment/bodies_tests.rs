//! Joining of surface layers on spheres and blocks of Gaussians.

use super::*;
use crate::rng::{Purpose, Rng};
use crate::segment::colour::fibonacci_sphere;
use crate::segment::test_support::{add, on_threads};

/// Adds a sphere of Gaussians whose neighbours are 0.083 radii apart, and returns the `label` of each.
fn sphere(to: &mut HostGaussians, x: f32, radius: f32, label: impl Fn(usize) -> u32) -> Vec<u32> {
    let places = fibonacci_sphere(1800);
    places.iter().for_each(|p| add(to, [x + radius * p[0], radius * p[1], radius * p[2]], [-3.0; 3]));
    (0..places.len()).map(label).collect()
}

/// The labels after joining, in a scene that begins with Gaussians that are not shown.
fn joined(at: &HostGaussians, labels: &[u32]) -> Vec<u32> {
    let (count, mut out) = (at.len() as u32, labels.to_vec());
    let others = count.min(3);
    let at = at.subset(&(0..others).chain(0..count).collect::<Vec<u32>>());
    let shown: Vec<u32> = (others..others + count).collect();
    join_surface_layers(&at, &shown, &mut out, &SegmentConfig::default()).unwrap();
    out
}

#[test]
fn a_surface_layer_joins_what_it_covers_and_the_rest_of_its_material_stays() {
    let mut at = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
    // four ninths of the first sphere are of the material of the second, which is far away
    let mut labels = sphere(&mut at, -3.0, 1.0, |i| if i % 9 < 5 { 1 } else { 2 });
    labels.extend(sphere(&mut at, 3.0, 1.0, |_| 2));
    let found = joined(&at, &labels);
    assert!(found[..1800].iter().all(|l| *l == 1) && found[1800..].iter().all(|l| *l == 2));
    assert_eq!(found, on_threads(1, || joined(&at, &labels)));
    // the same if all of its material is surface layer, as both cover each other; a stray bit of it follows
    let mut alone = at.subset(&(0..1800).collect::<Vec<u32>>());
    add(&mut alone, [-3.0, 0.0, 1.5], [-3.0; 3]);
    labels[1800] = 2;
    assert!(joined(&alone, &labels[..1801]).iter().all(|l| *l == 1));
}

/// Adds a block of Gaussians 0.05 apart, each `material`.
fn block(to: &mut Vec<([f32; 3], u32)>, from: [i32; 3], size: [i32; 3], material: u32) {
    for place in 0..size.iter().product() {
        let at = [place % size[0], place / size[0] % size[1], place / (size[0] * size[1])];
        to.push(([0, 1, 2].map(|a| 0.05 * (from[a] + at[a]) as f32), material));
    }
}

/// Gaussians at these places, and the material of each.
fn scene(rows: &[([f32; 3], u32)]) -> (HostGaussians, Vec<u32>) {
    let mut at = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
    rows.iter().for_each(|(place, _)| add(&mut at, *place, [-3.3; 3]));
    (at, rows.iter().map(|row| row.1).collect())
}

#[test]
fn a_layer_several_gaussians_thick_joins_what_it_covers() {
    let mut rows = Vec::new();
    // a body, a layer on it, and another body of the layer's material that the layer runs into
    block(&mut rows, [0, 0, 0], [40, 40, 8], 1);
    block(&mut rows, [0, 0, 8], [40, 40, 2], 2);
    block(&mut rows, [40, 0, 8], [40, 40, 16], 2);
    Rng::new(0, 0, Purpose::Custom(0)).shuffle(&mut rows);
    let (at, labels) = scene(&rows);
    let found = joined(&at, &labels);
    let share = |found: &[u32], wanted: &dyn Fn([f32; 3]) -> bool, label: u32| {
        let of_it: Vec<usize> = (0..rows.len()).filter(|&n| wanted(rows[n].0)).collect();
        of_it.iter().filter(|&&n| found[n] == label).count() as f64 / of_it.len() as f64
    };
    let layer = |p: [f32; 3]| p[0] < 1.8 && p[2] > 0.38;
    let others = [share(&found, &|p| p[2] < 0.38, 1), share(&found, &|p| p[0] > 2.2, 2)];
    assert!(share(&found, &layer, 1) > 0.9 && others == [1.0; 2], "{} {others:?}", share(&found, &layer, 1));
    assert_eq!(found, on_threads(1, || joined(&at, &labels)));
    let (all, mut at_once): (Vec<u32>, _) = ((0..at.len() as u32).collect(), labels.clone());
    join(&at, &all, &mut at_once, &vec![false; labels.len()], &SegmentConfig::default()).unwrap();
    assert!(share(&at_once, &layer, 2) > 0.9, "not without samples");
}

#[test]
fn what_has_joined_a_layer_goes_along_with_it() {
    // as above, with a small patch on the layer, whose material is mostly elsewhere
    let mut rows = Vec::new();
    block(&mut rows, [0, 0, 0], [40, 40, 8], 1);
    block(&mut rows, [0, 0, 8], [40, 40, 2], 2);
    block(&mut rows, [40, 0, 8], [40, 40, 16], 2);
    let patch = rows.len();
    block(&mut rows, [8, 8, 10], [12, 12, 1], 3);
    let elsewhere = rows.len();
    block(&mut rows, [120, 0, 0], [12, 12, 4], 3);
    let (at, labels) = scene(&rows);
    let (all, mut at_once): (Vec<u32>, _) = ((0..at.len() as u32).collect(), labels.clone());
    join(&at, &all, &mut at_once, &vec![false; labels.len()], &SegmentConfig::default()).unwrap();
    assert!(at_once[patch..elsewhere].iter().all(|l| *l == 2), "it is on the layer");
    let found = joined(&at, &labels);
    let share = |range: std::ops::Range<usize>, label: u32| {
        found[range.clone()].iter().filter(|l| **l == label).count() as f64 / range.len() as f64
    };
    assert!(share(12_800..16_000, 1) > 0.9, "the layer joins the body");
    assert!(share(patch..elsewhere, 1) > 0.9, "the patch on the layer goes along: {}", share(patch..elsewhere, 1));
    assert_eq!(share(elsewhere..rows.len(), 3), 1.0, "the rest of its material stays");
}

#[test]
fn bodies_of_the_same_two_materials_get_one_label() {
    let mut at = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
    // two spheres are five ninths of the first material, the third is five ninths of the second and would get that
    // label on its own
    let mut labels = Vec::new();
    for (x, more, less) in [(-3.0, 1, 2), (3.0, 1, 2), (9.0, 2, 1)] {
        labels.extend(sphere(&mut at, x, 1.0, |i| if i % 9 < 5 { more } else { less }));
    }
    assert!(joined(&at, &labels).iter().all(|l| *l == 1));
    // a sphere of one material alone does not take the label of the others
    labels.extend(sphere(&mut at, 15.0, 1.0, |_| 2));
    let found = joined(&at, &labels);
    assert!(found[..5400].iter().all(|l| *l == 1) && found[5400..].iter().all(|l| *l == 2));
}

#[test]
fn shells_around_objects_and_patches_on_them_stay() {
    let mut at = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
    // a core, a shell well away from it, and a sphere with one half painted
    let mut labels = sphere(&mut at, 0.0, 1.0, |_| 1);
    labels.extend(sphere(&mut at, 0.0, 1.3, |_| 2));
    labels.extend(sphere(&mut at, 5.0, 1.0, |i| if i < 900 { 3 } else { 4 }));
    assert_eq!(joined(&at, &labels), labels);
}

#[test]
fn gaussians_without_material_stay_and_invisible_ones_follow() {
    let mut at = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
    let mut labels = sphere(&mut at, 0.0, 1.0, |i| if i % 9 < 5 { 1 } else { 2 });
    (labels[3], at.opacity_logits[8]) = (0, -9.0);
    let found = joined(&at, &labels);
    assert_eq!((found[3], found[8], found[14]), (0, 1, 1));
    // also if most of their material is elsewhere and stays
    let more = sphere(&mut at, 5.0, 1.0, |_| 2);
    at.opacity_logits[1808] = -9.0;
    let found = joined(&at, &[labels, more].concat());
    assert_eq!((found[8], found[14], found[1808], found[1814]), (1, 1, 2, 2));
    assert_eq!(joined(&at.subset(&[]), &[]), [0u32; 0]);
    assert_eq!(joined(&at.subset(&[4]), &[7]), [7]);
}
