//! Ranges of settings that several methods share.

/// Rejects the first of these keys that is 0.
pub(super) fn at_least_one(counts: &[(&str, usize)]) -> Result<(), String> {
    let found = counts.iter().find(|(_, value)| *value == 0);
    found.map_or(Ok(()), |(key, _)| Err(format!("{key} = 0: at least 1")))
}

/// Rejects the first of these keys that is not above 0.
pub(super) fn above_zero(values: &[(&str, f64)]) -> Result<(), String> {
    let found = values.iter().find(|(_, value)| value.is_nan() || *value <= 0.0);
    found.map_or(Ok(()), |(key, value)| Err(format!("{key} = {value:?}: above 0")))
}

/// Rejects the first of these keys that is below 0.
pub(super) fn not_negative(values: &[(&str, f64)]) -> Result<(), String> {
    let found = values.iter().find(|(_, value)| value.is_nan() || *value < 0.0);
    found.map_or(Ok(()), |(key, value)| Err(format!("{key} = {value:?}: 0 or above")))
}
