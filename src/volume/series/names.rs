//! The numbers in the names of a series: whole as `t10`, decimal as `t0.25`, dates as `2020-01-31`. No file is opened
//! here.

use std::cmp::Ordering;
use std::ops::Range;

/// A number in a name: its digits, and those after a decimal point.
#[derive(Clone, Copy, Debug)]
struct Number<'a> {
    whole: &'a str,
    fraction: &'a str,
}

impl Number<'_> {
    fn cmp(&self, other: &Self) -> Ordering {
        let [a, b] = [self, other].map(|n| (n.whole.trim_start_matches('0'), n.fraction.trim_end_matches('0')));
        a.0.len().cmp(&b.0.len()).then_with(|| a.0.cmp(b.0)).then_with(|| a.1.cmp(b.1))
    }
}

/// One piece of a name.
#[derive(Clone, Copy, Debug)]
enum Piece<'a> {
    Text(&'a str),
    Number(Number<'a>),
}

impl<'a> Piece<'a> {
    fn len(&self) -> usize {
        match self {
            Self::Text(text) => text.len(),
            Self::Number(Number { whole, fraction: "" }) => whole.len(),
            Self::Number(Number { whole, fraction }) => whole.len() + 1 + fraction.len(),
        }
    }

    /// The digits of a whole number.
    fn digits(&self) -> Option<&'a str> {
        match self {
            Self::Number(Number { whole, fraction: "" }) => Some(whole),
            _ => None,
        }
    }

    fn cmp(&self, other: &Self) -> Ordering {
        match (self, other) {
            (Self::Text(a), Self::Text(b)) => a.cmp(b),
            (Self::Number(_), Self::Text(_)) => Ordering::Less,
            (Self::Text(_), Self::Number(_)) => Ordering::Greater,
            (Self::Number(a), Self::Number(b)) => a.cmp(b),
        }
    }
}

/// Splits a text into alternating texts and whole numbers.
fn pieces(text: &str) -> Vec<Piece<'_>> {
    let mut found = Vec::new();
    let mut rest = text;
    while let Some(first) = rest.bytes().next() {
        let digits = first.is_ascii_digit();
        let end = rest.bytes().position(|b| b.is_ascii_digit() != digits).unwrap_or(rest.len());
        let (head, tail) = rest.split_at(end);
        found.push(if digits { Piece::Number(Number { whole: head, fraction: "" }) } else { Piece::Text(head) });
        rest = tail;
    }
    found
}

