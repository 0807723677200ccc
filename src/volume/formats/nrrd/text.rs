//! The text of an NRRD header: lines to fields, and the names of the data files. What fields mean is not decided here.

use crate::volume::error::VolumeError;
use std::collections::{BTreeMap, HashSet};
use std::path::Path;

/// Fields of the standard that say nothing about where voxels are or how they are stored.
const UNUSED: [&str; 19] = [
    "content",
    "thicknesses",
    "axismins",
    "axismaxs",
    "centers",
    "centerings",
    "labels",
    "units",
    "spaceunits",
    "sampleunits",
    "min",
    "max",
    "oldmin",
    "oldmax",
    "number",
    "blocksize",
    "measurementframe",
    "space",
    "spacedimension",
];

/// Fields that the reader uses.
const USED: [&str; 11] = [
    "type",
    "dimension",
    "sizes",
    "encoding",
    "endian",
    "spacings",
    "spacedirections",
    "spaceorigin",
    "kinds",
    "lineskip",
    "byteskip",
];

/// Longest name of a data file in a pattern, bytes: one header must not make gigabytes of names.
const MAX_NAME: usize = 4096;

/// Most bytes of all names that a pattern makes.
const MAX_NAMES: usize = 1 << 26;

/// Most files that one header may name.
const MAX_FILES: usize = 1 << 20;

/// A header as text.
#[derive(Debug, Default)]
pub struct Text {
    /// Values by field name in lower case without blanks.
    fields: BTreeMap<String, String>,
    /// Names of the data files; empty where the data follow the header.
    pub files: Vec<String>,
    /// Bytes of the header with the blank line that ends it; `None` where no blank line was found.
    pub end: Option<u64>,
    /// Fields passed over.
    pub notes: Vec<String>,
}

impl Text {
    /// Splits the start of a file into fields.
    ///
    /// # Errors
    /// No NRRD magic, a line that is no field, a field given twice, or a list of data files that is no list.
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self, VolumeError> {
        let bad = |field: String, problem: String, hint: &str| VolumeError::invalid(path, field, problem, hint);
        let mut text = Self::default();
        let (mut at, mut listing) = (0usize, false);
        for (number, raw) in bytes.split_inclusive(|&b| b == b'\n').enumerate() {
            at += raw.len();
            let line = raw.strip_suffix(b"\n").unwrap_or(raw);
            let line = line.strip_suffix(b"\r").unwrap_or(line);
            if number == 0 {
                let known = matches!(line, [b'N', b'R', b'R', b'D', b'0', b'0', b'0', b'1'..=b'5']);
                if !known {
                    let problem = "does not start with NRRD0001 to NRRD0005".to_owned();
                    return Err(bad("magic".into(), problem, "write it again as NRRD"));
                }
                continue;
            }
            if line.is_empty() {
                text.end = Some(at as u64);
                break;
            }
            let line = String::from_utf8_lossy(line);
            if listing {
                text.files.push(line.trim().to_owned());
                continue;
            }
            if line.starts_with('#') {
                continue;
            }
            let Some((name, value)) = line.split_once(':') else {
                let problem = "is no comment, field or key".to_owned();
                return Err(bad(format!("line {}", number + 1), problem, "write \"field: value\", or start it with #"));
            };
            if value.starts_with('=') {
                continue;
            }
            let key: String = name.to_ascii_lowercase().split_whitespace().collect();
            let value = value.trim().to_owned();
            if key == "datafile" {
                if !text.files.is_empty() {
                    return Err(bad("data file".into(), "is given twice".into(), "remove one of them"));
                }
                listing = value.split_whitespace().next() == Some("LIST");
                if !listing {
                    text.files = pattern(&value).map_err(|p| bad("data file".into(), p, "as in %03d.raw 0 9 1"))?;
                }
            } else if USED.contains(&key.as_str()) {
                if text.fields.insert(key, value).is_some() {
                    return Err(bad(name.trim().to_owned(), "is given twice".into(), "remove one of them"));
                }
            } else if !UNUSED.contains(&key.as_str()) {
                text.notes.push(format!("unknown field \"{}\" ignored", name.trim()));
            }
        }
        let mut names = HashSet::new();
        if let Some(twin) = text.files.iter().find(|name| !names.insert(name.as_str())) {
            let problem = format!("names \"{}\" twice", twin.chars().take(80).collect::<String>());
            return Err(bad("data file".into(), problem, "name each file once"));
        }
        if listing && text.files.is_empty() {
            return Err(bad("data file".into(), "LIST is followed by no name".into(), "name one file a line"));
        }
        Ok(text)
    }

