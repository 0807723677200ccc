//! Segments that merge and split: which ids hold, at another time, the matter of what was clicked.

use serde::{Deserialize, Serialize};

/// What becomes of a segment at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Change {
    /// It ends, as it merges into the other.
    Merged,
    /// It begins, as it splits off the other.
    Split,
}

/// A merge or a split of segments, from one step of the series to the next.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Turn {
    /// Time in [0, 1] of the first step at which it has happened.
    pub time: f64,
    /// The segment that ends or begins.
    pub segment: u16,
    /// Which of the two.
    pub change: Change,
    /// The one that goes on.
    pub other: u16,
}

/// The ids that hold at time `to` the matter of what the segments `ids` are at time `from`, by the merges and splits between
/// the two: back in time, what has merged into them is among them; forward, what splits off them. `None` where they are
/// part of something larger at that time, of which no id tells their part.
#[must_use]
pub fn ids_at(turns: &[Turn], ids: &[u16], from: f64, to: f64) -> Option<Vec<u16>> {
    let (low, high) = (from.min(to), from.max(to));
    let mut between: Vec<&Turn> = turns.iter().filter(|t| low < t.time && t.time <= high).collect();
    // of one step merges first: what splits off may have merged before
    between.sort_by(|a, b| a.time.total_cmp(&b.time).then(a.change.cmp(&b.change)));
    let back = to < from;
    if back {
        between.reverse();
    }
    let mut found = ids.to_vec();
    for turn in between {
        let (ours, others) = (found.contains(&turn.segment), found.contains(&turn.other));
        match (turn.change == Change::Merged) == back {
            // seen in this direction, the segment comes out of the other
            true if others && !ours => found.push(turn.segment),
            // and here it goes into the other
            false if others != ours => return None,
            _ => {}
        }
    }
    found.sort_unstable();
    Some(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use Change::{Merged, Split};

    fn turn(time: f64, segment: u16, change: Change, other: u16) -> Turn {
        Turn { time, segment, change, other }
    }

    #[test]
    fn what_merged_is_among_its_whole_before_and_cannot_be_told_after() {
        // 3 and 4 merge into 2, and that into 1
        let turns = [turn(0.2, 3, Merged, 2), turn(0.2, 4, Merged, 2), turn(0.6, 2, Merged, 1)];
        let at = |ids: &[u16], from, to| ids_at(&turns, ids, from, to);
        assert_eq!(at(&[1], 0.9, 0.0), Some(vec![1, 2, 3, 4]));
        assert_eq!(at(&[1], 0.9, 0.3), Some(vec![1, 2]));
        assert_eq!(at(&[1], 0.9, 0.7), Some(vec![1]));
        assert_eq!(at(&[2], 0.5, 0.1), Some(vec![2, 3, 4]));
        assert_eq!(
            (at(&[3], 0.0, 0.1), at(&[3], 0.0, 0.2)),
            (Some(vec![3]), None),
            "at the time of the turn it has happened"
        );
        assert_eq!(at(&[2], 0.0, 0.5), None, "more than it was");
        assert_eq!(at(&[2, 3, 4], 0.0, 0.5), Some(vec![2, 3, 4]), "all that merges: ids that ended hold nothing");
        assert_eq!(at(&[7], 0.0, 1.0), Some(vec![7]));
        assert_eq!(at(&[1], 0.5, 0.5), Some(vec![1]));
    }

    #[test]
    fn what_splits_off_is_among_its_whole_after_and_cannot_be_told_before() {
        let turns = [turn(0.4, 5, Split, 1), turn(0.7, 6, Split, 5)];
        let at = |ids: &[u16], from, to| ids_at(&turns, ids, from, to);
        assert_eq!(at(&[1], 0.1, 1.0), Some(vec![1, 5, 6]));
        assert_eq!(at(&[1], 0.1, 0.5), Some(vec![1, 5]));
        assert_eq!((at(&[5], 0.5, 0.3), at(&[1], 0.5, 0.3)), (None, None));
        assert_eq!(at(&[1, 5], 0.5, 0.3), Some(vec![1, 5]));
        assert_eq!(at(&[6], 0.9, 0.8), Some(vec![6]));
    }

    #[test]
    fn of_one_step_merges_come_first() {
        // 2 merges into 1, of which 3 splits off
        let turns = [turn(0.5, 3, Split, 1), turn(0.5, 2, Merged, 1)];
        assert_eq!(ids_at(&turns, &[1, 2], 0.0, 1.0), Some(vec![1, 2, 3]));
        assert_eq!(ids_at(&turns, &[1, 3], 1.0, 0.0), Some(vec![1, 2, 3]));
        assert_eq!(ids_at(&turns, &[1], 1.0, 0.0), None);
    }
}
