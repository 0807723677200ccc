//! Tests of scores and matchings against sets worked out by hand and by brute force.

use super::*;
use proptest::prelude::*;

#[test]
fn dice_and_iou_of_known_sets() {
    let truth = [1u16, 1, 1, 2, 2, 0, 0, 4];
    let predicted = [1u16, 1, 2, 2, 0, 0, 3, 0];
    let table = Confusion::new(&truth, &predicted).unwrap();
    let scores = [1, 2, 3, 4].map(|l| table.overlap(l, l)).map(|o| (o.dice(), o.iou()));
    assert_eq!(scores, [(0.8, 2.0 / 3.0), (0.5, 1.0 / 3.0), (0.0, 0.0), (0.0, 0.0)]);
    assert_eq!(Overlap::default().dice(), 1.0);
    assert_eq!(Confusion::new::<u8>(&[], &[]).unwrap().match_sets(), []);
    let error = Confusion::new(&[1u32], &[]).unwrap_err();
    assert_eq!(error, LengthError { truth: 1, predicted: 0 });
}

#[test]
fn tables_of_two_halves_make_that_of_the_whole() {
    let (truth, predicted) = ([1u8, 1, 0, 2, 2, 1], [4u8, 0, 3, 4, 4, 4]);
    let mut sum = Confusion::new(&truth[..2], &predicted[..2]).unwrap();
    sum.merge(&Confusion::new(&truth[2..], &predicted[2..]).unwrap());
    assert_eq!(sum, Confusion::new(&truth, &predicted).unwrap());
}

#[test]
fn pieces_of_an_object_are_matched_together() {
    // Label 1 is split into 5 and 6; 7 lies mostly outside it; 8 is elsewhere.
    let truth = [[1u8; 10].as_slice(), &[0; 10], &[2; 4]].concat();
    let predicted = [[5u8; 5].as_slice(), &[6; 4], &[7; 10], &[0], &[8; 4]].concat();
    let table = Confusion::new(&truth, &predicted).unwrap();
    let sets = table.match_sets();
    assert_eq!((sets[0].truth, sets[0].predicted.as_slice()), (1, [5, 6].as_slice()));
    assert_eq!(sets[0].overlap, Overlap { truth: 10, predicted: 9, both: 9 });
    assert_eq!((sets[1].predicted.as_slice(), sets[1].overlap.dice()), ([8].as_slice(), 1.0));
    let ones = table.match_one_to_one();
    assert_eq!(ones[0].predicted, [5]);
    assert_eq!(ones[1].predicted, [8]);
    assert_eq!(mean_dice(&ones), Some((10.0 / 15.0 + 1.0) / 2.0));
}

#[test]
fn one_to_one_gives_up_a_good_pair_for_a_better_sum() {
    // Both true labels overlap 5 best, but only 1 has a second choice.
    let truth = [1u8, 1, 1, 1, 1, 2, 2, 2];
    let predicted = [5u8, 5, 5, 6, 6, 5, 5, 5];
    let ones = Confusion::new(&truth, &predicted).unwrap().match_one_to_one();
    assert_eq!((ones[0].predicted.as_slice(), ones[1].predicted.as_slice()), ([6].as_slice(), [5].as_slice()));
    let lost = Confusion::new(&[1u8, 2], &[5, 5]).unwrap().match_one_to_one();
    assert_eq!(lost.iter().filter(|m| m.predicted.is_empty()).count(), 1);
}

#[test]
fn no_labels_have_no_mean() {
    assert_eq!(mean_dice(&[]), None);
}

proptest! {
    #[test]
    fn the_chosen_set_is_the_best_of_all(pairs in prop::collection::vec((0u8..3, 0u8..7), 1..60)) {
        let (truth, predicted): (Vec<u8>, Vec<u8>) = pairs.into_iter().unzip();
        for found in Confusion::new(&truth, &predicted).unwrap().match_sets() {
            let score = |set: u32| {
                let chosen = |p: u8| p > 0 && set & (1 << p) != 0;
                let mut o = Overlap::default();
                for (&t, &p) in truth.iter().zip(&predicted) {
                    o.truth += u64::from(u32::from(t) == found.truth);
                    o.predicted += u64::from(chosen(p));
                    o.both += u64::from(chosen(p) && u32::from(t) == found.truth);
                }
                o
            };
            let own = found.predicted.iter().fold(0, |set, p| set | 1 << p);
            prop_assert_eq!(score(own), found.overlap);
            let best = (0..128).map(|set| score(set).dice()).fold(0.0, f64::max);
            prop_assert!((found.overlap.dice() - best).abs() < 1e-12);
        }
    }

    #[test]
    fn renaming_labels_does_not_change_scores(labels in prop::collection::vec(0u16..9, 1..200)) {
        let renamed: Vec<u16> = labels.iter().map(|&l| if l == 0 { 0 } else { 100 - l }).collect();
        let table = Confusion::new(&labels, &renamed).unwrap();
        for matches in [table.match_sets(), table.match_one_to_one()] {
            prop_assert!(matches.iter().all(|m| m.overlap.dice() == 1.0 && m.predicted == [100 - m.truth]));
        }
    }
}
