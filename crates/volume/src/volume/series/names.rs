//! The numbers that order the names of a series: one as `t10`, several as `cycle01_step99`, dates as `2020-01-31`. No
//! file is opened here.

use super::dates::dates;
use super::pieces::{NamePiece, split};
use std::cmp::Ordering;
use std::ops::Range;

/// The order in which `t2` comes before `t10`, and `t0.25` before `t0.5`; names that differ in zeros alone are ordered
/// as texts.
pub fn order(stems: &[String]) -> Vec<usize> {
    let (names, _) = split(stems, None);
    let natural = |a: usize, b: usize| {
        let (left, right) = (&names[a], &names[b]);
        let differ = left.iter().zip(right).map(|(l, r)| l.cmp(r)).find(|o| o.is_ne());
        differ.unwrap_or_else(|| left.len().cmp(&right.len())).then_with(|| stems[a].cmp(&stems[b]))
    };
    let mut order: Vec<usize> = (0..stems.len()).collect();
    order.sort_by(|&a, &b| natural(a, b));
    order
}

/// A step that no name has.
#[derive(Debug, PartialEq, Eq)]
pub struct MissingStep {
    /// The name after which it is missing.
    pub after: usize,
    /// Where the number stands in that name, in bytes.
    pub at: Range<usize>,
    /// The number that is missing, as it would be written there.
    pub number: String,
}

/// Names in order, and the numbers that give the step in each.
pub struct Names<'a> {
    names: Vec<Vec<NamePiece<'a>>>,
    /// The pieces that hold the numbers by which the names are ordered: where names differ in numbers only, all that
    /// vary, else the number that ends each name.
    at: Vec<Vec<usize>>,
    /// The pieces of the date that contains them, and its seconds in each name.
    date: Option<(Range<usize>, Vec<i64>)>,
    /// Two names of which the first comes before the second if their numbers are whole, and after it if decimal, where
    /// nothing tells which they are; they are then read as decimal.
    pub unclear: Option<[usize; 2]>,
}

impl<'a> Names<'a> {
    /// Reads names; whether numbers joined by a point are decimal is told from all of them.
    pub fn from_stems(stems: &'a [String]) -> Self {
        Self::read(stems, None)
    }

    /// Reads names; numbers joined by a point are whole.
    pub fn whole(stems: &'a [String]) -> Self {
        Self::read(stems, Some(false))
    }

    fn read(stems: &'a [String], decimal: Option<bool>) -> Self {
        let (names, unclear) = split(stems, decimal);
        let varying = varying(&names).filter(|v| !v.is_empty());
        let date = varying.as_ref().and_then(|varying| dates(&names, varying));
        let at = match varying {
            Some(varying) => vec![varying; names.len()],
            None => ends(&names).unwrap_or_default(),
        };
        Self { names, at, date, unclear }
    }