/// The position of the last two numbers joined by a point, unless a third is joined to them as in `1.2.10`.
fn joined(name: &[Piece<'_>]) -> Option<usize> {
    let is_point = |i: usize| matches!(name.get(i), Some(Piece::Text(".")));
    let ends_in_point = |i: usize| matches!(name.get(i), Some(Piece::Text(t)) if t.ends_with('.'));
    let pair = |&i: &usize| name[i].digits().is_some() && is_point(i + 1) && name.get(i + 2).is_some();
    let alone = |&i: &usize| !is_point(i + 3) && !i.checked_sub(1).is_some_and(ends_in_point);
    (0..name.len()).rev().find(pair).filter(alone)
}

/// How numbers joined by a point are read.
#[derive(Debug)]
enum Reading {
    /// Two whole numbers.
    Whole,
    /// One decimal number.
    Decimal,
    /// Either; of these two names, the first comes before the second only if the numbers are whole.
    Unclear([usize; 2]),
}

/// How numbers joined by a point are read. `t0.5` and `t0.25` could also be read as steps 5 and 25. If the digits after
/// the point differ in length, some that end in a zero are those of unpadded steps; else numbers that share their whole
/// part are read by their stride, and others are decimal. If the lengths are equal, they are decimal if the numbers on
/// both sides of the point vary.
fn reading(names: &[Vec<Piece<'_>>]) -> Reading {
    let at: Vec<Option<(&str, &str)>> =
        names.iter().map(|name| joined(name).and_then(|i| name[i].digits().zip(name[i + 2].digits()))).collect();
    let Some((first, fraction)) = at.iter().flatten().next() else { return Reading::Whole };
    let unlike = |differs: &dyn Fn(&(&str, &str)) -> bool| at.iter().any(|p| p.as_ref().is_none_or(differs));
    if !unlike(&|p| p.1.len() != fraction.len()) {
        let both = unlike(&|p| p.0 != *first) && unlike(&|p| p.1 != *fraction);
        return if both { Reading::Decimal } else { Reading::Whole };
    }
    if at.iter().flatten().any(|p| p.1.len() > 1 && p.1.ends_with('0')) {
        return Reading::Whole;
    }
    if unlike(&|p| p.0 != *first) {
        return Reading::Decimal;
    }
    let fractions: Vec<&str> = at.iter().flatten().map(|p| p.1).collect();
    by_stride(&fractions)
}

/// How numbers are read that share their whole part and whose fractions, one for each name, differ in length: decimal
/// if these have a constant stride, else whole if those have one. If neither has, the numbers are decimal where that
/// does not change the order, or where the stride is constant but for rounding; else the order is unclear. Strides that
/// are multiples of the smallest, as of steps with a gap, prove nothing: `0.35`, `0.5`, `0.7`, `0.9` has them too.
fn by_stride(fractions: &[&str]) -> Reading {
    let longest = fractions.iter().map(|f| f.len()).max().unwrap_or(0);
    let shortest = fractions.iter().map(|f| f.len()).min().unwrap_or(0);
    // steps padded with zeros are at least as long as the others, so `0.05` beside `0.1` is decimal
    let padded = fractions.iter().any(|f| f.len() > shortest && f.starts_with('0'));
    let values = |(i, f): (usize, &&str)| -> Option<(u128, u128, usize)> {
        Some((f.parse().ok()?, format!("{f:0<longest$}").parse().ok()?, i))
    };
    let values: Option<Vec<_>> = fractions.iter().enumerate().map(values).collect();
    // fractions beyond 128 bits are no steps
    let Some(mut values) = values.filter(|_| !padded) else { return Reading::Decimal };
    values.sort_unstable();
    let mut whole: Vec<u128> = values.iter().map(|v| v.0).collect();
    let mut decimal: Vec<u128> = values.iter().map(|v| v.1).collect();
    whole.dedup();
    decimal.sort_unstable();
    decimal.dedup();
    if is_even(&decimal, 0) {
        return Reading::Decimal;
    }
    if is_even(&whole, 0) {
        return Reading::Whole;
    }
    match values.windows(2).find(|w| w[0].1 > w[1].1) {
        Some(w) if !is_even(&decimal, 1) => Reading::Unclear([w[0].2, w[1].2]),
        _ => Reading::Decimal,
    }
}

/// Whether at least three ascending numbers have one stride, but for `slack` where that is a small part of it.
fn is_even(numbers: &[u128], slack: u128) -> bool {
    let strides = numbers.windows(2).map(|w| w[1] - w[0]);
    let least = strides.clone().min().unwrap_or(0);
    numbers.len() > 2 && strides.max().is_some_and(|most| most - least <= slack.min(least / 10))
}

/// The names in pieces, with each decimal number as one piece; and two names whose order is unclear, if any.
fn split(stems: &[String]) -> (Vec<Vec<Piece<'_>>>, Option<[usize; 2]>) {
    let mut names: Vec<_> = stems.iter().map(|s| pieces(s)).collect();
    let unclear = match reading(&names) {
        Reading::Whole => return (names, None),
        Reading::Decimal => None,
        Reading::Unclear(pair) => Some(pair),
    };
    for name in &mut names {
        let Some(i) = joined(name) else { continue };
        if let (Some(whole), Some(fraction)) = (name[i].digits(), name[i + 2].digits()) {
            name.splice(i..i + 3, [Piece::Number(Number { whole, fraction })]);
        }
    }
    (names, unclear)
}

/// The order in which `t2` comes before `t10`, and `t0.25` before `t0.5`; names that differ in zeros alone are ordered
/// as texts.
pub fn order(stems: &[String]) -> Vec<usize> {
    let (names, _) = split(stems);
    let natural = |a: usize, b: usize| {
        let (left, right) = (&names[a], &names[b]);
        let differ = left.iter().zip(right).map(|(l, r)| l.cmp(r)).find(|o| o.is_ne());
        differ.unwrap_or_else(|| left.len().cmp(&right.len())).then_with(|| stems[a].cmp(&stems[b]))
    };
    let mut order: Vec<usize> = (0..stems.len()).collect();
    order.sort_by(|&a, &b| natural(a, b));
    order
}

/// The whole number that gives the step in a name.
#[derive(Debug)]
pub struct Step {
    /// The number.
    pub value: u64,
    /// Bytes of the name before it.
    pub at: usize,
    /// Number of its digits.
    pub width: usize,
}

/// Names in order, and the position of the step in each.
pub struct Names<'a> {
    names: Vec<Vec<Piece<'a>>>,
    /// The pieces of each name that give the step; empty where names carry no numbers.
    at: Vec<Range<usize>>,
    /// Two names of which the first comes before the second if their numbers are whole, and after it if decimal, where
    /// nothing tells which they are; they are then read as decimal.
    pub unclear: Option<[usize; 2]>,
}

impl<'a> Names<'a> {
    /// If names differ in numbers only, the last number that varies gives the step, or the date that contains it; else
    /// the number that ends each name.
    pub fn of(stems: &'a [String]) -> Self {
        let (names, unclear) = split(stems);
        let at = steps_at(&names).unwrap_or_default();
        Self { names, at, unclear }
    }

    /// The first name whose number is not above that of the previous name.
    pub fn first_unsorted(&self) -> Option<usize> {
        let number = |i: usize| &self.names[i][self.at[i].clone()];
        let order = |i: usize| number(i - 1).iter().zip(number(i)).map(|(a, b)| a.cmp(b)).find(|o| o.is_ne());
        (1..self.at.len()).find(|&i| order(i) != Some(Ordering::Less))
    }

    /// The word for what gives the step in name `i`.
    pub fn kind(&self, i: usize) -> &'static str {
        if self.at[i].len() > 1 { "date" } else { "number" }
    }

    /// What gives the step in name `i`, as written there.
    pub fn written(&self, i: usize) -> String {
        let text = |p: &Piece<'_>| match p {
            Piece::Text(text) => (*text).to_owned(),
            Piece::Number(Number { whole, fraction: "" }) => (*whole).to_owned(),
            Piece::Number(Number { whole, fraction }) => format!("{whole}.{fraction}"),
        };
        self.names[i][self.at[i].clone()].iter().map(text).collect()
    }

    /// The numbers of the steps; `None` if there are none, or they are decimal, dates, or beyond 64 bits.
    pub fn steps(&self) -> Option<Vec<Step>> {
        let step = |(name, at): (&Vec<Piece<'a>>, &Range<usize>)| {
            let digits = name[at.start].digits().filter(|_| at.len() == 1)?;
            let before = name[..at.start].iter().map(Piece::len).sum();
            Some(Step { value: digits.parse().ok()?, at: before, width: digits.len() })
        };
        let steps: Option<Vec<Step>> = self.names.iter().zip(&self.at).map(step).collect();
        steps.filter(|s| !s.is_empty())
    }
}

