//! Parses text to JSON values, with errors that name the frame in which they occur. Knows no fields but `file_path`.
//! Used by `scan` alone.

use std::path::Path;

use serde_json::Value;

use super::error::DataError;

/// Parses JSON; numbers that JSON cannot represent (NaN, Infinity, 1e999) become null, so that the error can name the
/// frame and the field rather than a column.
pub(super) fn parse_lenient(path: &Path, text: &str) -> Result<Value, DataError> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    serde_json::from_str(text).or_else(|error| {
        null_for_non_finite(text)
            .and_then(|mended| serde_json::from_str(&mended).ok())
            .ok_or_else(|| syntax_error(path, text, &error))
    })
}

fn syntax_error(path: &Path, text: &str, error: &serde_json::Error) -> DataError {
    let before: usize = text.split_inclusive('\n').take(error.line().saturating_sub(1)).map(str::len).sum();
    let mut end = (before + error.column()).min(text.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    let begun = text[..end].matches("\"file_path\"").count();
    let (problem, hint) = if error.is_eof() {
        ("the file ends too early".to_owned(), "the file looks truncated; copy or export it again")
    } else {
        (format!("not JSON: {error}"), "correct the JSON there, or export the file again")
    };
    let (line, column, frame) = (error.line(), error.column(), begun.checked_sub(1));
    DataError::Syntax { path: path.to_owned(), frame, line, column, problem, hint: hint.to_owned() }
}

/// `text` with every bare word that parses as a non-finite number replaced by `null`; `None` if there is no such word.
fn null_for_non_finite(text: &str) -> Option<String> {
    let (mut out, mut changed, mut in_string, mut escaped) = (String::with_capacity(text.len()), false, false, false);
    let mut chars = text.char_indices().peekable();
    while let Some((start, c)) = chars.next() {
        if in_string || !is_word(c) {
            in_string = if in_string { escaped || c != '"' } else { c == '"' };
            escaped = in_string && c == '\\' && !escaped;
            out.push(c);
            continue;
        }
        let mut end = start + c.len_utf8();
        while let Some((i, c)) = chars.next_if(|(_, c)| is_word(*c)) {
            end = i + c.len_utf8();
        }
        let word = &text[start..end];
        let non_finite = word.parse::<f64>().is_ok_and(|x| !x.is_finite());
        changed |= non_finite;
        out.push_str(if non_finite { "null" } else { word });
    }
    changed.then_some(out)
}

fn is_word(c: char) -> bool {
    c.is_ascii_alphanumeric() || matches!(c, '+' | '-' | '.')
}
