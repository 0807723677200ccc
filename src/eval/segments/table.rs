//! Results as tables: a row per segment and method at the chosen time, and for tracking a row per segment and time.
//! Selections with fixed settings come first, and scores in space before those in pictures.

use super::method::SelectionMethod;
use super::result::{SegmentEvaluation, SegmentResult, SelectionMeans, SelectionOutcome, TimeRow};
use crate::draw::plot::{PlotSeries, line_plot};
use crate::draw::views::view_sheet;
use crate::export::images::encode_png;
use crate::files::{AtomicDir, FolderKind, WriteError};
use std::fmt::Write as _;
use std::path::Path;

/// Times that differ by less are one: the note shows three digits.
const SAME_TIME: f64 = 1e-3;

/// A share of labelled material that the note does not mention: what is left is rounding at the borders of segments.
const ALL_LABELLED: f64 = 0.995;

/// Formats the table at the chosen time as Markdown, as the terminal shows it: first what is selected with the fixed
/// setting of each method, in space and in pictures; then what the oracle selects; below it, what the numbers are based
/// on.
pub fn markdown(evaluation: &SegmentEvaluation) -> String {
    let asked = evaluation.oracle_tries > 0;
    let oracle = if asked { " oracle: 3D IoU % | min | 2D IoU % | min |" } else { "" };
    let mut out = format!(
        "| segment | method | 3D IoU % | min | 2D IoU % | min | PSNR dB | SSIM | LPIPS |{oracle} training, s | click, \
         s |\n|---|---|--:|--:|--:|--:|--:|--:|--:|{}--:|--:|\n",
        if asked { "--:|--:|--:|--:|" } else { "" }
    );
    // writing to a String cannot fail
    for r in &evaluation.results {
        let of = |o: &SelectionOutcome| SelectionMeans::mean(&[o]);
        let training = evaluation.training_seconds.get(r.method.name()).copied().filter(|t| *t > 0.0);
        let cells = cells(&of(&r.fixed), r.oracle.as_ref().map(of).as_ref().filter(|_| asked));
        let (training, click) = (cell(training, 1), cell(Some(r.fixed.click_seconds), 2));
        let _ = writeln!(out, "| {} | {} | {cells} | {training} | {click} |", r.segment, r.method);
    }
    for m in &evaluation.means {
        let cells = cells(&m.fixed, m.oracle.as_ref().filter(|_| asked));
        let _ = writeln!(out, "| **mean** | {} | {cells} | | |", m.method);
    }
    out + "\n" + &note(evaluation)
}

fn cells(fixed: &SelectionMeans, oracle: Option<&SelectionMeans>) -> String {
    let overlaps = |m: &SelectionMeans| [m.iou_3d, m.least_iou_3d, m.iou, m.least_iou].map(|v| cell(v, 2));
    let mut all = overlaps(fixed).to_vec();
    all.extend([cell(fixed.psnr, 2), cell(fixed.ssim, 3), cell(fixed.lpips, 3)]);
    all.extend(oracle.into_iter().flat_map(overlaps));
    all.join(" | ")
}

fn cell(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".into(), |v| format!("{v:.digits$}"))
}

