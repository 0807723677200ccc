//! Files of an evaluation (per-view table, means, contact sheet, PSNR over time), and the folder they go to.

use super::run::{Evaluation, Summary, to_csv};
use crate::draw::plot::{PlotSeries, line_plot};
use crate::export::images::encode_png;
use crate::files::{AtomicDir, FolderKind, WriteError, read_regular};
use crate::metrics::metric::headline;
use crate::versioned;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Kind of an evaluation's folder.
pub const KIND: FolderKind = FolderKind {
    what: "an evaluation",
    markers: &["mean.json"],
    entries: &["views.csv", "psnr-over-time.svg", "contact-sheet.png", "pictures/*.png"],
};

/// Identity of the data of an evaluation.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct DataId {
    /// Its folder.
    pub dataset: PathBuf,
    /// Its fingerprint; empty if it has no training views to compute one from.
    pub fingerprint: String,
}

/// Returns the folder, within the run's folder `eval`, for results called `what` (such as `test`) on `data`: `WHAT` for
/// the dataset that the run was trained on (`trained`, a fingerprint), `WHAT-NAME` for another, with its fingerprint
/// appended if `WHAT-NAME` holds results of yet another (or an unknown) dataset. `file` is the file there that
/// identifies the data, in its fields `dataset` and `fingerprint`.
pub fn results_folder(eval: &Path, what: &str, file: &str, data: &DataId, trained: &str) -> PathBuf {
    if data.fingerprint == trained && !trained.is_empty() {
        return eval.join(what);
    }
    let whole = std::fs::canonicalize(&data.dataset).unwrap_or_else(|_| data.dataset.clone());
    let fits = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '-' };
    let name: String = whole.file_name().unwrap_or_default().to_string_lossy().chars().map(fits).take(60).collect();
    let folder = eval.join(format!("{what}-{name}"));
    match owner(&folder.join(file)) {
        Some(owner) if owner != data.fingerprint => {
            let short = if data.fingerprint.is_empty() { "no-training-views" } else { &data.fingerprint };
            eval.join(format!("{what}-{name}-{short}"))
        }
        _ => folder,
    }
}

/// Returns the fingerprint of the data that the results in `file` are of; `None` if there are no results.
fn owner(file: &Path) -> Option<String> {
    let value: serde_json::Value = serde_json::from_slice(&read_regular(file).ok()?).ok()?;
    Some(value["fingerprint"].as_str().unwrap_or_default().to_owned())
}

/// Plots the first metric, PSNR, of each view over its time, as SVG.
pub fn headline_over_time(evaluation: &Evaluation) -> String {
    let mut points: Vec<(f64, f64)> = evaluation.views.iter().map(|v| (v.time, v.metrics.headline())).collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let series = [PlotSeries { name: evaluation.summary.split.clone(), points }];
    let display = headline();
    line_plot(&format!("{} over time", display.short), "time", display.unit, &series)
}

/// Writes `views.csv`, `mean.json`, `psnr-over-time.svg`, `contact-sheet.png` and `pictures/VIEW-{truth,render}.png`
/// into `folder`, which appears only when complete, replacing an earlier evaluation.
///
/// # Errors
/// If something else is there, or a file cannot be written.
pub fn write_results(folder: &Path, evaluation: &Evaluation) -> Result<(), WriteError> {
    let out = AtomicDir::create_replacing(folder, &KIND, &[])?;
    let write =
        |name: &str, bytes: &[u8]| std::fs::write(out.dir().join(name), bytes).map_err(WriteError::writing(folder));
    let summary: &Summary = &evaluation.summary;
    write("views.csv", to_csv(&evaluation.views).as_bytes())?;
    write("mean.json", &versioned::to_json_pretty(summary).map_err(WriteError::writing(folder))?)?;
    write("psnr-over-time.svg", headline_over_time(evaluation).as_bytes())?;
    if let Some(sheet) = &evaluation.sheet {
        write("contact-sheet.png", &encode_png(sheet).map_err(WriteError::writing(folder))?)?;
    }
    std::fs::create_dir(out.dir().join("pictures")).map_err(WriteError::writing(folder))?;
    for picture in &evaluation.pictures {
        // the name of a view may contain folders
        let name = picture.view.replace(['/', '\\'], "-");
        for (kind, image) in [("truth", &picture.truth), ("render", &picture.render)] {
            let png = encode_png(image).map_err(WriteError::writing(folder))?;
            write(&format!("pictures/{name}-{kind}.png"), &png)?;
        }
    }
    Ok(out.commit_replacing(&KIND, &[])?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_of_other_data_have_folders_of_their_own() {
        let dir = tempfile::tempdir().unwrap();
        let eval = dir.path().join("eval");
        let id = |folder: &str, print: &str| DataId { dataset: folder.into(), fingerprint: print.into() };
        let folder = |data: &DataId| results_folder(&eval, "test", "mean.json", data, "aaaa");
        assert_eq!(folder(&id("/moved/data", "aaaa")), eval.join("test"));
        let other = folder(&id("/one/other data", "bbbb"));
        assert_eq!(other, eval.join("test-other-data"));
        std::fs::create_dir_all(&other).unwrap();
        std::fs::write(other.join("mean.json"), "{\"fingerprint\": \"bbbb\"}").unwrap();
        assert_eq!(folder(&id("/one/other data", "bbbb")), other, "its own results are replaced");
        assert_eq!(folder(&id("/two/other data", "cccc")), eval.join("test-other-data-cccc"));
        assert_eq!(folder(&id("/one/views", "")), eval.join("test-views"));
        assert_eq!(results_folder(&eval, "test", "mean.json", &id("/x", ""), ""), eval.join("test-x"));
    }
}
