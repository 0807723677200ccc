//! A report as data, and its one self-contained HTML file: text, tables, pictures, plots.
//!
//! This file defines what a report consists of and how it is written; the page's skeleton is in `page`, its blocks in
//! `blocks`. Nothing here renders pictures or measures anything: callers supply finished text, PNGs and numbers.

mod blocks;
mod page;
#[cfg(test)]
mod tests;

use crate::files::write_atomic;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A page that opens from disk without a network: every picture is embedded in it.
///
/// All strings are plain text; the page shows `<` and `&` literally.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Heading of the page and title of its window.
    pub title: String,
    /// One line under the heading; may be empty.
    pub subtitle: String,
    /// The parts in reading order; each has a line in the table of contents.
    pub sections: Vec<ReportSection>,
}

/// One part of a report.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReportSection {
    /// Anchor for links (`report.html#quality`), in lower case. Characters other than ASCII letters, digits and `-`
    /// become `-`; an empty or repeated anchor is made unique.
    pub id: String,
    /// Heading.
    pub title: String,
    /// One or two sentences on what is shown here; may be empty.
    pub intro: String,
    /// What is shown, in reading order.
    pub blocks: Vec<ReportBlock>,
}

/// An element of a section. Pictures are whole PNG files; bytes that are not a PNG are replaced by a note.
#[derive(Clone, Debug, PartialEq)]
pub enum ReportBlock {
    /// Paragraphs, separated by empty lines.
    Text(String),
    /// One picture.
    Figure {
        /// The picture.
        png: Vec<u8>,
        /// Description of the picture, for users who cannot see it.
        alt: String,
        /// Text below; may be empty.
        caption: String,
    },
    /// A grid of pictures, row by row.
    Figures {
        /// Each picture with the text below it, which is also its description for users who cannot see it.
        items: Vec<(Vec<u8>, String)>,
        /// Pictures in a row where the window is wide enough, 1 to 8.
        columns: usize,
    },
    /// Two pictures of the same view, one over the other, with a border to drag between them.
    Compare {
        /// Seen left of the border.
        left: Vec<u8>,
        /// Name of the left one.
        left_name: String,
        /// Seen right of the border.
        right: Vec<u8>,
        /// Name of the right one.
        right_name: String,
        /// Text below; may be empty.
        caption: String,
    },
    /// Pictures that play in a loop, which can be stopped and turned by hand.
    Turntable {
        /// The pictures, all of one size.
        frames: Vec<Vec<u8>>,
        /// Name of each frame; a frame without one is named by its number.
        labels: Vec<String>,
        /// Text below; may be empty.
        caption: String,
        /// Pictures per second, 0.5 to 60; any other value plays at 8.
        fps: f32,
    },
    /// A plot, such as [`crate::draw::plot::line_plot`] makes. It is shown as a picture: scripts in it do not run.
    Svg {
        /// The SVG document.
        svg: String,
        /// Text below, which is also the plot's description for users who cannot see it.
        caption: String,
    },
    /// A table. Columns that hold only numbers are right-aligned.
    Table {
        /// Headings of the columns.
        head: Vec<String>,
        /// Cells; short rows are filled with empty ones. The first cell names its row. A cell enclosed in `**` is bold.
        rows: Vec<Vec<String>>,
        /// Text above; may be empty.
        caption: String,
        /// Column to highlight, from 0.
        highlight: Option<usize>,
    },
    /// Headline figures.
    Numbers(Vec<Headline>),
    /// Commands to run again, each with a comment (may be empty) and a button that copies the command.
    Commands(Vec<(String, String)>),
    /// How long each stage took, in seconds; non-finite and negative values are shown as a dash.
    Timings(Vec<(String, f64)>),
    /// A part that does not exist yet.
    Missing {
        /// What is missing.
        what: String,
        /// How to get it; may be empty.
        how: String,
    },
}

/// One headline figure.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Headline {
    /// The value as displayed, such as `30.1`.
    pub value: String,
    /// Its unit, such as `dB`; may be empty.
    pub unit: String,
    /// What it is, such as `PSNR`.
    pub name: String,
    /// A short note beside it, such as `target 28`; may be empty.
    pub note: String,
}

/// Why a report could not be written.
#[derive(Debug, Error)]
pub enum ReportError {
    /// The file system failed.
    #[error("{}: cannot write the report: {source}; check that its folder exists, is writable and has room", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
}

impl ReportSection {
    /// Makes a part of a report.
    pub fn new(id: &str, title: &str, intro: impl Into<String>, blocks: Vec<ReportBlock>) -> Self {
        Self { id: id.to_owned(), title: title.to_owned(), intro: intro.into(), blocks }
    }
}

impl Report {
    /// Returns the whole page. The same report gives the same bytes.
    pub fn to_html(&self) -> String {
        page::render(self)
    }

    /// Writes the page to `path`, whose folder must exist; an older page there is replaced as a whole.
    ///
    /// # Errors
    /// [`ReportError::Write`] if the file system refuses; an older page at `path` is then unchanged.
    pub fn write(&self, path: &Path) -> Result<(), ReportError> {
        write_atomic(path, self.to_html().as_bytes())
            .map_err(|source| ReportError::Write { path: path.to_owned(), source })
    }
}
