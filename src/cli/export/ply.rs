//! `volseggs export` to PLY.

use super::super::{CliError, print_json};
use super::ExportArgs;
use super::output::Output;
use crate::export::ply::{self, PlyError};
use crate::run::OpenRun;

/// Writes the Gaussians of each time: edited, those of the segments alone, without those that edits hide.
///
/// # Errors
/// No place to write to, nothing to write, or a file that cannot be written.
pub(super) fn run(args: &ExportArgs, run: &OpenRun) -> Result<(), CliError> {
    let Some(out) = &args.out else {
        return Err(CliError::input("--out: say where to write to, such as --out scene.ply"));
    };
    let shown = args.shown.select(run)?;
    // what is hidden is so at every time
    let count = shown.visible(&run.scene, 0.0)?.len();
    if count == 0 {
        return Err(CliError::input(
            "nothing to write: no Gaussian is left; see `volseggs edit list`, or pass --no-edits",
        ));
    }
    let times = args.times()?;
    let needed = [run.path.as_path()];
    let output = if args.frames.is_some() { Output::folder(out, "ply", &needed) } else { Output::file(out, "ply") }?;
    let mut files = Vec::with_capacity(times.len());
    for (i, time) in times.iter().enumerate() {
        let (path, name) = output.place(i);
        let shown = shown.visible(&run.scene, *time as f32)?.with_unit_rotations();
        ply::write(&shown, &path).map_err(|e| match e {
            PlyError::Replace(e) => e.into(),
            e => CliError::failure(e),
        })?;
        files.push(name.display().to_string());
    }
    let edited = !args.shown.no_edits && !run.edits()?.operations.is_empty();
    output.finish(&args.record(run, "ply", &times, edited, &args.shown.segments), &needed)?;
    errln!("{} file(s), {count} Gaussians each: {}", files.len(), out.display());
    if args.common.json {
        print_json(&serde_json::json!({ "files": files, "gaussians": count }))?;
    }
    Ok(())
}
