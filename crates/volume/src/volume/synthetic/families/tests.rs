//! What all scenes of all families guarantee.

use super::*;
use crate::data::lineage::LineageChange;
use crate::volume::synthetic::Synthetic;
use proptest::prelude::*;

const SIDE: usize = 40;
const TIMES: [f64; 4] = [0.0, 0.3, 0.65, 1.0];

fn scenes(seeds: u64) -> impl Iterator<Item = FamilyScene> {
    Family::all().flat_map(move |family| (0..seeds).map(move |seed| FamilyScene { family, seed }))
}

fn counts(scene: FamilyScene, t: f64) -> Vec<usize> {
    let mut counts = vec![0; scene.names().len() + 1];
    for id in Synthetic::Drawn(scene).sample([SIDE; 3], t).1.ids {
        counts[usize::from(id)] += 1;
    }
    counts
}

#[test]
fn every_part_has_four_families() {
    for part in [Part::Fit, Part::Choose, Part::Report] {
        assert_eq!(Family::all().filter(|family| family.part() == part).count(), 4, "{part:?}");
    }
}

#[test]
fn cells_are_there_when_they_should_be() {
    for drawn in scenes(6) {
        let scene = drawn.scene();
        let least = if drawn.family == Family::Nested { 2 } else { 3 };
        assert!(scene.bodies.len() >= least, "{drawn:?}: {} cells", scene.bodies.len());
        for t in TIMES {
            let counts = counts(drawn, t);
            let share = 1.0 - counts[0] as f64 / counts.iter().sum::<usize>() as f64;
            assert!((0.001..0.5).contains(&share), "{drawn:?} at {t}: {share} of the box");
            for (k, body) in scene.bodies.iter().enumerate() {
                let there = body.there.at(t) > 0.5 && body.path.at(t).size > 0.5;
                let own = scene.label(k, t) == k as u16 + 1;
                let found = counts[k + 1];
                match there && own {
                    true => assert!(found >= 4, "{drawn:?} {} at {t}: {found} voxels", scene.names()[k]),
                    false if !own || body.there.at(t) == 0.0 => assert_eq!(found, 0, "{drawn:?} {k} at {t}"),
                    false => {}
                }
            }
        }
    }
}

#[test]
fn what_shows_is_labelled_and_what_is_labelled_shows() {
    for drawn in scenes(3) {
        let transfer = drawn.transfer_function();
        for t in [0.0, 0.55] {
            let (volume, labels) = Synthetic::Drawn(drawn).sample([SIDE; 3], t);
            let mut shown = vec![0.0; drawn.names().len() + 1];
            for (value, id) in volume.values.iter().zip(&labels.ids) {
                assert!((0.0..=1.0).contains(value), "{drawn:?}");
                shown[usize::from(*id)] += f64::from(transfer.opacity_at(f64::from(*value)));
            }
            assert_eq!(shown[0], 0.0, "{drawn:?} at {t}: visible, but without label");
            for (k, count) in counts(drawn, t).iter().enumerate().skip(1) {
                assert!(*count < 40 || shown[k] > 0.0, "{drawn:?} at {t}: cell {k} is invisible");
            }
        }
    }
}

#[test]
fn a_seed_is_one_scene_and_another_seed_another() {
    for family in Family::all() {
        let sample = |seed| Synthetic::Drawn(FamilyScene { family, seed }).sample([16; 3], 0.4);
        assert_eq!(sample(3), sample(3), "{family}");
        assert_ne!(sample(3).0.values, sample(4).0.values, "{family}");
        // four seeds in a row have four kinds of light
        let light = |seed| FamilyScene { family, seed }.transfer_function().shading.ambient;
        let mut lights = [5, 6, 7, 8].map(light);
        lights.sort_by(f32::total_cmp);
        assert!(lights.windows(2).all(|pair| pair[1] - pair[0] > 0.04), "{family}: {lights:?}");
    }
}

#[test]
fn threads_do_not_matter() {
    let with = |threads: usize, scene| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| Synthetic::Drawn(scene).sample([13, 18, 15], 0.43))
    };
    for scene in scenes(2) {
        assert_eq!(with(1, scene), with(3, scene), "{scene:?}");
    }
}

