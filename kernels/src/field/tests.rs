use super::{FieldGrads, FieldParams, FieldShape, FieldShapeError, LevelShape, cpu, reference};
use proptest::prelude::*;

/// Reproducible values in `lo..hi`.
fn noise(seed: u64, len: usize, lo: f32, hi: f32) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1u64 << 24) as f32
    };
    (0..len).map(|_| lo + (hi - lo) * next()).collect()
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&v| f64::from(v)).collect()
}

fn shape(levels: &[[usize; 3]], time_knots: usize, channels: usize) -> FieldShape {
    let levels = levels.iter().map(|&resolution| LevelShape { resolution });
    FieldShape { levels: levels.collect(), time_knots, channels }
}

/// Moves coordinates off the nodes, where f32 and f64 may fall into different cells.
fn clear_of_borders(shape: &FieldShape, mut points: Vec<f32>) -> Vec<f32> {
    let on_node = |value: f32, axis: usize| {
        shape.levels.iter().any(|level| {
            let n = level.resolution[axis];
            let grid = f64::from(value * 0.5 + 0.5) * (n - 1) as f64;
            n > 1 && (grid - grid.round()).abs() < 1e-3
        })
    };
    for (i, value) in points.iter_mut().enumerate() {
        while on_node(*value, i % 3) {
            *value += 1e-3;
        }
    }
    points
}

/// A field with inputs; the points keep clear of cell borders so that slopes are well defined.
struct Case {
    shape: FieldShape,
    planes: Vec<f32>,
    lines: Vec<f32>,
    times: Vec<f32>,
    points: Vec<f32>,
    grad: Vec<f32>,
    time: f32,
}

#[derive(Debug, PartialEq)]
struct Out {
    planes: Vec<f32>,
    lines: Vec<f32>,
    times: Vec<f32>,
    points: Vec<f32>,
}

impl Case {
    fn new(shape: FieldShape, n: usize, seed: u64) -> Self {
        Self {
            planes: noise(seed + 1, shape.planes_len(), -1.0, 1.0),
            lines: noise(seed + 2, shape.lines_len(), -1.0, 1.0),
            times: noise(seed + 3, shape.times_len(), 0.5, 1.5),
            points: clear_of_borders(&shape, noise(seed + 4, 3 * n, -1.1, 1.1)),
            grad: noise(seed + 5, n * shape.features_len(), -1.0, 1.0),
            time: 0.37,
            shape,
        }
    }

    fn params(&self) -> FieldParams<'_> {
        FieldParams { planes: &self.planes, lines: &self.lines, times: &self.times }
    }

    fn forward(&self) -> Vec<f32> {
        let mut out = vec![f32::NAN; self.grad.len()];
        cpu::forward(&self.shape, self.params(), &self.points, self.time, &mut out);
        out
    }

    fn backward(&self, active: Option<&[bool]>) -> Out {
        let mut out = Out {
            planes: vec![f32::NAN; self.planes.len()],
            lines: vec![f32::NAN; self.lines.len()],
            times: vec![f32::NAN; self.times.len()],
            points: vec![f32::NAN; self.points.len()],
        };
        let grads = FieldGrads {
            planes: &mut out.planes,
            lines: &mut out.lines,
            times: &mut out.times,
            points: &mut out.points,
        };
        let params = self.params();
        cpu::backward(&self.shape, params, &self.points, self.time, &self.grad, active, grads);
        out
    }

    fn reference_forward(&self) -> Vec<f64> {
        let (planes, lines, times) = (wide(&self.planes), wide(&self.lines), wide(&self.times));
        let params = reference::FieldParamsF64 { planes: &planes, lines: &lines, times: &times };
        reference::forward(&self.shape, params, &wide(&self.points), f64::from(self.time))
    }

    fn reference_backward(&self) -> reference::FieldGradsF64 {
        let (planes, lines, times) = (wide(&self.planes), wide(&self.lines), wide(&self.times));
        let params = reference::FieldParamsF64 { planes: &planes, lines: &lines, times: &times };
        let (points, grad) = (wide(&self.points), wide(&self.grad));
        reference::backward(&self.shape, params, &points, f64::from(self.time), &grad)
    }
}

#[track_caller]
fn close(name: &str, fast: &[f32], exact: &[f64], tolerance: f64) {
    assert_eq!(fast.len(), exact.len(), "{name}");
    let scale = exact.iter().fold(1.0, |m: f64, v| m.max(v.abs()));
    for (i, (&f, &e)) in fast.iter().zip(exact).enumerate() {
        let error = (f64::from(f) - e).abs();
        assert!(error <= tolerance * scale, "{name}[{i}]: {f} against {e}");
    }
}

fn against_reference(case: &Case) {
    close("features", &case.forward(), &case.reference_forward(), 1e-5);
    let (fast, exact) = (case.backward(None), case.reference_backward());
    close("planes", &fast.planes, &exact.planes, 1e-5);
    close("lines", &fast.lines, &exact.lines, 1e-5);
    close("times", &fast.times, &exact.times, 1e-5);
    close("points", &fast.points, &exact.points, 1e-4);
}

#[test]
fn vector_path_matches_the_reference() {
    against_reference(&Case::new(shape(&[[5, 7, 4], [33, 18, 40]], 6, 32), 700, 1));
}

