//! CSV fields (RFC 4180).

use std::borrow::Cow;

/// Returns `text` as a field, quoted if it holds a comma, a quote, a line break or outer whitespace.
#[must_use]
pub fn field(text: &str) -> Cow<'_, str> {
    if text.contains([',', '"', '\n', '\r']) || text.trim() != text {
        Cow::Owned(format!("\"{}\"", text.replace('"', "\"\"")))
    } else {
        Cow::Borrowed(text)
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
        ] {
            assert_eq!(field(text), expected);
        }
    }
}