/// Returns what the numbers are based on: views, times, seed, tries.
fn note(evaluation: &SegmentEvaluation) -> String {
    let views = |of: &dyn Fn(&TimeRow) -> usize| {
        let counts = || evaluation.results.iter().filter_map(|r| r.fixed.at.as_ref()).map(of);
        match (counts().min(), counts().max()) {
            (Some(least), Some(most)) if least == most => format!("{most}"),
            (Some(least), Some(most)) => format!("{least} to {most}"),
            _ => "0".into(),
        }
    };
    let times = evaluation.results.iter().map(|r| r.fixed.times.len()).max().unwrap_or(0);
    let mut out = format!(
        "Clicked at time {:.3}, at places chosen from the ground truth; settings fixed in advance, one try. Seed {}; \
         masks: {}, {} views. 2D: {} views per time that were not clicked ({} of them show the segment at the clicked \
         time), {times} times; \"min\" is the minimum over these times, with the Gaussians tracked.",
        evaluation.time,
        evaluation.seed,
        evaluation.masks,
        evaluation.mask_views,
        views(&|r| r.views),
        views(&|r| r.iou_views),
    );
    let of_pictures = elsewhere(evaluation, &|o| o.at.as_ref().map(|r| r.time));
    let in_space = elsewhere(evaluation, &|o| o.time_3d);
    for (what, time) in [("2D IoU, PSNR, SSIM and LPIPS are", of_pictures), ("3D IoU is", in_space)] {
        if let Some(time) = time {
            let _ = write!(out, " {what} of time {time}, the nearest to the clicked one that has ground truth.");
        }
    }
    if evaluation.oracle_tries > 0 {
        let _ = write!(
            out,
            " Oracle: the best of {} settings for each method and click, judged by the ground truth in the clicked \
             view, which no user has.",
            evaluation.oracle_tries
        );
    }
    if !evaluation.not_seen.is_empty() {
        let _ = write!(
            out,
            " Not visible at that time, so not clicked and excluded from the table and the means: {}.",
            evaluation.not_seen.join(", ")
        );
    }
    if !evaluation.partly_known.is_empty() {
        let _ = write!(
            out,
            " Part of something larger at some times, which are excluded for them: {}.",
            evaluation.partly_known.join(", ")
        );
    }
    match evaluation.volume_times.len() {
        0 => out.push_str(
            " 3D: the dataset has no volumes of segment ids; make it again with `volseggs prepare` to get them.",
        ),
        n => {
            let _ = write!(out, " 3D: cells of ground-truth volumes at {n} times, weighted by their opacity.");
        }
    }
    if let Some(share) = evaluation.labelled_share.filter(|share| *share < ALL_LABELLED) {
        let _ = write!(
            out,
            " {:.1} % of what is visible belongs to a segment; the rest counts against any selection that holds it.",
            100.0 * share
        );
    }
    out.push('\n');
    out
}

/// Returns the time, or the first and the last time, that figures of the clicked time are of; `None` if it is the
/// clicked one.
fn elsewhere(evaluation: &SegmentEvaluation, time: &dyn Fn(&SelectionOutcome) -> Option<f64>) -> Option<String> {
    let times = || evaluation.results.iter().filter_map(move |r| time(&r.fixed));
    if times().all(|t| (t - evaluation.time).abs() < SAME_TIME) {
        return None;
    }
    let [first, last] = [times().min_by(f64::total_cmp)?, times().max_by(f64::total_cmp)?];
    Some(if last - first < SAME_TIME { format!("{first:.3}") } else { format!("{first:.3} to {last:.3}") })
}

/// Returns the outcomes of all results with their names: the fixed setting's, then the oracle's.
fn outcomes(evaluation: &SegmentEvaluation) -> impl Iterator<Item = (&SegmentResult, &'static str, &SelectionOutcome)> {
    evaluation
        .results
        .iter()
        .flat_map(|r| std::iter::once((r, "fixed", &r.fixed)).chain(r.oracle.as_ref().map(|o| (r, "oracle", o))))
}

fn plain(value: Option<f64>, digits: usize) -> String {
    value.map(|v| format!("{v:.digits$}")).unwrap_or_default()
}

fn row_cells(r: &TimeRow) -> String {
    format!(
        "{:.6},{},{},{},{},{},{},{}",
        r.time,
        r.views,
        r.iou_views,
        plain(r.iou, 6),
        plain(r.psnr, 4),
        plain(r.ssim, 6),
        plain(r.ssim_gray, 6),
        plain(r.lpips, 6)
    )
}

const ROW_HEAD: &str = "time,views,iou_views,iou,psnr,ssim,ssim_gray,lpips_alex";

