//! `volseggs export` to NRRD and VTI: segment labels on the voxels of the volume, and their agreement with the ground
//! truth.

use super::super::values::fraction_f32;
use super::super::{CliError, print_json};
use super::ExportArgs;
use crate::data::calibration::AxisConvention;
use crate::export::exporters::LabelWriter;
use crate::log::progress;
use crate::run::OpenRun;
use crate::run::export::{ExportOutput, ExportRecord, write_labels};
use crate::run::fields::FieldPlan;
use crate::run::labels::{Agreement, LabelPlan, LabelTruth, RunLabels, VoxelLabels};
use crate::segment::dice::Confusion;
use crate::volume::directions::Directions;
use crate::volume::grid::Grid;
use clap::{Args, ValueEnum};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Options for label volumes only.
#[derive(Debug, Args)]
#[command(next_help_heading = "Labels and fields on voxels (.nrrd, .vti, .npy)")]
pub(super) struct LabelArgs {
    /// Voxels along the axes x, y, z of space, over the box around the volume; those of the prepared volume if not given.
    #[arg(long, value_name = "X,Y,Z", value_parser = voxels, conflicts_with = "like")]
    dims: Option<[usize; 3]>,
    /// Volume file whose voxels to label, at their places: number, spacing, origin and directions.
    #[arg(long, value_name = "VOLUME")]
    like: Option<PathBuf>,
    /// Share of a segment's typical opacity down to which a voxel belongs to it; lower values enlarge segments, higher
    /// ones shrink them [default: 0.5].
    #[arg(long, value_name = "SHARE", value_parser = fraction_f32, allow_negative_numbers = true)]
    threshold: Option<f32>,
    /// Take the scene with the edits of the run applied; if not given, as trained.
    #[arg(long, conflicts_with = "no_edits")]
    edited: bool,
    /// Space that an NRRD file states; if not given, that of the data, or none where they name none.
    #[arg(long, value_enum, value_name = "SPACE")]
    space: Option<SpaceName>,
    /// Print Dice scores against the ground truth: label volumes in order of time (the one nearest in time is used), or
    /// a synthetic scene as in `prepare --synthetic`.
    #[arg(long, value_name = "LABELS", num_args = 1..)]
    truth: Vec<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum SpaceName {
    /// Left-posterior-superior, as in DICOM; coordinates of data in RAS are converted.
    Lps,
    /// Right-anterior-superior, as in NIfTI; coordinates of data in LPS are converted.
    Ras,
    /// State no space, with the coordinates of the data.
    None,
}

impl LabelArgs {
    fn plan(&self, segments: Vec<String>) -> LabelPlan {
        let Self { dims, threshold, edited, .. } = *self;
        LabelPlan { segments, dims, like: self.like.clone(), threshold, edited }
    }

    /// The voxels and the scene of fields.
    pub(super) fn field_plan(&self) -> FieldPlan {
        let Self { dims, edited, .. } = *self;
        FieldPlan { dims, like: self.like.clone(), edited, ..FieldPlan::default() }
    }

    /// The first option given that fields do not have.
    pub(super) fn for_labels_only(&self) -> Option<&'static str> {
        let all = [
            ("--threshold", self.threshold.is_some()),
            ("--space", self.space.is_some()),
            ("--truth", !self.truth.is_empty()),
        ];
        all.into_iter().find(|(_, given)| *given).map(|(flag, _)| flag)
    }

    /// The meaning of the axes of space that the file states, if chosen.
    fn space(&self) -> Option<Option<AxisConvention>> {
        self.space.map(|name| match name {
            SpaceName::Lps => Some(AxisConvention::LeftPosteriorSuperior),
            SpaceName::Ras => Some(AxisConvention::RightAnteriorSuperior),
            SpaceName::None => None,
        })
    }

    /// The first of these options that was given.
    pub(super) fn given(&self) -> Option<&'static str> {
        let all = [
            ("--dims", self.dims.is_some()),
            ("--like", self.like.is_some()),
            ("--threshold", self.threshold.is_some()),
            ("--edited", self.edited),
            ("--space", self.space.is_some()),
            ("--truth", !self.truth.is_empty()),
        ];
        all.into_iter().find(|(_, given)| *given).map(|(flag, _)| flag)
    }
}

