//! `volseggs export --format nrrd|vti`: labels of segments on the voxels of the volume, and how well they agree with
//! the truth.

use super::super::run_folder::RunFolder;
use super::super::{CliError, print_json};
use super::label_grid::{choose, record};
use super::truth::{Agreement, Truth, report};
use super::{ExportArgs, Format};
use crate::export::labels::{LabelVolume, NamedLabel, Space, write_nrrd, write_vti};
use crate::log::progress;
use crate::segment::dice::Confusion;
use crate::segment::segmentation::Segmentation;
use crate::segment::voxels::{LabelledCloud, Vote, label_voxels};
use clap::{Args, ValueEnum};
use serde::Serialize;
use std::path::PathBuf;

/// Options of label volumes alone.
#[derive(Debug, Args)]
#[command(next_help_heading = "Labels on voxels (--format nrrd or vti)")]
pub(super) struct LabelArgs {
    /// Voxels along x, y, z; those of the prepared volume if not given.
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', num_args = 1, conflicts_with = "like")]
    dims: Option<Vec<usize>>,
    /// Volume file whose voxels to take: dims, spacing and origin.
    #[arg(long, value_name = "VOLUME")]
    like: Option<PathBuf>,
    /// The run's dataset, where it is not at its place any more.
    #[arg(long, value_name = "DATASET")]
    data: Option<PathBuf>,
    /// Density of Gaussians above which a voxel belongs to a segment; lower swells, higher wears off [default: 0.1].
    #[arg(long, value_name = "DENSITY", allow_negative_numbers = true)]
    threshold: Option<f32>,
    /// Where the axes of the volume point to, for NRRD readers that care.
    #[arg(long, value_enum, value_name = "SPACE")]
    space: Option<SpaceName>,
    /// Print Dice scores against the truth: label volumes in order of time (that of the nearest time is taken), or a
    /// synthetic scene: jets, vortices or shells.
    #[arg(long, value_name = "LABELS", num_args = 1..)]
    truth: Vec<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum SpaceName {
    /// A patient's left, back and head, as in 3D Slicer (the default).
    Lps,
    /// A patient's right, front and head, as in NIfTI.
    Ras,
    /// Nothing anatomical.
    None,
}

impl LabelArgs {
    /// The first of these options that is given.
    pub(super) fn given(&self) -> Option<&'static str> {
        let all = [
            ("--dims", self.dims.is_some()),
            ("--like", self.like.is_some()),
            ("--data", self.data.is_some()),
            ("--threshold", self.threshold.is_some()),
            ("--space", self.space.is_some()),
            ("--truth", !self.truth.is_empty()),
        ];
        all.into_iter().find(|(_, given)| *given).map(|(flag, _)| flag)
    }

    fn dims(&self) -> Result<Option<[usize; 3]>, CliError> {
        let Some(dims) = &self.dims else { return Ok(None) };
        let dims = <[usize; 3]>::try_from(dims.as_slice());
        dims.map(Some).map_err(|_| CliError::input("--dims: three numbers of voxels, such as --dims 128,128,64"))
    }
}

#[derive(Serialize)]
struct Report {
    dims: [usize; 3],
    spacing: [f64; 3],
    origin: [f64; 3],
    labels: Vec<Label>,
    volumes: Vec<Written>,
    /// Over all times together.
    #[serde(skip_serializing_if = "Option::is_none")]
    agreement: Option<Agreement>,
}

#[derive(Serialize)]
struct Label {
    value: u16,
    name: String,
}

#[derive(Serialize)]
struct Written {
    file: PathBuf,
    time: f64,
    /// Voxels of each label, in the order of `labels`.
    voxels: Vec<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    agreement: Option<Agreement>,
}

