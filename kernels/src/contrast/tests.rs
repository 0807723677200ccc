use super::{Contrast, FEATURES, Repulsion, contrast, reference};

fn case(pixels: usize) -> (Vec<f32>, Vec<u32>) {
    let mut state = 0x9E37_79B9u32 | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        state
    };
    let features = (0..pixels * FEATURES).map(|_| next() as f32 / u32::MAX as f32 - 0.4).collect();
    (features, (0..pixels).map(|_| next() % 4).collect())
}

const ALL: [Repulsion; 5] =
    [Repulsion::Cosine, Repulsion::Margin(0.1), Repulsion::Margin(0.5), Repulsion::Margin(-1.0), Repulsion::None];

#[test]
fn loss_and_gradient_match_the_sum_over_all_pairs() {
    let (features, masks) = case(45);
    let mut wide: Vec<f64> = features.iter().map(|v| f64::from(*v)).collect();
    for repulsion in ALL {
        let out = contrast(&features, &masks, repulsion);
        let exact = reference::contrast(&wide, &masks, repulsion);
        assert!((out.loss - exact).abs() < 1e-6, "{repulsion:?}: {} against {exact}", out.loss);
        for i in (0..features.len()).step_by(37) {
            let at = wide[i];
            wide[i] = at + 1e-5;
            let up = reference::contrast(&wide, &masks, repulsion);
            wide[i] = at - 1e-5;
            let slope = (up - reference::contrast(&wide, &masks, repulsion)) / 2e-5;
            wide[i] = at;
            assert!((slope - f64::from(out.gradient[i])).abs() < 1e-6, "{repulsion:?} {slope} {}", out.gradient[i]);
        }
    }
}

#[test]
fn a_margin_of_minus_one_has_the_gradient_of_cosines() {
    let (features, masks) = case(300);
    let (cosine, margin) = (contrast(&features, &masks, ALL[0]), contrast(&features, &masks, ALL[3]));
    let apart = masks.iter().flat_map(|a| masks.iter().map(move |b| f64::from(u8::from(a != b)))).sum::<f64>();
    assert!(
        (margin.loss - cosine.loss - apart / (300.0 * 300.0)).abs() < 1e-5,
        "each pair of different masks counts 1 more"
    );
    assert!(cosine.gradient.iter().zip(&margin.gradient).all(|(a, b)| (a - b).abs() < 1e-7));
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let (features, masks) = case(333);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| contrast(&features, &masks, Repulsion::Margin(0.2)))
    };
    let one = run(1);
    assert!(one == run(2) && one == run(5));
}

#[test]
fn a_zero_feature_has_no_gradient_and_nan_propagates() {
    let (mut features, masks) = case(10);
    features[..FEATURES].fill(0.0);
    for repulsion in ALL {
        let out = contrast(&features, &masks, repulsion);
        assert!(out.gradient[..FEATURES].iter().all(|g| *g == 0.0));
        let wide: Vec<f64> = features.iter().map(|v| f64::from(*v)).collect();
        let exact = reference::contrast(&wide, &masks, repulsion);
        assert!((out.loss - exact).abs() < 1e-6, "{repulsion:?}: {} against {exact}", out.loss);
        assert_eq!(contrast(&[], &[], repulsion), Contrast { loss: 0.0, gradient: Vec::new() });
    }
    features[0] = f32::NAN;
    assert!(contrast(&features, &masks, Repulsion::Cosine).loss.is_nan());
}
