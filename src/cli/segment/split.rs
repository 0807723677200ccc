//! `volseggs segment split`

use super::super::camera::surroundings;
use super::super::data::DataArgs;
use super::super::settings::SegmentSettings;
use super::super::{CliError, CommonArgs, print_json};
use crate::files::LockDuration;
use crate::run::segments::{RunSegments, write_picture};
use crate::run::split::{SplitOptions, sheet, split};
use crate::segment::segmentation::Segment;
use clap::Args;
use std::path::PathBuf;

/// Split a segment into parts by its affinity features.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs segment split RUN red --scale 0.3\n  volseggs segment split RUN red --clusters 5\n\nThe parts are called SEGMENT.1, SEGMENT.2, ... from the largest, skipping names in use; a picture is in RUN/segments/. Parts of an earlier split of the segment are replaced; `volseggs segment undo RUN` restores them. Segments picked in the segment itself are kept."
)]
pub struct SplitArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Segment to split.
    segment: String,
    #[command(flatten)]
    options: SplitOptions,
    /// Keep small pieces that do not touch the rest of their part (`segment.pieces.strays = false`).
    #[arg(long)]
    keep_strays: bool,
    #[command(flatten)]
    settings: SegmentSettings,
    #[command(flatten)]
    data: DataArgs,
    #[command(flatten)]
    common: CommonArgs,
}

impl SplitArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let run = self.data.apply_to(self.common.open_to_write(&self.run, LockDuration::Short)?)?;
        let mut run = self.settings.apply_to(run)?;
        run.config.segment.pieces.strays &= !self.keep_strays;
        let around = surroundings(&run, None);
        let mut segments = RunSegments::open(&run)?;
        let parts = split(&run, &mut segments, &self.segment, &self.options, &|| true)?;
        let parts = parts.ok_or_else(|| CliError::failure("stopped; nothing was written"))?;
        segments.save()?;
        let path = run.paths().segment_sheet(&self.segment);
        write_picture(&path, &sheet(&run, &around, &parts))?;
        let found: Vec<&Segment> = segments.now().segments.iter().filter(|s| parts.names.contains(&s.name)).collect();
        if self.common.json {
            return print_json(&found);
        }
        for part in &found {
            outln!("{:20} {:>8} Gaussians", part.name, part.members.len());
        }
        errln!("pictures: {}", path.display());
        Ok(())
    }
}
