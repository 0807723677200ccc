//! What the scenes guarantee: range, empty faces, continuity, and which segments exist when and in how many pieces.

use super::Synthetic;
use crate::volume::grid::{Volume, VolumeLabels};
use proptest::prelude::*;

const SIDE: usize = 48;

fn cube(scene: Synthetic, t: f64) -> (Volume, VolumeLabels) {
    scene.sample([SIDE; 3], t)
}

fn count(labels: &VolumeLabels, name: &str, scene: Synthetic) -> usize {
    let id = id_of(scene, name);
    labels.ids.iter().filter(|&&l| l == id).count()
}

fn id_of(scene: Synthetic, name: &str) -> u16 {
    scene.segment_names().iter().position(|n| *n == name).unwrap() as u16 + 1
}

/// Number of connected sets (26 neighbours) of voxels with this label.
fn pieces(labels: &VolumeLabels, id: u16) -> usize {
    let [nx, ny, nz] = labels.grid.dims.map(|d| d as i64);
    let mut open: Vec<bool> = labels.ids.iter().map(|&l| l == id).collect();
    let mut found = 0;
    for start in 0..open.len() {
        if !std::mem::take(&mut open[start]) {
            continue;
        }
        found += 1;
        let mut todo = vec![start as i64];
        while let Some(at) = todo.pop() {
            let (x, y, z) = (at % nx, at / nx % ny, at / (nx * ny));
            for (i, j, k) in (0..27).map(|n| (x + n % 3 - 1, y + n / 3 % 3 - 1, z + n / 9 - 1)) {
                if (0..nx).contains(&i) && (0..ny).contains(&j) && (0..nz).contains(&k) {
                    let next = (k * ny + j) * nx + i;
                    if std::mem::take(&mut open[next as usize]) {
                        todo.push(next);
                    }
                }
            }
        }
    }
    found
}

#[test]
fn names_parse_back_and_no_other_does() {
    for scene in Synthetic::ALL {
        assert_eq!(scene.to_string().parse(), Ok(scene));
        let mut names = scene.segment_names();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), scene.segment_names().len());
    }
    for (name, said) in [
        ("Jets", ["\"Jets\"", "jets, vortices, shells"]),
        ("tube:1", ["\"tube:1\"", "FAMILY:SEED of blobs, touching, tubes"]),
        ("blobs:", ["\"\" is no seed", "blobs:7"]),
        ("blobs:-1", ["\"-1\" is no seed", "whole number"]),
        ("blobs:+1", ["\"+1\" is no seed", "whole number"]),
        ("blobs:99999999999999999999", ["is no seed", "whole number"]),
        ("jets:1", ["jets has no seeds", "blobs"]),
    ] {
        let refused = name.parse::<Synthetic>().unwrap_err().to_string();
        assert!(said.iter().all(|part| refused.contains(part)), "{refused}");
    }
    assert_eq!("nested".parse::<Synthetic>(), "nested:0".parse());
}

#[test]
fn values_stay_in_range_and_labels_name_segments() {
    for scene in Synthetic::ALL {
        for step in 0..=10 {
            let (volume, labels) = cube(scene, f64::from(step) / 10.0);
            assert!(volume.values.iter().all(|v| (0.0..=1.0).contains(v)), "{scene} {step}");
            assert!(volume.values.iter().any(|v| *v > 0.9), "{scene} {step}");
            assert!(labels.ids.iter().all(|l| usize::from(*l) <= scene.segment_names().len()), "{scene} {step}");
        }
    }
}

#[test]
fn every_segment_is_there_when_it_should_be() {
    for scene in Synthetic::ALL {
        for step in 0..=20 {
            let t = f64::from(step) / 20.0;
            let (_, labels) = cube(scene, t);
            for name in &scene.segment_names() {
                let there = count(&labels, name, scene);
                match name.as_str() {
                    "tube-c" if t > 0.5 => assert_eq!(there, 0, "{name} {t}"),
                    "tube-d" if t < 0.45 => assert_eq!(there, 0, "{name} {t}"),
                    "tube-c" if t > 0.2 => {}
                    "tube-d" if t < 0.75 => {}
                    "bead-7" if t < 0.3 => assert_eq!(there, 0, "{name} {t}"),
                    "bead-7" if t < 0.6 => {}
                    _ => assert!(there >= 24, "{scene} {name} {t}: {there} voxels"),
                }
            }
        }
    }
}

