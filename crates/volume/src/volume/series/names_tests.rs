use super::*;
use proptest::prelude::*;

fn sorted(names: &[&str]) -> Vec<String> {
    let stems: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
    order(&stems).into_iter().map(|i| stems[i].clone()).collect()
}

fn unsorted(names: &[&str]) -> Option<String> {
    let stems: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
    let names = Names::from_stems(&stems);
    names.first_unsorted().map(|i| format!("{} {}", names.kind(i), names.written(i)))
}

#[test]
fn names_come_in_order_of_their_numbers_however_these_are_written() {
    for right in [
        ["t2", "t9", "t10", "t11"],
        ["t0.25", "t0.5", "t0.75", "t1"],
        ["t0.5", "t1", "t1.5", "t2"],
        ["t0.9", "t1.0", "t1.1", "t2.0"],
        ["t9.5", "t10.25", "t10.5", "t11.75"],
        // steps of a run, not decimal numbers
        ["run0.8", "run0.9", "run0.10", "run0.11"],
        ["v1.2.8", "v1.2.9", "v1.2.10", "v1.2.11"],
        ["run1.08", "run1.09", "run1.10", "run1.11"],
        ["2020-01-30", "2020-01-31", "2020-02-01", "2021-01-01"],
        ["w2020_12_31T18", "w2020_12_31T23", "w2021_01_01T00", "w2021_01_01T06"],
    ] {
        let mut names = right;
        for turn in 0..4 {
            names.rotate_left(1);
            names.swap(0, turn % 3 + 1);
            assert_eq!(sorted(&names), right, "{names:?}");
        }
        assert_eq!(unsorted(&right), None, "{right:?}");
        let [a, b, c, d] = right;
        assert!(unsorted(&[a, c, b, d]).is_some_and(|text| text.len() > 7), "{right:?}");
    }
}

fn unclear(names: &[&str]) -> Option<[String; 2]> {
    let stems: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
    Names::from_stems(&stems).unclear.map(|pair| pair.map(|i| stems[i].clone()))
}

/// Checks that names are in this order, beyond doubt, and whether their numbers are steps.
fn check_order(right: &[&str], steps: bool) {
    let mut names = right.to_vec();
    names.reverse();
    assert_eq!(sorted(&names), right);
    assert_eq!((unsorted(right), unclear(right)), (None, None), "{right:?}");
    let stems: Vec<String> = right.iter().map(|n| (*n).to_owned()).collect();
    // the number of each name is whole, so that a gap would show
    assert_eq!((0..right.len()).all(|i| last(&Names::from_stems(&stems), i).is_some()), steps, "{right:?}");
}

/// The whole number that orders name `i`, the last of several.
fn last(names: &Names<'_>, i: usize) -> Option<i128> {
    names.numbers(i).last().and_then(NamePiece::whole).map(|(value, _)| value)
}

#[test]
fn unpadded_steps_after_a_constant_number_come_in_order() {
    for right in [
        &["f128.3", "f128.6", "f128.9", "f128.12", "f128.15", "f128.18"][..],
        &["run01.1", "run01.3", "run01.5", "run01.7", "run01.9", "run01.11", "run01.13"],
        &["run1.8", "run1.9", "run1.10", "run1.12"],
    ] {
        check_order(right, true);
    }
}

#[test]
fn decimals_of_one_whole_part_stay_decimal() {
    for right in [
        &["t0.25", "t0.5", "t0.75"][..],
        &["t0.5", "t0.75"],
        &["t0.1", "t0.2", "t0.3", "t0.4", "t0.5", "t0.6", "t0.7", "t0.8", "t0.9", "t0.95"],
        &["t0.125", "t0.25", "t0.375", "t0.5", "t0.625", "t0.75", "t0.875"],
        // rounded
        &["t0.167", "t0.333", "t0.5", "t0.667", "t0.833"],
        // no steps, as these would not be padded to two digits beside one of one digit
        &["t0.05", "t0.1", "t0.2", "t0.5"],
        // beyond 128 bits
        &["t0.1111111111111111111111111111111111111111", "t0.3", "t0.4"],
    ] {
        check_order(right, false);
    }
}

