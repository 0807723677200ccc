//! `volseggs inspect` on volumes and transfer functions: their contents, and a picture of both.

use super::{CliError, print_json};
use crate::export::images::encode_png;
use crate::files::write_named;
use crate::volume::formats::format_of;
use crate::volume::picture::{HistogramBins, transfer_picture};
use crate::volume::series::{Series, SeriesOptions, SeriesScan};
use crate::volume::source::VolumeVariable;
use crate::volume::transfer::TransferFunction;
use serde_json::json;
use std::path::Path;

/// Maximum number of bars of the histogram.
const BINS: usize = 256;

/// Whether a path is a volume, a folder of volumes or a glob.
pub(super) fn is_volume(path: &Path) -> bool {
    let in_folder = || {
        let entries = std::fs::read_dir(path).ok()?;
        entries.flatten().find(|e| format_of(&e.path()).is_some())
    };
    format_of(path).is_some() || path.to_string_lossy().contains(['*', '?']) || in_folder().is_some()
}

/// Prints a volume or series, and draws its histogram under a transfer function.
pub(super) fn inspect_volume(
    path: &Path,
    transfer: Option<&str>,
    variable: Option<String>,
    picture: Option<&Path>,
    as_json: bool,
) -> Result<(), CliError> {
    let inputs = [path.to_string_lossy().into_owned()];
    // gaps and voxels that are not finite are reported, not rejected, so that this command can be used to find them;
    // what replaces the voxels counts neither in the range nor in the histogram, and 0 is a whole number like any other
    let options = SeriesOptions { nan_as: Some(0.0), variable, ..SeriesOptions::default() };
    let (series, gap) = match Series::open(&inputs, &options) {
        Ok(series) => (series, None),
        Err(e) => {
            let options = SeriesOptions { allow_gaps: true, ignore_origin: true, ..options };
            (Series::open(&inputs, &options)?, Some(e.to_string()))
        }
    };
    let SeriesScan { range, not_finite } = series.scan()?;
    let grid = series.grid();
    let skipped = (not_finite > 0).then(|| {
        format!(
            "{not_finite} voxels of all steps are NaN, infinite or too large; range and histogram are of the others, \
             and prepare needs --nan VALUE"
        )
    });
    let notes: Vec<String> =
        series.notes().iter().cloned().chain(gap).chain(skipped).chain(series.rounding()).collect();
    let variables = series.variables()?;
    // before anything is printed, as either can fail
    let function = match transfer.or(picture.map(|_| "ramp")) {
        Some(spec) => {
            let tf = TransferFunction::load(spec)?;
            let span = tf.span(series.range()?.map(f64::from));
            Some((tf, span))
        }
        None => None,
    };
    let physical = series.physical();
    let orientation = grid.directions.code(physical.axes);
    if as_json {
        print_json(&json!({
            "kind": "volume", "steps": series.len(), "dims": grid.dims, "spacing": grid.spacing,
            "origin": grid.origin, "directions": grid.directions, "orientation": orientation, "axes": physical.axes,
            "length_unit": physical.length_unit, "time_values": series.time_values(), "time_unit": series.time_unit(),
            "type": series.scalar().name(), "range": range,
            "not_finite": not_finite, "variable": series.variable(), "variables": variables, "notes": notes,
            "transfer_function": function.as_ref().filter(|_| transfer.is_some()).map(|(tf, span)| json!({ "name": tf.name, "span": span })),
        }))?;
    } else {
        outln!("steps    {} ({} .. {})", series.len(), series.name(0), series.name(series.len() - 1));
        outln!("dims     {} x {} x {}", grid.dims[0], grid.dims[1], grid.dims[2]);
        let unit = physical.length_unit.as_deref().unwrap_or("(no unit)");
        let [[sx, sy, sz], [ox, oy, oz]] = [grid.spacing, grid.origin];
        outln!("spacing  {sx} x {sy} x {sz} {unit}");
        outln!("origin   {ox}, {oy}, {oz}");
        outln!("axes     {orientation}");
        if let Some(&[first, .., last]) = series.time_values() {
            outln!("times    {first} .. {last} {}", series.time_unit().unwrap_or("(no unit)"));
        }
        outln!("type     {}", series.scalar().name());
        if let Some(read) = series.variable() {
            let array = |v: &VolumeVariable| match (v.name == read, v.components) {
                (true, _) => format!("{} (read)", v.name),
                (false, 1) => v.name.clone(),
                (false, n) => format!("{} ({n} components)", v.name),
            };
            outln!("arrays   {}", variables.iter().map(array).collect::<Vec<_>>().join(", "));
        }
        match range {
            Some([low, high]) => outln!("range    {low} .. {high}"),
            None => outln!("range    none: no voxel is finite"),
        }
        if let Some((tf, [low, high])) = function.as_ref().filter(|_| transfer.is_some()) {
            outln!("transfer function {}: ok, over the values {low} .. {high}", tf.name);
        }
        notes.iter().for_each(|n| outln!("note: {n}"));
    }
    if let (Some(file), Some((tf, span))) = (picture, function) {
        let middle = series.len() / 2;
        let whole = series.load(middle)?.values.iter().all(|v| v.fract() == 0.0);
        let bins = HistogramBins::new(span, whole, BINS);
        let range = bins.range.map(|v| v as f32);
        let histogram = series.histogram(middle, bins.count, range)?;
        let title = format!("{} - {}", tf.name, series.name(middle));
        let picture = transfer_picture(&histogram, bins.range, span, &tf, &title);
        write_named(file, &encode_png(&picture).map_err(CliError::failure)?)?;
        errln!("histogram and transfer function: {}", file.display());
    }
    Ok(())
}
