//! Names split into numbers and the texts between them. Numbers are whole as in `t10`, decimal as in `t0.25` or
//! `t1e-3`, negative as in `t-1` beside `t1`.

use std::cmp::Ordering;
use std::ops::Range;

/// A number in a name: its sign, its digits, those after a decimal point, and a power of ten.
#[derive(Clone, Copy, Debug)]
struct NumberInName<'a> {
    negative: bool,
    whole: &'a str,
    fraction: &'a str,
    exponent: i64,
}

impl NumberInName<'_> {
    /// -1, 0 or 1.
    fn sign(&self) -> i8 {
        let zero = self.digits().all(|d| d == b'0');
        if zero { 0 } else { 1 - 2 * i8::from(self.negative) }
    }

    fn digits(&self) -> impl Iterator<Item = u8> {
        self.whole.bytes().chain(self.fraction.bytes())
    }

    /// Position of the decimal point after the first digit that is not 0, and the digits from there on.
    fn significant(&self) -> (i64, impl Iterator<Item = u8>) {
        let zeros = self.digits().take_while(|d| *d == b'0').count();
        (self.whole.len() as i64 - zeros as i64 + self.exponent, self.digits().skip(zeros))
    }

    fn cmp(&self, other: &Self) -> Ordering {
        let sign = self.sign();
        sign.cmp(&other.sign()).then_with(|| match sign {
            0 => Ordering::Equal,
            1 => self.cmp_size(other),
            _ => other.cmp_size(self),
        })
    }

    /// Compares numbers that are not 0, without their signs.
    fn cmp_size(&self, other: &Self) -> Ordering {
        let ((point, mut a), (others, mut b)) = (self.significant(), other.significant());
        point.cmp(&others).then_with(|| {
            loop {
                match (a.next(), b.next()) {
                    (None, None) => return Ordering::Equal,
                    (x, y) if x.unwrap_or(b'0') == y.unwrap_or(b'0') => {}
                    (x, y) => return x.unwrap_or(b'0').cmp(&y.unwrap_or(b'0')),
                }
            }
        })
    }
}

/// One piece of a name: a number, or the text between two.
#[derive(Clone, Copy, Debug)]
pub struct NamePiece<'a> {
    /// The piece as written.
    pub text: &'a str,
    number: Option<NumberInName<'a>>,
}

impl<'a> NamePiece<'a> {
    /// The digits of a whole number without a sign.
    pub fn digits(&self) -> Option<&'a str> {
        let plain = |n: &NumberInName<'a>| !n.negative && n.whole.len() == self.text.len();
        self.number.filter(plain).map(|n| n.whole)
    }

    /// Whether it is a number.
    pub fn is_number(&self) -> bool {
        self.number.is_some()
    }

    /// The value of a whole number, and the number of its digits.
    pub fn whole(&self) -> Option<(i128, usize)> {
        let number = self.number.filter(|n| n.fraction.is_empty() && n.exponent == 0)?;
        // numbers beyond 64 bits are no steps
        let value = i128::from(number.whole.parse::<u64>().ok()?);
        Some((if number.negative { -value } else { value }, number.whole.len()))
    }

    /// Orders numbers by value, before texts.
    pub fn cmp(&self, other: &Self) -> Ordering {
        match (&self.number, &other.number) {
            (None, None) => self.text.cmp(other.text),
            (Some(_), None) => Ordering::Less,
            (None, Some(_)) => Ordering::Greater,
            (Some(a), Some(b)) => a.cmp(b),
        }
    }
}

/// Splits a text into alternating texts and whole numbers; the first piece is a text, which may be empty.
fn pieces(text: &str) -> Vec<NamePiece<'_>> {
    let (mut found, mut rest, mut digits) = (Vec::new(), text, false);
    while !rest.is_empty() || found.is_empty() {
        let end = rest.bytes().position(|b| b.is_ascii_digit() != digits).unwrap_or(rest.len());
        let (text, tail) = rest.split_at(end);
        let number = NumberInName { negative: false, whole: text, fraction: "", exponent: 0 };
        found.push(NamePiece { text, number: digits.then_some(number) });
        (rest, digits) = (tail, !digits);
    }
    found
}

