//! Dataset layouts: which files a folder has, and how the views of a split are read from them.

use super::LAYOUTS;
use super::dataset::SplitName;
use super::error::DataError;
use super::scan::SplitScan;
use super::transforms::{Transforms, TransformsLayout};
use std::path::{Path, PathBuf};

/// A layout of dataset folders.
pub trait DatasetLayout: Send + Sync {
    /// The files that a folder of this layout has, for messages.
    fn holds(&self) -> &'static str;

    /// The file that lists the views of a split, which is missing if there is no such split. Messages name it.
    fn file(&self, root: &Path, split: SplitName) -> PathBuf;

    /// Reads the views of a split as far as possible: a lens that they share, and for each view its image, pose and time.
    /// Poses map the camera's axes (right, up, backward) to the dataset's space; times are in [0, 1]; paths of images
    /// are relative to the folder.
    ///
    /// # Errors
    /// If nothing can be read; what is wrong within a file is listed in [`SplitScan::problems`].
    fn scan(&self, root: &Path, split: SplitName) -> Result<SplitScan, DataError>;

    /// Whether the folder has a split.
    fn has(&self, root: &Path, split: SplitName) -> bool {
        self.file(root, split).is_file()
    }

    /// Whether the folder is of this layout.
    fn recognises(&self, root: &Path) -> bool {
        SplitName::ALL.iter().any(|split| self.has(root, *split))
    }
}

/// Returns whether a layout recognises the folder.
pub fn is_dataset(root: &Path) -> bool {
    LAYOUTS.all().iter().any(|(_, layout)| layout.recognises(root))
}

/// Returns the layout of a folder. One that no layout recognises counts as of the first, whose errors then say what was
/// looked for.
pub fn layout_of(root: &Path) -> &'static dyn DatasetLayout {
    let all = LAYOUTS.all();
    let found = all.iter().find(|(_, layout)| layout.recognises(root)).or(all.first());
    found.map_or(&TransformsLayout, |(_, layout)| *layout)
}

impl SplitName {
    /// Reads and checks the views of the split under `root`.
    ///
    /// # Errors
    /// The first problem, with file, frame and field.
    pub fn views(self, root: &Path) -> Result<Transforms, DataError> {
        Ok(self.views_and_contents(root)?.0)
    }

    /// The same, and the bytes that identify them.
    pub(super) fn views_and_contents(self, root: &Path) -> Result<(Transforms, Vec<u8>), DataError> {
        let mut scan = layout_of(root).scan(root, self)?;
        let contents = std::mem::take(&mut scan.contents);
        Ok((Transforms::from_scan(&self.json_path(root), scan)?, contents))
    }
}

/// Returns what a dataset folder may hold, in words: the files of each layout.
pub fn looked_for() -> String {
    LAYOUTS.all().iter().map(|(_, layout)| layout.holds()).collect::<Vec<_>>().join(", or ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::fixture::write_sphere_dataset;
    use crate::data::scan::scan;
    use crate::data::{Dataset, OpenOptions};

    /// One split, whose JSON has another name.
    struct Named;

    impl DatasetLayout for Named {
        fn holds(&self) -> &'static str {
            "views.json"
        }

        fn file(&self, root: &Path, split: SplitName) -> PathBuf {
            root.join(if split == SplitName::Train { "views.json" } else { "no-views.json" })
        }

        fn scan(&self, root: &Path, split: SplitName) -> Result<SplitScan, DataError> {
            let path = self.file(root, split);
            let text = std::fs::read_to_string(&path).unwrap();
            Ok(SplitScan { contents: text.clone().into_bytes(), ..scan(&path, &text) })
        }
    }

    #[test]
    fn a_folder_is_read_in_the_layout_that_recognises_it() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        write_sphere_dataset(root, 4, 8).unwrap();
        assert!(is_dataset(root));
        let known = Dataset::open(root, &OpenOptions::default()).unwrap();
        std::fs::remove_file(SplitName::Test.json_path(root)).unwrap();
        std::fs::rename(SplitName::Train.json_path(root), root.join("views.json")).unwrap();
        assert!(!is_dataset(root));
        let said = Dataset::open(root, &OpenOptions::default()).unwrap_err().to_string();
        let words = "a dataset folder holds transforms_train.json and transforms_test.json";
        assert!(said.contains(words), "{said}");

        LAYOUTS.insert("named", Box::new(Named));
        assert_eq!(Dataset::present(root), [SplitName::Train]);
        let found = Dataset::open(root, &OpenOptions::default()).unwrap();
        assert_eq!((&found.train, found.fingerprint()), (&known.train, known.fingerprint()));
        std::fs::remove_file(root.join("views.json")).unwrap();
        let said = Dataset::open(root, &OpenOptions::default()).unwrap_err().to_string();
        assert!(said.contains("transforms_test.json, or views.json; check the path"), "{said}");
    }
}
