//! Parsers of numeric arguments; they reject values that no command can use, above all NaN and infinities.

use crate::run::cameras::SIDE;
use glam::DVec3;
use std::num::NonZero;

/// Parses a finite number for which `fits` holds; the error message is "expected" and `wanted`.
pub(super) fn number(text: &str, fits: impl Fn(f64) -> bool, wanted: &str) -> Result<f64, String> {
    let found = text.trim().parse::<f64>().ok().filter(|v| v.is_finite() && fits(*v));
    found.ok_or_else(|| format!("expected {wanted}"))
}

fn small(value: f64, wanted: &str) -> Result<f32, String> {
    let value = value as f32;
    if value.is_finite() { Ok(value) } else { Err(format!("expected {wanted}")) }
}

/// Parses a finite number.
pub(super) fn finite(text: &str) -> Result<f64, String> {
    number(text, |_| true, "a finite number")
}

/// Parses a finite number above 0.
pub(super) fn positive(text: &str) -> Result<f64, String> {
    number(text, |v| v > 0.0, "a finite number above 0")
}

/// Parses a finite number, 0 or above.
pub(super) fn not_negative(text: &str) -> Result<f64, String> {
    number(text, |v| v >= 0.0, "a finite number, 0 or above")
}

/// Parses a number in [0, 1], such as a time.
pub(super) fn fraction(text: &str) -> Result<f64, String> {
    number(text, |v| (0.0..=1.0).contains(&v), "a number between 0 and 1")
}

/// Parses a cosine, in [-1, 1].
pub(super) fn cosine(text: &str) -> Result<f64, String> {
    number(text, |v| (-1.0..=1.0).contains(&v), "a number between -1 and 1")
}

/// [`finite`] as `f32`.
pub(super) fn finite_f32(text: &str) -> Result<f32, String> {
    small(finite(text)?, "a finite number")
}

/// [`positive`] as `f32`.
pub(super) fn positive_f32(text: &str) -> Result<f32, String> {
    small(positive(text)?, "a finite number above 0")
}

/// [`not_negative`] as `f32`.
pub(super) fn not_negative_f32(text: &str) -> Result<f32, String> {
    small(not_negative(text)?, "a finite number, 0 or above")
}

/// [`fraction`] as `f32`.
pub(super) fn fraction_f32(text: &str) -> Result<f32, String> {
    fraction(text).map(|v| v as f32)
}

/// [`cosine`] as `f32`.
pub(super) fn cosine_f32(text: &str) -> Result<f32, String> {
    cosine(text).map(|v| v as f32)
}

/// Parses a whole number, at least 1.
pub(super) fn count(text: &str) -> Result<usize, String> {
    text.trim()
        .parse::<NonZero<usize>>()
        .map(NonZero::get)
        .map_err(|_| "expected a whole number, at least 1".to_owned())
}

/// Parses the width or height of an image in pixels.
pub(super) fn pixels(text: &str) -> Result<u32, String> {
    let found = text.trim().parse::<u32>().ok().filter(|n| (1..=SIDE).contains(n));
    found.ok_or_else(|| format!("expected a number of pixels from 1 to {SIDE}"))
}

/// Parses a point in space: three numbers separated by commas, each below 1e15.
pub(super) fn point(text: &str) -> Result<DVec3, String> {
    let wanted = "three finite numbers below 1e15, separated by commas, such as 3,-2,1.5";
    let numbers = text.split(',').map(|v| number(v, |v| v.abs() < 1e15, wanted)).collect::<Result<Vec<_>, _>>()?;
    <[f64; 3]>::try_from(numbers).map(DVec3::from_array).map_err(|_| format!("expected {wanted}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn non_numbers_are_refused_by_every_parser() {
        for bad in ["nan", "NaN", "inf", "-inf", "1e999", "", "x", "1,5"] {
            for parse in [finite, positive, not_negative, fraction, cosine] {
                assert!(parse(bad).is_err(), "{bad}");
            }
            for parse in [finite_f32, positive_f32, not_negative_f32, fraction_f32, cosine_f32] {
                assert!(parse(bad).is_err(), "{bad}");
            }
            assert!(count(bad).is_err() && pixels(bad).is_err() && point(&format!("0,{bad},0")).is_err(), "{bad}");
        }
        assert!(finite_f32("1e300").is_err() && positive("0").is_err() && not_negative("-1e-9").is_err());
        assert!(
            fraction("1.01").is_err() && cosine("-1.1").is_err() && count("0").is_err() && pixels("16385").is_err()
        );
        for bad in ["1,2", "1,2,3,4", "1,,3", "1e300,0,0"] {
            assert!(point(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn numbers_are_read() {
        assert_eq!((finite("-2.5"), positive("1e-3"), fraction("1")), (Ok(-2.5), Ok(1e-3), Ok(1.0)));
        assert_eq!((count("7"), pixels("800")), (Ok(7), Ok(800)));
        assert_eq!(point("3, -2,1.5"), Ok(DVec3::new(3.0, -2.0, 1.5)));
    }
}
