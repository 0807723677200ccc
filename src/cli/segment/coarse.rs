//! `volseggs segment coarse`

use super::super::camera::surroundings;
use super::super::data::DataArgs;
use super::super::error::refuse;
use super::super::settings::{SegmentSettings, set_if_given};
use super::super::time::TimeArg;
use super::super::values::{count, fraction_f32, positive_f32};
use super::super::{CliError, CommonArgs, print_json};
use crate::config::types::segment::{ColourConfig, ColourSpace};
use crate::files::LockDuration;
use crate::run::segments::{RunSegments, SHOWN, sheet, write_picture};
use crate::segment::coarse::Coarse;
use crate::segment::segmentation::Segmentation;
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;

/// Find segments by colour.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs segment coarse RUN\n  volseggs segment coarse RUN --clusters 3 --space lab --time 0.2 --replace\n\nWrites RUN/segments/segments.safetensors and coarse.png: each segment alone. `volseggs segment undo RUN` restores what --replace removed."
)]
pub struct CoarseArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Time at which colours are grouped and outliers are found: in [0, 1], or a time of the data, such as data:150.
    #[arg(long, value_name = "T", default_value_t = TimeArg::Scene(0.5), allow_negative_numbers = true)]
    time: TimeArg,
    /// Number of colours (`segment.colour.clusters`); suggested from the data by default.
    #[arg(long, value_name = "K", value_parser = count)]
    clusters: Option<usize>,
    /// Space in which colours are compared (`segment.colour.space`) [default: material].
    #[arg(long, value_enum)]
    space: Option<ColourSpace>,
    /// Gaussians less opaque than this do not define colours; those that are so at all times belong to no segment
    /// (`segment.colour.min_opacity`) [default: 0.02].
    #[arg(long, value_name = "ALPHA", value_parser = fraction_f32)]
    min_opacity: Option<f32>,
    /// Keep the surface layers of objects, in the colours that a transfer function gives their flanks, as separate
    /// segments (`segment.layers.join = false`).
    #[arg(long, alias = "keep-skins", conflicts_with = "clusters")]
    keep_surface_layers: bool,
    /// Keep Gaussians without neighbours (`segment.colour.outliers = false`).
    #[arg(long)]
    keep_outliers: bool,
    /// Radius in which neighbours are counted, scene units; derived from the scene's spacing by default
    /// (`segment.colour.outlier_radius`).
    #[arg(long, value_name = "R", value_parser = positive_f32, conflicts_with = "keep_outliers")]
    radius: Option<f32>,
    /// Minimum number of neighbours of a Gaussian (`segment.colour.outlier_neighbours`) [default: 8].
    #[arg(long, value_name = "N", conflicts_with = "keep_outliers")]
    min_neighbours: Option<u32>,
    /// Seed of the clustering.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Replace all existing segments.
    #[arg(long)]
    replace: bool,
    #[command(flatten)]
    settings: SegmentSettings,
    #[command(flatten)]
    data: DataArgs,
    #[command(flatten)]
    common: CommonArgs,
}

/// The segments found, and what happened to each Gaussian.
#[derive(Serialize)]
struct CoarseReport<'a> {
    #[serde(flatten)]
    all: &'a Segmentation,
    /// Gaussians in segments.
    in_segments: usize,
    /// Gaussians that are never as opaque as --min-opacity.
    transparent: usize,
    /// Gaussians without neighbours.
    outliers: usize,
    /// Gaussians with a position or colour that is not finite.
    not_finite: usize,
}

impl CoarseArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        self.check(self.space.unwrap_or(ColourSpace::Material))?;
        let run = self.data.apply_to(self.common.open_to_write(&self.run, LockDuration::Short)?)?;
        let run = self.settings.apply_to(run)?;
        let mut config = run.config.segment.clone();
        self.set(&mut config.colour);
        self.check(config.colour.space)?;
        config.layers.join &= !self.keep_surface_layers;
        let around = surroundings(&run, None);
        let time = self.time.to_scene_time("--time", run.calibration())?;
        let n = run.scene.gaussians.count();
        let mut segments = if self.replace {
            let (segments, unusable) = RunSegments::replacing(&run);
            if let Some(error) = unusable {
                errln!("note: undo cannot restore the previous segments: {error}");
            }
            segments
        } else {
            RunSegments::open(&run)?
        };
        let there = segments.now().segments.len();
        if there > 0 && !self.replace {
            return Err(CliError::input(format!(
                "{}: {there} segments exist already; pass --replace to start over",
                run.paths().segments().display()
            )));
        }
        let at = run.scene.host_at(time as f32);
        let found = segments.coarse(&run, &at, time, &config, self.seed)?;
        if found.palette.is_empty() {
            return Err(CliError::input(format!(
                "no segments found: of {n} Gaussians, {}",
                left_out(&found, &config.colour)
            )));
        }
        segments.save()?;
        let all = segments.now();
        let path = run.paths().segment_sheet("coarse");
        write_picture(&path, &sheet(&run, &around, &at, &all.segments))?;
        let (outliers, transparent, not_finite) = (found.outliers, found.transparent, found.not_finite);
        let in_segments = n - outliers - transparent - not_finite;
        if self.common.json {
            return print_json(&CoarseReport { all, in_segments, transparent, outliers, not_finite });
        }
        for segment in &all.segments {
            outln!("{:20} {:>8} Gaussians", segment.name, segment.members.len());
        }
        errln!("{in_segments} of {n} Gaussians are in segments; {}", left_out(&found, &config.colour));
        let shown = if all.segments.len() > SHOWN { format!(" of the first {SHOWN}") } else { String::new() };
        errln!("pictures{shown}: {}", path.display());
        Ok(())
    }

    /// Refuses what would have no effect in a space of colours.
    fn check(&self, space: ColourSpace) -> Result<(), CliError> {
        let idle = self.keep_surface_layers && space != ColourSpace::Material;
        let why = "only --space material joins surface layers to bodies; omit one of the two";
        refuse(&[("--keep-surface-layers", idle)], why)
    }

    /// Sets the keys of options that were given.
    fn set(&self, to: &mut ColourConfig) {
        set_if_given(&mut to.clusters, self.clusters);
        set_if_given(&mut to.space, self.space);
        set_if_given(&mut to.min_opacity, self.min_opacity);
        set_if_given(&mut to.outlier_radius, self.radius);
        set_if_given(&mut to.outlier_neighbours, self.min_neighbours);
        to.outliers &= !self.keep_outliers;
    }
}

/// The reasons why Gaussians are in no segment, with their numbers.
fn left_out(found: &Coarse, config: &ColourConfig) -> String {
    let mut parts = vec![
        format!("{} are too transparent at all times (below --min-opacity {})", found.transparent, config.min_opacity),
        format!("{} are outliers (few neighbours, and touching few; --keep-outliers keeps them)", found.outliers),
    ];
    if found.not_finite > 0 {
        parts.push(format!("{} have a non-finite position or colour", found.not_finite));
    }
    parts.join(", ")
}
