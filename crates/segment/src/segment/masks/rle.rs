//! The compressed text form of run lengths that COCO files use.
//!
//! Each count, from the fourth on minus the count two before it, is written in groups of five bits, low group first. A
//! group is one character: 48 plus the bits plus 32 if more groups follow; the last group's top bit is the sign.
//! Nothing here knows image sizes: whether the counts fit an image is checked by
//! [`Mask::from_counts`](super::Mask::from_counts).

use thiserror::Error;

/// Groups of five bits that a count or difference may need: 35 bits hold any difference of two `u32`.
const MAX_GROUPS: usize = 7;

/// What can be wrong with a compressed counts string.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum RleError {
    /// A character outside `'0'..='o'`.
    #[error("RLE counts: byte {byte:#04x} at position {position} is not one of '0' to 'o'")]
    Character {
        /// Byte offset in the string.
        position: usize,
        /// The byte found.
        byte: u8,
    },
    /// The string ends within a number.
    #[error("RLE counts: the string is cut off within a number")]
    Truncated,
    /// A number of too many characters.
    #[error("RLE counts: the number ending at position {position} is longer than {MAX_GROUPS} characters")]
    TooLong {
        /// Byte offset of the group over the limit.
        position: usize,
    },
    /// A count below zero or past `u32`.
    #[error("RLE counts: count {index} decodes to {value}, outside 0 to 2^32 - 1")]
    OutOfRange {
        /// Which count.
        index: usize,
        /// What it came out as.
        value: i64,
    },
}

/// Writes run lengths as COCO's compressed string.
pub fn encode(counts: &[u32]) -> String {
    let mut text = String::with_capacity(counts.len() * 2);
    for (index, &count) in counts.iter().enumerate() {
        let mut rest = i64::from(count);
        if index > 2 {
            rest -= i64::from(counts[index - 2]);
        }
        loop {
            let group = (rest & 31) as u8;
            rest >>= 5;
            // The top bit of the last group is the sign, so what is left must equal its extension.
            let done = if group & 16 != 0 { rest == -1 } else { rest == 0 };
            text.push(char::from(48 + group + if done { 0 } else { 32 }));
            if done {
                break;
            }
        }
    }
    text
}

/// Reads COCO's compressed string back into run lengths.
///
/// # Errors
/// [`RleError`] on characters outside the alphabet, numbers cut off or too long, and counts outside `u32`.
pub fn decode(text: &str) -> Result<Vec<u32>, RleError> {
    let mut counts: Vec<u32> = Vec::new();
    let (mut value, mut groups) = (0_i64, 0_usize);
    for (position, byte) in text.bytes().enumerate() {
        if !(48..112).contains(&byte) {
            return Err(RleError::Character { position, byte });
        }
        if groups == MAX_GROUPS {
            return Err(RleError::TooLong { position });
        }
        let group = byte - 48;
        value |= i64::from(group & 31) << (5 * groups);
        groups += 1;
        if group & 32 != 0 {
            continue;
        }
        if group & 16 != 0 {
            value |= -1 << (5 * groups);
        }
        let index = counts.len();
        if index > 2 {
            value += i64::from(counts[index - 2]);
        }
        counts.push(u32::try_from(value).map_err(|_| RleError::OutOfRange { index, value })?);
        (value, groups) = (0, 0);
    }
    if groups > 0 {
        return Err(RleError::Truncated);
    }
    Ok(counts)
}

#[cfg(test)]
mod tests {
    use super::super::Mask;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn round_trip(counts in proptest::collection::vec(prop_oneof![any::<u32>(), 0_u32..400], 0..40)) {
            prop_assert_eq!(decode(&encode(&counts)), Ok(counts));
        }

        #[test]
        fn any_string_decodes_or_errs(text in any::<String>(), near in "[0-o]{0,60}") {
            let _ = decode(&text);
            let _ = decode(&near);
        }
    }

    /// Strings written by pycocotools 2.0.
    #[test]
    fn agrees_with_pycocotools() {
        let picture = |set: &dyn Fn(i32, i32) -> bool| {
            let rows: Vec<bool> = (0..30).flat_map(|y| (0..40).map(move |x| (x, y))).map(|(x, y)| set(x, y)).collect();
            Mask::from_rows(40, 30, &rows).unwrap()
        };
        let disc = picture(&|x, y| (x - 15).pow(2) + (y - 12).pow(2) < 64);
        let ring = picture(&|x, y| (49..169).contains(&((x - 20).pow(2) + (y - 15).pow(2))));
        for (mask, text, area, bbox) in [
            (&disc, "i77e04M2O0O2O000000000001N101N3Lg?", 193, [8, 5, 15, 15]),
            (
                &ring,
                "k79c04L4M2N2O0OCO00O20M050JO80H080H080H080H080H080H080H160K030N1001=101N2N3L4LY6",
                372,
                [8, 3, 25, 25],
            ),
            (&picture(&|_, _| true), "0`U1", 1200, [0, 0, 40, 30]),
            (&picture(&|_, _| false), "`U1", 0, [0; 4]),
        ] {
            assert_eq!(encode(&mask.counts), text);
            assert_eq!(decode(text).as_ref(), Ok(&mask.counts));
            assert_eq!((mask.area(), mask.bbox()), (area, bbox));
        }
        assert_eq!(encode(&[0, 100_000, 1, 59_999]), "0PeQ31omhN");
        assert_eq!(encode(&[5, 3, 500, 2, 7, 159_483]), "53d?Oc@igk4");
        assert_eq!(decode("53d?Oc@igk4"), Ok(vec![5, 3, 500, 2, 7, 159_483]));
        assert_eq!(decode("111000"), Ok(vec![1; 6]));
    }

    #[test]
    fn broken_strings_name_the_place() {
        assert_eq!(decode("0 1"), Err(RleError::Character { position: 1, byte: b' ' }));
        assert_eq!(decode("1P"), Err(RleError::Truncated));
        assert_eq!(decode("oooooooo0"), Err(RleError::TooLong { position: 7 }));
        assert!(matches!(decode("O"), Err(RleError::OutOfRange { index: 0, value: -1 })));
    }
}