#[test]
fn tubes_split_and_join() {
    let scene = Synthetic::Vortices;
    let over_time = |name: &str| -> Vec<usize> {
        (0..=20).map(|step| pieces(&cube(scene, f64::from(step) / 20.0).1, id_of(scene, name))).collect()
    };
    let (split, join) = (over_time("tube-a"), over_time("tube-b"));
    assert_eq!((split[0], split[20]), (1, 2), "{split:?}");
    assert_eq!((join[0], join[20]), (2, 1), "{join:?}");
    assert!(split.windows(2).all(|w| w[0] <= w[1]), "{split:?}");
    assert!(join.windows(2).all(|w| w[0] >= w[1]), "{join:?}");
    assert!(over_time("tube-e").iter().all(|n| *n == 1));
    assert!(over_time("shell-outer").iter().all(|n| *n == 1));
}

#[test]
fn plumes_and_hidden_solids_stay_whole() {
    for step in 0..=10 {
        let t = f64::from(step) / 10.0;
        let jets = cube(Synthetic::Jets, t).1;
        assert!(
            (1..=5).all(|id| pieces(&jets, id) == 1),
            "plumes at {t}: {:?}",
            [1, 2, 3, 4, 5].map(|i| pieces(&jets, i))
        );
        let shells = cube(Synthetic::Shells, t).1;
        assert!((1..=4).all(|id| pieces(&shells, id) == 1), "layers at {t}");
    }
}

#[test]
fn layers_lie_within_each_other() {
    const FINE: usize = 64;
    for step in 0..=5 {
        let t = f64::from(step) / 5.0;
        let (_, labels) = Synthetic::Layers.sample([FINE; 3], t);
        assert!((1..=3).all(|id| pieces(&labels, id) == 1), "layers at {t}");
        // nothing but the body touches the core, and neither touches the shell or its surroundings
        for (at, id) in labels.ids.iter().enumerate().filter(|(_, id)| **id > 1) {
            for next in [at - 1, at + 1, at - FINE, at + FINE, at - FINE * FINE, at + FINE * FINE] {
                let other = labels.ids[next];
                assert!(other != 1 && (*id == 2 || other >= 2), "{id} beside {other} at {t}");
            }
        }
    }
}

#[test]
fn layers_are_not_concentric() {
    let centre = |labels: &VolumeLabels, id: u16| -> [f64; 3] {
        let at: Vec<usize> = (0..labels.ids.len()).filter(|&i| labels.ids[i] == id).collect();
        let place = |i: usize| [i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE)].map(|c| c as f64 * 2.0 / SIDE as f64);
        let sum = at.iter().fold([0.0; 3], |s: [f64; 3], i| std::array::from_fn(|a| s[a] + place(*i)[a]));
        sum.map(|c| c / at.len() as f64)
    };
    let apart = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
    for t in [0.0, 0.3, 0.6] {
        let labels = cube(Synthetic::Layers, t).1;
        let [shell, body, core] = [1, 2, 3].map(|id| centre(&labels, id));
        assert!(apart(shell, body) > 0.04 && apart(body, core) > 0.02, "{t}: {shell:?} {body:?} {core:?}");
    }
}

