//! `volseggs segment coarse`

use super::super::camera::surroundings;
use super::super::data::DataArgs;
use super::super::time::TimeArg;
use super::super::values::{count, fraction_f32, positive_f32};
use super::super::{CliError, Common, command_line, print_json};
use crate::files::Work;
use crate::points::outliers::OutlierConfig;
use crate::run::OpenRun;
use crate::run::segments::{RunSegments, SHOWN, sheet, write_picture};
use crate::segment::coarse::{Coarse, CoarseOptions, ColourSpace};
use crate::segment::segmentation::Segmentation;
use clap::{Args, ValueEnum};
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
    /// Number of colours; suggested from the data if not given.
    #[arg(long, value_name = "K", value_parser = count)]
    clusters: Option<usize>,
    /// Space in which colours are compared.
    #[arg(long, value_enum, default_value_t = Space::Material)]
    space: Space,
    /// Gaussians less opaque than this do not define colours; those that are so at all times belong to no segment.
    #[arg(long, default_value_t = 0.02, value_name = "ALPHA", value_parser = fraction_f32)]
    min_opacity: f32,
    /// Keep the surface layers of objects, in the colours that a transfer function gives their flanks, as separate
    /// segments.
    #[arg(long, alias = "keep-skins", conflicts_with = "clusters")]
    keep_surface_layers: bool,
    /// Keep Gaussians without neighbours.
    #[arg(long)]
    keep_outliers: bool,
    /// Radius in which neighbours are counted, scene units; derived from the scene's spacing if not given.
    #[arg(long, value_name = "R", value_parser = positive_f32, conflicts_with = "keep_outliers")]
    radius: Option<f32>,
    /// Minimum number of neighbours of a Gaussian.
    #[arg(long, value_name = "N", conflicts_with = "keep_outliers")]
    min_neighbours: Option<u32>,
    /// Seed of the clustering.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Replace all existing segments.
    #[arg(long)]
    replace: bool,
    #[command(flatten)]
    data: DataArgs,
    #[command(flatten)]
    common: Common,
}

/// The segments found, and what happened to each Gaussian.
#[derive(Serialize)]
struct Report<'a> {
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

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Space {
    /// The colour of the material, regardless of its shading: hue first.
    Material,
    /// The mean colour as displayed, as in the paper; shading forms groups as well.
    Rgb,
    /// The mean colour in CIE Lab, with perceptual distances.
    Lab,
}

impl CoarseArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        if self.keep_surface_layers && self.space != Space::Material {
            return Err(CliError::input(
                "--keep-surface-layers: only --space material joins surface layers to bodies; omit one of the two",
            ));
        }
        let (_, device) = self.common.device()?;
        let run = self.data.of(OpenRun::open_to_write(&self.run, &device, &command_line(), Work::Short)?)?;
        let around = surroundings(&run, None);
        let time = self.time.of("--time", run.calibration())?;
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
        let mut outliers = OutlierConfig { radius: self.radius, ..OutlierConfig::default() };
        outliers.min_neighbours = self.min_neighbours.unwrap_or(outliers.min_neighbours);
        let options = CoarseOptions {
            clusters: self.clusters,
            space: match self.space {
                Space::Material => ColourSpace::Material,
                Space::Rgb => ColourSpace::Rgb,
                Space::Lab => ColourSpace::Lab,
            },
            min_opacity: self.min_opacity,
            keep_surface_layers: self.keep_surface_layers,
            outliers: (!self.keep_outliers).then_some(outliers),
            seed: self.seed,
        };
        let at = run.scene.host_at(time as f32);
        let found = segments.coarse(&run, &at, time, &options)?;
        if found.palette.is_empty() {
            return Err(CliError::input(format!("no segments found: of {n} Gaussians, {}", self.left_out(&found))));
        }
        segments.save()?;
        let all = segments.now();
        let path = run.paths().segment_sheet("coarse");
        write_picture(&path, &sheet(&run, &around, &at, &all.segments, &device))?;
        let (outliers, transparent, not_finite) = (found.outliers, found.transparent, found.not_finite);
        let in_segments = n - outliers - transparent - not_finite;
        if self.common.json {
            return print_json(&Report { all, in_segments, transparent, outliers, not_finite });
        }
        for segment in &all.segments {
            outln!("{:20} {:>8} Gaussians", segment.name, segment.members.len());
        }
        errln!("{in_segments} of {n} Gaussians are in segments; {}", self.left_out(&found));
        let shown = if all.segments.len() > SHOWN { format!(" of the first {SHOWN}") } else { String::new() };
        errln!("pictures{shown}: {}", path.display());
        Ok(())
    }

    /// The reasons why Gaussians are in no segment, with their numbers.
    fn left_out(&self, found: &Coarse) -> String {
        let mut parts = vec![
            format!(
                "{} are too transparent at all times (below --min-opacity {})",
                found.transparent, self.min_opacity
            ),
            format!("{} are outliers (few neighbours, and touching few; --keep-outliers keeps them)", found.outliers),
        ];
        if found.not_finite > 0 {
            parts.push(format!("{} have a non-finite position or colour", found.not_finite));
        }
        parts.join(", ")
    }
}