/// Formats the scores at the clicked time; `time` is that of the pictures, `time_3d` that of the volume.
fn csv_at(evaluation: &SegmentEvaluation) -> String {
    let mut out = format!("segment,method,setting,iou_3d,least_iou_3d,least_iou,{ROW_HEAD},time_3d\n");
    for (r, setting, o) in outcomes(evaluation) {
        let overlaps = [o.iou_3d, o.least_iou_3d, o.least_iou].map(|v| plain(v, 6)).join(",");
        let row = o.at.as_ref().map_or_else(|| ",".repeat(7), row_cells);
        // writing to a String cannot fail
        let _ = writeln!(out, "{},{},{setting},{overlaps},{row},{}", r.segment, r.method, plain(o.time_3d, 6));
    }
    out
}

/// Formats the scores of silhouettes and pictures at every time.
fn csv_tracking(evaluation: &SegmentEvaluation) -> String {
    let mut out = format!("segment,method,setting,{ROW_HEAD}\n");
    for (r, setting, o) in outcomes(evaluation) {
        for row in &o.times {
            let _ = writeln!(out, "{},{},{setting},{}", r.segment, r.method, row_cells(row));
        }
    }
    out
}

/// Formats the scores in space at every time that has a volume.
fn csv_volumes(evaluation: &SegmentEvaluation) -> String {
    let mut out = String::from("segment,method,setting,time,iou_3d\n");
    for (r, setting, o) in outcomes(evaluation) {
        for v in &o.volumes {
            let _ = writeln!(out, "{},{},{setting},{:.6},{}", r.segment, r.method, v.time, plain(v.iou_3d, 6));
        }
    }
    out
}

/// Kind of the folder of an evaluation of segments.
pub const KIND: FolderKind = FolderKind {
    what: "an evaluation of segments",
    markers: &["segments.json"],
    entries: &["*.csv", "table.md", "*.svg", "segments.png"],
};

/// Writes `segments.json`, `segments.csv` (at the chosen time), `tracking.csv` (pictures of every time), `volumes.csv`
/// (in space), `table.md`, `iou-METHOD.svg`, `iou-3d-METHOD.svg` and `segments.png` into `folder`, replacing what was
/// there.
///
/// # Errors
/// If something else is there, or a file cannot be written.
pub fn write_results(folder: &Path, evaluation: &SegmentEvaluation) -> Result<(), WriteError> {
    let out = AtomicDir::create_replacing(folder, &KIND, &[])?;
    let put =
        |name: &str, bytes: &[u8]| std::fs::write(out.dir().join(name), bytes).map_err(WriteError::writing(folder));
    put("segments.json", &serde_json::to_vec_pretty(evaluation).map_err(WriteError::writing(folder))?)?;
    put("segments.csv", csv_at(evaluation).as_bytes())?;
    put("tracking.csv", csv_tracking(evaluation).as_bytes())?;
    put("volumes.csv", csv_volumes(evaluation).as_bytes())?;
    put("table.md", markdown(evaluation).as_bytes())?;
    for method in SelectionMethod::ALL {
        let name = method.name().replace('+', "-");
        let flat = |o: &SelectionOutcome| o.times.iter().filter_map(|r| Some((r.time, r.iou?))).collect();
        let deep = |o: &SelectionOutcome| o.volumes.iter().filter_map(|v| Some((v.time, v.iou_3d?))).collect();
        let kinds: [(&str, &str, &PlotPoints); 2] = [("iou-3d", "3D IoU", &deep), ("iou", "2D IoU", &flat)];
        for (file, what, points) in kinds {
            let of = evaluation.results.iter().filter(|r| r.method == method);
            let series = of.map(|r| PlotSeries { name: r.segment.clone(), points: points(&r.fixed) });
            let series: Vec<PlotSeries> = series.filter(|s| s.points.len() > 1).collect();
            if !series.is_empty() {
                let plot = line_plot(&format!("{what} over time, {method}"), "time", "%", &series);
                put(&format!("{file}-{name}.svg"), plot.as_bytes())?;
            }
        }
    }
    if !evaluation.pictures.is_empty() {
        let sheet = view_sheet(&evaluation.pictures, evaluation.columns, 300);
        put("segments.png", &encode_png(&sheet).map_err(WriteError::writing(folder))?)?;
    }
    Ok(out.commit_replacing(&KIND, &[])?)
}