/// Writes the labels at each time, and compares them with the truth if that is given.
///
/// # Errors
/// Segments, voxels or a truth that cannot be used; a file that cannot be written.
pub(super) fn run(args: &ExportArgs, run: &RunFolder) -> Result<(), CliError> {
    let options = &args.labels;
    if let Some(t) = options.threshold.filter(|t| !(t.is_finite() && *t >= 0.0)) {
        return Err(CliError::input(format!("--threshold {t}: a density of at least 0")));
    }
    let all = run.segments()?;
    let names = names(args, &all)?;
    let labels = all.labels(&names).map_err(CliError::input)?;
    let listed = named(&names, &all)?;
    let selection = args.shown.select(run)?;
    let record = record(run, options.data.as_deref())?;
    let grid = choose(run, record.as_ref(), options.dims()?, options.like.as_deref())?;
    let data = options.data.as_deref().unwrap_or(&run.record.dataset);
    let truth = if options.truth.is_empty() { None } else { Some(Truth::open(&options.truth, &grid, data)?) };
    let vote = options.threshold.map_or(Vote::default(), |threshold| Vote { threshold, ..Vote::default() });

    let extension = if args.format == Format::Vti { "vti" } else { "nrrd" };
    let files = match &args.out {
        Some(out) => args.files(out, extension)?,
        None => {
            let folder = run.path.join("labels");
            let out = if args.frames.is_some() { folder.clone() } else { folder.join(format!("labels.{extension}")) };
            std::fs::create_dir_all(&folder).map_err(|e| CliError::failure(format!("{}: {e}", folder.display())))?;
            args.files(&out, extension)?
        }
    };
    let bar = progress::bar(files.len(), "times");
    let mut volumes = Vec::with_capacity(files.len());
    let mut whole = Confusion::default();
    for (path, time) in files {
        let at = selection.edited(&run.scene, time as f32)?;
        let cloud = LabelledCloud {
            means: &at.means,
            rotations: &at.rotations,
            log_scales: &at.log_scales,
            opacity: &at.opacity(),
            labels: &labels,
        };
        let ids = label_voxels(&cloud, &grid.scene, &vote).map_err(CliError::input)?;
        let volume = LabelVolume { grid: grid.file, ids: &ids, names: &listed };
        let written = match args.format {
            Format::Vti => write_vti(&path, &volume),
            Format::Nrrd | Format::Ply => write_nrrd(&path, &volume, space(options.space)),
        };
        written.map_err(CliError::failure)?;
        let mut agreement = None;
        if let Some(truth) = &truth {
            let pairs = Confusion::new(&truth.at(time)?, &ids).map_err(CliError::failure)?;
            agreement = Some(truth.agreement(&pairs, &names));
            whole.merge(&pairs);
        }
        volumes.push(Written { file: path, time, voxels: count(&ids, names.len()), agreement });
        bar.inc(1);
    }
    bar.finish_and_clear();
    let agreement = truth.map(|truth| truth.agreement(&whole, &names));
    let labels = listed.into_iter().map(|l| Label { value: l.value, name: l.name }).collect();
    let (dims, spacing, origin) = (grid.file.dims, grid.file.spacing, grid.file.origin);
    let found = Report { dims, spacing, origin, labels, volumes, agreement };
    if args.common.json { print_json(&found) } else { print(&found) }
}

/// The segments to write: those asked for, each once; else those that have no parts.
fn names(args: &ExportArgs, all: &Segmentation) -> Result<Vec<String>, CliError> {
    let mut names: Vec<String> = Vec::new();
    for name in &args.shown.segments {
        if !names.contains(name) {
            names.push(name.clone());
        }
    }
    if names.is_empty() {
        names = all.leaves();
    }
    if names.is_empty() {
        return Err(CliError::input(format!(
            "{}: no segments yet; run `volseggs segment coarse {}`",
            args.run.display(),
            args.run.display()
        )));
    }
    Ok(names)
}

fn named(names: &[String], all: &Segmentation) -> Result<Vec<NamedLabel>, CliError> {
    let mut listed = Vec::with_capacity(names.len());
    for (i, name) in names.iter().enumerate() {
        let value = u16::try_from(i + 1)
            .map_err(|_| CliError::input(format!("{} segments, at most 65535 fit a volume; name some", names.len())))?;
        let colour = all.get(name).map_err(CliError::input)?.colour.map(|c| c.clamp(0.0, 1.0));
        listed.push(NamedLabel { value, name: name.clone(), colour });
    }
    Ok(listed)
}

fn space(name: Option<SpaceName>) -> Space {
    match name {
        Some(SpaceName::Lps) | None => Space::LeftPosteriorSuperior,
        Some(SpaceName::Ras) => Space::RightAnteriorSuperior,
        Some(SpaceName::None) => Space::Plain,
    }
}

/// Voxels of the labels 1 to `labels`.
fn count(ids: &[u16], labels: usize) -> Vec<u64> {
    let mut counts = vec![0; labels + 1];
    for id in ids {
        counts[usize::from(*id)] += 1;
    }
    counts.split_off(1)
}

fn print(found: &Report) -> Result<(), CliError> {
    let [x, y, z] = found.dims;
    errln!("labels on {x} x {y} x {z} voxels, spacing {:?}, origin {:?}", found.spacing, found.origin);
    for volume in &found.volumes {
        let share = |(label, n): (&Label, &u64)| format!("{} {n}", label.name);
        let voxels: Vec<String> = found.labels.iter().zip(&volume.voxels).map(share).collect();
        outln!("{}  t = {:.3}  {}", volume.file.display(), volume.time, voxels.join(", "));
        let mean = volume.agreement.as_ref().and_then(|a| a.mean_dice);
        if let Some(mean) = mean.filter(|_| found.volumes.len() > 1) {
            outln!("  mean Dice {mean:.4}");
        }
    }
    found.agreement.iter().for_each(|agreement| out!("{}", report(agreement)));
    Ok(())
}
