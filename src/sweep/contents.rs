//! Digests of the files that runs are measured with: weights of networks and masks of other programs. Their names do
//! not tell when they are replaced.

use crate::eval::segments::SegmentEvalOptions;
use crate::segment::masks::registry::SourceOption;
use crate::segment::masks::source::MASK_SOURCES;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use twox_hash::XxHash3_128;

/// Digests of files and folders by path, taken once, when the sweep is planned.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ContentDigests(BTreeMap<PathBuf, String>);

impl ContentDigests {
    /// Reads all that measuring with these LPIPS weights and specifications uses, each file once.
    ///
    /// # Errors
    /// The key of a file that cannot be read, and why.
    pub(super) fn read<'a>(
        lpips: &[PathBuf],
        specs: impl Iterator<Item = &'a SegmentEvalOptions>,
    ) -> Result<Self, (String, String)> {
        let mut contents = Self::default();
        for path in lpips {
            contents.add("eval.lpips_weights", path, path)?;
        }
        for spec in specs {
            let source = spec.source().map_err(|e| ("segments".to_owned(), e.to_string()))?;
            let places = [&source.options.path, &source.options.weights].into_iter().flatten();
            for ((key, name), place) in files(spec).into_iter().zip(places) {
                contents.add(key, name, place)?;
            }
        }
        Ok(contents)
    }

    fn add(&mut self, key: &str, name: &Path, place: &Path) -> Result<(), (String, String)> {
        if self.0.contains_key(name) {
            return Ok(());
        }
        let bad = |e: io::Error| (key.to_owned(), format!("{}: {e}; make it readable", place.display()));
        self.0.insert(name.to_owned(), digest(place).map_err(bad)?);
        Ok(())
    }

    /// The digests of these LPIPS weights as text, empty without weights.
    pub(super) fn of_lpips(&self, weights: &[PathBuf]) -> String {
        self.text(weights.iter().map(PathBuf::as_path))
    }

    /// The digests of the files that `spec` names as text, empty if it names none.
    pub(super) fn of_segments(&self, spec: &SegmentEvalOptions) -> String {
        self.text(files(spec).into_iter().map(|(_, name)| name))
    }

    fn text<'a>(&self, names: impl Iterator<Item = &'a Path>) -> String {
        names.filter_map(|name| self.0.get(name)).map(|digest| format!(" {digest}")).collect()
    }
}

/// The files that the masks of `spec` are made from: the key of each, and what it is called here. Weights that the source
/// finds by itself have its name, as each machine has its own folder for them.
fn files(spec: &SegmentEvalOptions) -> Vec<(&'static str, &Path)> {
    let kind = MASK_SOURCES.get(&spec.masks);
    let reads = |option| kind.as_ref().is_ok_and(|kind| kind.reads().contains(&option));
    let weights = || spec.sam_weights.as_deref().unwrap_or(Path::new(&spec.masks));
    let path = spec.mask_dir.as_deref().filter(|_| reads(SourceOption::Path)).map(|path| ("segments.mask_dir", path));
    let weights = reads(SourceOption::Weights).then(|| ("segments.sam_weights", weights()));
    path.into_iter().chain(weights).collect()
}

/// The 128-bit XXH3 hash of a file, or of the sorted names and the hashes of the masks in a folder.
fn digest(path: &Path) -> io::Result<String> {
    let found = std::fs::metadata(path)?;
    if found.is_file() {
        return hash(path);
    }
    if !found.is_dir() {
        return Err(io::Error::other("neither a file nor a folder"));
    }
    let mut files = Vec::new();
    list(path, true, &mut files)?;
    files.sort();
    let mut whole = XxHash3_128::new();
    for file in &files {
        let name = file.strip_prefix(path).unwrap_or(file).as_os_str().as_encoded_bytes();
        // lengths first, so that names and contents cannot run into each other
        whole.write(&(name.len() as u64).to_le_bytes());
        whole.write(name);
        whole.write(hash(file)?.as_bytes());
    }
    Ok(format!("{:032x}", whole.finish_128()))
}

/// Adds the masks in `folder` and, with `groups`, in the folders of groups there: PNG files, as nothing else is read.
fn list(folder: &Path, groups: bool, files: &mut Vec<PathBuf>) -> io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            if groups {
                list(&path, false, files)?;
            }
        } else if path.is_file() && path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("png")) {
            files.push(path);
        }
    }
    Ok(())
}

fn hash(path: &Path) -> io::Result<String> {
    crate::program::digest(File::open(path)?).map(|(digest, _)| digest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_contents_of_a_folder_count_and_its_place_does_not() {
        let dir = tempfile::tempdir().unwrap();
        let of = |folder: &str, files: &[(&str, &str)]| {
            for (name, text) in files {
                let path = dir.path().join(folder).join(name);
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, text).unwrap();
            }
            digest(&dir.path().join(folder)).unwrap()
        };
        let base = of("a", &[("scene/v_1.png", "one"), ("scene/v_2.png", "two")]);
        assert_eq!(of("b", &[("scene/v_2.png", "two"), ("scene/v_1.png", "one"), ("scene/notes", "x")]), base);
        for (folder, files) in [
            ("c", [("scene/v_1.png", "two"), ("scene/v_2.png", "one")]),
            ("d", [("scene/v_1.png", "one"), ("scene/v_3.png", "two")]),
            ("e", [("scene/v_1.png", "one"), ("v_2.png", "two")]),
        ] {
            assert_ne!(of(folder, &files), base, "{folder}");
        }
        // as given by `xxh128sum`
        std::fs::write(dir.path().join("empty"), "").unwrap();
        assert_eq!(digest(&dir.path().join("empty")).unwrap(), "99aa06d3014798d86001c324468d497f");
        assert!(digest(&dir.path().join("nothing")).is_err());
    }
}
