//! Sections of the other methods, each with all settings of its method.

mod coordnet;
mod d3dgs;
mod fourdgs;
mod insitunet;
mod visnerf;

pub use coordnet::CoordNetConfig;
pub use d3dgs::D3dgsConfig;
pub use fourdgs::FourDgsConfig;
pub use insitunet::{AdversarialLoss, InSituNetConfig};
pub use visnerf::VisNerfConfig;

/// Rejects the first of these keys that is 0.
fn at_least_one(counts: &[(&str, usize)]) -> Result<(), String> {
    let found = counts.iter().find(|(_, value)| *value == 0);
    found.map_or(Ok(()), |(key, _)| Err(format!("{key} = 0: at least 1")))
}

/// Rejects the first of these keys that is not above 0.
fn above_zero(values: &[(&str, f64)]) -> Result<(), String> {
    let found = values.iter().find(|(_, value)| value.is_nan() || *value <= 0.0);
    found.map_or(Ok(()), |(key, value)| Err(format!("{key} = {value:?}: above 0")))
}

/// Rejects the first of these keys that is below 0.
fn not_negative(values: &[(&str, f64)]) -> Result<(), String> {
    let found = values.iter().find(|(_, value)| value.is_nan() || *value < 0.0);
    found.map_or(Ok(()), |(key, value)| Err(format!("{key} = {value:?}: 0 or above")))
}