#[test]
fn beads_merge_part_and_split() {
    let scene = Synthetic::Beads;
    // what a threshold sees, with only some of the beads
    let bodies = |t: f64, names: &[&str]| {
        let (_, mut labels) = cube(scene, t);
        let ids: Vec<u16> = names.iter().map(|n| id_of(scene, n)).collect();
        labels.ids.iter_mut().for_each(|id| *id = u16::from(ids.contains(id)));
        pieces(&labels, 1)
    };
    let over_time = |names: &[&str]| [0.0, 0.25, 0.5, 0.75, 1.0].map(|t| bodies(t, names));
    let pair = over_time(&["bead-1", "bead-2"]);
    assert_eq!([pair[0], pair[2], pair[4]], [2, 1, 2], "{pair:?}");
    let family = over_time(&["bead-3", "bead-7"]);
    assert_eq!([family[0], family[2], family[4]], [1, 1, 2], "{family:?}");
    let passing = over_time(&["bead-4", "bead-5"]);
    assert_eq!(passing, [2, 2, 1, 2, 2]);
    assert_eq!(over_time(&["bead-6"]), [1; 5]);
    let all = scene.segment_names();
    let all: Vec<&str> = all.iter().map(String::as_str).collect();
    assert_eq!([bodies(0.0, &all[..6]), bodies(1.0, &all)], [6, 7]);
    for step in 0..=20 {
        let labels = cube(scene, f64::from(step) / 20.0).1;
        assert!((1..=7).all(|id| pieces(&labels, id) <= 1), "a bead is in pieces at step {step}");
    }
}

#[test]
fn filaments_are_thin_and_whole() {
    for step in 0..=5 {
        let t = f64::from(step) / 5.0;
        let (_, labels) = Synthetic::Filaments.sample([96; 3], t);
        for (id, name) in (1..).zip(Synthetic::Filaments.segment_names()) {
            assert_eq!(pieces(&labels, id), 1, "{name} at {t}");
            let share = labels.ids.iter().filter(|l| **l == id).count() as f64 / labels.ids.len() as f64;
            assert!((0.0003..0.003).contains(&share), "{name} at {t}: {share} of the box");
        }
    }
}

#[test]
fn plumes_merge_late() {
    // Merged: bright values of several plumes form one connected set.
    let bodies = |t: f64| {
        let (volume, mut labels) = cube(Synthetic::Jets, t);
        for (id, value) in labels.ids.iter_mut().zip(&volume.values) {
            *id = u16::from(*value > 0.35);
        }
        pieces(&labels, 1)
    };
    assert_eq!(bodies(0.0), 5);
    assert_eq!(bodies(1.0), 1);
}

#[test]
fn the_field_is_continuous_in_time() {
    for scene in Synthetic::ALL {
        let mut before = scene.sample([24; 3], 0.0);
        for step in 1..=99 {
            let now = scene.sample([24; 3], f64::from(step) / 99.0);
            let worst = before.0.values.iter().zip(&now.0.values).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(worst < 0.5, "{scene} step {step}: {worst}");
            before = now;
        }
    }
}

#[test]
fn segments_move_little_between_sixteen_steps() {
    for scene in Synthetic::ALL {
        let centroids = |t: f64| -> Vec<Option<[f64; 3]>> {
            let labels = cube(scene, t).1;
            (1..=scene.segment_names().len() as u16)
                .map(|id| {
                    let at: Vec<usize> = (0..labels.ids.len()).filter(|&i| labels.ids[i] == id).collect();
                    let sum = at.iter().fold([0.0; 3], |s, i| {
                        let c = [i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE)];
                        std::array::from_fn(|a| s[a] + c[a] as f64 * 2.0 / SIDE as f64)
                    });
                    (!at.is_empty()).then(|| sum.map(|c| c / at.len() as f64))
                })
                .collect()
        };
        let mut before = centroids(0.0);
        for step in 1..=16 {
            let now = centroids(f64::from(step) / 16.0);
            for (k, pair) in before.iter().zip(&now).enumerate() {
                if let (Some(a), Some(b)) = pair {
                    let moved = (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
                    assert!(moved < 0.12, "{scene} {} step {step}: {moved}", scene.segment_names()[k]);
                }
            }
            before = now;
        }
    }
}

