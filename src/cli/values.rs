//! Parsers of arguments that are numbers; they reject values that no command can use, above all NaN and infinities.

pub(super) use crate::numbers::*;
use crate::run::cameras::SIDE;
use glam::DVec3;

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
            assert!(pixels(bad).is_err() && point(&format!("0,{bad},0")).is_err(), "{bad}");
        }
        assert!(pixels("16385").is_err());
        for bad in ["1,2", "1,2,3,4", "1,,3", "1e300,0,0"] {
            assert!(point(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn numbers_are_read() {
        assert_eq!(pixels("800"), Ok(800));
        assert_eq!(point("3, -2,1.5"), Ok(DVec3::new(3.0, -2.0, 1.5)));
    }
}