/// Parses the numbers of voxels along x, y, z.
fn voxels(text: &str) -> Result<[usize; 3], String> {
    let number = |t: &str| t.trim().parse::<usize>().ok().filter(|n| *n >= 2);
    let numbers = text.split(',').map(number).collect::<Option<Vec<_>>>();
    numbers
        .and_then(|n| n.try_into().ok())
        .ok_or_else(|| "expected three numbers such as 128,128,64, at least 2 voxels along each axis".to_owned())
}

#[derive(Serialize)]
struct LabelExportReport {
    dims: [usize; 3],
    spacing: [f64; 3],
    origin: [f64; 3],
    directions: Directions,
    /// The letters of the directions, such as `LPS`.
    orientation: String,
    /// What the axes of space mean, and the unit of length; null where the data do not say.
    axes: Option<AxisConvention>,
    unit: Option<String>,
    /// Whether the edits of the run are applied.
    edited: bool,
    labels: Vec<NamedValue>,
    volumes: Vec<WrittenLabels>,
    /// Over all times.
    #[serde(skip_serializing_if = "Option::is_none")]
    agreement: Option<Agreement>,
}

#[derive(Serialize)]
struct NamedValue {
    value: u16,
    name: String,
}

#[derive(Serialize)]
struct WrittenLabels {
    file: String,
    time: f64,
    /// Voxels of each label, in the order of `labels`.
    voxels: Vec<u64>,
    /// Share of each segment's content whose Gaussians lie in its place; `null` if none is visible.
    counted_shares: Vec<Option<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    agreement: Option<Agreement>,
}

/// Writes the labels at each time, and compares them with the ground truth if given.
///
/// # Errors
/// If the segments, voxels or ground truth cannot be used, or a file cannot be written.
pub(super) fn run(
    args: &ExportArgs,
    run: &OpenRun,
    extension: &'static str,
    write: LabelWriter,
    states_space: bool,
) -> Result<(), CliError> {
    let (options, space) = (&args.labels, args.labels.space());
    if options.space.is_some() && !states_space {
        return Err(CliError::input("--space: only NRRD files store it; omit it, or write .nrrd"));
    }
    let labels = RunLabels::new(run, &options.plan(args.shown.segments.clone()))?;
    let times = args.times(run)?;
    let truth = match options.truth.as_slice() {
        [] => None,
        inputs => Some(LabelTruth::open(inputs, &labels.grid, &labels.data, &times)?),
    };
    labels.notes.iter().for_each(|note| errln!("note: {note}"));
    truth.iter().flat_map(|truth| truth.notes()).for_each(|note| errln!("note: {note}"));
    if !options.edited {
        note_unapplied_edits(run);
    }

    let mut needed = vec![run.path.as_path(), labels.data.as_path()];
    needed.extend(options.like.as_deref());
    needed.extend(truth.iter().flat_map(LabelTruth::files));
    let output = output(args, run, extension, &needed)?;
    let bar = progress::bar(times.len(), "times");
    let mut volumes = Vec::with_capacity(times.len());
    let mut whole = Confusion::default();
    for (i, &time) in times.iter().enumerate() {
        let VoxelLabels { ids, shares } = labels.labels_at(time)?;
        let (path, name) = output.paths_of(i);
        write_labels(&path, &labels, &ids, options.edited, write, space)?;
        let mut agreement = None;
        if let Some(truth) = &truth {
            let pairs = Confusion::new(&truth.labels_at(time)?, &ids).map_err(CliError::failure)?;
            agreement = Some(truth.agreement(&pairs, &labels.names));
            whole.merge(&pairs);
        }
        let file = name.display().to_string();
        volumes.push(WrittenLabels {
            file,
            time,
            voxels: count(&ids, labels.names.len()),
            counted_shares: shares,
            agreement,
        });
        bar.inc(1);
    }
    bar.finish_and_clear();
    output.finish(&ExportRecord::new(run, extension, &times, options.edited, &labels.names), &needed)?;
    let agreement = truth.map(|truth| truth.agreement(&whole, &labels.names));
    let (Grid { dims, spacing, origin, directions }, axes) = labels.grid.stated(space);
    let (orientation, unit) = (directions.code(axes), labels.grid.unit.clone());
    let labels = labels.listed.iter().map(|l| NamedValue { value: l.value, name: l.name.clone() }).collect();
    let edited = options.edited;
    let found = LabelExportReport {
        dims,
        spacing,
        origin,
        directions,
        orientation,
        axes,
        unit,
        edited,
        labels,
        volumes,
        agreement,
    };
    if args.common.json { print_json(&found) } else { print(&found) }
}

