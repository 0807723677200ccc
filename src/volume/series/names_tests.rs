use super::*;

fn sorted(names: &[&str]) -> Vec<String> {
    let stems: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
    order(&stems).into_iter().map(|i| stems[i].clone()).collect()
}

fn unsorted(names: &[&str]) -> Option<String> {
    let stems: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
    let names = Names::of(&stems);
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
    Names::of(&stems).unclear.map(|pair| pair.map(|i| stems[i].clone()))
}

/// Checks that names are in this order, beyond doubt, and whether their numbers are steps.
fn check_order(right: &[&str], steps: bool) {
    let mut names = right.to_vec();
    names.reverse();
    assert_eq!(sorted(&names), right);
    assert_eq!((unsorted(right), unclear(right)), (None, None), "{right:?}");
    let stems: Vec<String> = right.iter().map(|n| (*n).to_owned()).collect();
    assert_eq!(Names::of(&stems).steps().is_some(), steps, "{right:?}");
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
    // two series in two folders: the last number that varies begins again
    assert_eq!(unsorted(&["run1/t0", "run1/t1", "run2/t0"]).unwrap(), "number 0");
    assert_eq!(unsorted(&["a-1-1", "a-1-2", "a-2-1"]).unwrap(), "number 1");
}

#[test]
fn steps_are_whole_numbers_alone() {
    let steps = |names: &[&str]| {
        let stems: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
        Names::of(&stems).steps().map(|s| s.iter().map(|s| (s.value, s.at, s.width)).collect::<Vec<_>>())
    };
    assert_eq!(steps(&["t08", "t10"]), Some(vec![(8, 1, 2), (10, 1, 2)]));
    assert_eq!(steps(&["t0.5", "t0.25"]), None);
    assert_eq!(steps(&["2020-01-31", "2020-02-01"]), None);
    assert_eq!(steps(&["a", "b"]), None);
    assert_eq!(steps(&["t1", "t99999999999999999999"]), None);
    assert_eq!(steps(&[]), None);
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
        let found = Names::of(&names);
        if let Some(i) = found.first_unsorted() {
            assert!(!found.written(i).is_empty());
        }
        found.steps();
    }
}
