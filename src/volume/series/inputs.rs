//! What the user named, to files in order: expansion of folders and patterns, natural order, and the checks on the
//! numbers in names. No file is opened here.

use crate::volume::error::VolumeError;
use crate::volume::formats::{self, Format, format_of};
use std::cmp::Ordering;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// The files that `inputs` name, in order: a file as it is, a folder's volume files and a pattern's matches in natural
/// order. In a folder, hidden files are left out, and so are raw files without a sidecar beside `.nhdr` headers.
///
/// # Errors
/// An input that names nothing, or a file named twice.
pub fn expand(inputs: &[String]) -> Result<Vec<PathBuf>, VolumeError> {
    let mut files = Vec::new();
    for input in inputs {
        let path = Path::new(input);
        let found = if path.is_dir() {
            folder(path)?
        } else if !path.exists() && input.contains(['*', '?', '[']) {
            matches(path, input)?
        } else {
            vec![path.to_owned()]
        };
        files.extend(found);
    }
    if files.is_empty() {
        let hint = "name volume files, a folder, or a pattern in quotes";
        return Err(VolumeError::invalid(Path::new("."), "inputs", "no volume file is named", hint));
    }
    let mut seen = HashMap::new();
    for file in &files {
        // A file that is absent is found out when it is opened.
        let real = file.canonicalize().unwrap_or_else(|_| file.clone());
        if let Some(before) = seen.insert(real, file) {
            let problem = format!("is the same file as {}", before.display());
            return Err(VolumeError::invalid(file, "inputs", problem, "name each file once"));
        }
    }
    Ok(files)
}

fn folder(path: &Path) -> Result<Vec<PathBuf>, VolumeError> {
    let fail = |e| VolumeError::io(path, "list the folder", e, "check its permissions");
    let mut files = Vec::new();
    for entry in std::fs::read_dir(path).map_err(fail)? {
        let file = entry.map_err(fail)?.path();
        let hidden = file.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
        if !hidden && file.is_file() && format_of(&file).is_some() {
            files.push(file);
        }
    }
    if files.iter().any(|f| f.extension().is_some_and(|e| e.eq_ignore_ascii_case("nhdr"))) {
        let bare = |f: &PathBuf| {
            matches!(format_of(f), Some((Format::Raw, _))) && matches!(formats::raw::sidecar_of(f), Ok(None))
        };
        files.retain(|f| !bare(f));
    }
    if files.is_empty() {
        let hint = format!("these are read: {}", formats::READ);
        return Err(VolumeError::invalid(path, "folder", "holds no volume file", hint));
    }
    files.sort_by(|a, b| natural(a, b));
    Ok(files)
}

fn matches(path: &Path, pattern: &str) -> Result<Vec<PathBuf>, VolumeError> {
    let found = glob::glob(pattern)
        .map_err(|e| VolumeError::invalid(path, "pattern", e.to_string(), "use *, ? and [a-z], in quotes"))?;
    let found: Result<Vec<PathBuf>, _> = found.collect();
    let mut found = found.map_err(|e| {
        let at = e.path().to_owned();
        VolumeError::io(&at, "list the folder", e.into(), "check its permissions")
    })?;
    found.retain(|f| f.is_file());
    if found.is_empty() {
        return Err(VolumeError::invalid(path, "pattern", "matches no file", "check the folder and the name"));
    }
    found.sort_by(|a, b| natural(a, b));
    Ok(found)
}

/// One piece of a name.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Piece<'a> {
    Text(&'a str),
    Digits(&'a str),
}

fn pieces(text: &str) -> Vec<Piece<'_>> {
    let mut found = Vec::new();
    let mut rest = text;
    while let Some(first) = rest.bytes().next() {
        let digits = first.is_ascii_digit();
        let end = rest.bytes().position(|b| b.is_ascii_digit() != digits).unwrap_or(rest.len());
        let (head, tail) = rest.split_at(end);
        found.push(if digits { Piece::Digits(head) } else { Piece::Text(head) });
        rest = tail;
    }
    found
}

