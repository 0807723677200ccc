//! Which views of which steps show each segment alone, and which steps have a volume of ids. No images.

use super::views::PlannedView;
use std::collections::BTreeSet;

/// Number of steps at which the ground truth is rendered by default, and of volumes written if each view has its own
/// step.
pub const EVEN_STEPS: usize = 5;

/// The steps at which segments are rendered alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SegmentSteps {
    /// This many, evenly spread over the series, in every view. Each is replaced by the nearest step that training sees
    /// if that is within half the distance between two of them.
    Even(usize),
    /// The given steps, counted from 0, in every view.
    These(Vec<usize>),
    /// In each view, the step that the test image of that view shows.
    OfViews,
}

impl Default for SegmentSteps {
    fn default() -> Self {
        Self::Even(EVEN_STEPS)
    }
}

impl SegmentSteps {
    /// The steps of every view, ascending; `None` if each view has its own.
    fn common(&self, steps: usize, trained: &BTreeSet<usize>) -> Option<BTreeSet<usize>> {
        match self {
            Self::Even(n) => Some(even_steps(*n, steps, trained)),
            Self::These(list) => Some(list.iter().copied().collect()),
            Self::OfViews => None,
        }
    }
}

/// A view of a step in which every segment is shown.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SegmentShot {
    /// Name of its image, without extension.
    pub name: String,
    /// Its camera and step.
    pub view: PlannedView,
}

/// `n` steps of a series of `steps`, evenly spread, each moved to a step that training sees if one is near.
fn even_steps(n: usize, steps: usize, trained: &BTreeSet<usize>) -> BTreeSet<usize> {
    let last = steps.saturating_sub(1) as f64;
    let apart = last / n.saturating_sub(1).max(1) as f64;
    let nearest = |k: usize| {
        let wanted = if n == 1 { 0.5 * last } else { k as f64 * apart };
        let away = |step: &usize| (*step as f64 - wanted).abs();
        let near = trained.iter().copied().min_by(|a, b| away(a).total_cmp(&away(b)));
        near.filter(|step| away(step) <= 0.5 * apart).unwrap_or(wanted.round() as usize)
    };
    (0..n).map(nearest).collect()
}

/// `n` of the test views, evenly spaced, at the chosen steps of a series of `steps`.
pub(super) fn shots(
    test: &[PlannedView],
    n: usize,
    chosen: &SegmentSteps,
    steps: usize,
    trained: &BTreeSet<usize>,
) -> Vec<SegmentShot> {
    let common = chosen.common(steps, trained);
    let views = (0..n.min(test.len())).map(|k| if n == 1 { 0 } else { k * (test.len() - 1) / (n - 1) });
    let of_view = |i: usize| -> Vec<SegmentShot> {
        let view = &test[i];
        let Some(common) = &common else { return vec![SegmentShot { name: format!("r_{i}"), view: view.clone() }] };
        let at = |step: &usize| SegmentShot {
            name: format!("r_{i}_step_{step}"),
            view: PlannedView { camera: view.camera.clone(), step: *step },
        };
        common.iter().map(at).collect()
    };
    views.flat_map(of_view).collect()
}

/// The steps of a series of `steps` that have a volume of ids.
pub(super) fn volume_steps(chosen: &SegmentSteps, steps: usize, trained: &BTreeSet<usize>) -> BTreeSet<usize> {
    chosen.common(steps, trained).unwrap_or_else(|| even_steps(EVEN_STEPS, steps, trained))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::paths::time_indices;
    use crate::prepare::views::{ViewOptions, test_views};

    fn even(n: usize, steps: usize, trained: &[usize]) -> Vec<usize> {
        even_steps(n, steps, &trained.iter().copied().collect()).into_iter().collect()
    }

    #[test]
    fn even_steps_are_trained_where_training_is_near() {
        let default = time_indices(30, 100);
        let found = even(5, 100, &default);
        assert_eq!((found.len(), found[0], found[4]), (5, 0, 99));
        assert!(found.iter().all(|s| default.contains(s)), "{found:?}");
        assert_eq!(even(5, 100, &[50]), [0, 25, 50, 74, 99]);
        assert_eq!(even(5, 3, &[0, 1, 2]), [0, 1, 2]);
        assert_eq!(even(5, 1, &[0]), [0]);
        assert_eq!(even(1, 11, &[0, 4]), [4]);
        assert_eq!(even(2, 11, &[]), [0, 10]);
    }

    #[test]
    fn each_view_at_each_step_or_at_its_own() {
        let test = test_views(&ViewOptions::default(), 100);
        let trained = time_indices(30, 100).into_iter().collect();
        let all = shots(&test, 10, &SegmentSteps::default(), 100, &trained);
        assert_eq!(all.len(), 50);
        assert_eq!((all[0].name.as_str(), all[49].name.as_str()), ("r_0_step_0", "r_180_step_99"));
        assert!(all.iter().all(|s| trained.contains(&s.view.step)));
        let own = shots(&test, 181, &SegmentSteps::OfViews, 100, &trained);
        assert!(own.iter().map(|s| &s.view).eq(&test));
        assert_eq!(own[7].name, "r_7");
        let these = SegmentSteps::These(vec![9, 3, 9]);
        assert_eq!(shots(&test, 1, &these, 100, &trained).len(), 2, "a step given twice counts once");
        assert!(shots(&test, 0, &these, 100, &trained).is_empty());
        assert_eq!(volume_steps(&these, 100, &trained).into_iter().collect::<Vec<_>>(), [3, 9]);
        assert_eq!(volume_steps(&SegmentSteps::OfViews, 100, &trained).len(), 5);
    }
}