#[test]
fn odd_channel_counts_and_flat_axes_match_the_reference() {
    against_reference(&Case::new(shape(&[[1, 3, 2], [2, 1, 1]], 1, 3), 50, 2));
    against_reference(&Case::new(shape(&[[1, 20, 17]], 2, 8), 50, 3));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn any_shape_matches_the_reference(
        n in 0usize..60, x in 1usize..20, y in 1usize..40, z in 1usize..40,
        knots in 1usize..5, channels in 1usize..18, time in -0.2f32..1.2, seed in 0u64..1000,
    ) {
        let mut case = Case::new(shape(&[[x, y, z], [z, x, y]], knots, channels), n, seed);
        case.time = time;
        against_reference(&case);
    }
}

#[test]
fn reference_gradient_matches_finite_differences() {
    let shape = shape(&[[4, 3, 5], [6, 5, 3]], 4, 2);
    let case = Case::new(shape, 4, 9);
    let base = [wide(&case.planes), wide(&case.lines), wide(&case.times), wide(&case.points)];
    let grad = wide(&case.grad);
    let loss = |v: &[Vec<f64>; 4]| -> f64 {
        let params = reference::FieldParamsF64 { planes: &v[0], lines: &v[1], times: &v[2] };
        let features = reference::forward(&case.shape, params, &v[3], f64::from(case.time));
        features.iter().zip(&grad).map(|(f, g)| f * g).sum()
    };
    let grads = case.reference_backward();
    let analytic = [grads.planes, grads.lines, grads.times, grads.points];
    for kind in 0..4 {
        for i in 0..base[kind].len() {
            let mut moved = base.clone();
            let step = 1e-6;
            moved[kind][i] = base[kind][i] + step;
            let up = loss(&moved);
            moved[kind][i] = base[kind][i] - step;
            let slope = (up - loss(&moved)) / (2.0 * step);
            let error = (slope - analytic[kind][i]).abs();
            assert!(error < 1e-6, "kind {kind} element {i}: {slope} against {}", analytic[kind][i]);
        }
    }
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let case = Case::new(shape(&[[20, 30, 40], [40, 33, 50]], 5, 32), 3000, 4);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (features, out) = pool.install(|| (case.forward(), case.backward(None)));
        let all = [features, out.planes, out.lines, out.times, out.points];
        all.map(|values| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>())
    };
    let one = run(1);
    assert!(one == run(2) && one == run(5));
}

#[test]
fn poisoned_points_stay_finite_and_get_no_gradient() {
    let mut case = Case::new(shape(&[[5, 6, 7]], 3, 8), 6, 5);
    let poison = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1.0, -1.0, 3.0e38];
    for (i, &value) in poison.iter().enumerate() {
        case.points[3 * i..3 * i + 3].fill(value);
    }
    let features = case.forward();
    assert!(features.iter().all(|v| v.is_finite()));
    let out = case.backward(None);
    assert!(out.points.iter().all(|&v| v == 0.0));
    assert!(out.planes.iter().chain(&out.lines).chain(&out.times).all(|v| v.is_finite()));
    // NaN reads nothing, infinity the border on its side
    assert_eq!(features[..8], [0.0; 8]);
    assert_eq!(features[16..24], features[32..40]);
    assert_eq!(features[8..16], features[24..32]);
}

#[test]
fn a_point_with_a_nan_coordinate_counts_as_inactive() {
    let mut case = Case::new(shape(&[[9, 20, 33]], 3, 16), 400, 7);
    let active: Vec<bool> = (0..400).map(|i| i % 3 != 0).collect();
    let (plain, masked) = (case.forward(), case.backward(Some(&active)));
    for i in (0..400).step_by(3) {
        case.points[3 * i + i % 2] = f32::NAN;
    }
    assert_eq!(masked, case.backward(None));
    for (i, (before, after)) in plain.chunks_exact(16).zip(case.forward().chunks_exact(16)).enumerate() {
        assert_eq!(after, if i % 3 == 0 { &[0.0; 16] } else { before }, "point {i}");
    }
    let wide = |v: &[f32]| v.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
    let (planes, lines, times) = (wide(&case.planes), wide(&case.lines), wide(&case.times));
    let params = reference::FieldParamsF64 { planes: &planes, lines: &lines, times: &times };
    let exact = reference::backward(&case.shape, params, &wide(&case.points), f64::from(case.time), &wide(&case.grad));
    assert!(masked.planes.iter().zip(&exact.planes).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-3 * (1.0 + b.abs())));
}

#[test]
fn a_poisoned_time_reads_the_first_knot() {
    let mut case = Case::new(shape(&[[3, 3, 3]], 4, 8), 5, 6);
    case.time = 0.0;
    let first = case.forward();
    case.time = f32::NAN;
    assert_eq!(first, case.forward());
}

#[test]
fn inactive_points_count_as_zero_gradient() {
    let mut case = Case::new(shape(&[[9, 20, 33]], 3, 16), 400, 7);
    let active: Vec<bool> = (0..400).map(|i| i % 3 != 0).collect();
    let masked = case.backward(Some(&active));
    for (row, &on) in case.grad.chunks_exact_mut(16).zip(&active) {
        if !on {
            row.fill(0.0);
        }
    }
    assert_eq!(masked, case.backward(None));
}

#[test]
fn empty_extents_are_reported_by_name() {
    assert_eq!(shape(&[], 1, 1).validate(), Err(FieldShapeError::NoLevels));
    let empty = Err(FieldShapeError::EmptyAxis { level: 1, axis: 2 });
    assert_eq!(shape(&[[1, 1, 1], [1, 2, 0]], 1, 1).validate(), empty);
    assert_eq!(shape(&[[1, 1, 1]], 0, 1).validate(), Err(FieldShapeError::NoTimeKnots));
    assert_eq!(shape(&[[1, 1, 1]], 1, 0).validate(), Err(FieldShapeError::NoChannels));
}
