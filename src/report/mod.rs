//! A report as data, and its one self-contained HTML file: text, tables, pictures, plots.
//!
//! Here is what a report consists of and how it is written; the page's skeleton is in `page`, its blocks in `blocks`.
//! Nothing here renders pictures or measures anything: every part hands over finished text, PNGs and numbers.

mod blocks;
mod page;
#[cfg(test)]
mod tests;

use crate::files::write_atomic;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A page that opens from disk with no network: every picture is inside it.
///
/// All strings are plain text; the page shows `<` and `&` as they stand.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Heading of the page and name of its window.
    pub title: String,
    /// One line under the heading; may be empty.
    pub subtitle: String,
    /// The parts in reading order; each has a line in the table of contents.
    pub sections: Vec<Section>,
}

/// One part of a report.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Section {
    /// Anchor for links (`report.html#quality`). Other characters than ASCII letters, digits and `-` become `-`;
    /// an empty or repeated one is made unique.
    pub id: String,
    /// Heading.
    pub title: String,
    /// One or two sentences on what is seen here; may be empty.
    pub intro: String,
    /// What is shown, in reading order.
    pub blocks: Vec<Block>,
}

/// One thing to see. Pictures are whole PNG files; bytes that are no PNG show as a note in their place.
#[derive(Clone, Debug, PartialEq)]
pub enum Block {
    /// Paragraphs, with an empty line between them.
    Text(String),
    /// One picture.
    Figure {
        /// The picture.
        png: Vec<u8>,
        /// What is in the picture, for those who do not see it.
        alt: String,
        /// Text below; may be empty.
        caption: String,
    },
    /// A grid of pictures, row by row.
    Figures {
        /// Each picture with the text below it, which also stands for it where it is not seen.
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
    /// Pictures that play as a loop, to be stopped and turned by hand.
    Turntable {
        /// The pictures, all of one size.
        frames: Vec<Vec<u8>>,
        /// Name of each frame; where one lacks, its number stands.
        labels: Vec<String>,
        /// Text below; may be empty.
        caption: String,
        /// Pictures per second, 0.5 to 60; another value plays at 8.
        fps: f32,
    },
    /// A plot, such as [`crate::draw::plot::line_plot`] makes. It is shown as a picture: scripts in it do not run.
    Svg {
        /// The SVG document.
        svg: String,
        /// Text below, which also stands for the plot where it is not seen.
        caption: String,
    },
    /// A table. Columns that hold numbers alone are set to the right.
    Table {
        /// Headings of the columns.
        head: Vec<String>,
        /// Cells; short rows are filled with empty ones. The first cell names its row. A cell between `**` and `**`
        /// is bold.
        rows: Vec<Vec<String>>,
        /// Text above; may be empty.
        caption: String,
        /// Column to stress, from 0.
        highlight: Option<usize>,
    },
    /// Headline figures.
    Numbers(Vec<Number>),
    /// Commands to run again, each with a comment (may be empty) and a button that copies it.
    Commands(Vec<(String, String)>),
    /// How long each stage took, in seconds; values that are not finite or below zero show as a dash.
    Timings(Vec<(String, f64)>),
    /// A part that is not there yet.
    Missing {
        /// What is missing.
        what: String,
        /// How to get it; may be empty.
        how: String,
    },
}

/// One headline figure.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Number {
    /// The value as it is to be read, `30.1`.
    pub value: String,
    /// Its unit, `dB`; may be empty.
    pub unit: String,
    /// What it is, `PSNR`.
    pub name: String,
    /// A word beside it, `target 28`; may be empty.
    pub note: String,
}

/// A report that could not be written.
#[derive(Debug, Error)]
pub enum ReportError {
    /// The file system said no.
    #[error("{}: cannot write the report: {source}; check that its folder exists, is writable and has room", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system answered.
        source: std::io::Error,
    },
}

impl Report {
    /// The whole page. The same report gives the same bytes.
    #[must_use]
    pub fn to_html(&self) -> String {
        page::render(self)
    }

    /// Writes the page to `path`, whose folder must exist; an older page there is replaced as a whole.
    ///
    /// # Errors
    /// [`ReportError::Write`] if the file system refuses; what stood at `path` is then unchanged.
    pub fn write(&self, path: &Path) -> Result<(), ReportError> {
        write_atomic(path, self.to_html().as_bytes())
            .map_err(|source| ReportError::Write { path: path.to_owned(), source })
    }
}
