use super::{DecoderGrads, DecoderInputs, DecoderParams, DecoderShape, DecoderShapeError, cpu, reference};
use proptest::prelude::*;

/// Reproducible values in `-size..size`.
fn noise(seed: u64, len: usize, size: f32) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1u64 << 24) as f32
    };
    (0..len).map(|_| size * (2.0 * next() - 1.0)).collect()
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&v| f64::from(v)).collect()
}

fn shape(inputs: usize, width: usize, head_sizes: &[usize]) -> DecoderShape {
    DecoderShape { inputs, width, head_sizes: head_sizes.to_vec() }
}

/// Parameters w0, b0, w1, b1, w2, b2 and the inputs, or their gradients, in this order.
type Parts<T> = [Vec<T>; 7];

/// A decoder with inputs whose hidden units keep clear of the kink, so that f32 and f64 fall on the same side of it.
struct Case {
    shape: DecoderShape,
    parts: Parts<f32>,
    grad: Vec<f32>,
}

fn reference_params(parts: &Parts<f64>) -> reference::DecoderParamsF64<'_> {
    reference::DecoderParamsF64 {
        w0: &parts[0],
        b0: &parts[1],
        w1: &parts[2],
        b1: &parts[3],
        w2: &parts[4],
        b2: &parts[5],
    }
}

impl Case {
    fn new(shape: DecoderShape, n: usize, seed: u64) -> Self {
        let (f, w) = (shape.inputs, shape.width);
        let near_one = |fan_in: usize| (3.0 / fan_in as f32).sqrt();
        let parts = [
            noise(seed + 1, shape.w0_len(), near_one(f)),
            noise(seed + 2, shape.b0_len(), 0.5),
            noise(seed + 3, shape.w1_len(), near_one(w)),
            // where no unit of the trunk is active, a head's is at its bias, wherever the inputs are moved
            noise(seed + 4, shape.b1_len(), 0.5).into_iter().map(|b| b + 1e-3f32.copysign(b)).collect(),
            noise(seed + 5, shape.w2_len(), near_one(w)),
            noise(seed + 6, shape.b2_len(), 0.5),
            noise(seed + 7, n * f, 1.0),
        ];
        let grad = noise(seed + 8, n * shape.outputs(), 1.0);
        let mut case = Self { shape, parts, grad };
        let exact = case.parts.each_ref().map(|part| wide(part));
        for row in case.parts[6].chunks_exact_mut(f) {
            let params = reference_params(&exact);
            let mut moves = 0;
            while reference::kink_distance(&case.shape, params, &wide(row)) < 1e-5 {
                assert!(
                    moves < 10_000,
                    "seed {seed}, {n} rows, {f} inputs, width {w}: a hidden unit stays at its kink"
                );
                row.iter_mut().for_each(|v| *v += 1e-3);
                moves += 1;
            }
        }
        case
    }

