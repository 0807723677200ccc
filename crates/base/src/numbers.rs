//! Parsers of numbers given by users; they reject values that nothing can use, above all NaN and infinities. Each error
//! says what was expected.

use std::num::NonZero;

/// Parses a finite number for which `fits` holds; the error message is "expected" and `wanted`.
///
/// # Errors
/// If the text is no such number.
pub fn number(text: &str, fits: impl Fn(f64) -> bool, wanted: &str) -> Result<f64, String> {
    let found = text.trim().parse::<f64>().ok().filter(|v| v.is_finite() && fits(*v));
    found.ok_or_else(|| format!("expected {wanted}"))
}

fn small(value: f64, wanted: &str) -> Result<f32, String> {
    let value = value as f32;
    if value.is_finite() { Ok(value) } else { Err(format!("expected {wanted}")) }
}

/// Parses a finite number.
///
/// # Errors
/// If the text is no such number.
pub fn finite(text: &str) -> Result<f64, String> {
    number(text, |_| true, "a finite number")
}

/// Parses a finite number above 0.
///
/// # Errors
/// If the text is no such number.
pub fn positive(text: &str) -> Result<f64, String> {
    number(text, |v| v > 0.0, "a finite number above 0")
}

/// Parses a finite number, 0 or above.
///
/// # Errors
/// If the text is no such number.
pub fn not_negative(text: &str) -> Result<f64, String> {
    number(text, |v| v >= 0.0, "a finite number, 0 or above")
}

/// Parses a number in [0, 1], such as a time.
///
/// # Errors
/// If the text is no such number.
pub fn fraction(text: &str) -> Result<f64, String> {
    number(text, |v| (0.0..=1.0).contains(&v), "a number between 0 and 1")
}

/// Parses a cosine, in [-1, 1].
///
/// # Errors
/// If the text is no such number.
pub fn cosine(text: &str) -> Result<f64, String> {
    number(text, |v| (-1.0..=1.0).contains(&v), "a number between -1 and 1")
}

/// [`finite`] as `f32`.
///
/// # Errors
/// If the text is no such number.
pub fn finite_f32(text: &str) -> Result<f32, String> {
    small(finite(text)?, "a finite number")
}

/// [`positive`] as `f32`.
///
/// # Errors
/// If the text is no such number.
pub fn positive_f32(text: &str) -> Result<f32, String> {
    small(positive(text)?, "a finite number above 0")
}

/// [`not_negative`] as `f32`.
///
/// # Errors
/// If the text is no such number.
pub fn not_negative_f32(text: &str) -> Result<f32, String> {
    small(not_negative(text)?, "a finite number, 0 or above")
}

/// [`fraction`] as `f32`.
///
/// # Errors
/// If the text is no such number.
pub fn fraction_f32(text: &str) -> Result<f32, String> {
    fraction(text).map(|v| v as f32)
}

/// [`cosine`] as `f32`.
///
/// # Errors
/// If the text is no such number.
pub fn cosine_f32(text: &str) -> Result<f32, String> {
    cosine(text).map(|v| v as f32)
}

/// Parses a whole number, at least 1.
///
/// # Errors
/// If the text is no such number.
pub fn count(text: &str) -> Result<usize, String> {
    text.trim()
        .parse::<NonZero<usize>>()
        .map(NonZero::get)
        .map_err(|_| "expected a whole number, at least 1".to_owned())
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
            assert!(count(bad).is_err(), "{bad}");
        }
        assert!(finite_f32("1e300").is_err() && positive("0").is_err() && not_negative("-1e-9").is_err());
        assert!(fraction("1.01").is_err() && cosine("-1.1").is_err() && count("0").is_err());
    }

    #[test]
    fn numbers_are_read() {
        assert_eq!((finite("-2.5"), positive("1e-3"), fraction("1")), (Ok(-2.5), Ok(1e-3), Ok(1.0)));
        assert_eq!(count("7"), Ok(7));
    }
}
