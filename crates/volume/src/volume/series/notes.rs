//! What the user should know about the files of a series.

use std::path::{Path, PathBuf};

/// Notes on files, each text once with the first file it concerns.
#[derive(Default)]
pub struct FileNotes(Vec<(String, PathBuf, usize)>);

impl FileNotes {
    /// Adds notes on a file.
    pub fn add(&mut self, path: &Path, texts: &[String]) {
        for text in texts {
            match self.0.iter_mut().find(|n| n.0 == *text) {
                Some(note) => note.2 += 1,
                None => self.0.push((text.clone(), path.to_owned(), 1)),
            }
        }
    }

    /// A line for each text.
    pub fn lines(self) -> Vec<String> {
        let line = |(text, path, count): (String, PathBuf, usize)| match count {
            1 => format!("{}: {text}", path.display()),
            _ => format!("{} and {} more files: {text}", path.display(), count - 1),
        };
        self.0.into_iter().map(line).collect()
    }
}