    fn params(&self) -> DecoderParams<'_> {
        DecoderParams {
            w0: &self.parts[0],
            b0: &self.parts[1],
            w1: &self.parts[2],
            b1: &self.parts[3],
            w2: &self.parts[4],
            b2: &self.parts[5],
        }
    }

    fn forward(&self) -> Vec<f32> {
        let mut out = vec![f32::NAN; self.grad.len()];
        cpu::forward(&self.shape, self.params(), &self.parts[6][..], &mut out);
        out
    }

    fn backward(&self, active: Option<&[bool]>) -> Parts<f32> {
        let mut out = self.parts.each_ref().map(|p| vec![f32::NAN; p.len()]);
        let [w0, b0, w1, b1, w2, b2, x] = &mut out;
        let grads = DecoderGrads { w0, b0, w1, b1, w2, b2, features: x, own: &mut [] };
        let (params, x) = (self.params(), &self.parts[6][..]);
        cpu::backward(&self.shape, params, x, &self.grad, active, grads);
        out
    }

    fn reference_forward(&self) -> Vec<f64> {
        let exact = self.parts.each_ref().map(|part| wide(part));
        reference::forward(&self.shape, reference_params(&exact), &exact[6])
    }

    fn reference_backward(&self) -> Parts<f64> {
        let exact = self.parts.each_ref().map(|part| wide(part));
        let params = reference_params(&exact);
        let grads = reference::backward(&self.shape, params, &exact[6], &wide(&self.grad));
        [grads.w0, grads.b0, grads.w1, grads.b1, grads.w2, grads.b2, grads.x]
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

#[track_caller]
fn against_reference(case: &Case) {
    close("out", &case.forward(), &case.reference_forward(), 1e-5);
    let names = ["w0", "b0", "w1", "b1", "w2", "b2", "x"];
    let (fast, exact) = (case.backward(None), case.reference_backward());
    for (name, (fast, exact)) in names.iter().zip(fast.iter().zip(&exact)) {
        close(name, fast, exact, 1e-5);
    }
}

fn bits(parts: &[Vec<f32>]) -> Vec<Vec<u32>> {
    let bits = |part: &Vec<f32>| part.iter().map(|v| v.to_bits()).collect();
    parts.iter().map(bits).collect()
}

#[test]
fn typical_sizes_match_the_reference() {
    against_reference(&Case::new(shape(64, 64, &[3, 4, 3, 1]), 700, 1));
    against_reference(&Case::new(shape(64, 64, &[11]), 1100, 2));
}

#[test]
fn odd_sizes_match_the_reference() {
    for n in [0, 1, 5, 6, 7, 47, 48, 49, 480, 481] {
        against_reference(&Case::new(shape(20, 48, &[3, 4, 3, 1]), n, 3));
    }
    against_reference(&Case::new(shape(1, 1, &[1]), 50, 4));
    against_reference(&Case::new(shape(65, 33, &[1, 13]), 100, 5));
    // a row without an active unit in the trunk, and a bias drawn within 1e-5 of zero
    against_reference(&Case::new(shape(19, 7, &[3, 4, 3, 1]), 20, 616));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn any_shape_matches_the_reference(
        n in 0usize..150, inputs in 1usize..40, width in 1usize..40,
        head_sizes in prop::collection::vec(1usize..9, 1..5), seed in 0u64..1000,
    ) {
        against_reference(&Case::new(shape(inputs, width, &head_sizes), n, seed));
    }
}

#[test]
fn reference_gradient_matches_finite_differences() {
    let case = Case::new(shape(5, 6, &[3, 1, 2]), 4, 9);
    let base = case.parts.each_ref().map(|part| wide(part));
    let grad = wide(&case.grad);
    let loss = |parts: &Parts<f64>| -> f64 {
        let out = reference::forward(&case.shape, reference_params(parts), &parts[6]);
        out.iter().zip(&grad).map(|(o, g)| o * g).sum()
    };
    // Small enough that no hidden unit crosses its kink.
    let step = 1e-6;
    let analytic = case.reference_backward();
    for part in 0..base.len() {
        for i in 0..base[part].len() {
            let mut moved = base.clone();
            moved[part][i] = base[part][i] + step;
            let up = loss(&moved);
            moved[part][i] = base[part][i] - step;
            let slope = (up - loss(&moved)) / (2.0 * step);
            let exact = analytic[part][i];
            let error = (slope - exact).abs();
            assert!(error < 1e-7, "part {part} element {i}: {slope} against {exact}");
        }
    }
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let case = Case::new(shape(20, 48, &[3, 4, 3, 1]), 3001, 6);
    let active: Vec<bool> = (0..3001).map(|i| i % 7 < 5).collect();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let out = bits(&[case.forward()]);
            (out, bits(&case.backward(Some(&active))))
        })
    };
    let one = run(1);
    assert!(one == run(2) && one == run(5));
}