#[test]
fn transfer_functions_are_written_and_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drawn.toml");
    for scene in scenes(6) {
        let transfer = scene.transfer_function();
        std::fs::write(&path, transfer.to_toml()).unwrap();
        let again = TransferFunction::load(path.to_str().unwrap()).unwrap();
        assert_eq!(again, transfer, "{scene:?}");
    }
}

#[test]
fn events_are_where_labels_change() {
    let mut found = [0; 2];
    for drawn in scenes(6).filter(|scene| matches!(scene.family, Family::Merging | Family::Splitting)) {
        let steps: Vec<f64> = (0..60).map(|step| f64::from(step) / 59.0).collect();
        let events = drawn.lineage(&steps);
        assert!(!events.is_empty(), "{drawn:?}");
        for event in events {
            let step = steps.iter().position(|t| *t == event.time).unwrap();
            let before = counts(drawn, steps[step - 1])[usize::from(event.segment)];
            let after = counts(drawn, steps[step])[usize::from(event.segment)];
            let other = counts(drawn, event.time)[usize::from(event.other.unwrap())];
            let (gone, there) = if event.change == LineageChange::Began { (before, after) } else { (after, before) };
            assert_eq!(gone, 0, "{drawn:?} {event:?}");
            assert!(there > 10 && other > 10, "{drawn:?} {event:?}: {there} and {other} voxels");
            found[usize::from(event.change == LineageChange::Began)] += 1;
        }
    }
    assert!(found[0] > 5 && found[1] > 5, "{found:?}");
    for drawn in scenes(3).filter(|scene| !matches!(scene.family, Family::Merging | Family::Splitting)) {
        assert!(drawn.lineage(&[0.0, 0.5, 1.0]).is_empty(), "{drawn:?}");
    }
}

#[test]
fn an_event_before_the_series_or_after_it_is_none() {
    let scene = FamilyScene { family: Family::Splitting, seed: 0 };
    assert!(!scene.lineage(&[0.0, 1.0]).is_empty());
    assert!(scene.lineage(&[0.0]).is_empty() && scene.lineage(&[]).is_empty());
}

#[test]
fn fast_bodies_move_by_more_than_their_size_between_times() {
    for seed in 0..6 {
        let scene = FamilyScene { family: Family::Fast, seed }.scene();
        let quick = scene.bodies.iter().filter(|body| body.role == "quick");
        assert!(quick.clone().count() >= 1, "{seed}");
        for body in quick {
            let shape::Shape::Ball(axes) = &body.shape else { panic!("no ball") };
            let diameter = 2.0 * axes.iter().sum::<f64>() / 3.0;
            let place = |k: f64| body.path.at(k / scattered::INTERVALS).centre;
            let chord = crate::volume::synthetic::field::sub(place(1.0), place(0.0));
            let moved = crate::volume::synthetic::field::norm(chord) / diameter;
            // the chord of an arc is shorter than the arc
            assert!((0.6..4.0).contains(&moved), "{seed}: {moved} diameters");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn any_seed_gives_a_scene_inside_the_box(seed in any::<u64>(), number in 0..12_usize, t in 0.0..1.0_f64) {
        let family = FAMILIES[number].0;
        let drawn = FamilyScene { family, seed };
        let name = Synthetic::Drawn(drawn).to_string();
        prop_assert_eq!(name.parse(), Ok(Synthetic::Drawn(drawn)));
        let (volume, labels) = Synthetic::Drawn(drawn).sample([20; 3], t);
        let (empty, cells) = (drawn.frame(t).empty() as f32, drawn.names().len());
        for (i, (value, id)) in volume.values.iter().zip(&labels.ids).enumerate() {
            prop_assert!((0.0..=1.0).contains(value) && usize::from(*id) <= cells);
            let outermost = [i % 20, i / 20 % 20, i / 400].iter().any(|c| *c == 0 || *c == 19);
            prop_assert!(!outermost || (*id == 0 && (value - empty).abs() < 0.04), "{} at {}: {}", name, i, value);
        }
        prop_assert!(labels.ids.iter().any(|id| *id > 0));
    }
}
