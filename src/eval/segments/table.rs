//! Results in the shape of the paper's tables: a row for each segment and method at the chosen time, and for tracking
//! a row for each segment and time.

use super::measure::FrameScore;
use super::methods::Method;
use super::run::SegmentEvaluation;
use crate::draw::plot::{Series, line_plot};
use crate::draw::views::view_sheet;
use crate::eval::results::WriteError;
use crate::export::images::encode_png;
use crate::files::{AtomicDir, FolderKind};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::Path;

/// Means over the views of one time, or of all times.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Name of the segment.
    pub segment: String,
    /// The method.
    pub method: Method,
    /// Time in [0, 1]; none for the mean over all times.
    pub time: Option<f64>,
    /// Views.
    pub views: usize,
    /// Intersection over union, percent; none where the segment is nowhere, and nothing was shown.
    pub iou: Option<f64>,
    /// Decibels.
    pub psnr: f64,
    /// SSIM, RGB.
    pub ssim: f64,
    /// SSIM, grey.
    pub ssim_gray: f64,
    /// LPIPS, AlexNet; none without weights.
    pub lpips: Option<f64>,
}

impl Row {
    /// The means of `scores`; `None` if the segment is nowhere, and nothing was shown.
    #[must_use]
    pub fn mean(segment: &str, method: Method, time: Option<f64>, scores: &[&FrameScore]) -> Option<Self> {
        // a view in which the segment is not there, and nothing is shown, says nothing
        let scores: Vec<&FrameScore> = scores.iter().copied().filter(|s| s.iou.is_some()).collect();
        if scores.is_empty() {
            return None;
        }
        let of = |f: &dyn Fn(&FrameScore) -> Option<f64>| {
            let values: Vec<f64> = scores.iter().filter_map(|s| f(s)).collect();
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
        };
        Some(Self {
            segment: segment.into(),
            method,
            time,
            views: scores.len(),
            iou: of(&|s| s.iou).map(|v| 100.0 * v),
            psnr: of(&|s| Some(s.psnr)).unwrap_or_default(),
            ssim: of(&|s| Some(s.ssim)).unwrap_or_default(),
            ssim_gray: of(&|s| Some(s.ssim_gray)).unwrap_or_default(),
            lpips: of(&|s| s.lpips),
        })
    }
}

/// The table at the chosen time, as Markdown: what the terminal shows.
#[must_use]
pub fn markdown(evaluation: &SegmentEvaluation) -> String {
    let mut out = String::from(
        "| segment | method | IoU % | PSNR dB | SSIM | LPIPS | training, s | click, s |\n|---|---|--:|--:|--:|--:|--:|--:|\n",
    );
    let cell = |v: Option<f64>, digits: usize| v.map_or("-".into(), |v| format!("{v:.digits$}"));
    for result in &evaluation.results {
        let (row, training) = (&result.at, evaluation.training_seconds.get(result.method.name()));
        let seconds = (cell(training.copied().filter(|t| *t > 0.0), 1), cell(Some(result.click_seconds), 2));
        // writing to a String cannot fail
        let _ = match row {
            Some(r) => writeln!(
                out,
                "| {} | {} | {} | {:.2} | {:.3} | {} | {} | {} |",
                r.segment,
                r.method,
                cell(r.iou, 2),
                r.psnr,
                r.ssim,
                cell(r.lpips, 3),
                seconds.0,
                seconds.1
            ),
            None => writeln!(out, "| {} | {} | - | - | - | - | {} | - |", result.segment, result.method, seconds.0),
        };
    }
    out
}

fn csv(rows: &[&Row]) -> String {
    let mut out = String::from("segment,method,time,views,iou,psnr,ssim,ssim_gray,lpips_alex\n");
    let cell = |v: Option<f64>| v.map(|v| format!("{v:.6}")).unwrap_or_default();
    for r in rows {
        // writing to a String cannot fail
        let _ = writeln!(
            out,
            "{},{},{},{},{},{:.4},{:.6},{:.6},{}",
            r.segment,
            r.method,
            cell(r.time),
            r.views,
            cell(r.iou),
            r.psnr,
            r.ssim,
            r.ssim_gray,
            cell(r.lpips)
        );
    }
    out
}

/// The folder of an evaluation of segments.
pub const KIND: FolderKind = FolderKind {
    what: "an evaluation of segments",
    markers: &["segments.json"],
    entries: &["*.csv", "table.md", "*.svg", "segments.png"],
};

/// Writes `segments.json`, `segments.csv` (at the chosen time), `tracking.csv` (every time), `table.md`,
/// `iou-METHOD.svg` and `segments.png` into `folder`, in place of what was there.
///
/// # Errors
/// If something else stands there, or a file cannot be written.
pub fn write_results(folder: &Path, evaluation: &SegmentEvaluation) -> Result<(), WriteError> {
    if let Some(parent) = folder.parent() {
        std::fs::create_dir_all(parent).map_err(WriteError::at(parent))?;
    }
    let out = AtomicDir::create(folder).map_err(WriteError::at(folder))?;
    let put = |name: &str, bytes: &[u8]| std::fs::write(out.dir().join(name), bytes).map_err(WriteError::at(folder));
    put("segments.json", &serde_json::to_vec_pretty(evaluation).map_err(WriteError::at(folder))?)?;
    put("segments.csv", csv(&evaluation.results.iter().filter_map(|r| r.at.as_ref()).collect::<Vec<_>>()).as_bytes())?;
    put("tracking.csv", csv(&evaluation.results.iter().flat_map(|r| &r.times).collect::<Vec<_>>()).as_bytes())?;
    put("table.md", markdown(evaluation).as_bytes())?;
    for method in Method::ALL {
        let series: Vec<Series> = evaluation
            .results
            .iter()
            .filter(|r| r.method == method && r.times.len() > 1)
            .map(|r| Series {
                name: r.segment.clone(),
                points: r.times.iter().filter_map(|row| Some((row.time?, row.iou?))).collect(),
            })
            .collect();
        if !series.is_empty() {
            let plot = line_plot(&format!("IoU over time, {method}"), "time", "%", &series);
            put(&format!("iou-{}.svg", method.name().replace('+', "-")), plot.as_bytes())?;
        }
    }
    if !evaluation.pictures.is_empty() {
        let sheet = view_sheet(&evaluation.pictures, evaluation.columns, 300);
        put("segments.png", &encode_png(&sheet).map_err(WriteError::at(folder))?)?;
    }
    Ok(out.commit_replacing(&KIND, &[])?)
}
