//! `volseggs export` of Gaussians to PLY and SPZ.

use super::super::{CliError, print_json};
use super::ExportArgs;
use crate::model::rendering::Rendering;
use crate::run::OpenRun;
use crate::run::export::{Output, Record, SplatFormat, write_splats};
use volseggs_kernels::splat::DILATION;

/// Writes the Gaussians at each time.
///
/// # Errors
/// If there is no output path, nothing to write, or a file cannot be written.
pub(super) fn run(args: &ExportArgs, run: &OpenRun, format: SplatFormat) -> Result<(), CliError> {
    let Some(out) = &args.out else {
        return Err(CliError::input("--out: give the file to write, such as --out scene.ply"));
    };
    let shown = args.shown.select(run)?;
    let times = args.times()?;
    let needed = [run.path.as_path()];
    let extension = format.extension();
    let output = if args.frames.is_some() {
        Output::folder(out, extension, &needed)
    } else {
        Output::file(out, extension, &needed)
    }?;
    // a command is never cancelled here
    let count = write_splats(run, &shown, &times, &output, format, || true)?.unwrap_or_default();
    let files: Vec<String> = (0..times.len()).map(|i| output.place(i).1.display().to_string()).collect();
    let edited = !args.shown.no_edits && !run.edits()?.operations.is_empty();
    output.finish(&Record::new(run, extension, &times, edited, &args.shown.segments), &needed)?;
    errln!("{} file(s), {count} Gaussians each: {}", files.len(), out.display());
    let Rendering { dilation, path_opacity, .. } = run.scene.spec.rendering();
    if dilation != DILATION {
        errln!(
            "note: trained with a dilation of {dilation} pixels squared, which the file cannot store; viewers that dilate \
             by {DILATION}, as most do, show it differently from `volseggs render`"
        );
    }
    if path_opacity != 0.0 {
        errln!(
            "note: trained with opacities that depend on the direction of view (model.path_opacity = {path_opacity}), which \
             the file cannot store: other viewers draw it worse, by a decibel or two; to export for them, train with \
             --set model.path_opacity=0"
        );
    }
    if args.common.json {
        print_json(&serde_json::json!({ "files": files, "gaussians": count }))?;
    }
    Ok(())
}
