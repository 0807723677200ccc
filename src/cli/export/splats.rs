//! `volseggs export` of Gaussians to files of other programs.

use super::super::{CliError, print_json, stop_flag};
use super::ExportArgs;
use crate::data::Calibration;
use crate::data::calibration::PhysicalSpace;
use crate::export::exporters::Exporter;
use crate::export::ply::MAX_SH_DEGREE;
use crate::log::progress;
use crate::model::Rendering;
use crate::run::OpenRun;
use crate::run::export::{
    ExportOutput, ExportRecord, ExportUnits, MEASURED, Refit, RefitPlan, SplatPlan, write_splats,
};
use std::sync::atomic::Ordering;
use volseggs_kernels::splat::DILATION;

/// Writes the Gaussians at each time.
///
/// # Errors
/// If there is no output path, nothing to write, or a file cannot be written.
pub(super) fn run(args: &ExportArgs, run: &OpenRun, format: &'static Exporter) -> Result<(), CliError> {
    let Some(out) = &args.out else {
        return Err(CliError::input("--out: give the file to write, such as --out scene.ply"));
    };
    let shown = args.shown.select(run)?;
    let times = args.times(run)?;
    let needed = [run.path.as_path()];
    let extension = format.extension;
    let output = ExportOutput::new(out, extension, args.frames.is_some(), &needed)?;
    let plan = SplatPlan {
        format,
        units: args.units(run)?,
        sh_degree: args.sh_degree.map_or(MAX_SH_DEGREE, usize::from),
        refit: RefitPlan::new(run, args.refit.map(|steps| steps as usize)),
    };
    let refit_steps = plan.refit_steps();
    let stop = stop_flag("stopping after this step; nothing is written")?;
    let bar = progress::bar(times.len() * (refit_steps + 1), if refit_steps > 0 { "steps" } else { "files" });
    let written = write_splats(run, &shown, &times, &output, &plan, || {
        bar.inc(1);
        !stop.load(Ordering::Relaxed)
    })?;
    bar.finish_and_clear();
    let Some(written) = written else { return Err(CliError::failure("interrupted; nothing is written")) };
    let files: Vec<String> = (0..times.len()).map(|i| output.paths_of(i).1.display().to_string()).collect();
    let edited = !args.shown.no_edits && !run.edits()?.operations.is_empty();
    let coordinates = Some(plan.units);
    let record = ExportRecord {
        refit_steps,
        coordinates,
        ..ExportRecord::new(run, extension, &times, edited, &args.shown.segments)
    };
    output.finish(&record, &needed)?;
    let (known, gaussians) = (run.calibration(), written.gaussians);
    let at = match times[..] {
        [time] => format!("at time {}", time_in_words(known, time)),
        _ => format!("{} files, times {} to {}", files.len(), time_in_words(known, 0.0), time_in_words(known, 1.0)),
    };
    let coordinates = match plan.units {
        ExportUnits::Physical => format!("physical coordinates ({})", known.length_unit()),
        ExportUnits::Scene => "scene coordinates".to_owned(),
    };
    errln!("{gaussians} Gaussians {at}, in {coordinates}: {}", out.display());
    if let (ExportUnits::Physical, Some(space)) = (plan.units, &known.space) {
        note_rounding(space);
    }
    if written.refits.is_empty() {
        note(run);
    } else {
        let mean = |psnr: fn(&Refit) -> f64| written.refits.iter().map(psnr).sum::<f64>() / files.len() as f64;
        errln!(
            "refitted, as other viewers draw Gaussians differently: their views have a PSNR of {:.1} dB against \
             `volseggs render`, without refitting {:.1} dB ({} views not used for it); --refit 0 writes it as trained",
            mean(|refit| refit.psnr_after),
            mean(|refit| refit.psnr_before),
            MEASURED
        );
    }
    if args.common.json {
        print_json(&serde_json::json!({
            "files": files, "gaussians": gaussians, "refit": written.refits, "times": times,
            "coordinates": plan.units, "calibration": known, "physical_times": record.physical_times,
        }))?;
    }
    Ok(())
}

/// A time in [0, 1] and, where it is known, that of the data.
fn time_in_words(known: &Calibration, time: f64) -> String {
    match &known.time {
        Some(known_time) => format!("{time} ({} {})", known_time.time(time), known_time.unit_name()),
        None => format!("{time}"),
    }
}

/// Tells if positions lose digits that the scene has, as files hold them in single precision.
fn note_rounding(space: &PhysicalSpace) {
    let farthest = space.centre.iter().fold(space.scale, |most, v| most.max(v.abs()));
    // half the distance to the next number, at worst
    let rounding = farthest * f64::from(f32::EPSILON);
    if rounding > 1e-4 * space.scale {
        errln!(
            "note: positions so far from the origin are rounded to about {rounding:.1e} {}, as files hold them in single \
             precision; scene coordinates keep all digits",
            space.unit_name()
        );
    }
}

/// Tells what other viewers show differently.
fn note(run: &OpenRun) {
    let Rendering { dilation, path_opacity, .. } = run.scene.spec.rendering();
    if dilation != DILATION {
        errln!(
            "note: trained with a dilation of {dilation} pixels squared, which the file cannot store; viewers that dilate \
             by {DILATION}, as most do, show it differently from `volseggs render`; --refit 300 adapts it"
        );
    }
    if path_opacity != 0.0 {
        errln!(
            "note: trained with opacities that depend on the direction of view (model.path_opacity = {path_opacity}), which \
             the file cannot store: other viewers draw it worse, by some decibels; --refit 300 adapts it"
        );
    }
}
