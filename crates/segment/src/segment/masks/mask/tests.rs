//! Tests of the run-length mask against plain pixel buffers.

use super::*;
use proptest::prelude::*;

fn image() -> impl Strategy<Value = (u32, u32, Vec<bool>, Vec<bool>)> {
    (1_u32..12, 1_u32..12).prop_flat_map(|(width, height)| {
        let size = (width * height) as usize;
        let rows = || proptest::collection::vec(any::<bool>(), size);
        (Just(width), Just(height), rows(), rows())
    })
}

proptest! {
    #[test]
    fn agrees_with_the_pixels((width, height, a, b) in image()) {
        let first = Mask::from_rows(width, height, &a).unwrap();
        let second = Mask::from_rows(width, height, &b).unwrap();
        first.validate().unwrap();
        prop_assert_eq!(&first.to_rows(), &a);
        let labels: Vec<u16> = a.iter().zip(&b).map(|(p, q)| u16::from(*p) + 2 * u16::from(*q)).collect();
        for (label, mask) in Mask::of_labels(width, height, &labels).unwrap() {
            mask.validate().unwrap();
            prop_assert_eq!(mask.to_rows(), labels.iter().map(|l| *l == label).collect::<Vec<_>>());
        }
        prop_assert_eq!(first.area(), a.iter().filter(|&&set| set).count() as u64);
        let both: Vec<bool> = a.iter().zip(&b).map(|(&p, &q)| p && q).collect();
        let expected = Mask::from_rows(width, height, &both).unwrap();
        prop_assert_eq!(first.intersection(&second).unwrap(), expected.clone());
        prop_assert_eq!(first.intersection_area(&second).unwrap(), expected.area());
        let union = a.iter().zip(&b).filter(|(p, q)| **p || **q).count();
        let iou = if union == 0 { 0.0 } else { expected.area() as f64 / union as f64 };
        prop_assert_eq!(first.iou(&second).unwrap(), iou);
        let [left, top, across, down] = first.bbox();
        let window = first.window(first.bbox());
        prop_assert_eq!(&Mask::from_window(width, height, first.bbox(), &window), &first);
        let mut seen = [u32::MAX, u32::MAX, 0, 0];
        for y in 0..height {
            for x in 0..width {
                let set = a[(y * width + x) as usize];
                prop_assert_eq!(first.contains(x, y), set);
                if set {
                    seen = [seen[0].min(x), seen[1].min(y), seen[2].max(x + 1), seen[3].max(y + 1)];
                }
            }
        }
        if seen[2] == 0 {
            prop_assert_eq!([left, top, across, down], [0; 4]);
        } else {
            prop_assert_eq!([left, top, left + across, top + down], seen);
        }
    }

    #[test]
    fn broken_counts_do_not_panic(counts in proptest::collection::vec(any::<u32>(), 0..9), width in 0_u32..9, height in 0_u32..9) {
        let mask = Mask { width, height, counts };
        let inside = mask.pixels().all(|pixel| pixel < width * height);
        prop_assert!(inside);
        prop_assert!(mask.area() <= u64::from(width * height));
        let _ = (mask.bbox(), mask.to_rows(), mask.contains(3, 3), mask.iou(&mask), mask.intersection(&mask));
    }
}

#[test]
fn column_order_and_first_run_of_zeros() {
    let mask = Mask::from_rows(3, 2, &[true, false, false, true, true, false]).unwrap();
    assert_eq!(mask.counts, [0, 2, 1, 1, 2]);
    assert_eq!(mask.pixels().collect::<Vec<_>>(), [0, 3, 4]);
}

#[test]
fn empty_runs_in_the_middle_are_allowed() {
    let split = Mask::from_counts(2, 3, vec![1, 2, 0, 2, 1]).unwrap();
    let whole = Mask::from_counts(2, 3, vec![1, 4, 1]).unwrap();
    assert_eq!(split.to_rows(), whole.to_rows());
    assert_eq!(split.intersection(&whole).unwrap(), whole);
}

#[test]
fn wrong_sizes_are_errors() {
    assert!(matches!(Mask::from_counts(2, 2, vec![5]), Err(MaskError::CountsSum { sum: 5, expected: 4, .. })));
    assert!(matches!(Mask::from_rows(2, 2, &[true]), Err(MaskError::BufferLength { .. })));
    assert!(matches!(Mask::empty(u32::MAX, 2), Err(MaskError::TooLarge { .. })));
    let (a, b) = (Mask::empty(2, 3).unwrap(), Mask::empty(3, 2).unwrap());
    assert!(matches!(a.iou(&b), Err(MaskError::SizeMismatch { .. })));
}