    /// The numbers that order name `i`.
    fn numbers(&self, i: usize) -> impl Iterator<Item = &NamePiece<'a>> {
        self.at[i].iter().map(move |&k| &self.names[i][k])
    }

    /// Compares the numbers of a name with those of the name before, the first number first.
    fn with_previous(&self, i: usize) -> Ordering {
        let differ = self.numbers(i - 1).zip(self.numbers(i)).map(|(a, b)| a.cmp(b)).find(|o| o.is_ne());
        differ.unwrap_or(Ordering::Equal)
    }

    /// The first name whose numbers are not above those of the previous name.
    pub fn first_unsorted(&self) -> Option<usize> {
        (1..self.at.len()).find(|&i| self.with_previous(i).is_ge())
    }

    /// The first name whose last number is not above that of the previous name although the numbers before it are, as
    /// in `cycle1_9`, `cycle2_0`; and whether one of these is in the name of a folder. Dates do not begin again.
    pub fn begins_again(&self) -> Option<(usize, bool)> {
        let last = |i: usize| self.numbers(i).last();
        let falls = |&i: &usize| last(i - 1).zip(last(i)).is_some_and(|(a, b)| a.cmp(b).is_ge());
        let several = self.date.is_none() && self.at.first().is_some_and(|at| at.len() > 1);
        let i = (1..self.at.len()).filter(|_| several).find(falls)?;
        let changes = |&&k: &&usize| self.names[i - 1][k].cmp(&self.names[i][k]).is_ne();
        let first = self.at[i].iter().find(changes)?;
        let folder = self.names[i][first + 1..].iter().any(|p| p.text.contains(std::path::is_separator));
        Some((i, folder))
    }

    /// The word for what gives the step.
    pub fn kind(&self, i: usize) -> &'static str {
        match (&self.date, self.at[i].len()) {
            (Some(_), _) => "date",
            (None, 1) => "number",
            (None, _) => "numbers",
        }
    }

    /// What gives the step in name `i`, as written there.
    pub fn written(&self, i: usize) -> String {
        let range = match (&self.date, self.at[i].first().zip(self.at[i].last())) {
            (Some((range, _)), _) => range.clone(),
            (None, Some((&first, &last))) => first..last + 1,
            (None, None) => 0..0,
        };
        self.names[i][range].iter().map(|p| p.text).collect()
    }

    /// The time of each name in seconds, if dates give them.
    pub fn seconds(&self) -> Option<&[i64]> {
        self.date.as_ref().map(|(_, seconds)| seconds.as_slice())
    }

    /// Whether the numbers are decimal, at distances that differ by more than a hundredth.
    pub fn are_uneven(&self) -> bool {
        let value = |(name, at): (&Vec<NamePiece<'a>>, &Vec<usize>)| match at[..] {
            [k] if name[k].whole().is_none() => name[k].text.parse::<f64>().ok(),
            [k] => name[k].whole().map(|(value, _)| value as f64),
            _ => None,
        };
        let decimal = self.names.iter().zip(&self.at).any(|(name, at)| at.iter().any(|&k| name[k].whole().is_none()));
        let values: Option<Vec<f64>> = self.names.iter().zip(&self.at).map(value).collect();
        let Some(values) = values.filter(|v| v.len() > 2 && decimal && self.date.is_none()) else { return false };
        let steps = || values.windows(2).map(|w| w[1] - w[0]);
        let (least, most) = (steps().fold(f64::INFINITY, f64::min), steps().fold(0.0, f64::max));
        most - least > 0.01 * most
    }

    /// The first step that is missing among names in order: their last number has another stride there than elsewhere,
    /// which is judged where the numbers before it stay, if it begins again. Decimal numbers and dates show no gaps.
    pub fn missing(&self) -> Option<MissingStep> {
        if self.date.is_some() {
            return None;
        }
        let last = |i: usize| self.at[i].last().map(|&k| &self.names[i][k]);
        let values: Option<Vec<(i128, usize)>> = (0..self.at.len()).map(|i| last(i)?.whole()).collect();
        let values = values?;
        let again = self.begins_again().is_some();
        let stays = |i: usize| {
            let count = self.at[i].len() - 1;
            self.numbers(i - 1).zip(self.numbers(i)).take(count).all(|(a, b)| a.cmp(b).is_eq())
        };
        let steps = (1..values.len()).filter(|&i| !again || stays(i)).map(|i| (i, values[i].0 - values[i - 1].0));
        let steps: Vec<(usize, i128)> = steps.collect();
        let stride = steps.iter().map(|s| s.1).min()?;
        let after = steps.iter().find(|s| s.1 != stride)?.0 - 1;
        let (before, width) = values[after];
        let k = *self.at[after].last()?;
        let start = self.names[after][..k].iter().map(|p| p.text.len()).sum::<usize>();
        let missing = before + stride;
        let sign = if missing < 0 { "-" } else { "" };
        let number = format!("{sign}{:0width$}", missing.unsigned_abs());
        Some(MissingStep { after, at: start..start + self.names[after][k].text.len(), number })
    }
}

/// The pieces in which names vary, if they differ in numbers only.
fn varying(names: &[Vec<NamePiece<'_>>]) -> Option<Vec<usize>> {
    let first = names.first()?;
    let same = |(a, b): (&NamePiece<'_>, &NamePiece<'_>)| a.is_number() && b.is_number() || a.cmp(b).is_eq();
    let alike = names.iter().all(|name| name.len() == first.len() && name.iter().zip(first).all(same));
    alike.then(|| (0..first.len()).filter(|&i| names.iter().any(|name| name[i].cmp(&first[i]).is_ne())).collect())
}

/// The number that ends each name; `None` where one has none.
fn ends(names: &[Vec<NamePiece<'_>>]) -> Option<Vec<Vec<usize>>> {
    let end = |name: &Vec<NamePiece<'_>>| {
        let i = name.len().checked_sub(1)?;
        name[i].is_number().then(|| vec![i])
    };
    names.iter().map(end).collect()
}

#[cfg(test)]
#[path = "names_tests.rs"]
mod tests;