#[test]
fn an_output_row_does_not_depend_on_its_place_or_neighbours() {
    let case = Case::new(shape(20, 48, &[3, 4]), 600, 10);
    let all = case.forward();
    for row in [0, 5, 48, 479, 480, 599] {
        let mut out = [f32::NAN; 7];
        let x = &case.parts[6][row * 20..][..20];
        cpu::forward(&case.shape, case.params(), x, &mut out);
        assert_eq!(out, all[row * 7..][..7], "row {row}");
    }
}

#[test]
fn rows_of_zeros_share_one_result_at_any_position() {
    for keep in [1, 2, 7, 600] {
        let mut case = Case::new(shape(20, 48, &[3, 4]), 600, 10);
        let plain = case.forward();
        for (row, x) in case.parts[6].chunks_exact_mut(20).enumerate() {
            if row % keep != 0 {
                x.fill(if row % 2 == 0 { 0.0 } else { -0.0 });
            }
        }
        let mut zero = [f32::NAN; 7];
        cpu::forward(&case.shape, case.params(), &[0.0; 20][..], &mut zero);
        for (row, (before, after)) in plain.chunks_exact(7).zip(case.forward().chunks_exact(7)).enumerate() {
            assert_eq!(after, if row % keep == 0 { before } else { &zero }, "row {row}, one of {keep} kept");
        }
    }
}

#[test]
fn a_poisoned_row_affects_no_other_row_in_the_forward_pass() {
    for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 3.0e38] {
        let mut case = Case::new(shape(20, 48, &[3, 4, 3, 1]), 101, 11);
        let clean = case.forward();
        for row in [0, 50, 100] {
            case.parts[6][row * 20..][..20].fill(poison);
        }
        let poisoned = case.forward();
        for (row, (before, after)) in clean.chunks(11).zip(poisoned.chunks(11)).enumerate() {
            if row % 50 == 0 {
                assert!(!poison.is_nan() || after.iter().all(|v| v.is_nan()));
            } else {
                assert_eq!(before, after, "row {row} beside {poison}");
            }
        }
    }
}

#[test]
fn a_poisoned_row_reaches_parameter_gradients_but_no_other_row() {
    let mut case = Case::new(shape(20, 48, &[3, 4, 3, 1]), 101, 12);
    let clean = case.backward(None);
    case.parts[6][50 * 20..][..20].fill(f32::NAN);
    let poisoned = case.backward(None);
    for part in [0, 2, 4] {
        assert!(poisoned[part].iter().all(|v| v.is_nan()), "part {part}");
    }
    for row in (0..101).filter(|&row| row != 50) {
        let at = row * 20..(row + 1) * 20;
        assert_eq!(clean[6][at.clone()], poisoned[6][at], "row {row}");
    }
}

#[test]
fn poison_in_skipped_rows_reaches_no_gradient() {
    let mut case = Case::new(shape(20, 48, &[3, 4, 3, 1]), 301, 13);
    let active: Vec<bool> = (0..301).map(|i| i % 3 != 0).collect();
    for (row, grad) in case.grad.chunks_exact_mut(11).enumerate() {
        if row % 5 == 0 {
            grad.fill(-0.0);
        }
    }
    let clean = case.backward(Some(&active));
    for row in (0..301).filter(|row| row % 3 == 0 || row % 5 == 0) {
        case.parts[6][row * 20..][..20].fill(f32::NAN);
        if row % 3 == 0 {
            case.grad[row * 11..][..11].fill(f32::NAN);
        }
    }
    let poisoned = case.backward(Some(&active));
    assert_eq!(bits(&clean), bits(&poisoned));
    assert!(clean[6][..20].iter().all(|&v| v == 0.0));
}

