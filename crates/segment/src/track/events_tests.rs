//! Tests of event detection on small hand-made histories, their mirror images and invalid input.

use super::*;
use proptest::prelude::*;
use volseggs_testing::generator;

const SIZE: usize = 100;

/// A history of label rows; each entry lists `(label, number of Gaussians)` in order.
fn rows(history: &[&[(u32, usize)]]) -> Vec<Vec<u32>> {
    history
        .iter()
        .map(|parts| {
            let mut row: Vec<u32> = parts.iter().flat_map(|&(label, n)| vec![label; n]).collect();
            row.resize(SIZE, 0);
            row
        })
        .collect()
}

fn run(rows: &[Vec<u32>], opacity: &[Vec<f32>], config: &EventConfig, backward: bool) -> Tracking {
    let mut frames: Vec<SegmentAtTime<'_>> = rows
        .iter()
        .zip(opacity)
        .enumerate()
        .map(|(t, (labels, opacity))| SegmentAtTime { time: t as f64, labels, opacity })
        .collect();
    if backward {
        frames.reverse();
    }
    find_events(&frames, config).unwrap()
}

fn solid(rows: &[Vec<u32>]) -> Vec<Vec<f32>> {
    rows.iter().map(|r| r.iter().map(|&l| if l > 0 { 1.0 } else { 0.0 }).collect()).collect()
}

/// `(kind, from, to, number of parents, number of children)` of all events but continuations.
fn brief(tracking: &Tracking) -> Vec<(EventKind, f64, f64, usize, usize)> {
    let changes = tracking.events.iter().filter(|e| e.kind != EventKind::Continue);
    changes.map(|e| (e.kind, e.time_from, e.time_to, e.parents.len(), e.children.len())).collect()
}

fn forward(history: &[&[(u32, usize)]]) -> Tracking {
    let rows = rows(history);
    run(&rows, &solid(&rows), &EventConfig::default(), false)
}

use EventKind::{Appear, Merge, SegmentAppear, SegmentVanish, Split, Vanish};
const ONE: &[(u32, usize)] = &[(1, 100)];
const TWO: &[(u32, usize)] = &[(1, 60), (2, 40)];
const NONE: &[(u32, usize)] = &[];

#[test]
fn a_split_and_a_merge() {
    let tracking = forward(&[ONE, ONE, TWO, TWO, ONE, ONE]);
    assert_eq!(brief(&tracking), [(Split, 1.0, 2.0, 1, 2), (Merge, 3.0, 4.0, 2, 1)]);
    let split = tracking.events.iter().find(|e| e.kind == Split).unwrap();
    assert_eq!((split.parent_weights.as_slice(), split.child_weights.as_slice()), (&[100.0][..], &[60.0, 40.0][..]));
    let tracks: Vec<u32> = tracking.points.iter().map(|p| p.track).collect();
    assert_eq!(tracks, [1, 1, 2, 3, 2, 3, 4, 4]);
    assert_eq!(tracking.events.iter().filter(|e| e.kind == EventKind::Continue).count(), 4);
}

#[test]
fn labels_may_change_places_without_event() {
    let tracking = forward(&[&[(1, 60), (2, 40)], &[(2, 60), (1, 40)], &[(1, 60), (2, 40)]]);
    assert!(brief(&tracking).is_empty());
    let tracks: Vec<u32> = tracking.points.iter().map(|p| p.track).collect();
    assert_eq!(tracks, [1, 2, 2, 1, 1, 2]);
}

#[test]
fn a_part_appears_and_vanishes() {
    let (alone, pair) = (&[(1, 50)][..], &[(1, 50), (2, 50)][..]);
    let tracking = forward(&[alone, alone, pair, pair, pair, alone, alone]);
    assert_eq!(brief(&tracking), [(Appear, 1.0, 2.0, 0, 1), (Vanish, 4.0, 5.0, 1, 0)]);
}

#[test]
fn an_absence_as_long_as_the_persistence_is_no_flicker() {
    let (alone, pair) = (&[(1, 50)][..], &[(1, 50), (2, 50)][..]);
    let tracking = forward(&[pair, pair, alone, alone, pair, pair]);
    assert_eq!(brief(&tracking), [(Vanish, 1.0, 2.0, 1, 0), (Appear, 3.0, 4.0, 0, 1)]);
}

#[test]
fn a_change_behind_a_brief_merger_spans_it() {
    // The second part ends in a merger of one time, out of which the first part and a new one come.
    let (before, after) = (&[(1, 50), (2, 30)][..], &[(1, 50), (0, 30), (2, 20)][..]);
    let tracking = forward(&[before, before, ONE, after, after]);
    assert_eq!(brief(&tracking), [(Appear, 1.0, 3.0, 0, 1), (Vanish, 1.0, 3.0, 1, 0)]);
}