/// Function from an outcome to the points of a plot.
type PlotPoints = dyn Fn(&SelectionOutcome) -> Vec<(f64, f64)>;

#[cfg(test)]
mod tests {
    use super::super::measure::FrameScore;
    use super::super::result::VolumeScore;
    use super::*;
    use crate::eval::results::DataId;
    use std::collections::BTreeMap;

    fn empty() -> SegmentEvaluation {
        SegmentEvaluation {
            data: DataId::default(),
            time: 0.5,
            masks: "regions".to_owned(),
            mask_views: 4,
            seed: 0,
            oracle_tries: 0,
            volume_times: Vec::new(),
            partly_known: Vec::new(),
            labelled_share: None,
            palette: Vec::new(),
            training_seconds: BTreeMap::new(),
            means: Vec::new(),
            not_seen: Vec::new(),
            results: Vec::new(),
            pictures: Vec::new(),
            columns: 1,
        }
    }

    #[test]
    fn the_times_of_figures_are_named_where_they_are_not_the_clicked_one() {
        let of = |flat: f64, deep: f64| {
            let mut evaluation = empty();
            let score = FrameScore { time: flat, iou: Some(0.5), picture: None };
            let mut fixed = SelectionOutcome::default();
            fixed.fill(0.5, &[score], vec![VolumeScore { time: deep, iou_3d: Some(70.0) }]);
            let (segment, view) = ("core".to_owned(), "r_000".to_owned());
            let result =
                SegmentResult { segment, method: SelectionMethod::Coarse, view, pixel: [0; 2], fixed, oracle: None };
            evaluation.results.push(result);
            (markdown(&evaluation), csv_at(&evaluation))
        };
        let (note, csv) = of(0.5, 0.5004);
        assert!(!note.contains("of time"), "{note}");
        let lines: Vec<&str> = csv.lines().collect();
        assert!(lines[0].ends_with(",lpips_alex,time_3d") && lines[1].ends_with(",,0.500400"), "{csv}");
        assert_eq!(lines[0].split(',').count(), lines[1].split(',').count());
        let (note, csv) = of(0.492, 0.5254);
        assert!(note.contains("LPIPS are of time 0.492") && note.contains("3D IoU is of time 0.525"), "{note}");
        assert!(csv.contains(",0.492000,1,1,50.000000,") && csv.ends_with(",0.525400\n"), "{csv}");
        // without pictures and volumes
        let mut none = empty();
        let (segment, view, fixed) = ("core".to_owned(), "r_000".to_owned(), SelectionOutcome::default());
        none.results.push(SegmentResult {
            segment,
            method: SelectionMethod::Coarse,
            view,
            pixel: [0; 2],
            fixed,
            oracle: None,
        });
        let csv = csv_at(&none);
        let columns: Vec<usize> = csv.lines().map(|l| l.split(',').count()).collect();
        assert_eq!(columns[0], columns[1], "{csv}");
        assert!(!markdown(&none).contains("of time"));
    }

    #[test]
    fn the_note_says_how_much_of_what_is_visible_belongs_to_no_segment() {
        let mut evaluation = empty();
        for (share, words) in [(None, None), (Some(1.0), None), (Some(0.649), Some("64.9 % of what is visible"))] {
            evaluation.labelled_share = share;
            let note = markdown(&evaluation);
            assert_eq!(note.contains("of what is visible"), words.is_some(), "{note}");
            assert!(words.is_none_or(|w| note.contains(w)), "{note}");
        }
    }

    #[test]
    fn the_note_names_segments_that_were_not_seen() {
        let mut evaluation = empty();
        let json = |e: &SegmentEvaluation| serde_json::to_string(e).unwrap();
        assert!(!markdown(&evaluation).contains("Not visible") && !json(&evaluation).contains("not_seen"));
        evaluation.not_seen = vec!["tube-c".into(), "tube-d".into()];
        assert!(markdown(&evaluation).contains("Not visible") && markdown(&evaluation).contains("tube-c, tube-d."));
        assert!(json(&evaluation).contains(r#""not_seen":["tube-c","tube-d"]"#));
    }
}
