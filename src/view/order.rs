//! The order in which segments and edits were changed, so that one undo reverts whichever came last.
//!
//! Each of the two has a history of its own in its file, and no file says how the two interleave. This is the order
//! that one server saw: changes made through it, and those of commands that it found. Among earlier changes, edits
//! count as the later ones.

/// One of the two histories.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HistoryStack {
    /// That of the segments.
    Segments,
    /// That of the edits.
    Edits,
}

/// Numbers of steps that a history can undo and redo.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepCounts {
    /// To undo.
    pub undo: usize,
    /// To redo.
    pub redo: usize,
}

/// The changes that were seen in both histories, newest last.
#[derive(Clone, Debug, Default)]
pub struct ChangeOrder {
    done: Vec<HistoryStack>,
    undone: Vec<HistoryStack>,
}

impl ChangeOrder {
    /// Records that a history was changed, undone or redone: its steps before and after show which.
    pub fn record(&mut self, stack: HistoryStack, before: StepCounts, after: StepCounts) {
        if after.redo > before.redo {
            for _ in before.redo..after.redo {
                take_last(&mut self.done, stack);
                self.undone.push(stack);
            }
        } else if after.undo > before.undo && after.undo + after.redo == before.undo + before.redo {
            for _ in before.undo..after.undo {
                take_last(&mut self.undone, stack);
                self.done.push(stack);
            }
        } else {
            // at least one is new: a full history forgets its oldest change for it, so the number may be the same
            let new = after.undo.saturating_sub(before.undo).max(1);
            self.done.extend(std::iter::repeat_n(stack, new));
            // as in each history alone, what was undone before a new change cannot be redone
            self.undone.clear();
        }
        forget_oldest(&mut self.done, stack, after.undo);
        forget_oldest(&mut self.undone, stack, after.redo);
    }

    /// Returns the history of which to undo a step.
    pub fn to_undo(&self, segments: StepCounts, edits: StepCounts) -> Option<HistoryStack> {
        let last = self.done.last().copied();
        last.or_else(|| first(edits.undo, segments.undo))
    }

    /// Returns the history of which to redo a step.
    pub fn to_redo(&self, segments: StepCounts, edits: StepCounts) -> Option<HistoryStack> {
        let last = self.undone.last().copied();
        // after a change that was seen, what was undone before stays undone
        last.or_else(|| first(edits.redo, segments.redo).filter(|_| self.done.is_empty()))
    }
}

fn first(edits: usize, segments: usize) -> Option<HistoryStack> {
    match (edits, segments) {
        (0, 0) => None,
        (0, _) => Some(HistoryStack::Segments),
        _ => Some(HistoryStack::Edits),
    }
}

fn take_last(list: &mut Vec<HistoryStack>, stack: HistoryStack) {
    if let Some(at) = list.iter().rposition(|s| *s == stack) {
        list.remove(at);
    }
}

/// Keeps the last `max_changes` changes of a history.
fn forget_oldest(list: &mut Vec<HistoryStack>, stack: HistoryStack, max_changes: usize) {
    let mut over = list.iter().filter(|s| **s == stack).count().saturating_sub(max_changes);
    list.retain(|s| {
        let goes = *s == stack && over > 0;
        over -= usize::from(goes);
        !goes
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two histories as their files have them, and the order.
    #[derive(Default)]
    struct Both {
        order: ChangeOrder,
        steps: [StepCounts; 2],
    }

    impl Both {
        fn to(&mut self, stack: HistoryStack, undo: usize, redo: usize) {
            let steps = &mut self.steps[usize::from(stack == HistoryStack::Edits)];
            let after = StepCounts { undo, redo };
            self.order.record(stack, *steps, after);
            *steps = after;
        }

        fn undo(&self) -> Option<HistoryStack> {
            self.order.to_undo(self.steps[0], self.steps[1])
        }

        fn redo(&self) -> Option<HistoryStack> {
            self.order.to_redo(self.steps[0], self.steps[1])
        }
    }

    #[test]
    fn the_latest_change_is_undone_first_and_redone_last() {
        use HistoryStack::{Edits, Segments};
        let mut both = Both::default();
        assert_eq!((both.undo(), both.redo()), (None, None));
        both.to(Segments, 1, 0);
        both.to(Edits, 1, 0);
        both.to(Segments, 2, 0);
        assert_eq!(both.undo(), Some(Segments));
        both.to(Segments, 1, 1);
        assert_eq!((both.undo(), both.redo()), (Some(Edits), Some(Segments)));
        both.to(Edits, 0, 1);
        assert_eq!((both.undo(), both.redo()), (Some(Segments), Some(Edits)));
        both.to(Edits, 1, 0);
        both.to(Segments, 2, 0);
        assert_eq!((both.undo(), both.redo()), (Some(Segments), None));
        both.to(Segments, 1, 1);
        both.to(Edits, 2, 0);
        assert_eq!((both.undo(), both.redo()), (Some(Edits), None), "a new change forgets what was undone");
    }

    #[test]
    fn earlier_changes_are_undone_edits_first_and_forgotten_ones_never() {
        use HistoryStack::{Edits, Segments};
        let mut both =
            Both { steps: [StepCounts { undo: 50, redo: 1 }, StepCounts { undo: 2, redo: 0 }], ..Both::default() };
        assert_eq!((both.undo(), both.redo()), (Some(Edits), Some(Segments)));
        for _ in 0..60 {
            // the number of remembered changes has reached its limit
            both.to(Segments, 50, 0);
        }
        assert_eq!((both.order.done.len(), both.undo()), (50, Some(Segments)));
        both.to(Edits, 3, 0);
        both.to(Edits, 0, 0);
        assert_eq!(both.undo(), Some(Segments), "edits were cleared");
    }
}