/// Order in which `t2` comes before `t10`; names that differ in leading zeros alone keep a fixed order.
pub fn natural(a: &Path, b: &Path) -> Ordering {
    let (a, b) = (a.to_string_lossy(), b.to_string_lossy());
    let (left, right) = (pieces(&a), pieces(&b));
    for (l, r) in left.iter().zip(&right) {
        let order = match (l, r) {
            (Piece::Text(l), Piece::Text(r)) => l.cmp(r),
            (Piece::Digits(_), Piece::Text(_)) => Ordering::Less,
            (Piece::Text(_), Piece::Digits(_)) => Ordering::Greater,
            (Piece::Digits(l), Piece::Digits(r)) => {
                let (l, r) = (l.trim_start_matches('0'), r.trim_start_matches('0'));
                l.len().cmp(&r.len()).then_with(|| l.cmp(r))
            }
        };
        if order != Ordering::Equal {
            return order;
        }
    }
    left.len().cmp(&right.len()).then_with(|| a.cmp(&b))
}

/// The number of the step in a name.
struct Numbered {
    value: u64,
    /// Bytes of the path before the number, and digits of it.
    at: usize,
    width: usize,
}

/// The step number of each path: of names alike but for numbers, the last number that varies; else the number that ends
/// each name. `None` where names carry no numbers, or such that do not fit in 64 bits.
fn numbers(stems: &[String]) -> Option<Vec<Numbered>> {
    let split: Vec<Vec<Piece<'_>>> = stems.iter().map(|s| pieces(s)).collect();
    let first = split.first()?;
    let alike = split.iter().all(|p| {
        let same = |(a, b): (&Piece<'_>, &Piece<'_>)| a == b || matches!((a, b), (Piece::Digits(_), Piece::Digits(_)));
        p.len() == first.len() && p.iter().zip(first).all(same)
    });
    let varying = (0..first.len()).rev().find(|&i| alike && split.iter().any(|p| p[i] != first[i]));
    let number = |p: &Vec<Piece<'_>>| {
        let index = varying.or_else(|| p.len().checked_sub(1))?;
        let Piece::Digits(digits) = p[index] else { return None };
        let length = |p: &Piece<'_>| match p {
            Piece::Text(t) | Piece::Digits(t) => t.len(),
        };
        Some(Numbered { value: digits.parse().ok()?, at: p[..index].iter().map(length).sum(), width: digits.len() })
    };
    split.iter().map(number).collect()
}

/// Checks that the numbers in the names increase and, unless `allow_gaps`, that no step is missing. Says whether there
/// are gaps.
///
/// # Errors
/// Files out of order, files of several series, or a missing step.
pub fn check_order(files: &[PathBuf], allow_gaps: bool) -> Result<bool, VolumeError> {
    let stem = |f: &PathBuf| {
        let mut text = f.to_string_lossy().into_owned();
        let cut = format_of(f).map_or(0, |(_, n)| n);
        text.truncate(text.len() - cut);
        text
    };
    let stems: Vec<String> = files.iter().map(stem).collect();
    let Some(numbers) = numbers(&stems).filter(|n| n.len() > 1) else { return Ok(false) };
    if let Some(i) = (1..numbers.len()).find(|&i| numbers[i].value <= numbers[i - 1].value) {
        let problem = format!("unsorted: its number {} follows {}", numbers[i].value, numbers[i - 1].value);
        let problem = format!("{problem} of {}", files[i - 1].display());
        let hint = "name the files of one series in order of time, or give the folder or a pattern in quotes (\"t*.nrrd\"), \
                    which sorts t2 before t10";
        return Err(VolumeError::invalid(&files[i], "inputs", problem, hint));
    }
    let step = |i: usize| numbers[i].value - numbers[i - 1].value;
    let stride = (1..numbers.len()).map(step).min().unwrap_or(1);
    let Some(i) = (1..numbers.len()).find(|&i| step(i) != stride) else { return Ok(false) };
    if allow_gaps {
        return Ok(true);
    }
    let before = &numbers[i - 1];
    let path = files[i - 1].to_string_lossy();
    let (head, tail) = (&path[..before.at], &path[before.at + before.width..]);
    let missing = PathBuf::from(format!("{head}{:0width$}{tail}", before.value + stride, width = before.width));
    let problem = format!("this step is missing between {} and {}", files[i - 1].display(), files[i].display());
    let hint = "add the file, give each step its time (--time-values), or pass --allow-gaps";
    Err(VolumeError::invalid(&missing, "inputs", problem, hint))
}
