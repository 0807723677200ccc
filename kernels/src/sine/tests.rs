use super::cpu::{backward, forward};

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

fn sines(x: &[f32], bias: &[f32], omega: f32) -> Vec<f32> {
    let mut out = vec![7.0; x.len()];
    forward(x, bias, omega, &mut out);
    out
}

fn slopes(x: &[f32], bias: &[f32], omega: f32, grad: &[f32]) -> [Vec<f32>; 2] {
    let mut out = [vec![7.0; x.len()], vec![7.0; bias.len()]];
    let [of_x, of_bias] = &mut out;
    backward(x, bias, omega, grad, of_x, of_bias);
    out
}

#[test]
fn sines_and_cosines_match_double_precision() {
    // up to the largest arguments reduced here, and beyond, where the standard library is used
    for (size, within) in [(0.01f32, 2e-7), (1.0, 2e-7), (30.0, 3e-7), (5000.0, 4e-7), (19_000.0, 1e-6), (1e6, 1e-7)] {
        let x: Vec<f32> = noise(1, 40_000).iter().map(|v| v * size).collect();
        let exact = |f: fn(f64) -> f64| x.iter().map(move |v| f(f64::from(*v)));
        let off = |a: &[f32], b: &mut dyn Iterator<Item = f64>| {
            a.iter().zip(b).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max)
        };
        let sine = off(&sines(&x, &[0.0], 1.0), &mut exact(f64::sin));
        let cosine = off(&slopes(&x, &[0.0], 1.0, &vec![1.0; x.len()])[0], &mut exact(f64::cos));
        assert!(sine < within && cosine < within, "{size}: {sine:.1e} {cosine:.1e}");
    }
    assert_eq!(sines(&[0.0, -0.0], &[0.0], 30.0), [0.0, 0.0]);
}

#[test]
fn gradients_match_finite_differences() {
    let (width, n, omega) = (5, 7, 3.0f32);
    let (x, bias, grad) = (noise(2, n * width), noise(3, width), noise(4, n * width));
    let of_all = |x: &[f64], bias: &[f64]| -> f64 {
        let argument = |i: usize| f64::from(omega) * (x[i] + bias[i % width]);
        (0..x.len()).map(|i| argument(i).sin() * f64::from(grad[i])).sum()
    };
    let wide = |v: &[f32]| v.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
    let (mut x64, mut bias64) = (wide(&x), wide(&bias));
    let [of_x, of_bias] = slopes(&x, &bias, omega, &grad);
    let h = 1e-5;
    for i in 0..x.len() + width {
        let mut at = |step: f64| {
            let value = if i < x64.len() { &mut x64[i] } else { &mut bias64[i - x.len()] };
            *value += step;
            of_all(&x64, &bias64)
        };
        let slope = (at(h) - at(-2.0 * h)) / (2.0 * h);
        at(h);
        let ours = f64::from(if i < x.len() { of_x[i] } else { of_bias[i - x.len()] });
        assert!((slope - ours).abs() < 1e-5, "{i}: {ours} for {slope}");
    }
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads_and_poison_stays_in_its_place() {
    let (width, n) = (48, 3000);
    let (mut x, bias, grad) = (noise(5, n * width), noise(6, width), noise(7, n * width));
    let run = |x: &[f32], threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| (sines(x, &bias, 30.0), slopes(x, &bias, 30.0, &grad)))
    };
    let one = run(&x, 1);
    assert!(one == run(&x, 2) && one == run(&x, 5));
    for poison in [f32::NAN, f32::INFINITY] {
        x[4711] = poison;
        let (out, [of_x, of_bias]) = run(&x, 2);
        let is_there = |i: usize| i == 4711;
        assert!(out.iter().enumerate().all(|(i, v)| v.is_nan() == is_there(i)), "{poison}");
        assert!(of_x.iter().enumerate().all(|(i, v)| v.is_nan() == is_there(i)), "{poison}");
        assert!(of_bias.iter().enumerate().all(|(i, v)| v.is_nan() == (i == 4711 % width)), "{poison}");
    }
}
