//! The folder of a tracked segment: tables, plots, and pictures of it alone. Pictures are added one at a time, as the
//! caller draws them, and written at once; nothing is there before [`ReportFolder::finish`].

use super::follow::TrackedSegment;
use super::statistics::{RowStatus, SegmentStatistics};
use super::tables::{Unit, columns_csv, events_csv, statistics_csv, to_json, tracks_csv};
use crate::data::Calibration;
use crate::draw::plot::{PlotSeries, line_plot};
use crate::draw::views::view_sheet;
use crate::export::images::{encode_gray_png, encode_png, to_rgb8};
use crate::files::{AtomicDir, FolderKind, ReplaceError};
use crate::name::Name;
use image::{GrayImage, ImageError, RgbImage};
use std::io;
use std::path::{Path, PathBuf};

/// Width of a picture in `times.png`, in pixels.
pub const SHEET_CELL: u32 = 320;

/// Which pictures to keep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PictureOptions {
    /// Whether to write every picture to `renders/` and its mask to `masks/`.
    pub keep: bool,
    /// Minimum alpha of a pixel of the mask.
    pub mask_alpha: f32,
}

/// Why a report cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum TrackReportError {
    /// Something else is where the folder should go.
    #[error(transparent)]
    Replace(#[from] ReplaceError),
    /// The file system reported an error.
    #[error("{path}: {source}; check the folder and the free disk space")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        source: io::Error,
    },
    /// A picture cannot be encoded.
    #[error("{path}: {source}")]
    Image {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: ImageError,
    },
    /// A table cannot be encoded.
    #[error("{path}: {source}")]
    Json {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: serde_json::Error,
    },
}

/// Kind of a tracked segment's folder.
const KIND: FolderKind = FolderKind {
    what: "a segment's track",
    markers: &["statistics.json"],
    entries: &["*.csv", "*.svg", "times.png", "renders/[0-9]*.png", "masks/[0-9]*.png"],
};

/// The folder of a segment that is being written.
#[derive(Debug)]
pub struct ReportFolder {
    path: PathBuf,
    folder: AtomicDir,
    options: PictureOptions,
    /// Labelled pictures of the sheet.
    sheet: Vec<(String, RgbImage)>,
    /// Pixels of the mask, and their fraction of the picture, at each time.
    areas: Vec<(u64, f64)>,
}

impl ReportFolder {
    /// Creates the folder `name` in `parent`, which is created if missing.
    ///
    /// # Errors
    /// [`TrackReportError::Io`]; [`TrackReportError::Replace`] if something else has that name.
    pub fn create(parent: &Path, name: &Name, options: PictureOptions) -> Result<Self, TrackReportError> {
        let path = parent.join(name);
        let io = |source| TrackReportError::Io { path: path.clone(), source };
        std::fs::create_dir_all(parent).map_err(io)?;
        KIND.check(&path, &[])?;
        let folder = AtomicDir::create(&path).map_err(io)?;
        let kept = if options.keep { &["renders", "masks"][..] } else { &[] };
        for name in kept {
            std::fs::create_dir(folder.dir().join(name)).map_err(io)?;
        }
        Ok(Self { path, folder, options, sheet: Vec::new(), areas: Vec::new() })
    }

    /// Adds the picture of the next time: `rgba` is colour over the background, and alpha, `[H, W, 4]`. With a `label`,
    /// it is also added to the sheet.
    ///
    /// # Errors
    /// [`TrackReportError`].
    pub fn add(
        &mut self,
        rgba: &[f32],
        [width, height]: [usize; 2],
        label: Option<String>,
    ) -> Result<(), TrackReportError> {
        let inside = |p: &[f32]| p[3] >= self.options.mask_alpha;
        let area = rgba.chunks_exact(4).filter(|p| inside(p)).count();
        let name = format!("{:03}.png", self.areas.len());
        self.areas.push((area as u64, area as f64 / (width * height) as f64));
        if !self.options.keep && label.is_none() {
            return Ok(());
        }
        let picture = to_rgb8(rgba, width, height);
        if self.options.keep {
            let mask = GrayImage::from_fn(width as u32, height as u32, |x, y| {
                image::Luma([if inside(&rgba[4 * (y as usize * width + x as usize)..][..4]) { 255 } else { 0 }])
            });
            self.put_png(&format!("renders/{name}"), encode_png(&picture))?;
            self.put_png(&format!("masks/{name}"), encode_gray_png(&mask))?;
        }
        self.sheet.extend(label.map(|label| (label, picture)));
        Ok(())
    }