#[test]
fn flicker_makes_no_event() {
    let speck: &[(u32, usize)] = &[(1, 97), (2, 3)];
    for history in [
        // One-time split, one-time merger, one-time gap, specks, unequal flicker at every time.
        vec![ONE, ONE, TWO, ONE, ONE],
        vec![TWO, TWO, ONE, TWO, TWO],
        vec![TWO, TWO, NONE, TWO, TWO],
        vec![TWO, TWO, &[(1, 60)], TWO, TWO],
        vec![ONE, ONE, speck, speck, speck, ONE, ONE],
        vec![ONE, TWO, ONE, TWO, ONE, TWO],
        vec![&[(1, 50)], &[(1, 50)], &[(1, 50), (2, 50)], &[(1, 50)], &[(1, 50)]],
        // Changes at the very ends cannot be confirmed.
        vec![ONE, ONE, ONE, TWO],
        vec![TWO, TWO, TWO, ONE],
        vec![ONE, TWO, TWO, TWO],
        vec![TWO, TWO, TWO, NONE],
    ] {
        let tracking = forward(&history);
        assert!(brief(&tracking).is_empty(), "{history:?}: {:?}", brief(&tracking));
    }
    // With a persistence of 1 each is seen.
    let rows = rows(&[ONE, ONE, TWO, ONE, ONE]);
    let eager = EventConfig { persistence: 1, ..EventConfig::default() };
    assert_eq!(brief(&run(&rows, &solid(&rows), &eager, false)).len(), 2);
}

#[test]
fn ignored_components_are_lent_a_track() {
    let tracking = forward(&[ONE, ONE, TWO, ONE, ONE]);
    assert!(tracking.points.iter().all(|p| p.track == 1), "{:?}", tracking.points);
    assert_eq!(tracking.points.iter().filter(|p| p.lent).count(), 1);
}

#[test]
fn a_body_that_sheds_a_part_at_every_time_keeps_its_parts() {
    let tracking = forward(&[
        ONE,
        ONE,
        &[(1, 80), (2, 20)],
        &[(1, 60), (3, 20), (2, 20)],
        &[(1, 40), (4, 20), (3, 20), (2, 20)],
        &[(1, 40), (4, 20), (3, 20), (2, 20)],
    ]);
    assert_eq!(brief(&tracking), [(Split, 1.0, 2.0, 1, 2), (Split, 2.0, 3.0, 1, 2), (Split, 3.0, 4.0, 1, 2)]);
}

#[test]
fn the_whole_segment_fades_and_returns() {
    let rows = rows(&[ONE; 9]);
    let opacity: Vec<Vec<f32>> =
        [1.0, 0.8, 0.3, 0.005, 0.004, 0.005, 0.5, 1.0, 1.0].iter().map(|&o| vec![o; SIZE]).collect();
    let tracking = run(&rows, &opacity, &EventConfig::default(), false);
    assert_eq!(
        brief(&tracking),
        [
            (Vanish, 2.0, 3.0, 1, 0),
            (SegmentVanish, 2.0, 3.0, 1, 0),
            (Appear, 5.0, 6.0, 0, 1),
            (SegmentAppear, 5.0, 6.0, 0, 1)
        ]
    );
    assert_ne!(tracking.points[0].track, tracking.points[8].track);
}

#[test]
fn an_exchange_of_many_is_a_merge_and_a_split() {
    // The middle third leaves one component for the other, both large before and after: no event.
    let small = forward(&[&[(1, 52), (2, 48)], &[(1, 52), (2, 48)], &[(1, 48), (2, 52)], &[(1, 48), (2, 52)]]);
    assert!(brief(&small).is_empty(), "{:?}", brief(&small));
    // The larger gives half of itself to the smaller.
    let large = forward(&[&[(1, 80), (2, 20)], &[(1, 80), (2, 20)], &[(1, 40), (2, 60)], &[(1, 40), (2, 60)]]);
    assert_eq!(brief(&large), [(Split, 1.0, 2.0, 1, 2), (Merge, 1.0, 2.0, 2, 1)]);
}

#[test]
fn the_thread_count_never_changes_a_bit() {
    let mut u = generator(4);
    let labels: Vec<Vec<u32>> =
        (0..12).map(|t| (0..30_000).map(|i| if t > 3 && t < 8 { 1 + i / 9_000 } else { 1 }).collect()).collect();
    let opacity: Vec<Vec<f32>> = (0..12).map(|_| (0..30_000).map(|_| u()).collect()).collect();
    let work = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&labels, &opacity, &EventConfig::default(), false))
    };
    let one = work(1);
    assert_eq!(brief(&one), [(Split, 3.0, 4.0, 1, 4), (Merge, 7.0, 8.0, 4, 1)]);
    assert_eq!(one, work(4));
}

#[test]
fn random_histories_hold_events_of_every_kind() {
    let mut seen = std::collections::BTreeSet::new();
    for seed in 0..300 {
        let (rows, opacity) = random_history(seed, 12, 0.9);
        seen.extend(run(&rows, &opacity, &EventConfig::default(), false).events.iter().map(|e| e.kind));
    }
    assert!([Appear, Vanish, Split, Merge, SegmentAppear, SegmentVanish].iter().all(|k| seen.contains(k)), "{seen:?}");
}

