use super::{Distance, photometric, reference};
use proptest::prelude::*;

fn noise(seed: u64, len: usize) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1u64 << 24) as f32
    };
    (0..len).map(|_| next()).collect()
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&v| f64::from(v)).collect()
}

const KINDS: [Distance; 2] = [Distance::Absolute, Distance::Squared];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn any_size_matches_the_reference(pixels in 1usize..20_000, seed in 0u64..1000, alpha in 0.0f32..2.0) {
        let (a, mut b) = (noise(seed, 4 * pixels), noise(seed + 1, 4 * pixels));
        b[0] = a[0]; // the kink of the absolute value
        for kind in KINDS {
            let mut grad = vec![7.0; a.len()];
            let (value, squared) = photometric(&a, &b, kind, alpha, &mut grad);
            let (exact, slopes, mse) = reference::photometric(&wide(&a), &wide(&b), kind, f64::from(alpha));
            prop_assert!((value - exact).abs() < 1e-6 * exact && (squared - mse).abs() < 1e-6 * mse);
            for (g, e) in grad.iter().zip(&slopes) {
                prop_assert!((f64::from(*g) - e).abs() <= 1e-6 * e.abs(), "{g} {e}");
            }
        }
    }
}

#[test]
fn reference_gradient_matches_finite_differences() {
    let (mut a, b) = (wide(&noise(1, 48)), wide(&noise(2, 48)));
    for kind in KINDS {
        let (_, grad, _) = reference::photometric(&a, &b, kind, 0.3);
        for i in 0..a.len() {
            let at = a[i];
            a[i] = at + 1e-6;
            let up = reference::photometric(&a, &b, kind, 0.3).0;
            a[i] = at - 1e-6;
            let slope = (up - reference::photometric(&a, &b, kind, 0.3).0) / 2e-6;
            a[i] = at;
            assert!((slope - grad[i]).abs() < 1e-8, "{slope} against {}", grad[i]);
        }
    }
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads_and_poison_propagates() {
    let (mut a, b) = (noise(4, 4 * 50_001), noise(5, 4 * 50_001));
    let run = |a: &[f32], threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut grad = vec![0.0; a.len()];
        let (value, _) = pool.install(|| photometric(a, &b, Distance::Squared, 0.1, &mut grad));
        (value.to_bits(), grad.iter().map(|g| g.to_bits()).collect::<Vec<_>>())
    };
    let one = run(&a, 1);
    assert!(one == run(&a, 2) && one == run(&a, 5));
    a[7] = f32::NAN;
    for kind in KINDS {
        let mut grad = vec![0.0; a.len()];
        assert!(photometric(&a, &b, kind, 0.1, &mut grad).0.is_nan() && grad[7].is_nan());
        assert_eq!(grad.iter().filter(|g| g.is_nan()).count(), 1);
    }
    assert_eq!(photometric(&[], &[], Distance::Squared, 0.1, &mut []), (0.0, 0.0));
}
