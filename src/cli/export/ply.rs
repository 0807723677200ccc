//! `volseggs export --format ply`

use super::super::run_folder::RunFolder;
use super::super::{CliError, print_json};
use super::ExportArgs;
use crate::export::ply::PlyGaussians;
use crate::export::scene::at_time;
use std::path::PathBuf;

/// Writes the Gaussians of each time.
///
/// # Errors
/// No place to write to, or a file that cannot be written.
pub(super) fn run(args: &ExportArgs, run: &RunFolder) -> Result<(), CliError> {
    let Some(out) = &args.out else {
        return Err(CliError::input("--out: say where to write to, such as --out scene.ply"));
    };
    let files = args.files(out, "ply")?;
    for (path, time) in &files {
        let ply: PlyGaussians = at_time(&run.scene, *time as f32);
        ply.write(path).map_err(CliError::failure)?;
    }
    let paths: Vec<&PathBuf> = files.iter().map(|(p, _)| p).collect();
    eprintln!("{} file(s), {} Gaussians each: {}", files.len(), run.scene.gaussians.count(), out.display());
    if args.common.json {
        print_json(&serde_json::json!({ "files": paths, "gaussians": run.scene.gaussians.count() }))?;
    }
    Ok(())
}
