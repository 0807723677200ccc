//! What each operation does to Gaussians.

use super::super::{EditError, EditStack, HIDDEN_LOGIT, Operation, apply, centre};
use super::{applied, arrays, bits, distance, edit, segments, stack, state};
use crate::model::HostGaussians;
use crate::model::sh::C0;
use volseggs_kernels::activation::sigmoid;

fn rotate(axis: [f32; 3], degrees: f32, about: Option<[f32; 3]>) -> Operation {
    Operation::Rotate { axis, degrees, about }
}

#[test]
fn recolour_with_shading_moves_the_weighted_mean_alone() {
    let rgb = [0.9, 0.1, 0.4];
    let (old, new) = (state(), applied(&[edit(&["a"], Operation::Recolour { rgb, keep_shading: true })]));
    let (mut sum, mut total) = ([0.0; 3], 0.0);
    for i in 0..4 {
        let w = sigmoid(old.opacity_logits[i]);
        total += w;
        for c in 0..3 {
            sum[c] += w * (0.5 + C0 * new.sh[48 * i + c]);
            let moved = |s: &HostGaussians, i: usize| s.sh[48 * i + c] - s.sh[c];
            assert!((moved(&new, i) - moved(&old, i)).abs() < 1e-5);
        }
        assert_eq!(old.sh[48 * i + 3..48 * (i + 1)], new.sh[48 * i + 3..48 * (i + 1)]);
    }
    for c in 0..3 {
        assert!((sum[c] / total - rgb[c]).abs() < 1e-5);
    }
}

#[test]
fn recolour_without_shading_is_one_colour_from_every_side() {
    let new = applied(&[edit(&["a"], Operation::Recolour { rgb: [1.0, 0.5, 0.0], keep_shading: false })]);
    for i in 0..4 {
        let sh = &new.sh[48 * i..48 * (i + 1)];
        assert!((0.5 + C0 * sh[0] - 1.0).abs() < 1e-6 && sh[1] == 0.0 && (0.5 + C0 * sh[2]).abs() < 1e-6);
        assert!(sh[3..].iter().all(|v| *v == 0.0));
    }
}

#[test]
fn opacity_multiplies_and_stops_at_0_99() {
    let (old, half) = (state(), applied(&[edit(&["a"], Operation::Opacity { factor: 0.5, show: false })]));
    let many = applied(&[edit(&["a"], Operation::Opacity { factor: 1e6, show: false })]);
    for i in 0..4 {
        let half = sigmoid(half.opacity_logits[i]);
        assert!((half - 0.5 * sigmoid(old.opacity_logits[i])).abs() < 1e-6);
        assert!((sigmoid(many.opacity_logits[i]) - 0.99).abs() < 1e-6);
    }
    // The smallest opacities keep their precision.
    let mut faint = state();
    faint.opacity_logits[0] = -60.0;
    apply(&stack(&[edit(&["a"], Operation::Opacity { factor: 2.0, show: false })]), &segments, &mut faint).unwrap();
    assert!((faint.opacity_logits[0] - (-60.0 + 2f32.ln())).abs() < 1e-4);
}

#[test]
fn hidden_is_zero_opacity_and_show_restores_the_edited_opacity() {
    assert_eq!(sigmoid(HIDDEN_LOGIT), 0.0);
    for hide in [Operation::Hide, Operation::Opacity { factor: 0.0, show: false }] {
        let hide = edit(&["a"], hide);
        let hidden = applied(std::slice::from_ref(&hide));
        assert!(hidden.opacity_logits[..4].iter().all(|l| *l == HIDDEN_LOGIT));
        let half = edit(&["a"], Operation::Opacity { factor: 0.5, show: false });
        let shown = applied(&[hide, half.clone(), edit(&["a"], Operation::Show)]);
        assert_eq!(shown, applied(&[half]));
    }
    let [hide, show] = [Operation::Hide, Operation::Opacity { factor: 0.5, show: true }].map(|o| edit(&["a"], o));
    assert_eq!(applied(&[hide, show]), applied(&[edit(&["a"], Operation::Opacity { factor: 0.5, show: false })]));
    assert_eq!(applied(&[edit(&["ab"], Operation::Show)]), state());
}