/// The pieces of each name that give its step; `None` where one has no number.
fn steps_at(names: &[Vec<Piece<'_>>]) -> Option<Vec<Range<usize>>> {
    let first = names.first()?;
    let alike = names.iter().all(|name| {
        let same = |(a, b): (&Piece<'_>, &Piece<'_>)| match (a, b) {
            (Piece::Number(_), Piece::Number(_)) => true,
            _ => a.cmp(b).is_eq(),
        };
        name.len() == first.len() && name.iter().zip(first).all(same)
    });
    let varying = (0..first.len()).rev().find(|&i| alike && names.iter().any(|name| name[i].cmp(&first[i]).is_ne()));
    let at = |name: &Vec<Piece<'_>>| {
        let i = varying.or_else(|| name.len().checked_sub(1))?;
        let number = matches!(name[i], Piece::Number(_)).then_some(i..i + 1);
        if varying.is_some() && names.iter().all(|n| date(n, i) == date(name, i)) {
            return date(name, i).or(number);
        }
        number
    };
    names.iter().map(at).collect()
}

/// The date, with what is joined to it, that contains the number at `i`: four digits, then twice two, as in
/// `2020-01-31` or `2020_01_31T06_00`.
fn date(name: &[Piece<'_>], i: usize) -> Option<Range<usize>> {
    let digits = |k: usize, count: usize| name.get(k).and_then(Piece::digits).is_some_and(|d| d.len() == count);
    let joint = |k: usize| matches!(name.get(k), Some(Piece::Text("-" | "_" | "." | ":" | "T")));
    let of = |start: usize| {
        let whole = digits(start, 4) && joint(start + 1) && digits(start + 2, 2);
        let mut end = start + 3;
        while whole && joint(end) && digits(end + 1, 2) {
            end += 2;
        }
        (whole && end > start + 3).then_some(start..end)
    };
    (0..=i).filter_map(of).find(|range| range.contains(&i))
}

#[cfg(test)]
#[path = "names_tests.rs"]
mod tests;
