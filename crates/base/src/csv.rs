//! CSV fields (RFC 4180).

use std::borrow::Cow;

/// Returns `text` as a field, quoted if it holds a comma, a quote, a line break or outer whitespace. A text that a
/// spreadsheet would take for a formula gets an apostrophe in front, by which spreadsheets know text; numbers do not.
pub fn field(text: &str) -> Cow<'_, str> {
    let formula = text.starts_with(['=', '+', '-', '@', '\t', '\r']) && text.parse::<f64>().is_err();
    let text = if formula { Cow::Owned(format!("'{text}")) } else { Cow::Borrowed(text) };
    if text.contains([',', '"', '\n', '\r']) || text.trim() != text {
        Cow::Owned(format!("\"{}\"", text.replace('"', "\"\"")))
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::field;

    #[test]
    fn special_characters_are_quoted() {
        for (text, expected) in [
            ("grey-2", "grey-2"),
            ("", ""),
            ("a b", "a b"),
            ("a,b", "\"a,b\""),
            ("a\nb", "\"a\nb\""),
            (" x", "\" x\""),
            ("an \"x\"", "\"an \"\"x\"\"\""),
            ("=cmd|' /C calc'!A0", "'=cmd|' /C calc'!A0"),
            ("@SUM(1,2)", "\"'@SUM(1,2)\""),
            ("-dash", "'-dash"),
            ("-0.5", "-0.5"),
            ("+1e-3", "+1e-3"),
        ] {
            assert_eq!(field(text), expected);
        }
    }
}