#[test]
fn threads_do_not_matter() {
    let with = |threads: usize, scene: Synthetic| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap()
            .install(|| scene.sample([21, 18, 25], 0.43))
    };
    for scene in Synthetic::ALL {
        assert_eq!(with(1, scene), with(3, scene), "{scene}");
    }
}

#[test]
fn any_dims_agree_with_the_point_query() {
    for scene in Synthetic::ALL {
        for dims in [[7, 1, 33], [40, 12, 9], [1, 1, 1], [16, 16, 17]] {
            let (volume, labels) = scene.sample(dims, 0.6);
            let grid = volume.grid;
            assert_eq!((labels.grid, grid.dims), (grid, dims));
            let longest = dims.into_iter().max().unwrap();
            assert!(grid.spacing.iter().all(|s| *s == 2.0 / longest as f64));
            for ((origin, spacing), side) in grid.origin.iter().zip(grid.spacing).zip(dims) {
                assert!((origin + 0.5 * spacing * (side as f64 - 1.0)).abs() < 1e-12);
            }
            for i in 0..grid.len() {
                let index = [i % dims[0], i / dims[0] % dims[1], i / (dims[0] * dims[1])];
                let p = std::array::from_fn(|a| grid.origin[a] + grid.spacing[a] * index[a] as f64);
                assert_eq!(scene.value_and_label(p, 0.6), (volume.values[i], labels.ids[i]), "{scene} {dims:?} {i}");
            }
        }
        assert!(scene.sample([0, 4, 4], 0.5).0.values.is_empty());
    }
}

#[test]
fn the_transfer_function_shows_what_is_labelled() {
    for scene in Synthetic::ALL {
        let transfer = scene.transfer_function().unwrap();
        for t in [0.0, 0.5, 1.0] {
            let (volume, labels) = scene.sample([64; 3], t);
            let mut shown = vec![0.0; scene.segment_names().len() + 1];
            for (value, id) in volume.values.iter().zip(&labels.ids) {
                shown[usize::from(*id)] += f64::from(transfer.opacity_at(f64::from(*value)));
            }
            let all: f64 = shown.iter().sum();
            assert!(shown[0] < 0.01 * all, "{scene} {t}: unlabelled but visible {} of {all}", shown[0]);
            for (k, name) in scene.segment_names().iter().enumerate() {
                let there = count(&labels, name, scene) > 0;
                assert!(!there || shown[k + 1] > 1.0, "{scene} {t}: {name} is invisible");
            }
        }
    }
}

proptest! {
    #[test]
    fn faces_and_outside_are_empty(a in -1.0..1.0_f64, b in -1.0..1.0_f64, far in 1.0..4.0_f64, t in 0.0..1.0_f64) {
        for scene in Synthetic::ALL {
            for side in [-far, far, -1.0, 1.0, f64::NAN, f64::INFINITY] {
                for p in [[side, a, b], [a, side, b], [a, b, side]] {
                    prop_assert_eq!(scene.value_and_label(p, t), (0.0, 0));
                }
            }
        }
    }

    #[test]
    fn times_outside_are_clamped(p in prop::array::uniform3(-1.0..1.0_f64), past in 0.0..9.0_f64) {
        for scene in Synthetic::ALL {
            prop_assert_eq!(scene.value_and_label(p, 1.0 + past), scene.value_and_label(p, 1.0));
            prop_assert_eq!(scene.value_and_label(p, -past), scene.value_and_label(p, 0.0));
            prop_assert_eq!(scene.value_and_label(p, f64::NAN), scene.value_and_label(p, 0.0));
        }
    }

    #[test]
    fn nearby_points_have_nearby_values(p in prop::array::uniform3(-1.0..1.0_f64), t in 0.0..1.0_f64, axis in 0..3_usize) {
        let mut q = p;
        q[axis] += 1e-4;
        for scene in Synthetic::ALL {
            let change = (scene.value_and_label(p, t).0 - scene.value_and_label(q, t).0).abs();
            prop_assert!(change < 0.01, "{} jumps by {} at {:?}", scene, change, p);
        }
    }
}
