//! Trees of files: their contents and temporaries.

use std::collections::BTreeMap;
use std::path::Path;

/// Prefix of the names of files that are still being written.
const TEMPORARY: &str = ".tmp-";
/// Name of the lock file, whose contents do not matter.
const LOCK: &str = ".lock";

/// File contents by path below a folder, with `/`; excludes temporaries and locks.
pub type Snapshot = BTreeMap<String, Vec<u8>>;

/// Returns the entries of a folder, sorted by name, each with whether it is a folder; none if the folder does not exist
/// (any more).
fn entries(folder: &Path) -> Vec<(String, bool)> {
    let Ok(listed) = std::fs::read_dir(folder) else { return Vec::new() };
    let entry =
        |e: std::fs::DirEntry| Some((e.file_name().to_string_lossy().into_owned(), e.file_type().ok()?.is_dir()));
    let mut all: Vec<(String, bool)> = listed.flatten().filter_map(entry).collect();
    all.sort();
    all
}

/// Reads all contents below a folder that no process writes to.
pub fn snapshot(folder: &Path) -> Snapshot {
    let mut all = Snapshot::new();
    add(folder, "", &mut all);
    all
}

fn add(folder: &Path, prefix: &str, all: &mut Snapshot) {
    for (name, is_folder) in entries(folder) {
        let (path, shown) = (folder.join(&name), format!("{prefix}{name}"));
        if name.starts_with(TEMPORARY) || name == LOCK {
            continue;
        }
        if is_folder {
            add(&path, &format!("{shown}/"), all);
        } else {
            let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            all.insert(shown, bytes);
        }
    }
}

/// Returns the paths of the temporaries below a folder.
pub fn temporaries(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for (name, is_folder) in entries(folder) {
        if name.starts_with(TEMPORARY) {
            found.push(name);
        } else if is_folder {
            found.extend(temporaries(&folder.join(&name)).into_iter().map(|inner| format!("{name}/{inner}")));
        }
    }
    found
}

/// Removes a folder if it is there.
pub fn remove(folder: &Path) {
    if folder.exists() {
        std::fs::remove_dir_all(folder).unwrap();
    }
}

/// Whether one of the patterns matches a path; `*` matches across folders too.
pub fn fits(patterns: &[String], path: &str) -> bool {
    patterns.iter().any(|p| glob::Pattern::new(p).unwrap().matches(path))
}