#[test]
fn empty_non_finite_and_invalid_inputs() {
    let config = EventConfig::default();
    assert_eq!(find_events(&[], &config).unwrap(), Tracking::default());
    let frame = |labels: &'static [u32], opacity: &'static [f32]| SegmentAtTime { time: 0.0, labels, opacity };
    assert!(find_events(&[frame(&[], &[]), frame(&[], &[])], &config).unwrap().events.is_empty());
    assert!(brief(&find_events(&[frame(&[1], &[1.0]); 3], &config).unwrap()).is_empty());
    assert!(find_events(&[frame(&[1, 1], &[f32::NAN, -1.0]); 3], &config).unwrap().points.is_empty());
    assert!(find_events(&[frame(&[1], &[1.0]), frame(&[1, 1], &[1.0; 2])], &config).is_err());
    assert!(find_events(&[frame(&[9], &[1.0])], &config).is_err());
    assert!(find_events(&[frame(&[1], &[1.0])], &EventConfig { persistence: 0, ..config }).is_err());
    assert!(find_events(&[frame(&[1], &[1.0])], &EventConfig { min_share: f64::NAN, ..config }).is_err());
}

/// An event without track numbers: its kind, its times, and the bits of the weights of its parents and children.
type Shape = (EventKind, u64, u64, Vec<u64>, Vec<u64>);

fn shapes(tracking: &Tracking, mirror: bool) -> Vec<Shape> {
    let bits = |weights: &[f64]| {
        let mut bits: Vec<u64> = weights.iter().map(|w| w.to_bits()).collect();
        bits.sort_unstable();
        bits
    };
    let mut shapes: Vec<Shape> = tracking
        .events
        .iter()
        .map(|e| {
            let (parents, children) = (bits(&e.parent_weights), bits(&e.child_weights));
            if !mirror {
                return (e.kind, e.time_from as u64, e.time_to as u64, parents, children);
            }
            let kind = match e.kind {
                Appear => Vanish,
                Vanish => Appear,
                Split => Merge,
                Merge => Split,
                SegmentAppear => SegmentVanish,
                SegmentVanish => SegmentAppear,
                EventKind::Continue => EventKind::Continue,
            };
            (kind, e.time_to as u64, e.time_from as u64, children, parents)
        })
        .collect();
    shapes.sort();
    shapes
}

/// A random history: blocks of Gaussians move between labels and fade at random.
fn random_history(seed: u64, times: usize, steadiness: f32) -> (Vec<Vec<u32>>, Vec<Vec<f32>>) {
    let mut u = generator(seed);
    let mut blocks = [1u32, 1, 1, 2, 2, 3];
    let mut bright = [1.0f32; 6];
    let mut shown = 1.0f32;
    let (mut rows, mut opacity) = (Vec::new(), Vec::new());
    for _ in 0..times {
        if u() < 0.15 {
            shown = 1.001 - shown;
        }
        for b in 0..6 {
            if u() > steadiness {
                blocks[b] = (u() * 5.0) as u32;
            }
            if u() > steadiness {
                bright[b] = if u() < 0.3 { 0.0 } else { u() };
            }
        }
        rows.push((0..SIZE).map(|i| blocks[i * 6 / SIZE]).collect());
        opacity.push((0..SIZE).map(|i| shown * bright[i * 6 / SIZE] * (0.5 + (i % 13) as f32 / 26.0)).collect());
    }
    (rows, opacity)
}

/// A share of exactly one half, from sums that rounding may put on either side of it.
#[test]
fn a_tie_is_decided_alike_in_both_directions() {
    let (rows, opacity) = random_history(23_275, 4, 0.57744706);
    let config = EventConfig { persistence: 3, ..EventConfig::default() };
    let (there, back) = (run(&rows, &opacity, &config, false), run(&rows, &opacity, &config, true));
    assert_eq!(shapes(&there, false), shapes(&back, true));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn backward_in_time_gives_the_mirrored_events(
        seed in 0u64..100_000, times in 1usize..14, steadiness in 0.5f32..0.98, persistence in 1usize..4,
    ) {
        let (rows, opacity) = random_history(seed, times, steadiness);
        let config = EventConfig { persistence, ..EventConfig::default() };
        let there = run(&rows, &opacity, &config, false);
        let back = run(&rows, &opacity, &config, true);
        prop_assert_eq!(shapes(&there, false), shapes(&back, true));
    }

    #[test]
    fn every_visible_component_has_one_point(seed in 0u64..100_000, times in 1usize..10) {
        let (rows, opacity) = random_history(seed, times, 0.8);
        let tracking = run(&rows, &opacity, &EventConfig::default(), false);
        let mut want = std::collections::BTreeSet::new();
        for (t, (labels, opacity)) in rows.iter().zip(&opacity).enumerate() {
            for (&l, &o) in labels.iter().zip(opacity) {
                if l > 0 && o > 0.0 { want.insert((t as u64, l)); }
            }
        }
        let got: Vec<(u64, u32)> = tracking.points.iter().map(|p| (p.time as u64, p.component)).collect();
        prop_assert_eq!(got, want.into_iter().collect::<Vec<_>>());
    }
}