#[test]
fn isolate_hides_the_rest_and_keeps_the_named() {
    let (old, new) = (state(), applied(&[edit(&["b"], Operation::Isolate)]));
    for i in 0..10 {
        if (4..8).contains(&i) {
            assert_eq!(bits(&new, i), bits(&old, i));
        } else {
            assert_eq!(new.opacity_logits[i], HIDDEN_LOGIT);
        }
    }
    assert_eq!(new.means, old.means);
    let both = applied(&[edit(&["a", "b"], Operation::Isolate)]);
    assert_eq!(both, applied(&[edit(&["ab"], Operation::Isolate)]));
}

#[test]
fn a_quarter_turn_about_z_turns_x_into_y() {
    let mut one = HostGaussians {
        means: vec![2.0, 0.0, 5.0],
        rotations: vec![2.0, 0.0, 0.0, 0.0],
        log_scales: vec![0.0; 3],
        opacity_logits: vec![0.0],
        // Band 1 is C1 (-y, z, -x): seen along +x this Gaussian is bright in the first channel.
        sh: [vec![0.0; 9], vec![-1.0, 0.0, 0.0]].concat(),
        sh_stride: 4,
        ..HostGaussians::default()
    };
    let turn = edit(&["s"], rotate([0.0, 0.0, 3.0], 90.0, Some([1.0, 0.0, 0.0])));
    apply(&stack(&[turn]), &|_| Some(&[0]), &mut one).unwrap();
    let close = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-6);
    assert!(close(&one.means, &[1.0, 1.0, 5.0]), "{:?}", one.means);
    let h = 2f32.sqrt();
    assert!(close(&one.rotations, &[h, 0.0, 0.0, h]), "{:?}", one.rotations);
    assert!(close(&one.sh[3..6], &[-1.0, 0.0, 0.0]) && close(&one.sh[6..], &[0.0; 6]), "{:?}", one.sh);
}

#[test]
fn without_a_point_each_segment_turns_and_grows_about_its_own_centre_where_it_is_now() {
    let away = Operation::Translate { by: [10.0, -3.0, 2.0] };
    for own in [rotate([1.0, 2.0, 3.0], 40.0, None), Operation::Scale { factor: 2.5, about: None }] {
        // Rotating in place and moving commute, as at another time where the segment is elsewhere.
        let first = applied(&[edit(&["a"], away.clone()), edit(&["a"], own.clone())]);
        let last = applied(&[edit(&["a"], own.clone()), edit(&["a"], away.clone())]);
        assert!(super::distance(&first, &last) < 1e-5);
        // Two segments named at once are like two segments named one after the other, not like their union.
        let at_once = applied(&[edit(&["a", "b"], own.clone())]);
        let in_turn = applied(&[edit(&["a"], own.clone()), edit(&["b"], own.clone())]);
        assert_eq!(at_once, in_turn);
        assert!(super::distance(&at_once, &applied(&[edit(&["ab"], own)])) > 0.01);
    }
}

#[test]
fn scale_moves_apart_and_enlarges() {
    let (old, new) = (state(), applied(&[edit(&["a"], Operation::Scale { factor: 3.0, about: Some([0.0; 3]) })]));
    for k in 0..12 {
        assert!((new.means[k] - 3.0 * old.means[k]).abs() < 1e-5);
        assert!((new.log_scales[k] - old.log_scales[k] - 3f32.ln()).abs() < 1e-5);
    }
    assert_eq!((&new.rotations, &new.sh), (&old.rotations, &old.sh));
}

#[test]
fn a_gaussian_in_two_named_segments_is_edited_once() {
    let by = Operation::Translate { by: [1.0, 0.0, 0.0] };
    assert_eq!(applied(&[edit(&["a", "ab", "a"], by.clone())]), applied(&[edit(&["ab"], by)]));
}

