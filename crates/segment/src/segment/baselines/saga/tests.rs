//! SAGA on two balls: what a click selects, gradients, non-finite values, thread counts.

use super::loss::{FEATURES, Facts};
use super::step::SagaTrainer;
use super::*;
use crate::segment::test_support::{APART, COUNT, add, on_threads};

fn quick(steps: usize) -> SagaOptions {
    SagaOptions { steps, pixels: 48, scales: 2, rate: 0.02, ..SagaOptions::default() }
}

#[test]
fn a_click_selects_its_ball_at_a_small_scale_and_both_at_the_largest() {
    let at = APART.gaussians();
    let views = APART.prepared(&at);
    let (mut first, mut last) = (0.0, 0.0);
    let model = train(&views, &at.means, &quick(400), |step, loss| {
        first += if step < 20 { loss } else { 0.0 };
        last += if step >= 380 { loss } else { 0.0 };
        true
    })
    .unwrap();
    assert!(last < first, "{first} -> {last}");
    for clicked in [3, COUNT as u32 + 3] {
        let of = |i: usize| i / COUNT == clicked as usize / COUNT;
        let found = model.select(clicked, 0.0, 0.75);
        let wrong = (0..2 * COUNT).filter(|&i| found[i] != of(i)).count();
        assert!(wrong <= COUNT / 20, "{wrong} wrong");
        let all = model.select(clicked, 1.0, 0.75).into_iter().filter(|s| *s).count();
        assert!(all >= 2 * COUNT * 9 / 10, "{all} of {}", 2 * COUNT);
    }
}

#[test]
fn gradients_agree_with_differences() {
    let at = APART.gaussians();
    let views = APART.prepared(&at);
    // all pairs; then hard ones alone, with so few pixels that none is close to a threshold, where the loss jumps
    for (pixels, scales, alike, apart) in [(20, 8, 2.0, -1.0), (6, 1, 0.75, 0.5)] {
        let options = SagaOptions { pixels, scales, hard_alike: alike, hard_apart: apart, ..SagaOptions::default() };
        let mut trainer = SagaTrainer::new(&views, &at.means, &options).unwrap();
        let mut rng = Rng::new(1, 2, Purpose::Custom(3));
        let batch = trainer.batch(1, &mut rng);
        let slopes = trainer.loss(&batch);
        let of_gate = vec![slopes.gate.weight, slopes.gate.bias];
        for (by_features, by_gate) in [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            // along the gradient, where the change is large compared with rounding, plus a random component
            let mut direction = |rows: &[[f32; FEATURES]], size: f32| -> Vec<[f32; FEATURES]> {
                let length = rows.iter().flatten().map(|v| v * v).sum::<f32>().sqrt();
                let aside = 0.5 / ((rows.len() * FEATURES) as f32).sqrt();
                rows.iter().map(|row| row.map(|v| size * (v / length + aside * rng.normal()))).collect()
            };
            let (moves, turns) = (direction(&slopes.sources, by_features), direction(&of_gate, by_gate));
            let inner = |a: &[[f32; FEATURES]], b: &[[f32; FEATURES]]| -> f64 {
                a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| f64::from(a * b)).sum()
            };
            let expected = inner(&moves, &slopes.sources) + inner(&turns, &of_gate);
            let mut moved = |by: f32| {
                let add = |to: &mut [f32; FEATURES], step: &[f32; FEATURES]| {
                    to.iter_mut().zip(step).for_each(|(t, s)| *t += by * s);
                };
                let kept = (trainer.features.clone(), trainer.gate.clone());
                batch.sources.iter().zip(&moves).for_each(|(&i, m)| add(&mut trainer.features[i as usize].value, m));
                trainer.gate.iter_mut().zip(&turns).for_each(|(g, t)| add(&mut g.value, t));
                let loss = trainer.loss(&batch).loss;
                (trainer.features, trainer.gate) = kept;
                loss
            };
            let h = 1e-3;
            let found = (moved(h) - moved(-h)) / f64::from(2.0 * h);
            assert!(expected > 1e-3, "{expected}");
            assert!((found - expected).abs() < 0.03 * expected + 3e-4, "{found} against {expected}, {pixels} pixels");
        }
    }
}

#[test]
fn pixels_of_two_balls_are_together_from_the_scale_of_both() {
    let at = APART.gaussians();
    let view = &APART.prepared(&at)[0];
    let facts = Facts::of(view);
    let lists: Vec<&[u32]> = (0..view.pixels.len()).map(|p| view.covering(p)).collect();
    let alone = |ball: u32| *lists.iter().find(|l| **l == [ball, 2]).unwrap();
    let (first, second) = (alone(0), alone(1));
    assert_eq!(facts.joined(view, first, first), f32::NEG_INFINITY);
    let larger = view.scales[0].max(view.scales[1]);
    assert_eq!(facts.joined(view, first, second), larger);
    assert!(larger < view.scales[2]);
    assert_eq!(facts.joined(view, &first[..1], &second[..1]), f32::INFINITY);
}

#[test]
fn poison_is_never_selected_and_bad_input_is_refused() {
    let mut at = APART.gaussians();
    for poison in [f32::NAN, f32::INFINITY] {
        add(&mut at, [0.5, poison, 0.0], [-2.7; 3]);
    }
    let views = APART.prepared(&at);
    let model = train(&views, &at.means, &quick(5), |_, _| true).unwrap();
    let n = 2 * COUNT;
    assert_eq!((model.len(), model.is_empty()), (n + 2, false));
    assert_eq!(model.select(0, 0.5, -1.0)[n - 1..], [true, false, false]);
    assert!(!model.select(n as u32, 0.5, -1.0).contains(&true));
    assert!(matches!(train(&[], &at.means, &quick(5), |_, _| true), Err(SagaError::NoMasks)));
    assert!(matches!(train(&views, &at.means[1..], &quick(5), |_, _| true), Err(SagaError::Points(_))));
    let wild = SagaOptions { rate: f32::NAN, ..quick(5) };
    assert!(matches!(train(&views, &at.means, &wild, |_, _| true), Err(SagaError::NotFinite { step: 1, .. })));
}

#[test]
fn the_same_bits_on_one_thread_and_on_three() {
    let at = APART.gaussians();
    let views = APART.prepared(&at);
    let run = |threads| on_threads(threads, || train(&views, &at.means, &quick(10), |step, _| step < 8).unwrap());
    assert_eq!(run(1), run(3));
    let other = train(&views, &at.means, &SagaOptions { seed: 1, ..quick(10) }, |_, _| true).unwrap();
    assert_ne!(run(1), other);
}