    /// Writes tables and plots and publishes the folder, replacing an earlier one. The areas of the pictures, which are
    /// of the same times, are entered into the statistics, which are in the units of `calibration`.
    ///
    /// # Errors
    /// [`TrackReportError`]; an earlier folder then stays.
    pub fn finish(self, found: &mut TrackedSegment, calibration: &Calibration) -> Result<(), TrackReportError> {
        for (row, (area, share)) in found.statistics.iter_mut().zip(&self.areas) {
            (row.projected_area, row.projected_share) = (Some(*area), Some(*share));
        }
        let json = to_json(&found.statistics).map_err(|source| self.json("statistics.json", source))?;
        self.put("statistics.json", json.as_bytes())?;
        self.put("statistics.csv", statistics_csv(&found.statistics).as_bytes())?;
        self.put("columns.csv", columns_csv(calibration).as_bytes())?;
        self.put("events.csv", events_csv(&found.name, &found.tracking.events).as_bytes())?;
        self.put("tracks.csv", tracks_csv(&found.name, &found.tracking.points).as_bytes())?;
        self.put("over-time.svg", over_time(found, calibration).as_bytes())?;
        self.put("velocity-over-time.svg", velocity_over_time(found, calibration).as_bytes())?;
        self.put_png("times.png", encode_png(&view_sheet(&self.sheet, 4, SHEET_CELL)))?;
        Ok(self.folder.commit_replacing(&KIND, &[])?)
    }

    fn put(&self, name: &str, bytes: &[u8]) -> Result<(), TrackReportError> {
        let write = std::fs::write(self.folder.dir().join(name), bytes);
        write.map_err(|source| TrackReportError::Io { path: self.path.join(name), source })
    }

    fn put_png(&self, name: &str, encoded: Result<Vec<u8>, ImageError>) -> Result<(), TrackReportError> {
        let image = |source| TrackReportError::Image { path: self.path.join(name), source };
        self.put(name, &encoded.map_err(image)?)
    }

    fn json(&self, name: &str, source: serde_json::Error) -> TrackReportError {
        TrackReportError::Json { path: self.path.join(name), source }
    }
}

/// The time axis: its label, and the place of a row on it.
fn time_axis(calibration: &Calibration) -> String {
    format!("time [{}]", calibration.time_unit())
}

fn time(row: &SegmentStatistics) -> f64 {
    row.physical_time.unwrap_or(row.time)
}

/// Plots how much of the segment there is, each measure as a fraction of its largest value, which the legend states.
/// Times at which it is lost are gaps.
fn over_time(found: &TrackedSegment, calibration: &Calibration) -> String {
    let share = |name: &str, unit: &str, value: &dyn Fn(&SegmentStatistics) -> f64| {
        let known = |s: &SegmentStatistics| if s.status == RowStatus::Lost { f64::NAN } else { value(s) };
        let largest = found.statistics.iter().map(known).filter(|v| v.is_finite()).fold(0.0, f64::max);
        let points = found.statistics.iter().map(|s| (time(s), known(s) / largest.max(1e-300))).collect();
        PlotSeries { name: format!("{name}, of {largest:.4} {unit}").trim_end().into(), points }
    };
    let volume = Unit::Volume.name(calibration);
    let series = [
        share("volume", &volume, &|s| s.volume),
        share("opaque core", &volume, &|s| s.opaque_core_volume),
        share("opacity", "", &|s| s.opacity),
        share("projected area", "of the picture", &|s| s.projected_share.unwrap_or(f64::NAN)),
        share("counted share", "", &|s| s.counted_share.unwrap_or(f64::NAN)),
    ];
    line_plot(&found.name, &time_axis(calibration), "fraction of maximum", &series)
}

/// Plots the velocity of the centroid and its magnitude; times at which the segment is lost are gaps.
fn velocity_over_time(found: &TrackedSegment, calibration: &Calibration) -> String {
    let curve = |name: &str, value: &dyn Fn([f64; 3]) -> f64| {
        let points = found.statistics.iter().map(|s| (time(s), s.velocity.map_or(f64::NAN, value))).collect();
        PlotSeries { name: name.into(), points }
    };
    let series = [
        curve("speed", &|v| v.iter().map(|c| c * c).sum::<f64>().sqrt()),
        curve("x", &|v| v[0]),
        curve("y", &|v| v[1]),
        curve("z", &|v| v[2]),
    ];
    let unit = format!("velocity [{}]", Unit::Speed.name(calibration));
    line_plot(&found.name, &time_axis(calibration), &unit, &series)
}
