//! Parsers of the values given to edits.

use crate::volume::transfer::color::parse_hex;

/// Parses a colour, `#rrggbb`.
pub(super) fn colour(text: &str) -> Result<[f32; 3], String> {
    parse_hex(text).ok_or_else(|| {
        "expected a colour such as '#ff8800': red, green and blue, two hexadecimal digits each".to_owned()
    })
}

/// Parses three finite numbers separated by commas.
pub(super) fn point(text: &str) -> Result<[f32; 3], String> {
    super::super::values::point(text).map(|p| p.as_vec3().to_array())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_and_colours() {
        assert_eq!(point("-1, 0.5,2e-1"), Ok([-1.0, 0.5, 0.2]));
        for bad in ["", "1,2", "1,2,3,4", "1,,3", "a,b,c", "nan,0,0", "0,inf,0", "1e99,0,0"] {
            assert!(point(bad).is_err(), "{bad}");
        }
        assert_eq!(colour("#ff0080"), Ok([1.0, 0.0, 128.0 / 255.0]));
        assert!(colour("orange").unwrap_err().contains("'#ff8800'"));
    }
}
