//! Dates in the names of a series: `20240131_235900`, `2024-01-31T23:59`, `2024013123`, `202401`, in the Gregorian calendar.

use super::pieces::NamePiece;
use std::ops::Range;

/// Years that a date without separators may have: `00000101` is a step.
const YEARS: Range<i64> = 1000..3000;

/// The pieces that hold the date of each name, which must contain all that `varying` lists, and the seconds from
/// 1970-01-01 00:00 to each; `None` if one of the names has no date there.
pub fn dates(names: &[Vec<NamePiece<'_>>], varying: &[usize]) -> Option<(Range<usize>, Vec<i64>)> {
    let (&first, &last) = (varying.first()?, varying.last()?);
    let pieces = names.first()?.len();
    let read = |range: &Range<usize>| names.iter().map(|name| seconds(name, range.clone())).collect::<Option<Vec<_>>>();
    let ranges = (0..=first).flat_map(|start| (last + 1..=pieces).rev().map(move |end| start..end));
    ranges.into_iter().find_map(|range| read(&range).map(|seconds| (range, seconds))).or_else(|| months(names, varying))
}

/// As [`dates`], for years and months alone. A number of six digits is one only if the year changes, so that it can be
/// no step: `202412` is followed by `202501`.
fn months(names: &[Vec<NamePiece<'_>>], varying: &[usize]) -> Option<(Range<usize>, Vec<i64>)> {
    let &[at] = varying else { return None };
    let month = |name: &Vec<NamePiece<'_>>| {
        let digits = name[at].digits().filter(|d| d.len() == 6)?;
        Some((digits[..4].parse::<i64>().ok().filter(|y| YEARS.contains(y))?, month_of(&digits[4..])?))
    };
    let all: Vec<(i64, i64)> = names.iter().map(month).collect::<Option<_>>()?;
    let one_year = all.iter().all(|(year, _)| *year == all[0].0);
    (!one_year).then(|| (at..at + 1, all.into_iter().map(|(y, m)| 86_400 * days(y, m, 1)).collect()))
}

/// The date that the pieces in `range` hold from the first to the last.
fn seconds(name: &[NamePiece<'_>], range: Range<usize>) -> Option<i64> {
    let pieces = &name[range];
    let numbers: Vec<&str> = pieces.iter().step_by(2).map(NamePiece::digits).collect::<Option<_>>()?;
    let joints: Vec<&str> = pieces.iter().skip(1).step_by(2).map(|p| p.text).collect();
    // it ends with a number
    if joints.len() + 1 != numbers.len() {
        return None;
    }
    let lengths: Vec<usize> = numbers.iter().map(|n| n.len()).collect();
    let (date, time) = match lengths[..] {
        [10 | 12 | 14] => (0, 0),
        [8, ..] => (0, 1),
        [4, 2, 2, ..] => (2, 3),
        _ => return None,
    };
    let plain = |joint: &&str| matches!(*joint, "-" | "_" | "." | ":" | "T" | "t" | " ");
    let clock = |joint: &&str| plain(joint) || matches!(*joint, "h" | "m");
    if !(joints.iter().take(date + 1).all(plain) && joints.iter().skip(date + 1).all(clock)) {
        return None;
    }
    match (time, &lengths[time..]) {
        (0, _) | (_, [] | [2 | 4 | 6] | [2, 2] | [2, 2, 2]) => {}
        _ => return None,
    }
    let text = numbers.concat();
    let part = |from: usize| match text.get(from..from + 2) {
        Some(two) => two.parse::<i64>().ok(),
        None => Some(0),
    };
    let year = text.get(..4)?.parse::<i64>().ok().filter(|y| date > 0 || YEARS.contains(y))?;
    let (month, day) = (month_of(text.get(4..6)?)?, part(6)?);
    let first = days(year, month, 1);
    let next = if month == 12 { days(year + 1, 1, 1) } else { days(year, month + 1, 1) };
    let (hour, minute, second) = (part(8)?, part(10)?, part(12)?);
    let valid = (1..=next - first).contains(&day) && hour <= 24 && minute <= 59 && second <= 60;
    valid.then(|| 86_400 * (first + day - 1) + 3600 * hour + 60 * minute + second)
}

fn month_of(digits: &str) -> Option<i64> {
    digits.parse::<i64>().ok().filter(|m| (1..=12).contains(m))
}

/// Days from 1970-01-01 to a day of the Gregorian calendar.
fn days(year: i64, month: i64, day: i64) -> i64 {
    // years begin in March, so that the leap day is the last
    let (year, month) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    let leaps = year.div_euclid(4) - year.div_euclid(100) + year.div_euclid(400);
    365 * year + leaps + (153 * month + 2) / 5 + day - 1 - 719_468
}

#[cfg(test)]
mod tests {
    use super::super::names::Names;
    use super::*;
    use proptest::prelude::*;

    fn seconds_of(names: &[&str]) -> Option<Vec<i64>> {
        let stems: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
        Names::from_stems(&stems).seconds().map(<[i64]>::to_vec)
    }

    #[test]
    fn every_form_of_a_date_is_known() {
        for names in [
            ["sim_20240131_235900", "sim_20240201_000000", "sim_20240201_000100"],
            ["20240131-2359", "20240201-0000", "20240201-0001"],
            ["2024-01-31T23:59", "2024-02-01T00:00", "2024-02-01T00:01"],
            ["wrfout_d01_2024-01-31_23:59:00", "wrfout_d01_2024-02-01_00:00:00", "wrfout_d01_2024-02-01_00:01:00"],
            ["d01_2024_01_31_23_59_00", "d01_2024_02_01_00_00_00", "d01_2024_02_01_00_01_00"],
            ["v1.2_202401312359", "v1.2_202402010000", "v1.2_202402010001"],
            ["a20240131235900.b", "a20240201000000.b", "a20240201000001.b"],
            ["2024-01-31_235900", "2024-02-01_000000", "2024-02-01_000100"],
            ["20240131_23h59m00s", "20240201_00h00m00s", "20240201_00h01m00s"],
        ] {
            let found = seconds_of(&names).unwrap_or_else(|| panic!("{names:?}"));
            assert_eq!((found[0], found[1] - found[0]), (1_706_745_540, 60), "{names:?}");
            assert!(found[2] > found[1], "{names:?}");
        }
        assert_eq!(seconds_of(&["e_202412", "e_202501"]).unwrap()[1], 1_735_689_600);
        assert_eq!(seconds_of(&["2024-02-28", "2024-02-29", "2024-03-01"]).unwrap()[2] % 86_400, 0);
    }

    #[test]
    fn what_cannot_be_a_date_is_none() {
        for names in [
            ["t20241301", "t20241401"],
            ["t00000101", "t00000102"],
            ["2023-02-29", "2023-03-01"],
            ["1706745540", "1706745600"],
            ["e_202401", "e_202402"],
            ["20240131_000001_1", "20240131_000001_2"],
            ["p000_of_100", "p050_of_100"],
        ] {
            assert_eq!(seconds_of(&names), None, "{names:?}");
        }
    }

    proptest! {
        /// Days count up by one through every month and leap year.
        #[test]
        fn days_follow_each_other(year in 1i64..4000, month in 1i64..=12) {
            let next = if month == 12 { days(year + 1, 1, 1) } else { days(year, month + 1, 1) };
            let leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
            let length = match month { 2 if leap => 29, 2 => 28, 4 | 6 | 9 | 11 => 30, _ => 31 };
            prop_assert_eq!(next - days(year, month, 1), length);
            prop_assert_eq!(days(1970, 1, 1), 0);
        }
    }
}