#[test]
fn a_segment_without_gaussians_or_opacity_is_fine() {
    for operation in [rotate([1.0, 0.0, 0.0], 30.0, None), Operation::Recolour { rgb: [0.0; 3], keep_shading: true }] {
        assert_eq!(applied(&[edit(&["none"], operation.clone())]), state());
        let mut clear = state();
        clear.opacity_logits.fill(f32::NEG_INFINITY);
        apply(&stack(&[edit(&["a"], operation)]), &segments, &mut clear).unwrap();
        assert!(clear.means.iter().chain(&clear.sh).all(|v| v.is_finite()));
    }
}

#[test]
fn non_finite_gaussians_affect_no_others() {
    let edits = [
        edit(&["ab"], rotate([0.0, 1.0, 0.0], 20.0, None)),
        edit(&["ab"], Operation::Scale { factor: 2.0, about: None }),
        edit(&["ab"], Operation::Recolour { rgb: [0.2; 3], keep_shading: true }),
        edit(&["ab"], Operation::Opacity { factor: 0.3, show: false }),
    ];
    for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for array in 0..5 {
            let mut poisoned = state();
            match array {
                0 => poisoned.means[4] = poison,
                1 => poisoned.rotations[5] = poison,
                2 => poisoned.log_scales[3] = poison,
                3 => poisoned.opacity_logits[1] = poison,
                _ => poisoned.sh[48] = poison,
            }
            apply(&stack(&edits), &segments, &mut poisoned).unwrap();
            for i in (0..10).filter(|i| *i != 1) {
                for a in arrays(&poisoned) {
                    assert!(a[i * a.len() / 10..(i + 1) * a.len() / 10].iter().all(|v| v.is_finite()), "{i} {array}");
                }
            }
        }
    }
}

#[test]
fn bad_input_is_refused_and_changes_nothing() {
    let fine = edit(&["a"], Operation::Hide);
    let refused = |stack: &EditStack, mut s: HostGaussians| {
        let before = s.clone();
        let error = apply(stack, &segments, &mut s).unwrap_err();
        assert_eq!(s, before);
        error
    };
    let unknown = refused(&stack(&[fine.clone(), edit(&["a", "ghost"], Operation::Show)]), state());
    assert!(matches!(&unknown, EditError::UnknownSegment { edit: 2, name } if name == "ghost"), "{unknown}");
    let scale = edit(&["a"], Operation::Scale { factor: f32::NAN, about: None });
    assert!(matches!(refused(&stack(&[fine.clone(), scale]), state()), EditError::Value { .. }));
    let short = HostGaussians { rotations: vec![0.0; 39], ..state() };
    let short = refused(&stack(std::slice::from_ref(&fine)), short);
    assert!(matches!(short, EditError::Shape { field: "rotations", expected: 40, found: 39 }));
    let odd = refused(&stack(std::slice::from_ref(&fine)), HostGaussians { sh_stride: 3, ..state() });
    assert!(matches!(odd, EditError::ShStride { found: 3 }));
    let mut s = state();
    let error = apply(&stack(&[fine]), &|_| Some(&[3, 10]), &mut s).unwrap_err();
    assert!(matches!(error, EditError::Index { index: 10, count: 10, .. }));
    assert_eq!(s, state());
}

#[test]
fn the_centre_is_that_about_which_a_segment_turns() {
    let before = state();
    let moved = edit(&["ab"], Operation::Translate { by: [1.0, 2.0, 3.0] });
    let now = applied(&[moved.clone(), edit(&["ab"], Operation::Opacity { factor: 0.1, show: false })]);
    let members = segments("ab").unwrap();
    let [at, there] = [&before, &now].map(|n| centre(&before, n, members).unwrap());
    for k in 0..3 {
        assert!((there[k] - at[k] - (k + 1) as f64).abs() < 1e-6, "{at:?} {there:?}");
    }
    let about = Some(there.map(|c| c as f32));
    let turn = |about| edit(&["ab"], Operation::Rotate { axis: [0.0, 0.0, 1.0], degrees: 40.0, about });
    assert!(distance(&applied(&[moved.clone(), turn(None)]), &applied(&[moved, turn(about)])) < 1e-5);
    assert_eq!(centre(&before, &now, &[]), None);
}