    /// The value of a field, by its name in lower case without blanks.
    #[must_use]
    pub fn get(&self, key: &str) -> Option<&str> {
        self.fields.get(key).map(String::as_str)
    }

    /// The value of a field that must be there.
    ///
    /// # Errors
    /// It is not.
    pub fn need(&self, path: &Path, key: &str) -> Result<&str, VolumeError> {
        self.get(key).ok_or_else(|| {
            VolumeError::invalid(path, key, "is not given", format!("add a line \"{key}: ...\" to the header"))
        })
    }
}

/// The file names of a `data file` value: one name, or a pattern `%03d.raw MIN MAX STEP [SUBDIM]`.
fn pattern(value: &str) -> Result<Vec<String>, String> {
    let last = value.split_whitespace().rev().map_while(|w| w.parse::<i64>().ok());
    let mut numbers: Vec<i64> = last.take(4).collect();
    numbers.reverse();
    let conversion = value.split_once('%').and_then(|(before, rest)| {
        let (width, _) = rest.split_once('d')?;
        let digits = width.len() <= 2 && width.bytes().all(|b| b.is_ascii_digit());
        digits.then(|| (before, width, &rest[width.len() + 1..]))
    });
    let (Some((before, width, after)), &[min, max, step, ..]) = (conversion, numbers.as_slice()) else {
        return if value.is_empty() { Err("is empty".into()) } else { Ok(vec![value.to_owned()]) };
    };
    // What follows the conversion still holds the numbers at its end.
    let name_end = numbers.iter().rev().try_fold(after, |rest, n| {
        let rest = rest.trim_end();
        let cut = rest.rfind(char::is_whitespace)?;
        rest[cut..].trim().parse().is_ok_and(|m: i64| m == *n).then(|| rest[..cut].trim_end())
    });
    let after = name_end.ok_or("is neither a name nor a pattern with its numbers")?;
    let span = i128::from(max) - i128::from(min);
    if step == 0 || span.signum() * i128::from(step.signum()) < 0 {
        return Err(format!("the step {step} does not lead from {min} to {max}"));
    }
    let count = usize::try_from(span / i128::from(step)).ok().filter(|&n| n < MAX_FILES);
    let count = count.ok_or_else(|| format!("the pattern names more than {MAX_FILES} files"))? + 1;
    if before.len() + after.len() > MAX_NAME {
        return Err(format!("the name is longer than {MAX_NAME} bytes"));
    }
    let zeros = width.starts_with('0');
    let width: usize = width.parse().unwrap_or(0);
    // numbers of up to 20 characters
    if count.saturating_mul(before.len() + after.len() + width.max(20)) > MAX_NAMES {
        return Err(format!("the pattern makes more than {MAX_NAMES} bytes of names"));
    }
    let name = |i: usize| {
        let n = i128::from(min) + i as i128 * i128::from(step);
        if zeros { format!("{before}{n:0width$}{after}") } else { format!("{before}{n:width$}{after}") }
    };
    Ok((0..count).map(name).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_file_patterns() {
        assert_eq!(pattern("a b.raw").unwrap(), ["a b.raw"]);
        assert_eq!(pattern("t%02d.raw 8 12 2 3").unwrap(), ["t08.raw", "t10.raw", "t12.raw"]);
        assert_eq!(pattern("%d 2 0 -1").unwrap(), ["2", "1", "0"]);
        assert_eq!(pattern("100%.raw").unwrap(), ["100%.raw"]);
        assert!(pattern("%03d.raw 0 9 0").is_err());
        assert!(pattern("%03d.raw 0 9 -1").is_err());
        assert!(pattern("%03d.raw 0 9223372036854775807 1").is_err());
        assert!(pattern("").is_err());
        let long = format!("{}%d.raw 0 1000000 1", "x".repeat(5000));
        assert!(pattern(&long).unwrap_err().contains("longer than 4096"));
        let many = format!("{}%d.raw 0 1000000 1", "x".repeat(4000));
        assert!(pattern(&many).unwrap_err().contains("bytes of names"));
        assert_eq!(pattern("data/step-%06d.raw 0 999999 1").unwrap().len(), 1_000_000);
    }
}
