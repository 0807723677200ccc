//! Parsers of the values given to edits.

use crate::volume::transfer::color::parse_hex;

/// Parses a colour, `#rrggbb`.
pub(super) fn colour(text: &str) -> Result<[f32; 3], String> {
    parse_hex(text).ok_or_else(|| {
        "expected a colour such as '#ff8800': red, green and blue, two hexadecimal digits each".to_owned()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours() {
        assert_eq!(colour("#ff0080"), Ok([1.0, 0.0, 128.0 / 255.0]));
        assert!(colour("orange").unwrap_err().contains("'#ff8800'"));
    }
}
