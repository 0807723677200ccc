//! Agreement of two label volumes (or any two lists of labels of the same items): Dice and IoU for each label, and
//! which predicted labels represent which true ones. 0 means unlabelled and is not scored.

mod assign;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

/// Two lists of labels cannot be compared, as their lengths differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{predicted} predicted labels, but {truth} true ones; compare volumes on the same grid")]
pub struct LengthError {
    /// Number of true labels.
    pub truth: usize,
    /// Number of predicted labels.
    pub predicted: usize,
}

/// Sizes of two sets of voxels and of their intersection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Overlap {
    /// Voxels in the true set.
    pub truth: u64,
    /// Voxels in the predicted set.
    pub predicted: u64,
    /// Voxels in both.
    pub both: u64,
}

impl Overlap {
    /// `2 |A and B| / (|A| + |B|)`; 1 if both are empty.
    pub fn dice(&self) -> f64 {
        ratio(2 * self.both, self.truth + self.predicted)
    }

    /// `|A and B| / |A or B|`; 1 if both are empty.
    pub fn iou(&self) -> f64 {
        ratio(self.both, self.truth + self.predicted - self.both)
    }
}

fn ratio(part: u64, whole: u64) -> f64 {
    if whole == 0 { 1.0 } else { part as f64 / whole as f64 }
}

/// A true label and the predicted labels matched to it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LabelMatch {
    /// The true label.
    pub truth: u32,
    /// The predicted labels, ascending; empty if none overlaps.
    pub predicted: Vec<u32>,
    /// Overlap of their union with the true label.
    pub overlap: Overlap,
}

/// How often each pair of a true and a predicted label occurs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Confusion {
    pairs: BTreeMap<(u32, u32), u64>,
    truth: BTreeMap<u32, u64>,
    predicted: BTreeMap<u32, u64>,
}

impl Confusion {
    /// Counts the pairs of two lists of labels in the same order.
    ///
    /// # Errors
    /// [`LengthError`].
    pub fn new<T: Copy + PartialEq + Into<u32>>(truth: &[T], predicted: &[T]) -> Result<Self, LengthError> {
        if truth.len() != predicted.len() {
            return Err(LengthError { truth: truth.len(), predicted: predicted.len() });
        }
        let mut table = Self::default();
        // Labels come in long runs along x: one look-up per run.
        let mut done = 0;
        while let (Some(&t), Some(&p)) = (truth.get(done), predicted.get(done)) {
            let rest = truth[done..].iter().zip(&predicted[done..]);
            let run = rest.take_while(|(a, b)| **a == t && **b == p).count().max(1);
            table.count(t.into(), p.into(), run as u64);
            done += run;
        }
        Ok(table)
    }

    /// Adds the counts of another table, such as that of another time.
    pub fn merge(&mut self, other: &Self) {
        for (pair, n) in &other.pairs {
            *self.pairs.entry(*pair).or_default() += n;
        }
        for (mine, theirs) in [(&mut self.truth, &other.truth), (&mut self.predicted, &other.predicted)] {
            for (label, n) in theirs {
                *mine.entry(*label).or_default() += n;
            }
        }
    }

    fn count(&mut self, truth: u32, predicted: u32, n: u64) {
        if truth != 0 {
            *self.truth.entry(truth).or_default() += n;
        }
        if predicted != 0 {
            *self.predicted.entry(predicted).or_default() += n;
        }
        if truth != 0 && predicted != 0 {
            *self.pairs.entry((truth, predicted)).or_default() += n;
        }
    }

    /// Returns the overlap of a true label with a predicted one.
    pub fn overlap(&self, truth: u32, predicted: u32) -> Overlap {
        let get = |map: &BTreeMap<u32, u64>, label| map.get(&label).copied().unwrap_or(0);
        Overlap {
            truth: get(&self.truth, truth),
            predicted: get(&self.predicted, predicted),
            both: self.pairs.get(&(truth, predicted)).copied().unwrap_or(0),
        }
    }

    /// Finds for each true label the set of predicted labels with the highest Dice score, as when a user picks the
    /// pieces of an over-segmented object. True labels are matched independently: a predicted label may be used by
    /// several of them.
    ///
    /// Predicted labels are added in descending order of the fraction of their voxels inside the true label, as long as
    /// the score rises, which is optimal.
    pub fn match_sets(&self) -> Vec<LabelMatch> {
        self.truth.iter().map(|(&truth, &size)| self.best_set(truth, size)).collect()
    }

    fn best_set(&self, truth: u32, size: u64) -> LabelMatch {
        let pairs = self.pairs.range((truth, 0)..=(truth, u32::MAX));
        let mut pieces: Vec<(u32, Overlap)> = pairs.map(|(&(_, p), _)| (p, self.overlap(truth, p))).collect();
        // Fractions are compared exactly, by cross-multiplication; ties are broken by label.
        pieces.sort_by(|(p, a), (q, b)| {
            let (left, right) =
                (u128::from(a.both) * u128::from(b.predicted), u128::from(b.both) * u128::from(a.predicted));
            right.cmp(&left).then(p.cmp(q))
        });
        let mut chosen =
            LabelMatch { truth, predicted: Vec::new(), overlap: Overlap { truth: size, ..Overlap::default() } };
        for (label, piece) in pieces {
            let mut larger = chosen.overlap;
            larger.predicted += piece.predicted;
            larger.both += piece.both;
            if larger.dice() <= chosen.overlap.dice() {
                break;
            }
            chosen.overlap = larger;
            chosen.predicted.push(label);
        }
        chosen.predicted.sort_unstable();
        chosen
    }

    /// Finds the one-to-one matching of true and predicted labels with the highest sum of Dice scores (the Hungarian
    /// method, `O(n^3)` in the number of labels). Labels that do not overlap are never matched.
    pub fn match_one_to_one(&self) -> Vec<LabelMatch> {
        let truth: Vec<u32> = self.truth.keys().copied().collect();
        let predicted: Vec<u32> = self.predicted.keys().copied().collect();
        let n = truth.len().max(predicted.len());
        let score = |i: usize, j: usize| match (truth.get(i), predicted.get(j)) {
            (Some(&t), Some(&p)) => self.overlap(t, p).dice(),
            _ => 0.0,
        };
        let column = assign::maximise(n, score);
        let one = |(i, &t): (usize, &u32)| {
            let partner = predicted.get(column[i]).copied().filter(|&p| self.overlap(t, p).both > 0);
            let overlap = self.overlap(t, partner.unwrap_or(0));
            LabelMatch { truth: t, predicted: partner.into_iter().collect(), overlap }
        };
        truth.iter().enumerate().map(one).collect()
    }
}

/// Returns the mean Dice score over true labels; `None` without any.
pub fn mean_dice(matches: &[LabelMatch]) -> Option<f64> {
    let sum: f64 = matches.iter().map(|m| m.overlap.dice()).sum();
    (!matches.is_empty()).then(|| sum / matches.len() as f64)
}
