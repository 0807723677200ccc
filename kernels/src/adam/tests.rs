use super::{AdamStep, LrPattern, NonFiniteGradient, adam_step, reference};
use proptest::prelude::*;

fn noise(seed: u64, len: usize) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1u64 << 24) as f32
    };
    (0..len).map(|_| 2.0 * next() - 1.0).collect()
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&v| f64::from(v)).collect()
}

fn settings(t: i32, lr_pattern: Option<LrPattern>) -> AdamStep {
    AdamStep {
        lr: 0.01,
        beta1: 0.9,
        beta2: 0.999,
        eps: 1e-8,
        bias_correction1: (1.0 - f64::from(0.9f32).powi(t)) as f32,
        bias_correction2: (1.0 - f64::from(0.999f32).powi(t)) as f32,
        lr_pattern,
    }
}

/// Parameter and moments after `steps` steps.
fn train(len: usize, seed: u64, steps: i32, pattern: Option<LrPattern>) -> [Vec<f32>; 3] {
    let (mut param, mut m, mut v) = (noise(seed, len), vec![0.0; len], vec![0.0; len]);
    for t in 1..=steps {
        let grad = noise(seed + t as u64, len);
        adam_step(&mut param, &grad, &mut m, &mut v, settings(t, pattern)).unwrap();
    }
    [param, m, v]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn several_steps_match_the_reference(
        rows in 0usize..200, row_len in 1usize..60, head_len in 0usize..9, on in any::<bool>(), seed in 0u64..1000,
    ) {
        let pattern = on.then_some(LrPattern { row_len, head_len, tail_factor: 0.05 });
        let len = rows * row_len;
        let [param, ..] = train(len, seed, 4, pattern);
        let (mut exact, mut m, mut v) = (wide(&noise(seed, len)), vec![0.0; len], vec![0.0; len]);
        for t in 1..=4 {
            let grad = wide(&noise(seed + t as u64, len));
            reference::adam_step(&mut exact, &grad, &mut m, &mut v, settings(t, pattern), t);
        }
        for (p, e) in param.iter().zip(&exact) {
            prop_assert!((f64::from(*p) - e).abs() < 1e-5, "{} against {}", p, e);
        }
    }
}

#[test]
fn the_first_step_moves_by_the_rate_for_any_gradient() {
    let (mut param, mut m, mut v) = (vec![0.0; 6], vec![0.0; 6], vec![0.0; 6]);
    let grad = [1e-3, -5.0, 100.0, 1e-3, -5.0, 100.0];
    let pattern = LrPattern { row_len: 6, head_len: 3, tail_factor: 0.1 };
    adam_step(&mut param, &grad, &mut m, &mut v, settings(1, Some(pattern))).unwrap();
    for (p, e) in param.iter().zip([-0.01, 0.01, -0.01, -0.001, 0.001, -0.001]) {
        assert!((p - e).abs() < 1e-6, "{p} against {e}");
    }
}

#[test]
fn a_zero_gradient_on_fresh_moments_moves_nothing() {
    let (mut param, mut m, mut v) = (vec![3.0; 40], vec![0.0; 40], vec![0.0; 40]);
    adam_step(&mut param, &[0.0; 40], &mut m, &mut v, settings(1, None)).unwrap();
    assert_eq!(param, vec![3.0; 40]);
}

#[test]
fn a_poisoned_gradient_is_reported_and_nothing_is_updated() {
    let len = 50_000;
    for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30] {
        for at in [0, 17_001, len - 1] {
            let mut grad = noise(1, len);
            grad[at] = poison;
            grad[len - 1] = poison;
            let (mut param, mut m, mut v) = (noise(2, len), noise(3, len), vec![1.0; len]);
            let result = adam_step(&mut param, &grad, &mut m, &mut v, settings(1, None));
            assert_eq!(result, Err(NonFiniteGradient { index: at }));
            assert!(param == noise(2, len) && m == noise(3, len) && v == vec![1.0; len]);
        }
    }
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let pattern = Some(LrPattern { row_len: 48, head_len: 3, tail_factor: 0.05 });
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| train(48 * 1500, 5, 2, pattern))
    };
    let one = run(1);
    assert!(one == run(2) && one == run(5));
}
