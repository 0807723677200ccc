//! `volseggs export --format ply`

use super::super::run_folder::RunFolder;
use super::super::{CliError, print_json};
use super::ExportArgs;
use crate::export::scene::to_ply;
use std::path::PathBuf;

/// Writes the Gaussians of each time: edited, those of the segments alone, without those that edits hide.
///
/// # Errors
/// No place to write to, nothing to write, or a file that cannot be written.
pub(super) fn run(args: &ExportArgs, run: &RunFolder) -> Result<(), CliError> {
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
    let files = args.files(out, "ply")?;
    for (path, time) in &files {
        to_ply(shown.visible(&run.scene, *time as f32)?).write(path).map_err(CliError::failure)?;
    }
    let paths: Vec<&PathBuf> = files.iter().map(|(p, _)| p).collect();
    errln!("{} file(s), {count} Gaussians each: {}", files.len(), out.display());
    if args.common.json {
        print_json(&serde_json::json!({ "files": paths, "gaussians": count }))?;
    }
    Ok(())
}