#[test]
fn numbers_that_may_be_steps_or_decimal_are_unclear() {
    for (names, pair) in [
        (&["sim1.1", "sim1.2", "sim1.3", "sim1.11", "sim1.12"][..], ["sim1.3", "sim1.11"]),
        (&["sim1.1", "sim1.11", "sim1.12", "sim1.2", "sim1.3"], ["sim1.3", "sim1.11"]),
        (&["run1.9", "run1.11"], ["run1.9", "run1.11"]),
        // a gap in steps of 3; decimal numbers can look the same, as multiples of 2
        (&["f128.3", "f128.9", "f128.12"], ["f128.9", "f128.12"]),
        (&["t0.35", "t0.5", "t0.7", "t0.9"], ["t0.9", "t0.35"]),
    ] {
        assert_eq!(unclear(names).unwrap(), pair, "{names:?}");
    }
    assert_eq!(unclear(&["t0.9", "t1.11", "t1.2"]), None, "decimal, as the whole part varies");
}

#[test]
fn names_out_of_order_are_reported_as_written() {
    assert_eq!(unsorted(&["t0.5", "t0.25"]).unwrap(), "number 0.25");
    assert_eq!(unsorted(&["2020-02-01", "2020-01-31"]).unwrap(), "date 2020-01-31");
    assert_eq!(unsorted(&["t10", "t9"]).unwrap(), "number 9");
    assert_eq!(unsorted(&["a-1-2", "a-2-1", "a-1-1"]).unwrap(), "numbers 1-1");
    assert_eq!(unsorted(&["t1e-2", "t1e-3"]).unwrap(), "number 1e-3");
    assert_eq!(unsorted(&["t-1", "t0", "t-2"]).unwrap(), "number -2");
    assert_eq!(unsorted(&["d_20240201_0000", "d_20240131_2359"]).unwrap(), "date 20240131_2359");
    // the same step twice
    assert_eq!(unsorted(&["t1", "t01"]).unwrap(), "number 01");
}

#[test]
fn names_with_several_numbers_come_in_order_of_all_of_them() {
    for right in [
        &["sim_20240131_235900", "sim_20240201_000000", "sim_20240201_000100"][..],
        &["2024-01-31T23:59", "2024-02-01T00:00"],
        &["wrfout_d01_2024-01-31_23:59:00", "wrfout_d01_2024-02-01_00:00:00"],
        &["cycle01_step98", "cycle01_step99", "cycle02_step00", "cycle02_step01"],
        &["cycle9_step9", "cycle9_step10", "cycle10_step1"],
        &["run1_t0001", "run1_t0002", "run2_t0001", "run2_t0002"],
        &["10h58m", "10h59m", "11h00m"],
        &["t1e-3", "t2e-3", "t1e-2"],
        &["t9.5e-1", "t1.0e+0", "t1.05e0"],
        &["t-10", "t-2", "t-1", "t0", "t1"],
        &["t-0.5", "t-0.25", "t+0.0", "t0.75"],
        &["202401312359", "202402010000"],
        &["p000_of_100", "p050_of_100", "p100_of_100"],
        &["t0s900ms", "t1s000ms", "t1s100ms"],
        &["20240131-235900", "20240201-000000"],
        &["run2_t0009", "run2_t0010"],
        &["v1.2_t9", "v1.2_t10"],
        &["s01e09", "s01e10", "s02e01"],
        &["t-1", "t-2", "t-10"],
        &["t1", "t02", "t003", "t10"],
    ] {
        let mut names = right.to_vec();
        names.reverse();
        assert_eq!(sorted(&names), right);
        assert_eq!((unsorted(right), unclear(right)), (None, None), "{right:?}");
    }
}

#[test]
fn numbers_that_begin_again_are_known() {
    let again = |names: &[&str]| {
        let stems: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
        Names::from_stems(&stems).begins_again()
    };
    assert_eq!(again(&["cycle1_8", "cycle1_9", "cycle2_0"]), Some((2, false)));
    assert_eq!(again(&["run1/t0", "run1/t1", "run2/t0"]), Some((2, true)));
    assert_eq!(again(&["run1/t0", "run1/t1", "run2/t2"]), None);
    assert_eq!(again(&["20240131_235900", "20240201_000000"]), None);
    assert_eq!(again(&["t1", "t2"]), None);
}

