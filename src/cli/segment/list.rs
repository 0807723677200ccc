//! `volseggs segment list`

use super::super::{CliError, CommonArgs, print_json};
use crate::run::materials::{AssignedMaterials, SegmentMaterial, materials};
use crate::run::segments::{HistoryDirection, RunSegments};
use crate::segment::segmentation::Segment;
use crate::shell;
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;

/// List the segments of a run, parts below their wholes. The last column is the colour of the transfer function that most
/// of the segment is nearest to: a named range or, if the function names none, the value of a control point.
#[derive(Debug, Args)]
pub struct ListArgs {
    /// Folder of the run.
    run: PathBuf,
    #[command(flatten)]
    common: CommonArgs,
}

#[derive(Serialize)]
struct SegmentListReport<'a> {
    /// Number of Gaussians in the scene.
    gaussians: usize,
    /// Fingerprint of the scene.
    scene: &'a str,
    /// Each whole followed by its parts.
    segments: Vec<Listed<'a>>,
    /// Changes that can be undone, the next one first.
    undo: Vec<&'a str>,
    /// Changes that can be redone, the next one first.
    redo: Vec<&'a str>,
}

#[derive(Serialize)]
struct Listed<'a> {
    #[serde(flatten)]
    segment: &'a Segment,
    /// What it is made of, if the dataset's transfer function is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    material: Option<SegmentMaterial>,
}

impl ListArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let run = self.common.open(&self.run)?;
        let segments = RunSegments::open(&run)?;
        let (all, undo, redo) =
            (segments.now(), segments.steps(HistoryDirection::Undo), segments.steps(HistoryDirection::Redo));
        let tree = all.tree();
        let known = run.dataset().map_or_else(|_| Vec::new(), |dataset| materials(&dataset));
        let assigned = (!known.is_empty() && !tree.is_empty()).then(|| AssignedMaterials::new(&run, &known));
        let material = |segment: &Segment| assigned.as_ref().and_then(|assigned| assigned.most(&segment.members));
        if self.common.json {
            let listed = |(_, segment): (usize, _)| Listed { segment, material: material(segment) };
            let segments = tree.into_iter().map(listed).collect();
            return print_json(&SegmentListReport {
                gaussians: all.gaussians,
                scene: &all.scene,
                segments,
                undo,
                redo,
            });
        }
        for (depth, segment) in &tree {
            let name = format!("{:width$}{}", "", segment.name, width = 2 * depth);
            let made = material(segment).map_or_else(String::new, |SegmentMaterial { material, share }| {
                format!("  {:.0} % {} {}", 100.0 * share, material.name, material.hex)
            });
            outln!("{name:30} {:>8} Gaussians  found at {:.3}{made}", segment.members.len(), segment.time);
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
