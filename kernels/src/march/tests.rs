use super::cpu::{backward, forward, weights};
use super::{Box3, Ray, RaySamples, reference, sample};
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

/// Rays of `counts` samples, about two thirds of them coloured, with depths up to `deep` and colours.
fn random(counts: &[usize], deep: f32, seed: u64) -> (RaySamples, Vec<f32>, Vec<f32>) {
    let mut offsets = vec![0];
    for n in counts {
        offsets.push(offsets[offsets.len() - 1] + *n as u32);
    }
    let samples = offsets[counts.len()] as usize;
    let coloured: Vec<bool> = noise(seed, samples).iter().map(|v| *v < 0.66).collect();
    let rays = RaySamples::new(&offsets, &coloured);
    let depths = noise(seed + 1, samples).iter().map(|v| deep * v * v).collect();
    let colours = noise(seed + 2, 3 * rays.coloured());
    (rays, depths, colours)
}

const BACKGROUND: [f32; 3] = [0.9, 0.2, 0.6];
const WIDE: [f64; 3] = [0.9f32 as f64, 0.2f32 as f64, 0.6f32 as f64];

fn seen(rays: &RaySamples, depths: &[f32], colours: &[f32]) -> Vec<f32> {
    let mut out = vec![7.0; 4 * rays.rays()];
    forward(rays, depths, colours, BACKGROUND, &mut out);
    out
}

fn slopes(rays: &RaySamples, depths: &[f32], colours: &[f32], grad: &[f32]) -> [Vec<f32>; 2] {
    let mut out = [vec![7.0; depths.len()], vec![7.0; colours.len()]];
    let [of_depths, of_colours] = &mut out;
    backward(rays, depths, colours, BACKGROUND, grad, of_depths, of_colours);
    out
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn any_rays_match_the_reference(
        counts in prop::collection::vec(0usize..40, 1..150), deep in 0.001f32..6.0, seed in 0u64..1000,
    ) {
        let (rays, depths, colours) = random(&counts, deep, seed);
        let exact = reference::composite(&rays, &wide(&depths), &wide(&colours), WIDE);
        for (a, e) in seen(&rays, &depths, &colours).iter().zip(&exact) {
            prop_assert!((f64::from(*a) - e).abs() < 1e-5, "{a} {e}");
        }
    }
}

#[test]
fn gradients_match_finite_differences_of_the_reference() {
    let (rays, depths, colours) = random(&[9, 0, 1, 14, 70], 1.5, 3);
    let grad: Vec<f32> = noise(8, 20).iter().map(|v| v - 0.5).collect();
    let of_all = |depths: &[f64], colours: &[f64]| -> f64 {
        reference::composite(&rays, depths, colours, WIDE).iter().zip(&grad).map(|(v, g)| v * f64::from(*g)).sum()
    };
    let (mut d, mut c) = (wide(&depths), wide(&colours));
    let ours = slopes(&rays, &depths, &colours, &grad);
    let h = 1e-5;
    for i in 0..d.len() {
        let at = d[i];
        d[i] = at + h;
        let up = of_all(&d, &c);
        d[i] = at - h;
        let slope = (up - of_all(&d, &c)) / (2.0 * h);
        d[i] = at;
        assert!((slope - f64::from(ours[0][i])).abs() < 2e-6, "depth {i}: {} for {slope}", ours[0][i]);
    }
    for i in 0..c.len() {
        let at = c[i];
        c[i] = at + h;
        let up = of_all(&d, &c);
        c[i] = at - h;
        let slope = (up - of_all(&d, &c)) / (2.0 * h);
        c[i] = at;
        assert!((slope - f64::from(ours[1][i])).abs() < 2e-6, "colour {i}: {} for {slope}", ours[1][i]);
    }
}

