//! The files of an evaluation: per-view table, means, contact sheet, PSNR over time.

use super::run::{Evaluation, to_csv};
use crate::draw::plot::{Series, line_plot};
use crate::export::images::encode_png;
use crate::files::write_atomic;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A file that could not be written.
#[derive(Debug, Error)]
#[error("{}: {reason}", path.display())]
pub struct WriteError {
    path: PathBuf,
    reason: String,
}

/// PSNR of each view over its time, as SVG.
#[must_use]
pub fn psnr_over_time(evaluation: &Evaluation) -> String {
    let mut points: Vec<(f64, f64)> = evaluation.views.iter().map(|v| (v.time, v.psnr)).collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let series = [Series { name: evaluation.summary.split.clone(), points }];
    line_plot("PSNR over time", "time", "dB", &series)
}

/// Writes `views.csv`, `mean.json`, `psnr-over-time.svg`, `contact-sheet.png` and `pictures/VIEW-{truth,render}.png`
/// into `folder`, which is made.
///
/// # Errors
/// The first file that cannot be written.
pub fn write_results(folder: &Path, evaluation: &Evaluation) -> Result<(), WriteError> {
    let error = |path: &Path, e: &dyn std::fmt::Display| WriteError { path: path.into(), reason: e.to_string() };
    std::fs::create_dir_all(folder).map_err(|e| error(folder, &e))?;
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        write_atomic(&path, bytes).map_err(|e| error(&path, &e))
    };
    write("views.csv", to_csv(&evaluation.views).as_bytes())?;
    write("mean.json", &serde_json::to_vec_pretty(&evaluation.summary).map_err(|e| error(folder, &e))?)?;
    write("psnr-over-time.svg", psnr_over_time(evaluation).as_bytes())?;
    if let Some(sheet) = &evaluation.sheet {
        write("contact-sheet.png", &encode_png(sheet).map_err(|e| error(folder, &e))?)?;
    }
    let pictures = folder.join("pictures");
    std::fs::create_dir_all(&pictures).map_err(|e| error(&pictures, &e))?;
    for picture in &evaluation.pictures {
        // a view's name may hold folders
        let name = picture.view.replace(['/', '\\'], "-");
        for (kind, image) in [("truth", &picture.truth), ("render", &picture.render)] {
            write(&format!("pictures/{name}-{kind}.png"), &encode_png(image).map_err(|e| error(&pictures, &e))?)?;
        }
    }
    Ok(())
}
