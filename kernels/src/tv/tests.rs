use super::{DifferenceReduction, TvGrads, TvKind, TvWeights, reference, tv};
use crate::field::{FieldParams, FieldShape, LevelShape};
use proptest::prelude::*;

fn noise(seed: u64, len: usize) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1u64 << 24) as f32
    };
    (0..len).map(|_| 2.0 * next()).collect()
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&v| f64::from(v)).collect()
}

fn shape(levels: &[[usize; 3]], time_knots: usize, channels: usize) -> FieldShape {
    let levels = levels.iter().map(|&resolution| LevelShape { resolution });
    FieldShape { levels: levels.collect(), time_knots, channels }
}

const WEIGHTS: TvWeights = TvWeights {
    space: 0.7,
    time: 0.3,
    one_prior_space: 0.2,
    one_prior_time: 0.5,
    reduction: DifferenceReduction::Mean,
};
/// The same with sums, and smaller, so that gradients stay near 1.
const SUMS: TvWeights = TvWeights { space: 0.07, time: 0.03, reduction: DifferenceReduction::Sum, ..WEIGHTS };

/// Parameters of all three kinds.
fn params(shape: &FieldShape, seed: u64) -> [Vec<f32>; 3] {
    [noise(seed + 1, shape.planes_len()), noise(seed + 2, shape.lines_len()), noise(seed + 3, shape.times_len())]
}

fn fast(shape: &FieldShape, p: &[Vec<f32>; 3], kind: TvKind, w: TvWeights) -> (f64, [Vec<f32>; 3]) {
    let mut grads = p.clone().map(|v| vec![0.0f32; v.len()]);
    let [planes, lines, times] = &mut grads;
    let params = FieldParams { planes: &p[0], lines: &p[1], times: &p[2] };
    let loss = tv(params, shape, kind, w, TvGrads { planes, lines, times });
    (loss, grads)
}

fn exact(shape: &FieldShape, p: &[Vec<f64>; 3], kind: TvKind, w: TvWeights) -> (f64, [Vec<f64>; 3]) {
    let mut grads = p.clone().map(|v| vec![0.0; v.len()]);
    let (space, space_prior) = (w.space.into(), w.one_prior_space.into());
    let (time, time_prior) = (w.time.into(), w.one_prior_time.into());
    let (c, r) = (shape.channels, w.reduction);
    let loss = reference::tv(&p[0], &shape.plane_spans(), c, kind, r, space, space_prior, &mut grads[0])
        + reference::tv(&p[1], &shape.line_spans(), c, kind, r, space, space_prior, &mut grads[1])
        + reference::tv(&p[2], &shape.time_spans(), c, kind, r, time, time_prior, &mut grads[2]);
    (loss, grads)
}