#[test]
fn a_constant_medium_matches_its_closed_form_for_any_number_of_samples() {
    // C = c (1 - exp(-sigma L)) + exp(-sigma L) background: the integral of the emission-absorption model, not a limit
    // of it
    let (sigma, length, colour) = (0.8f64, 2.5f64, [0.25f32, 0.5, 0.75]);
    let through = (-sigma * length).exp();
    for n in [1usize, 2, 7, 400] {
        let rays = RaySamples::new(&[0, n as u32], &vec![true; n]);
        let out = seen(&rays, &vec![(sigma * length) as f32 / n as f32; n], &colour.repeat(n));
        for c in 0..3 {
            let expected = f64::from(colour[c]) * (1.0 - through) + through * WIDE[c];
            assert!((f64::from(out[c]) - expected).abs() < 1e-5, "{n}: {} for {expected}", out[c]);
        }
        assert!((f64::from(out[3]) - (1.0 - through)).abs() < 1e-5);
    }
    // one slab in front of another: the over operator of Porter and Duff
    let rays = RaySamples::new(&[0, 2], &[true, true]);
    let out = seen(&rays, &[1.0, 2.0], &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
    let (front, back) = (1.0 - (-1.0f64).exp(), 1.0 - (-2.0f64).exp());
    let expected = [front + (1.0 - front) * (1.0 - back) * WIDE[0], (1.0 - front) * (back + (1.0 - back) * WIDE[1])];
    assert!((f64::from(out[0]) - expected[0]).abs() < 1e-6 && (f64::from(out[1]) - expected[1]).abs() < 1e-6);
}

#[test]
fn weights_sum_to_the_alpha_of_the_picture() {
    let (rays, depths, _) = random(&[5, 0, 30], 1.0, 6);
    let all = weights(&[0, 5, 5, 35], &depths);
    let out = seen(&rays, &depths, &vec![0.0; 3 * rays.coloured()]);
    for (ray, range) in [(0, 0..5), (1, 5..5), (2, 5..35)] {
        assert!((all[range].iter().sum::<f32>() - out[4 * ray + 3]).abs() < 1e-5, "ray {ray}");
    }
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads_and_poison_stays_in_its_ray() {
    let counts: Vec<usize> = (0..500).map(|i| i * 7 % 60).collect();
    let (rays, mut depths, colours) = random(&counts, 0.3, 9);
    let grad: Vec<f32> = noise(10, 2000);
    let run = |depths: &[f32], threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| (seen(&rays, depths, &colours), slopes(&rays, depths, &colours, &grad)))
    };
    let one = run(&depths, 1);
    assert!(one == run(&depths, 2) && one == run(&depths, 5));
    let poisoned = rays.of(77).start;
    depths[poisoned] = f32::NAN;
    let (out, [of_depths, _]) = run(&depths, 2);
    assert!(out.iter().enumerate().all(|(i, v)| v.is_nan() == (i / 4 == 77)));
    assert!(of_depths.iter().enumerate().all(|(i, v)| !v.is_nan() || rays.of(77).contains(&i)));
    assert!(of_depths[poisoned].is_nan());
    depths[poisoned] = f32::INFINITY;
    assert!(run(&depths, 2).0.iter().all(|v| v.is_finite()), "an opaque sample");
}

const UNIT: Box3 = Box3 { centre: [1.0, 2.0, 3.0], half: [1.0, 0.5, 2.0] };

#[test]
fn samples_lie_on_the_part_of_the_ray_inside_the_box() {
    let rays = [
        Ray { origin: [-4.0, 2.0, 3.0], direction: [1.0, 0.0, 0.0], jitter: 0.5 },
        Ray { origin: [-4.0, 2.6, 3.0], direction: [1.0, 0.0, 0.0], jitter: 0.0 },
        Ray { origin: [1.0, 2.0, 3.0], direction: [0.0, 0.0, -1.0], jitter: 0.0 },
        Ray { origin: [9.0, 2.0, 3.0], direction: [1.0, 0.0, 0.0], jitter: 0.0 },
    ];
    let out = sample(&rays, UNIT, 0.25, 100, |_, _| true);
    // 8 steps along x; beside the box; the 9 ends of 8 steps from the centre; behind the origin
    assert_eq!(out.offsets, [0, 8, 8, 17, 17]);
    let xs: Vec<f32> = out.points.chunks(3).map(|p| p[0]).take(8).collect();
    assert_eq!(xs, [-0.875, -0.625, -0.375, -0.125, 0.125, 0.375, 0.625, 0.875]);
    assert_eq!((&out.points[24..27], &out.points[48..51]), (&[0.0, 0.0, 0.0][..], &[0.0, 0.0, -1.0][..]));
    assert_eq!(sample(&rays, UNIT, 0.25, 3, |_, _| true).offsets, [0, 3, 3, 6, 6], "at most three");
    let out = sample(&rays, UNIT, 0.25, 100, |ray, p| ray == 0 && p[0] > 0.2);
    assert_eq!((out.offsets, out.points.len()), (vec![0, 3, 3, 3, 3], 9));
}

#[test]
fn skipping_empty_space_does_not_change_the_picture() {
    // a ball in the box: with all samples, and with only those inside it
    let density = |p: &[f32]| if p.iter().map(|v| v * v).sum::<f32>() < 0.5 { 3.0 } else { 0.0 };
    let towards = |i: usize| {
        let (a, b) = (0.1 * (i % 20) as f32 - 1.0, 0.07 * (i / 20) as f32 - 0.5);
        let d = [1.0f32, 0.12 * b, 0.25 * a];
        let norm = d.iter().map(|v| v * v).sum::<f32>().sqrt();
        Ray { origin: [-5.0, 2.0, 3.0], direction: d.map(|v| v / norm), jitter: 0.3 }
    };
    let rays: Vec<Ray> = (0..300).map(towards).collect();
    let picture = |keep: &(dyn Fn(usize, [f32; 3]) -> bool + Sync)| {
        let samples = sample(&rays, UNIT, 0.05, 1000, keep);
        let depths: Vec<f32> = samples.points.chunks(3).map(|p| 0.05 * density(p)).collect();
        let rays = RaySamples::new(&samples.offsets, &vec![true; depths.len()]);
        let colours: Vec<f32> = samples.points.iter().map(|v| 0.5 + 0.5 * v).collect();
        (depths.len(), seen(&rays, &depths, &colours))
    };
    let (all, whole) = picture(&|_, _| true);
    let (few, skipped) = picture(&|_, p| density(&p) > 0.0);
    assert!(2 * few < all, "{few} of {all}");
    assert_eq!(whole, skipped);
    assert!(whole.chunks(4).any(|p| p[3] > 0.5) && whole.chunks(4).any(|p| p[3] == 0.0));
}
