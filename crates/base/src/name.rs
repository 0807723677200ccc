//! User-given names that become parts of paths: segments, groups, tracks, datasets and runs of a sweep.

use serde::{Deserialize, Serialize};
use std::borrow::Borrow;
use std::fmt;
use std::ops::Deref;
use std::path::Path;
use std::str::FromStr;

/// Maximum length in bytes, so that a file named after it, temporary names included, fits every file system.
const MAX_LENGTH: usize = 100;

/// A name that is safe as one path component: letters, digits, `-`, `_` and `.`, not beginning with `.` or `-`.
///
/// It is validated on construction, so any `Name` can be joined to a folder.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Name(String);

/// A text that cannot be a [`Name`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "\"{0}\" cannot be a name: use letters, digits, -, _ and ., at most 100, and begin with a letter, a digit or _"
)]
pub struct NameError(String);

impl Name {
    /// # Errors
    /// If `text` is empty, longer than 100 bytes, begins with `.` or `-`, or holds any other character.
    pub fn new(text: impl Into<String>) -> Result<Self, NameError> {
        let text = text.into();
        let fits = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        let begins = text.starts_with(|c: char| c.is_ascii_alphanumeric() || c == '_');
        if begins && text.len() <= MAX_LENGTH && text.chars().all(fits) { Ok(Self(text)) } else { Err(NameError(text)) }
    }

    /// The name as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for Name {
    type Err = NameError;
    fn from_str(text: &str) -> Result<Self, NameError> {
        Self::new(text)
    }
}

impl TryFrom<String> for Name {
    type Error = NameError;
    fn try_from(text: String) -> Result<Self, NameError> {
        Self::new(text)
    }
}

impl From<Name> for String {
    fn from(name: Name) -> Self {
        name.0
    }
}

impl Deref for Name {
    type Target = str;
    fn deref(&self) -> &str {
        &self.0
    }
}

impl Borrow<str> for Name {
    fn borrow(&self) -> &str {
        &self.0
    }
}

impl AsRef<Path> for Name {
    fn as_ref(&self) -> &Path {
        Path::new(&self.0)
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.0)
    }
}

impl PartialEq<str> for Name {
    fn eq(&self, other: &str) -> bool {
        self.0 == other
    }
}

impl PartialEq<&str> for Name {
    fn eq(&self, other: &&str) -> bool {
        self.0 == *other
    }
}

impl PartialEq<String> for Name {
    fn eq(&self, other: &String) -> bool {
        self.0 == *other
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn hidden_and_unsafe_path_components_are_refused() {
        for bad in ["", ".", "..", "../up", "a/b", "/abs", "a\\b", ".hidden", "-x", "a b", "\u{e9}", "a\n", "a\0"] {
            assert!(Name::new(bad).is_err(), "{bad:?}");
            assert!(serde_json::from_value::<Name>(bad.into()).is_err(), "{bad:?}");
        }
        assert!(Name::new("x".repeat(101)).is_err());
        for good in ["red", "red.1", "dark-grey-2", "_", "7", &"x".repeat(100)] {
            assert_eq!(Name::new(good).unwrap().as_str(), good);
        }
    }

    proptest! {
        #[test]
        fn a_name_is_one_normal_part_of_a_path(text in "\\PC{0,12}") {
            if let Ok(name) = Name::new(text.as_str()) {
                let parts: Vec<_> = Path::new(name.as_str()).components().collect();
                prop_assert!(matches!(parts[..], [std::path::Component::Normal(_)]), "{parts:?}");
            }
        }
    }
}