#[test]
fn inactive_rows_count_as_zero_gradient() {
    let mut case = Case::new(shape(20, 48, &[3, 4, 3, 1]), 1000, 7);
    let active: Vec<bool> = (0..1000).map(|i| i % 3 != 0 && i > 100).collect();
    let masked = case.backward(Some(&active));
    for (row, &on) in case.grad.chunks_exact_mut(11).zip(&active) {
        if !on {
            row.fill(0.0);
        }
    }
    assert_eq!(masked, case.backward(None));
    against_reference(&case);
    let none = case.backward(Some(&vec![false; 1000]));
    assert!(none.iter().flatten().all(|&v| v == 0.0));
}

#[test]
#[should_panic(expected = "w1: [W, H * W]")]
fn a_short_parameter_buffer_is_reported_by_name() {
    let mut case = Case::new(shape(2, 3, &[1, 1]), 2, 8);
    case.parts[2].pop();
    case.forward();
}

#[test]
fn empty_extents_are_reported_by_name() {
    assert_eq!(shape(0, 1, &[1]).validate(), Err(DecoderShapeError::NoInputs));
    assert_eq!(shape(1, 0, &[1]).validate(), Err(DecoderShapeError::NoWidth));
    assert_eq!(shape(1, 1, &[]).validate(), Err(DecoderShapeError::NoHeads));
    let empty = Err(DecoderShapeError::EmptyHead { head: 1 });
    assert_eq!(shape(1, 1, &[2, 0]).validate(), empty);
    assert_eq!(shape(1, 1, &[2, 3]).validate(), Ok(()));
}

#[test]
fn no_rows_give_no_outputs_and_gradients_of_zero() {
    let case = Case::new(shape(5, 3, &[1, 2]), 0, 9);
    assert!(case.forward().is_empty());
    let grads = case.backward(None);
    assert!(grads[..6].iter().all(|part| part.iter().all(|g| *g == 0.0)), "{grads:?}");
    assert!(grads[6].is_empty());
}

/// Columns of a row-major matrix.
fn columns(rows: &[f32], width: usize, range: std::ops::Range<usize>) -> Vec<f32> {
    rows.chunks_exact(width).flat_map(|row| row[range.clone()].to_vec()).collect()
}

#[test]
fn inputs_in_two_parts_give_the_same_bits_as_in_one() {
    for (inputs, beside) in [(10, 3), (10, 1), (16, 16), (80, 16)] {
        let mut case = Case::new(shape(inputs, 24, &[3, 4]), 700, 5);
        // rows of zeros share a result, rows without a gradient are skipped
        for i in (0..700).step_by(7) {
            case.parts[6][i * inputs..][..inputs].fill(0.0);
            case.grad[(i + 3) * 7..][..7].fill(0.0);
        }
        // zero in one part only
        case.parts[6][inputs..][..inputs - beside].fill(0.0);
        case.parts[6][3 * inputs - beside..3 * inputs].fill(0.0);
        let (at, x) = (inputs - beside, &case.parts[6]);
        let (features, own) = (columns(x, inputs, 0..at), columns(x, inputs, at..inputs));
        let parts = DecoderInputs { features: &features, own: &own };

        let mut out = vec![f32::NAN; case.grad.len()];
        cpu::forward(&case.shape, case.params(), parts, &mut out);
        assert_eq!(out, case.forward());

        let whole = case.backward(None);
        let mut of_parts = case.parts.each_ref().map(|p| vec![f32::NAN; p.len()]);
        let (mut of_features, mut of_own) = (vec![f32::NAN; features.len()], vec![f32::NAN; own.len()]);
        let [w0, b0, w1, b1, w2, b2, _] = &mut of_parts;
        let grads = DecoderGrads { w0, b0, w1, b1, w2, b2, features: &mut of_features, own: &mut of_own };
        cpu::backward(&case.shape, case.params(), parts, &case.grad, None, grads);
        assert_eq!(of_parts[..6], whole[..6]);
        assert_eq!(of_features, columns(&whole[6], inputs, 0..at));
        assert_eq!(of_own, columns(&whole[6], inputs, at..inputs));
    }
}
