//! Quoting of command-line words for a shell. Every command suggested to the user formats its paths with [`path`], so
//! that it can be copied whatever they contain.

use std::path::Path;

/// Returns `text` as one word of a POSIX shell: unchanged if no character is special, or else in single quotes.
pub fn quote(text: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "_./:,=@%+-".contains(c);
    if !text.is_empty() && text.chars().all(plain) {
        text.to_owned()
    } else {
        format!("'{}'", text.replace('\'', r"'\''"))
    }
}

/// [`quote`] of a path.
pub fn path(path: &Path) -> String {
    quote(&path.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_path_becomes_one_word() {
        for (given, word) in [
            ("runs/a-1.b", "runs/a-1.b"),
            ("my run", "'my run'"),
            ("it's", r"'it'\''s'"),
            ("", "''"),
            ("$HOME", "'$HOME'"),
        ] {
            assert_eq!(path(Path::new(given)), word);
        }
    }
}