/// The position of the last two numbers joined by a point, unless a third is joined to them as in `1.2.10`.
fn joined(name: &[NamePiece<'_>]) -> Option<usize> {
    let is_point = |i: usize| name.get(i).is_some_and(|p| p.text == ".");
    let ends_in_point = |i: usize| name.get(i).is_some_and(|p| p.text.ends_with('.'));
    let pair = |&i: &usize| name[i].digits().is_some() && is_point(i + 1) && name.get(i + 2).is_some();
    let alone = |&i: &usize| !is_point(i + 3) && !i.checked_sub(1).is_some_and(ends_in_point);
    (0..name.len()).rev().find(pair).filter(alone)
}

/// The position of a number and the exponent that follows it: `1e-3`, or with a decimal point `1.5e3`; `s01e02` has
/// none.
fn power(name: &[NamePiece<'_>]) -> Option<(usize, i64)> {
    (1..name.len().saturating_sub(2)).find_map(|i| {
        let sign = match name[i + 1].text {
            "e-" | "E-" => -1,
            "e+" | "E+" => 1,
            "e" | "E" if joined(&name[..=i]).is_some_and(|at| at + 2 == i) || name[i].text.contains('.') => 1,
            _ => return None,
        };
        let size: i64 = name[i + 2].digits().filter(|d| d.len() <= 4)?.parse().ok()?;
        name[i].number.is_some().then_some((i, sign * size))
    })
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
fn reading(names: &[Vec<NamePiece<'_>>]) -> Reading {
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

/// The name with the pieces in `range` as one, which is this number.
fn merge<'a>(stem: &'a str, name: &mut Vec<NamePiece<'a>>, range: Range<usize>, number: NumberInName<'a>) {
    let length = |pieces: &[NamePiece<'_>]| pieces.iter().map(|p| p.text.len()).sum::<usize>();
    let (start, size) = (length(&name[..range.start]), length(&name[range.clone()]));
    name.splice(range, [NamePiece { text: &stem[start..start + size], number: Some(number) }]);
}

/// The names in pieces, with each decimal number as one piece, as `decimal` says or else as can be told from the names;
/// and two names whose order is unclear, if any.
pub fn split(stems: &[String], decimal: Option<bool>) -> (Vec<Vec<NamePiece<'_>>>, Option<[usize; 2]>) {
    let mut names: Vec<_> = stems.iter().map(|s| pieces(s)).collect();
    let powers = names.iter().any(|name| power(name).is_some());
    let (decimal, unclear) = match decimal {
        Some(decimal) => (decimal, None),
        None if powers => (true, None),
        None => match reading(&names) {
            Reading::Whole => (false, None),
            Reading::Decimal => (true, None),
            Reading::Unclear(pair) => (true, Some(pair)),
        },
    };
    for (stem, name) in stems.iter().zip(&mut names) {
        if let Some(i) = joined(name).filter(|_| decimal)
            && let (Some(whole), Some(fraction)) = (name[i].digits(), name[i + 2].digits())
        {
            merge(stem, name, i..i + 3, NumberInName { negative: false, whole, fraction, exponent: 0 });
        }
        while let Some((i, exponent)) = power(name)
            && let Some(number) = name[i].number
        {
            merge(stem, name, i..i + 3, NumberInName { exponent: number.exponent + exponent, ..number });
        }
    }
    signs(stems, &mut names);
    (names, unclear)
}

/// Reads a dash before a number as its sign where other names have none there: `t-1`, `t0`. Else it is a separator.
fn signs<'a>(stems: &'a [String], names: &mut [Vec<NamePiece<'a>>]) {
    let Some(count) = names.first().map(Vec::len).filter(|n| names.iter().all(|name| name.len() == *n)) else { return };
    for i in (1..count).filter(|i| i % 2 == 1) {
        let bare = |name: &[NamePiece<'a>]| {
            let text = name[i - 1].text;
            text.strip_suffix(['-', '+']).unwrap_or(text)
        };
        let first = names[0][i - 1].text;
        let alike = names.iter().all(|name| bare(name) == bare(&names[0]));
        if !alike || names.iter().all(|name| name[i - 1].text == first) {
            continue;
        }
        for (stem, name) in stems.iter().zip(names.iter_mut()) {
            let Some(number) = name[i].number else { continue };
            let (before, text) = (bare(name).len(), name[i - 1].text);
            name[i - 1].text = &text[..before];
            let start = name[..i].iter().map(|p| p.text.len()).sum::<usize>();
            let end = start + text.len() - before + name[i].text.len();
            name[i] = NamePiece {
                text: &stem[start..end],
                number: Some(NumberInName { negative: text[before..].starts_with('-'), ..number }),
            };
        }
    }
}
