//! JSON that the program writes and reads again: records in files and in the headers of tensor files.
//!
//! Each carries the version of its format, [`FORMAT`], under the key `format`. The version is checked before anything
//! else, so that a file of another version is refused by name and never half understood. A file without a version is
//! refused as well.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Version of all these formats. It rises with each change after which a file means something else.
pub const FORMAT: u32 = 1;

/// Key of the version.
pub const KEY: &str = "format";

/// A record with the version of its format, as it is written.
#[derive(Debug, Serialize)]
pub struct Versioned<'a, T> {
    format: u32,
    #[serde(flatten)]
    record: &'a T,
}

/// A record has another version of its format, or none.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{KEY}: {problem}")]
pub struct OtherFormat {
    /// What was found instead, and what to do.
    pub problem: String,
}

/// Why a record cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum VersionedError {
    /// It is not JSON, or not of its type.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// It is of another version.
    #[error(transparent)]
    Format(#[from] OtherFormat),
}

impl<'a, T> Versioned<'a, T> {
    /// Marks a record with the version. It must be a struct: a map would read the version back as an entry.
    pub fn new(record: &'a T) -> Self {
        Self { format: FORMAT, record }
    }
}

/// Writes a record on one line.
///
/// # Errors
/// If it is no struct, or has no JSON form.
pub fn to_json(record: &impl Serialize) -> serde_json::Result<String> {
    serde_json::to_string(&Versioned::new(record))
}

/// Writes a record for files, which people read too.
///
/// # Errors
/// As [`to_json`].
pub fn to_json_pretty(record: &impl Serialize) -> serde_json::Result<Vec<u8>> {
    serde_json::to_vec_pretty(&Versioned::new(record))
}

/// Reads what [`to_json`] or [`to_json_pretty`] wrote.
///
/// # Errors
/// If it is of another version, is not JSON, or is not a `T`.
pub fn from_json<T: DeserializeOwned>(json: impl AsRef<[u8]>) -> Result<T, VersionedError> {
    #[derive(Deserialize)]
    struct Mark {
        format: Option<Value>,
    }
    let Mark { format } = serde_json::from_slice(json.as_ref())?;
    check(format.as_ref())?;
    Ok(serde_json::from_slice(json.as_ref())?)
}

/// Checks the version that a record states.
///
/// # Errors
/// If it is another one, or there is none.
pub fn check(found: Option<&Value>) -> Result<(), OtherFormat> {
    if found.is_some_and(|found| *found == FORMAT) {
        return Ok(());
    }
    let found = found.map_or_else(|| "missing".to_owned(), Value::to_string);
    let remedy = "use the version of the program that wrote it, or make it again with this one";
    Err(OtherFormat { problem: format!("is {found}, but this program reads {FORMAT}; {remedy}") })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn the_version_is_checked_before_anything_else() {
        let record = BTreeMap::from([("a".to_owned(), 0.1f32)]);
        let text = to_json(&record).unwrap();
        assert_eq!(text, r#"{"format":1,"a":0.1}"#);
        let read = |text: &str| from_json::<BTreeMap<String, f32>>(text);
        assert_eq!(read(&text).unwrap()["a"], 0.1);
        assert_eq!(read(std::str::from_utf8(&to_json_pretty(&record).unwrap()).unwrap()).unwrap()["a"], 0.1);
        for (text, found) in [
            (r#"{"a": "no number", "format": 2}"#, "format: is 2, but this program reads 1"),
            (r#"{"format": "1"}"#, r#"format: is "1", but"#),
            ("{}", "format: is missing, but this program reads 1; use the version of the program that wrote it"),
        ] {
            let error = read(text).unwrap_err();
            assert!(matches!(error, VersionedError::Format(_)) && error.to_string().starts_with(found), "{error}");
        }
        for text in ["", "[", "3", r#"{"format": 1, "a": "no number"}"#] {
            assert!(matches!(read(text), Err(VersionedError::Json(_))), "{text}");
        }
    }
}