/// The given output path, or one in `RUN/labels`, which is created.
fn output(
    args: &ExportArgs,
    run: &OpenRun,
    extension: &'static str,
    needed: &[&Path],
) -> Result<ExportOutput, CliError> {
    let many = args.frames.is_some();
    Ok(match &args.out {
        Some(out) => ExportOutput::new(out, extension, many, needed)?,
        None => ExportOutput::within(&run.paths().labels(), "labels", extension, many, needed)?,
    })
}

/// Prints that edits are not applied, if there are any. An unreadable file of edits is ignored here.
fn note_unapplied_edits(run: &OpenRun) {
    let edits = run.edits().map_or(0, |edits| edits.operations.len());
    if edits > 0 {
        errln!(
            "note: the labels describe the scene as trained, which matches the data; --edited applies the edits of the \
             run ({edits})"
        );
    }
}

/// Number of voxels of each label from 1 to `labels`.
fn count(ids: &[u16], labels: usize) -> Vec<u64> {
    let mut counts = vec![0; labels + 1];
    for id in ids {
        counts[usize::from(*id)] += 1;
    }
    counts.split_off(1)
}

fn print(found: &LabelExportReport) -> Result<(), CliError> {
    let [x, y, z] = found.dims;
    let state = if found.edited { "as edited" } else { "as trained" };
    errln!(
        "labels of the scene {state} on {x} x {y} x {z} voxels, spacing {:?}, origin {:?}, axes {}, unit {}",
        found.spacing,
        found.origin,
        found.orientation,
        found.unit.as_deref().unwrap_or("unknown")
    );
    for volume in &found.volumes {
        let share = |((label, n), share): ((&NamedValue, &u64), &Option<f64>)| match share {
            Some(share) => format!("{} {n} ({:.0} % of its content)", label.name, 100.0 * share),
            None => format!("{} {n}", label.name),
        };
        let counts = found.labels.iter().zip(&volume.voxels).zip(&volume.counted_shares);
        let voxels: Vec<String> = counts.map(share).collect();
        outln!("{}  t = {:.3}  {}", volume.file, volume.time, voxels.join(", "));
        let mean = volume.agreement.as_ref().and_then(|a| a.mean_dice);
        if let Some(mean) = mean.filter(|_| found.volumes.len() > 1) {
            outln!("  mean Dice {mean:.4}");
        }
    }
    found.agreement.iter().for_each(|agreement| out!("{}", table(agreement)));
    Ok(())
}

/// The scores as lines for the terminal.
fn table(agreement: &Agreement) -> String {
    let mut text = format!("{:<20} {:<20} {:>7} {:>7}   {}\n", "truth", "segment", "Dice", "IoU", "combined");
    for s in &agreement.segments {
        let segment = s.segment.as_deref().unwrap_or("-");
        let set = if s.set.len() > 1 { format!("{:.4} {}", s.set_dice, s.set.join(" + ")) } else { String::new() };
        // writing to a string cannot fail
        let _ = writeln!(
            text,
            "{}",
            format!("{:<20} {segment:<20} {:>7.4} {:>7.4}   {set}", s.truth, s.dice, s.iou).trim_end()
        );
    }
    match (agreement.mean_dice, agreement.mean_dice_of_sets) {
        (Some(one), Some(set)) => {
            let _ = writeln!(text, "mean Dice {one:.4}; {set:.4} with several segments for one true label");
        }
        _ => text.push_str("the ground truth has no labels\n"),
    }
    text
}
