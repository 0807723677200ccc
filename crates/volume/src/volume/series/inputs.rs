//! Resolves what the user named to files in order: expansion of folders and patterns, natural order, and the checks on
//! the numbers in names. No file is opened here.

use super::SeriesOptions;
use super::names::{self, MissingStep, Names};
use crate::volume::error::VolumeError;
use crate::volume::formats::{self, VolumeFormat, format_of};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// The files named by `inputs`, in order: a file as it is, a folder's volume files and a pattern's matches in natural
/// order. In a folder, hidden files are skipped, and so are raw files without a sidecar beside `.nhdr` headers.
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
        // a missing file is reported when it is opened
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
            matches!(format_of(f), Some((VolumeFormat::Raw, _))) && matches!(formats::raw::sidecar_of(f), Ok(None))
        };
        files.retain(|f| !bare(f));
    }
    if files.is_empty() {
        let hint = format!("supported are {}", formats::READ);
        return Err(VolumeError::invalid(path, "folder", "holds no volume file", hint));
    }
    sort(&mut files);
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
    sort(&mut found);
    Ok(found)
}

/// Sorts files by their names without extensions, numbers by value.
fn sort(files: &mut Vec<PathBuf>) {
    let stems: Vec<String> = files.iter().map(|f| stem(f)).collect();
    let order = names::order(&stems);
    *files = order.into_iter().map(|i| files[i].clone()).collect();
}

/// The path without the extension of its format.
fn stem(file: &Path) -> String {
    let mut text = file.to_string_lossy().into_owned();
    let cut = format_of(file).map_or(0, |(_, n)| n);
    text.truncate(text.len() - cut);
    text
}

/// What the names of a series tell.
#[derive(Debug, Default)]
pub struct SeriesOrder {
    /// Whether steps are missing.
    pub gaps: bool,
    /// The time of each file in seconds, where dates give them.
    pub seconds: Option<Vec<f64>>,
    /// What the user should know.
    pub notes: Vec<String>,
}

/// Checks that the numbers in the names of the `files` that `inputs` named increase, those on the left first, and,
/// unless gaps are allowed or times given, that no step is missing, which decimal numbers and dates do not show. Files
/// listed one by one are in order as listed, if their numbers can be read so or their times are given.
///
/// # Errors
/// Files out of order or of unclear order, files of several series, or a missing step.
pub fn check_order(inputs: &[String], files: &[PathBuf], options: &SeriesOptions) -> Result<SeriesOrder, VolumeError> {
    // each input names at least one file
    let listed = files.len() == inputs.len();
    if options.times.is_some() && listed {
        return Ok(SeriesOrder::default());
    }
    let stems: Vec<String> = files.iter().map(|f| stem(f)).collect();
    let mut names = Names::from_stems(&stems);
    if let Some([a, b]) = names.unclear
        && !(listed && names.first_unsorted().is_none())
    {
        let whole = Some(Names::whole(&stems)).filter(|whole| listed && whole.first_unsorted().is_none());
        names = whole.ok_or_else(|| {
            let problem = format!(
                "the order is unclear: {} comes after {} if their numbers are decimal, and before it if they are steps",
                files[a].display(),
                files[b].display()
            );
            let hint = "list the files one by one in order of time, with the time of each (--time-values) if these are \
                        not evenly spaced, or pad the numbers with zeros to one length";
            VolumeError::invalid(&files[a], "inputs", problem, hint)
        })?;
    }
    if let Some(i) = names.first_unsorted() {
        let problem = format!("unsorted: its {} {} follows {}", names.kind(i), names.written(i), names.written(i - 1));
        let problem = format!("{problem} of {}", files[i - 1].display());
        let hint = if listed {
            "list the files in order of time, give the time of each (--time-values), or give their folder or a pattern \
             in quotes (\"t*.nrrd\"), which sorts t2 before t10"
        } else {
            "these are several series, or a step is there twice: give a pattern that matches one series, or list the \
             files one by one with the time of each (--time-values)"
        };
        return Err(VolumeError::invalid(&files[i], "inputs", problem, hint));
    }
    let mut told = SeriesOrder {
        seconds: names.seconds().map(|all| all.iter().map(|&s| s as f64).collect()),
        ..SeriesOrder::default()
    };
    let again = names.begins_again();
    if let Some((i, folder)) = again {
        let problem = format!("its {} {} follows {}", names.kind(i), names.written(i), names.written(i - 1));
        if folder && !listed {
            let problem = format!("the steps begin again: {problem} in another folder");
            let hint = "give one folder; or, if one series goes on in the next folder, list the files one by one";
            return Err(VolumeError::invalid(&files[i], "inputs", problem, hint));
        }
        let files = files[i].display();
        told.notes.push(format!("{files}: {problem}: taken for one series that goes on, not for several"));
    }
    if options.times.is_none() {
        if names.seconds().is_some() && files.len() > 1 {
            let (first, last) = (names.written(0), names.written(files.len() - 1));
            told.notes.push(format!("the times of the steps are the dates in their names, {first} to {last}"));
        }
        if names.are_uneven() {
            let problem = "the numbers in the names are not evenly spaced, but the steps are taken to be";
            told.notes.push(format!("{problem}; give the time of each with --time-values"));
        }
    }
    let Some(MissingStep { after, at, number }) = names.missing() else { return Ok(told) };
    if options.allow_gaps || options.times.is_some() {
        told.gaps = true;
        return Ok(told);
    }
    let path = files[after].to_string_lossy();
    let missing = PathBuf::from(format!("{}{number}{}", &path[..at.start], &path[at.end..]));
    let problem = format!("this step is missing between {} and {}", files[after].display(), files[after + 1].display());
    let hint = "add the file, give each step its time (--time-values), or pass --allow-gaps";
    Err(VolumeError::invalid(&missing, "inputs", problem, hint))
}
