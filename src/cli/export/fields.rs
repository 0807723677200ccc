//! `volseggs export --fields`: fields of the scene on the voxels of the volume.

use super::super::{CliError, print_json};
use super::ExportArgs;
use crate::export::exporters::FieldWriter;
use crate::export::fields::FieldVolume;
use crate::log::progress;
use crate::run::OpenRun;
use crate::run::export::{ExportOutput, ExportRecord};
use crate::run::fields::{FieldKind, FieldPlan, RunFields};
use serde_json::json;

/// Writes the fields at each time.
///
/// # Errors
/// If the voxels are unknown, or a file cannot be written.
pub(super) fn run(
    args: &ExportArgs,
    run: &OpenRun,
    kinds: &[FieldKind],
    extension: &'static str,
    write: FieldWriter,
) -> Result<(), CliError> {
    let options = &args.labels;
    if let Some(flag) = options.for_labels_only() {
        return Err(CliError::input(format!("{flag}: only for labels; omit it, or omit --fields")));
    }
    let Some(out) = &args.out else {
        return Err(CliError::input("--out: give the file of the fields, such as --out fields.vti"));
    };
    let plan = FieldPlan { kinds: kinds.to_vec(), segments: args.shown.segments.clone(), ..options.field_plan() };
    let fields = RunFields::new(run, &plan)?;
    let times = args.times(run)?;
    fields.notes.iter().for_each(|note| errln!("note: {note}"));
    let mut needed = vec![run.path.as_path(), fields.data.as_path()];
    needed.extend(plan.like.as_deref());
    let output = ExportOutput::new(out, extension, args.frames.is_some(), &needed)?;
    let known = &fields.calibration;
    let bar = progress::bar(times.len(), "times");
    let (mut files, mut channels) = (Vec::new(), Vec::new());
    for (i, &time) in times.iter().enumerate() {
        let found = fields.fields_at(time)?;
        let volume = FieldVolume {
            grid: fields.grid.file,
            axes: fields.grid.axes,
            fields: &found,
            unit: fields.grid.unit.as_deref(),
            time: known.time(time),
            time_unit: known.time_unit(),
            edited: plan.edited,
        };
        let (path, name) = output.paths_of(i);
        write(&path, &volume)?;
        channels = volume.channels();
        files.push(name.display().to_string());
        bar.inc(1);
    }
    bar.finish_and_clear();
    output.finish(&ExportRecord::new(run, extension, &times, plan.edited, &plan.segments), &needed)?;
    let grid = fields.grid.file;
    let [x, y, z] = grid.dims;
    errln!(
        "{} on {x} x {y} x {z} voxels, spacing {:?}, origin {:?}; lengths: {}, times: {}: {}",
        channels.join(", "),
        grid.spacing,
        grid.origin,
        fields.length_unit(),
        known.time_unit(),
        out.display()
    );
    if args.common.json {
        let physical: Vec<f64> = times.iter().map(|time| known.time(*time)).collect();
        print_json(&json!({
            "files": files, "times": times, "physical_times": physical, "channels": channels, "dims": grid.dims,
            "spacing": grid.spacing, "origin": grid.origin, "directions": grid.directions, "length_unit": fields.length_unit(),
            "time_unit": known.time_unit(), "edited": plan.edited,
        }))?;
    }
    Ok(())
}