#[test]
fn missing_steps_are_found_where_numbers_are_whole() {
    let missing = |names: &[&str]| {
        let stems: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
        Names::from_stems(&stems).missing().map(|m| (m.after, m.at, m.number))
    };
    assert_eq!(missing(&["t08", "t10", "t11"]), Some((0, 1..3, "09".to_owned())));
    assert_eq!(missing(&["t-3", "t-2", "t0", "t1"]), Some((1, 1..3, "-1".to_owned())));
    assert_eq!(missing(&["t-1", "t1", "t2"]), Some((0, 1..3, "0".to_owned())));
    assert_eq!(missing(&["c1_8", "c1_9", "c2_0", "c2_1"]), None);
    assert_eq!(missing(&["c1_7", "c1_9", "c2_0", "c2_1"]), Some((0, 3..4, "8".to_owned())));
    assert_eq!(missing(&["s1_125", "s2_250", "s4_500"]), Some((1, 3..6, "375".to_owned())));
    for none in [
        &["t0.25", "t0.5", "t1.5"][..],
        &["2020-01-31", "2020-02-01", "2020-02-09"],
        &["20240131", "20240201", "20240207"],
        &["e202411", "e202412", "e202501"],
        &["a", "b"],
        &["t1", "t99999999999999999999", "t99999999999999999999999"],
        &[],
    ] {
        assert_eq!(missing(none), None, "{none:?}");
    }
}

proptest! {
    /// Any numbers of any widths, between any texts: names are in the order of their tuples, whichever order they are
    /// given in, and lists in this order alone are in order.
    #[test]
    fn tuples_order_names(
        mut tuples in prop::collection::btree_set(prop::collection::vec(0u32..200, 3), 2..12),
        widths in prop::collection::vec(0usize..5, 3), texts in prop::collection::vec("[a-d]{1,3}[_-]?", 3),
        seed in any::<u64>(),
    ) {
        // the number of the second differs in none: a constant among them
        tuples = tuples.into_iter().map(|t| vec![t[0] % 3, 7, t[2]]).collect();
        let name = |t: &Vec<u32>| -> String {
            (0..3).map(|i| format!("{}{:0width$}", texts[i], t[i], width = widths[i])).collect()
        };
        let right: Vec<String> = tuples.iter().map(name).collect();
        let mut given = right.clone();
        let mut state = seed;
        for i in (1..given.len()).rev() {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            given.swap(i, (state >> 33) as usize % (i + 1));
        }
        let found: Vec<String> = order(&given).into_iter().map(|i| given[i].clone()).collect();
        prop_assert_eq!(&found, &right);
        prop_assert_eq!(Names::from_stems(&right).first_unsorted(), None);
        prop_assert_eq!(Names::from_stems(&given).first_unsorted().is_none(), given == right);
    }

    /// Numbers with signs, points and exponents are in order of their values.
    #[test]
    fn values_order_names(mut values in prop::collection::vec((-999i32..1000, -9i32..9), 2..9)) {
        let value = |(m, e): &(i32, i32)| f64::from(*m) * 10f64.powi(*e);
        // in every second name a point
        let name = |(i, (m, e)): (usize, &(i32, i32))| {
            let digits = format!("{:03}", m.unsigned_abs());
            let sign = if *m < 0 { "-" } else { "" };
            let (point, e) = if i % 2 == 0 { (format!("{}.{}", &digits[..1], &digits[1..]), e + 2) } else { (digits, *e) };
            format!("t{sign}{point}e{e:+03}")
        };
        values.sort_by(|a, b| value(a).total_cmp(&value(b)));
        values.dedup_by(|a, b| (value(a) - value(b)).abs() <= 1e-12 * value(a).abs());
        // signs are signs only where they differ
        prop_assume!(values.iter().any(|v| v.0 < 0) && values.iter().any(|v| v.0 >= 0));
        let right: Vec<String> = values.iter().enumerate().map(name).collect();
        let mut given = right.clone();
        given.reverse();
        let found: Vec<String> = order(&given).into_iter().map(|i| given[i].clone()).collect();
        prop_assert_eq!(&found, &right);
        prop_assert_eq!(Names::from_stems(&right).first_unsorted(), None);
    }
}

#[test]
fn any_names_are_put_in_an_order_and_found_in_it() {
    let letters = ["", "0", "1", "10", ".", "-", "a", "2020", "01", "é", "T", "/"];
    let mut state = 1u64;
    let mut next = |n: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 33) as usize % n
    };
    for _ in 0..2000 {
        let names: Vec<String> =
            (0..1 + next(5)).map(|_| (0..next(7)).map(|_| letters[next(letters.len())]).collect()).collect();
        let order = order(&names);
        let mut all = order.clone();
        all.sort_unstable();
        assert_eq!(all, (0..names.len()).collect::<Vec<_>>());
        let found = Names::from_stems(&names);
        if let Some(i) = found.first_unsorted() {
            assert!(!found.written(i).is_empty());
        }
        let _ = (found.missing(), found.begins_again(), found.are_uneven(), found.seconds());
        let _ = Names::whole(&names).first_unsorted();
    }
}
