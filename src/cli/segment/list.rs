//! `volseggs segment list`

use super::super::{CliError, Common, print_json};
use crate::run::OpenRun;
use crate::run::segments::{RunSegments, Towards};
use crate::segment::segmentation::Segment;
use crate::shell;
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;

/// List the segments of a run, parts below their wholes.
#[derive(Debug, Args)]
pub struct ListArgs {
    /// Folder of the run.
    run: PathBuf,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Report<'a> {
    /// Number of Gaussians in the scene.
    gaussians: usize,
    /// Fingerprint of the scene.
    scene: &'a str,
    /// Each whole followed by its parts.
    segments: Vec<&'a Segment>,
    /// Changes that can be undone, the next one first.
    undo: Vec<&'a str>,
    /// Changes that can be redone, the next one first.
    redo: Vec<&'a str>,
}

impl ListArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let run = OpenRun::open(&self.run, &device)?;
        let segments = RunSegments::open(&run)?;
        let (all, undo, redo) = (segments.now(), segments.steps(Towards::Undo), segments.steps(Towards::Redo));
        let tree = all.tree();
        if self.common.json {
            let segments = tree.into_iter().map(|(_, segment)| segment).collect();
            return print_json(&Report { gaussians: all.gaussians, scene: &all.scene, segments, undo, redo });
        }
        for (depth, segment) in &tree {
            let name = format!("{:width$}{}", "", segment.name, width = 2 * depth);
            outln!("{name:30} {:>8} Gaussians  found at {:.3}", segment.members.len(), segment.time);
        }
        let path = shell::path(&run.path);
        if tree.is_empty() {
            errln!("no segments yet; next: volseggs segment coarse {path}");
        }
        for (changes, what) in [(undo, "undo"), (redo, "redo")] {
            if let Some(next) = changes.first() {
                errln!("{} to {what}, next: {next} (volseggs segment {what} {path})", changes.len());
            }
        }
        Ok(())
    }
}
