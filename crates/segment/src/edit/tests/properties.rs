//! Properties that hold for any edits.

use super::super::{EditError, EditStack, Operation};
use super::{applied, bits, distance, edit, segments, stack, state};
use proptest::prelude::*;

fn point() -> impl Strategy<Value = [f32; 3]> {
    prop::array::uniform3(-3.0f32..3.0)
}

fn axis() -> impl Strategy<Value = [f32; 3]> {
    point().prop_filter("an axis has a direction", |a| a.iter().any(|c| c.abs() > 0.1))
}

fn operation() -> impl Strategy<Value = Operation> {
    let about = || prop::option::of(point());
    prop_oneof![
        (prop::array::uniform3(0.0f32..=1.0), any::<bool>())
            .prop_map(|(rgb, keep_shading)| Operation::Recolour { rgb, keep_shading }),
        (0.0f32..2.0, any::<bool>()).prop_map(|(factor, show)| Operation::Opacity { factor, show }),
        Just(Operation::Hide),
        Just(Operation::Show),
        Just(Operation::Isolate),
        point().prop_map(|by| Operation::Translate { by }),
        (axis(), -400.0f32..400.0, about()).prop_map(|(axis, degrees, about)| Operation::Rotate {
            axis,
            degrees,
            about
        }),
        (0.2f32..4.0, about()).prop_map(|(factor, about)| Operation::Scale { factor, about }),
    ]
}

fn filled() -> impl Strategy<Value = EditStack> {
    let names = prop::sample::subsequence(vec!["a", "b", "ab", "none"], 1..=4);
    (prop::collection::vec((names, operation()), 1..8), 0usize..8).prop_map(|(edits, undone)| {
        let mut stack = EditStack::default();
        for (names, operation) in edits {
            stack.push(edit(&names, operation)).unwrap();
        }
        for _ in 0..undone {
            stack.undo();
        }
        stack
    })
}

/// Returns the operation that reverses a move, rotation or scaling.
fn inverse(operation: &Operation) -> Option<Operation> {
    match operation.clone() {
        Operation::Translate { by } => Some(Operation::Translate { by: by.map(|c| -c) }),
        Operation::Rotate { axis, degrees, about } => Some(Operation::Rotate { axis, degrees: -degrees, about }),
        Operation::Scale { factor, about } => Some(Operation::Scale { factor: 1.0 / factor, about }),
        _ => None,
    }
}

proptest! {
    #[test]
    fn undo_then_redo_is_the_identity(stack in filled(), times in 1usize..10) {
        let mut changed = stack.clone();
        let undone = (0..times).filter(|_| changed.undo().is_some()).count();
        prop_assert_eq!(undone, times.min(stack.operations.len()));
        for _ in 0..undone {
            prop_assert!(changed.redo().is_some());
        }
        prop_assert_eq!(changed, stack);
    }

    #[test]
    fn push_discards_undone_edits(stack in filled(), operation in operation()) {
        let mut changed = stack.clone();
        changed.undo();
        let kept = changed.operations.len();
        changed.push(edit(&["a"], operation.clone())).unwrap();
        prop_assert!(changed.undone.is_empty() && changed.redo().is_none());
        prop_assert_eq!(changed.operations.len(), kept + 1);
        prop_assert_eq!(&changed.operations[kept].operation, &operation);
        prop_assert_eq!(&changed.operations[..kept], &stack.operations[..kept]);
    }

    #[test]
    fn a_file_gives_back_the_same_stack(stack in filled()) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("edits.json");
        stack.save(&path).unwrap();
        prop_assert_eq!(EditStack::load(&path).unwrap(), stack);
    }

    #[test]
    fn moves_turns_and_scales_are_undone_by_their_inverse(operation in operation(), names in 0usize..3) {
        let Some(back) = inverse(&operation) else { return Ok(()) };
        let names: &[&str] = [&["a"][..], &["b", "a"], &["a", "ab"]][names];
        let restored = applied(&[edit(names, operation), edit(names, back)]);
        prop_assert!(distance(&restored, &state()) < 1e-4);
    }

    #[test]
    fn the_order_of_edits_of_disjoint_segments_does_not_matter(one in operation(), other in operation()) {
        prop_assume!(![&one, &other].contains(&&Operation::Isolate));
        let (one, other) = (edit(&["a"], one), edit(&["b"], other));
        let orders = (applied(&[one.clone(), other.clone()]), applied(&[other, one]));
        for i in 0..10 {
            prop_assert_eq!(bits(&orders.0, i), bits(&orders.1, i));
        }
    }

    #[test]
    fn gaussians_outside_keep_their_bits(
        operation in operation(), name in prop::sample::select(vec!["a", "b", "none"]),
    ) {
        prop_assume!(operation != Operation::Isolate);
        let (old, new) = (state(), applied(&[edit(&[name], operation)]));
        let inside = segments(name).unwrap();
        for i in (0..10).filter(|i| !inside.contains(i)) {
            prop_assert_eq!(bits(&old, i as usize), bits(&new, i as usize));
        }
    }

    #[test]
    fn an_undone_edit_has_no_effect(full in filled()) {
        let applying = full.operations.clone();
        let mut by_stack = state();
        super::super::apply(&full, &segments, &mut by_stack).unwrap();
        prop_assert_eq!(by_stack, applied(&applying));
    }

    #[test]
    fn values_that_are_not_finite_are_refused(
        poison in prop::sample::select(vec![f32::NAN, f32::INFINITY, f32::NEG_INFINITY]), at in 0usize..3,
    ) {
        let mut p = [0.5; 3];
        p[at] = poison;
        let bad = [
            Operation::Recolour { rgb: p, keep_shading: true },
            Operation::Opacity { factor: poison, show: false },
            Operation::Translate { by: p },
            Operation::Rotate { axis: p, degrees: 1.0, about: None },
            Operation::Rotate { axis: [1.0; 3], degrees: poison, about: None },
            Operation::Rotate { axis: [1.0; 3], degrees: 1.0, about: Some(p) },
            Operation::Scale { factor: poison, about: None },
            Operation::Scale { factor: 1.0, about: Some(p) },
        ];
        for operation in bad {
            let mut stack = EditStack::default();
            let refused = matches!(stack.push(edit(&["a"], operation)), Err(EditError::Value { .. }));
            prop_assert!(refused && stack == EditStack::default());
        }
    }
}

#[test]
fn the_order_of_edits_that_do_not_commute_matters() {
    let turn = edit(&["a"], Operation::Rotate { axis: [0.0, 0.0, 1.0], degrees: 90.0, about: Some([0.0; 3]) });
    let step = edit(&["a"], Operation::Translate { by: [1.0, 0.0, 0.0] });
    let (first, last) = (applied(&[turn.clone(), step.clone()]), applied(&[step, turn]));
    assert!(distance(&first, &last) > 0.9);
    let (hide, show) = (edit(&["a"], Operation::Hide), edit(&["a"], Operation::Show));
    assert_ne!(applied(&[hide.clone(), show.clone()]), applied(&[show, hide]));
    assert_eq!(stack(&[]), EditStack::default());
}
