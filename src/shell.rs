//! Words of a command line as a shell reads them. Every command that a text offers to the reader names its paths by
//! [`path`], so that it can be copied wherever they lie.

use std::path::Path;

/// `text` as one word of a POSIX shell: as it is where nothing in it means anything there, else in single quotes.
#[must_use]
pub fn quote(text: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "_./:,=@%+-".contains(c);
    if !text.is_empty() && text.chars().all(plain) {
        text.to_owned()
    } else {
        format!("'{}'", text.replace('\'', r"'\''"))
    }
}

/// [`quote`] of a path.
#[must_use]
pub fn path(path: &Path) -> String {
    quote(&path.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_one_word_whatever_is_in_it() {
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
