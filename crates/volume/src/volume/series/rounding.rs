//! What the conversion of stored numbers to single precision loses.

use crate::volume::grid::ScalarType;

/// Whole numbers up to here are exact in single precision.
const EXACT: f64 = 16_777_216.0;

/// Number of different values below which a field looks stepped: that of 8 bits.
const FEW: f64 = 256.0;

/// What is lost of values of a type in `range`, for users, where that matters: whole numbers are no longer exact, or
/// fewer than [`FEW`] different values remain.
pub fn lost(scalar: ScalarType, [low, high]: [f32; 2]) -> Option<String> {
    let most = low.abs().max(high.abs());
    let largest = f64::from(most);
    // half the distance to the next number
    let error = 0.5 * (f64::from(most.next_up()) - largest);
    let few = high > low && f64::from(high) - f64::from(low) < 2.0 * error * FEW;
    let inexact = scalar.is_whole() && largest > EXACT;
    let name = scalar.name();
    let lost = format!("values of {name} up to {largest} are rounded to single precision, by at most {error}");
    match (few, inexact) {
        (true, _) => Some(format!(
            "{lost}, which is much for a range of {low} to {high}; subtract a constant, or scale them, before they are \
             saved"
        )),
        (false, true) => Some(lost),
        (false, false) => None,
    }
}
