use super::{reference, ssim, ssim_grad};
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

fn against_reference(a: &[f32], b: &[f32], h: usize, w: usize) {
    let mut grad = vec![0.5; a.len()];
    let scale = a.len() as f32;
    let value = ssim_grad(a, b, h, w, scale, &mut grad);
    assert_eq!(value, ssim(a, b, h, w));
    let (exact, exact_grad) = reference::ssim_grad(&wide(a), &wide(b), h, w);
    assert!((value - exact).abs() < 1e-5, "{value} against {exact}");
    let largest = exact_grad.iter().fold(0.0, |m: f64, g| m.max(g.abs()));
    for (g, e) in grad.iter().zip(&exact_grad) {
        let g = f64::from(*g) - 0.5;
        let e = e * f64::from(scale);
        let allowed = 1e-4 * (1.0 + largest * f64::from(scale));
        assert!((g - e).abs() < allowed, "{g} against {e}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn any_size_matches_the_reference(h in 1usize..30, w in 1usize..30, seed in 0u64..1000) {
        against_reference(&noise(seed, h * w * 3), &noise(seed + 1, h * w * 3), h, w);
    }
}

#[test]
fn smooth_and_flat_images_match_the_reference() {
    let (h, w) = (37, 29);
    let ramp: Vec<f32> = (0..h * w * 3).map(|i| (i / 3 % w) as f32 / w as f32).collect();
    let flat = vec![1.0; h * w * 3];
    against_reference(&ramp, &flat, h, w);
    against_reference(&flat, &ramp, h, w);
    against_reference(&vec![0.0; h * w * 3], &flat, h, w);
}

#[test]
fn reference_gradient_matches_finite_differences() {
    let (h, w) = (7, 13);
    let (mut a, b) = (wide(&noise(1, h * w * 3)), wide(&noise(2, h * w * 3)));
    let (_, grad) = reference::ssim_grad(&a, &b, h, w);
    for i in 0..a.len() {
        let at = a[i];
        a[i] = at + 1e-5;
        let up = reference::ssim_grad(&a, &b, h, w).0;
        a[i] = at - 1e-5;
        let slope = (up - reference::ssim_grad(&a, &b, h, w).0) / 2e-5;
        a[i] = at;
        assert!((slope - grad[i]).abs() < 1e-8, "{slope} against {}", grad[i]);
    }
}

#[test]
fn equal_images_score_one_with_zero_gradient() {
    let a = noise(3, 40 * 30 * 3);
    let mut grad = vec![0.0; a.len()];
    let value = ssim_grad(&a, &a, 40, 30, 3600.0, &mut grad);
    assert!((value - 1.0).abs() < 1e-6);
    assert!(grad.iter().all(|g| g.abs() < 1e-3));
    assert_eq!(ssim(&[], &[], 0, 5), 1.0);
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let (a, b) = (noise(4, 61 * 47 * 3), noise(5, 61 * 47 * 3));
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut grad = vec![0.0; a.len()];
        let value = pool.install(|| ssim_grad(&a, &b, 61, 47, 1.0, &mut grad));
        (value.to_bits(), grad)
    };
    let one = run(1);
    assert!(one == run(2) && one == run(5));
}

#[test]
fn a_poisoned_pixel_affects_the_value_and_only_nearby_gradients() {
    let (h, w) = (40, 40);
    let (mut a, b) = (noise(6, h * w * 3), noise(7, h * w * 3));
    a[(20 * w + 20) * 3] = f32::NAN;
    let mut grad = vec![0.0; a.len()];
    assert!(ssim_grad(&a, &b, h, w, 1.0, &mut grad).is_nan());
    // Window of the window: 21 by 21 pixels of one channel.
    assert_eq!(grad.iter().filter(|g| g.is_nan()).count(), 21 * 21);
}