fn against_reference(shape: &FieldShape, kind: TvKind, seed: u64) {
    let p = params(shape, seed);
    for weights in [WEIGHTS, SUMS] {
        let (loss, grads) = fast(shape, &p, kind, weights);
        let (loss_exact, grads_exact) = exact(shape, &p.clone().map(|v| wide(&v)), kind, weights);
        assert!((loss - loss_exact).abs() <= 1e-6 * loss_exact.max(1.0), "{loss} {loss_exact}");
        for (g, e) in grads.iter().flatten().zip(grads_exact.iter().flatten()) {
            assert!((f64::from(*g) - e).abs() < 1e-5, "{g} against {e}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn any_shape_matches_the_reference(
        x in 1usize..12, y in 1usize..12, z in 1usize..12, knots in 1usize..6, channels in 1usize..40,
        second in any::<bool>(), seed in 0u64..1000,
    ) {
        let kind = if second { TvKind::Second } else { TvKind::First };
        against_reference(&shape(&[[x, y, z], [y, z, x]], knots, channels), kind, seed);
    }
}

#[test]
fn large_planes_match_the_reference() {
    let shape = shape(&[[70, 90, 40]], 20, 32);
    against_reference(&shape, TvKind::First, 1);
    against_reference(&shape, TvKind::Second, 2);
}

#[test]
fn reference_gradient_matches_finite_differences() {
    let shape = shape(&[[3, 4, 2]], 4, 2);
    let base = params(&shape, 3).map(|v| wide(&v));
    for (kind, weights) in [TvKind::First, TvKind::Second].into_iter().flat_map(|k| [(k, WEIGHTS), (k, SUMS)]) {
        let (_, grads) = exact(&shape, &base, kind, weights);
        for part in 0..3 {
            for i in 0..base[part].len() {
                let mut moved = base.clone();
                moved[part][i] += 1e-6;
                let up = exact(&shape, &moved, kind, weights).0;
                moved[part][i] -= 2e-6;
                let slope = (up - exact(&shape, &moved, kind, weights).0) / 2e-6;
                assert!((slope - grads[part][i]).abs() < 1e-7);
            }
        }
    }
}

#[test]
fn a_field_of_ones_costs_nothing_and_a_ramp_only_its_slope() {
    let shape = shape(&[[4, 4, 4]], 5, 8);
    let ones = params(&shape, 0).map(|v| vec![1.0; v.len()]);
    for kind in [TvKind::First, TvKind::Second] {
        let (loss, grads) = fast(&shape, &ones, kind, WEIGHTS);
        assert_eq!(loss, 0.0);
        assert!(grads.iter().flatten().all(|&g| g == 0.0));
    }
    let mut ramp = ones;
    for (i, v) in ramp[2].iter_mut().enumerate() {
        *v = (i / 8) as f32;
    }
    let w = TvWeights { space: 1.0, time: 3.0, one_prior_space: 0.0, one_prior_time: 0.0, ..WEIGHTS };
    assert_eq!(fast(&shape, &ramp, TvKind::First, w).0, 3.0);
    assert_eq!(fast(&shape, &ramp, TvKind::Second, w).0, 0.0);
    // 4 steps of 1 in 8 channels
    let summed = TvWeights { reduction: DifferenceReduction::Sum, ..w };
    assert_eq!(fast(&shape, &ramp, TvKind::First, summed).0, 3.0 * 32.0);
}

#[test]
fn gradients_are_added_to_existing_ones() {
    let shape = shape(&[[3, 3, 3]], 3, 8);
    let p = params(&shape, 4);
    let (_, fresh) = fast(&shape, &p, TvKind::First, WEIGHTS);
    let mut grads = fresh.clone().map(|v| vec![2.0f32; v.len()]);
    let [planes, lines, times] = &mut grads;
    let given = FieldParams { planes: &p[0], lines: &p[1], times: &p[2] };
    tv(given, &shape, TvKind::First, WEIGHTS, TvGrads { planes, lines, times });
    for (sum, g) in grads.iter().flatten().zip(fresh.iter().flatten()) {
        assert_eq!(*sum, 2.0 + g);
    }
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let shape = shape(&[[64, 50, 40], [30, 80, 60]], 9, 32);
    let p = params(&shape, 5);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| [TvKind::First, TvKind::Second].map(|kind| fast(&shape, &p, kind, WEIGHTS)))
    };
    let one = run(1);
    assert!(one == run(2) && one == run(5));
}

#[test]
fn poison_affects_the_loss_and_only_neighbouring_gradients() {
    let shape = shape(&[[20, 20, 20]], 3, 8);
    let mut p = params(&shape, 6);
    p[0][(10 * 20 + 10) * 8] = f32::NAN;
    let (loss, grads) = fast(&shape, &p, TvKind::First, WEIGHTS);
    assert!(loss.is_nan());
    let spoiled = grads.iter().flatten().filter(|g| g.is_nan()).count();
    assert_eq!(spoiled, 5);
    assert!(grads[1].iter().chain(&grads[2]).all(|g| g.is_finite()));
}
