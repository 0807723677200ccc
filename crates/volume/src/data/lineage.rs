//! Segments that merge and split: which ids hold the clicked material at another time.

use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// What happens to a segment at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LineageChange {
    /// It ends: it merges into another, or vanishes.
    Ended,
    /// It begins: it splits off another, or appears.
    Began,
}

/// The end or the beginning of a segment, from one step of the series to the next.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LineageEvent {
    /// Time in [0, 1] of the first step at which it has happened.
    pub time: f64,
    /// The segment that ends or begins.
    pub segment: u16,
    /// Whether it ends or begins.
    pub change: LineageChange,
    /// The one that continues, into which it merges or from which it splits; none where it vanishes or appears alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub other: Option<u16>,
}

/// Returns the ids that hold at time `to` the material of the segments `ids` at time `from`, given the merges and
/// splits between the two: backwards in time these include what has merged into them; forwards, what splits off them.
/// Segments that vanish or appear between the two times count as loss and growth, as at any border. `None` where `ids`
/// are part of something larger at time `to`, in which no id distinguishes their part.
pub fn ids_at(turns: &[LineageEvent], ids: &[u16], from: f64, to: f64) -> Option<Vec<u16>> {
    let (low, high) = (from.min(to), from.max(to));
    let mut between: Vec<&LineageEvent> = turns.iter().filter(|t| low < t.time && t.time <= high).collect();
    // within a step ends come first: what splits off may have merged before
    between.sort_by(|a, b| a.time.total_cmp(&b.time).then(a.change.cmp(&b.change)));
    // backwards in time, an end is where a segment comes from, and a beginning is where it goes
    let comes = if to < from { LineageChange::Ended } else { LineageChange::Began };
    if to < from {
        between.reverse();
    }
    let mut found: BTreeSet<u16> = ids.iter().copied().collect();
    // segments that appeared on their own between the two times
    let mut passing: BTreeSet<u16> = BTreeSet::new();
    for turn in between {
        let segment = turn.segment;
        match (turn.change == comes, turn.other) {
            (true, None) => {
                passing.insert(segment);
            }
            (true, Some(other)) if found.contains(&other) => {
                found.insert(segment);
            }
            (true, Some(other)) if passing.contains(&other) => {
                passing.insert(segment);
            }
            (false, Some(other)) if found.contains(&segment) && !found.contains(&other) => return None,
            (false, Some(other)) if !found.contains(&segment) && !passing.contains(&segment) => {
                if found.contains(&other) {
                    return None;
                }
                // what appeared on its own no longer counts as such once it absorbs what was there
                passing.remove(&other);
            }
            _ => {}
        }
    }
    Some(found.into_iter().collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use LineageChange::{Began, Ended};

    fn turn(time: f64, segment: u16, change: LineageChange, other: impl Into<Option<u16>>) -> LineageEvent {
        LineageEvent { time, segment, change, other: other.into() }
    }

    #[test]
    fn merged_segments_are_found_backwards_and_indistinct_forwards() {
        // 3 and 4 merge into 2, and that into 1
        let turns = [turn(0.2, 3, Ended, 2), turn(0.2, 4, Ended, 2), turn(0.6, 2, Ended, 1)];
        let at = |ids: &[u16], from, to| ids_at(&turns, ids, from, to);
        assert_eq!(at(&[1], 0.9, 0.0), Some(vec![1, 2, 3, 4]));
        assert_eq!(at(&[1], 0.9, 0.3), Some(vec![1, 2]));
        assert_eq!(at(&[1], 0.9, 0.7), Some(vec![1]));
        assert_eq!(at(&[2], 0.5, 0.1), Some(vec![2, 3, 4]));
        assert_eq!((at(&[3], 0.0, 0.1), at(&[3], 0.0, 0.2)), (Some(vec![3]), None), "the merge has happened");
        assert_eq!(at(&[2], 0.0, 0.5), None, "part of a larger segment");
        assert_eq!(at(&[2, 3, 4], 0.0, 0.5), Some(vec![2, 3, 4]), "all that merge: ids that have ended hold nothing");
        assert_eq!(at(&[7], 0.0, 1.0), Some(vec![7]));
        assert_eq!(at(&[1], 0.5, 0.5), Some(vec![1]));
    }

    #[test]
    fn split_segments_are_found_forwards_and_indistinct_backwards() {
        let turns = [turn(0.4, 5, Began, 1), turn(0.7, 6, Began, 5)];
        let at = |ids: &[u16], from, to| ids_at(&turns, ids, from, to);
        assert_eq!(at(&[1], 0.1, 1.0), Some(vec![1, 5, 6]));
        assert_eq!(at(&[1], 0.1, 0.5), Some(vec![1, 5]));
        assert_eq!((at(&[5], 0.5, 0.3), at(&[1], 0.5, 0.3)), (None, None));
        assert_eq!(at(&[1, 5], 0.5, 0.3), Some(vec![1, 5]));
        assert_eq!(at(&[6], 0.9, 0.8), Some(vec![6]));
    }

    #[test]
    fn ends_come_before_beginnings_within_a_step() {
        // 2 merges into 1, from which 3 splits off
        let turns = [turn(0.5, 3, Began, 1), turn(0.5, 2, Ended, 1)];
        assert_eq!(ids_at(&turns, &[1, 2], 0.0, 1.0), Some(vec![1, 2, 3]));
        assert_eq!(ids_at(&turns, &[1, 3], 1.0, 0.0), Some(vec![1, 2, 3]));
        assert_eq!(ids_at(&turns, &[1], 1.0, 0.0), None);
    }

    #[test]
    fn vanishing_is_loss_and_appearing_is_growth() {
        // 5 splits off 1, a crumb falls off it, and both vanish
        let turns =
            [turn(0.2, 5, Began, 1), turn(0.3, 6, Began, 5), turn(0.4, 5, Ended, None), turn(0.5, 6, Ended, None)];
        assert_eq!(ids_at(&turns, &[1], 0.6, 0.0), Some(vec![1]));
        assert_eq!(ids_at(&turns, &[1], 0.45, 0.0), None, "one of them is still there");
        assert_eq!(ids_at(&turns, &[6], 0.45, 0.0), None);
        assert_eq!(ids_at(&turns, &[1], 0.0, 0.6), Some(vec![1, 5, 6]));
        // 7 appears, 8 splits off it, and both merge into 2, which later merges into what appeared as 9
        let turns = [
            turn(0.2, 7, Began, None),
            turn(0.3, 8, Began, 7),
            turn(0.4, 8, Ended, 2),
            turn(0.5, 7, Ended, 2),
            turn(0.6, 9, Began, None),
            turn(0.7, 2, Ended, 9),
        ];
        assert_eq!(ids_at(&turns, &[2], 0.0, 0.6), Some(vec![2]));
        assert_eq!(ids_at(&turns, &[2], 0.25, 0.6), None, "one was there before");
        assert_eq!(ids_at(&turns, &[2], 0.0, 0.8), None, "part of something larger");
        assert_eq!(ids_at(&turns, &[2], 0.6, 0.0), Some(vec![2, 7, 8]));
    }
}
