//! `volseggs export` to PLY and SPZ: Gaussians.

use super::super::{CliError, print_json};
use super::ExportArgs;
use crate::run::OpenRun;
use crate::run::export::{Output, Record, SplatFormat, write_splats};
use volseggs_kernels::splat::DILATION;

/// Writes the Gaussians of each time.
///
/// # Errors
/// No place to write to, nothing to write, or a file that cannot be written.
pub(super) fn run(args: &ExportArgs, run: &OpenRun, format: SplatFormat) -> Result<(), CliError> {
    let Some(out) = &args.out else {
        return Err(CliError::input("--out: say where to write to, such as --out scene.ply"));
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
    // a command has nothing that stops it but its end
    let count = write_splats(run, &shown, &times, &output, format, || true)?.unwrap_or_default();
    let files: Vec<String> = (0..times.len()).map(|i| output.place(i).1.display().to_string()).collect();
    let edited = !args.shown.no_edits && !run.edits()?.operations.is_empty();
    output.finish(&Record::new(run, extension, &times, edited, &args.shown.segments), &needed)?;
    errln!("{} file(s), {count} Gaussians each: {}", files.len(), out.display());
    let dilation = run.scene.spec.rendering().dilation;
    if dilation != DILATION {
        errln!(
            "note: trained with a dilation of {dilation} pixels squared, which the file cannot say; viewers that dilate by \
             {DILATION}, as most do, do not show it as `volseggs render` does"
        );
    }
    if args.common.json {
        print_json(&serde_json::json!({ "files": files, "gaussians": count }))?;
    }
    Ok(())
}
