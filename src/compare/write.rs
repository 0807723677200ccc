//! The files of a comparison: report.md, report.html, table.tex, results.csv, results.json, and TensorBoard logs.

use super::html::report;
use super::results::{OutcomeState, ResultSet, VariantOutcome};
use super::table::{Ordering, ResultTable, orderings};
use super::text;
use super::{curves, metric::MetricColumn};
use crate::files::{AtomicDir, FolderKind, WriteError, write_atomic};
use crate::log::tensorboard::{EventWriter, HyperParameter, SessionEnd};
use crate::report::{ReportBlock, ReportError};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Returns the table of `set` as Markdown, with differences, orderings and failures.
pub fn table_text(set: &ResultSet) -> String {
    let table = ResultTable::new(set);
    text::markdown(&table, &orderings(&table))
}

/// The folder of a comparison.
const FOLDER: FolderKind = FolderKind {
    what: "a comparison",
    markers: &["results.json"],
    entries: &["report.md", "report.html", "table.tex", "results.csv", "tensorboard/**"],
};

/// Writes a report to `folder`, which appears as a whole once it is complete and replaces an older comparison there,
/// unless that contains one of the runs. Returns the Markdown.
///
/// # Errors
/// If something else is there, or a file cannot be written; an older comparison is then unchanged.
pub fn replace_report(folder: &Path, set: &ResultSet) -> Result<String, WriteError> {
    let needed: Vec<&Path> = set.outcomes.iter().map(|outcome| outcome.run.as_path()).collect();
    let building = AtomicDir::create_replacing(folder, &FOLDER, &needed)?;
    let markdown = write_report(building.dir(), set).map_err(|e| match e {
        // not under the name that it has while it is built
        WriteError::File { path, reason } => {
            let inner = path.strip_prefix(building.dir()).unwrap_or(&path);
            WriteError::File { path: folder.join(inner), reason }
        }
        other => other,
    })?;
    building.commit_replacing(&FOLDER, &needed)?;
    Ok(markdown)
}

/// Writes all files of a report into `folder`, which is created if missing and may hold other files, one by one, and
/// returns the Markdown.
///
/// # Errors
/// The first file that cannot be written.
pub fn write_report(folder: &Path, set: &ResultSet) -> Result<String, WriteError> {
    std::fs::create_dir_all(folder).map_err(WriteError::writing(folder))?;
    let table = ResultTable::new(set);
    let orderings = orderings(&table);
    let markdown = text::markdown(&table, &orderings);
    let put = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        write_atomic(&path, bytes).map_err(WriteError::writing(&path))
    };
    put("report.md", markdown.as_bytes())?;
    put("table.tex", text::latex(&table).as_bytes())?;
    put("results.csv", text::csv(set).as_bytes())?;
    let json = serde_json::to_vec_pretty(&text::json(&table, &orderings)).map_err(WriteError::writing(folder))?;
    put("results.json", &json)?;
    tensorboard(folder, set)?;
    let page = folder.join("report.html");
    page_of(&table, &orderings)
        .write(&page)
        .map_err(|ReportError::Write { source, .. }| WriteError::writing(&page)(source))?;
    Ok(markdown)
}

fn page_of(table: &ResultTable<'_>, orderings: &[Ordering]) -> crate::report::Report {
    let block = |caption, head, rows| ReportBlock::Table { caption, head, rows, highlight: None };
    let plain = |caption: String, grid: text::TextGrid| block(caption, grid.head.clone(), grid.starred());
    let of = ["Mean and deviation over seeds; the best is bold.", &table.set.builds()].join(" ");
    let mut tables = vec![plain(of.trim_end().to_owned(), text::results(table))];
    let caption = || {
        let sure =
            if table.has_intervals() { ", with its 95 % confidence interval" } else { " (one seed: no intervals)" };
        format!("Difference to {}{sure}.", table.set.baseline)
    };
    tables.extend(text::differences(table).map(|grid| plain(caption(), grid)));
    let cells = |o: &Ordering| [&o.what, &o.theirs, &o.ours, &o.outcome].map(Clone::clone).to_vec();
    let head = ["metric", "order in the paper", "order here", "pairs"].map(str::to_owned).to_vec();
    let order = (!orderings.is_empty()).then(|| block(String::new(), head, orderings.iter().map(cells).collect()));
    report(table.set, tables, order)
}

/// Name of the file that marks a folder of logs.
const MARKER: &str = "comparison";

/// Writes one log for each outcome that is not missing: settings for the hparams page, curves as scalars, and the final
/// metrics of those that finished.
fn tensorboard(folder: &Path, set: &ResultSet) -> Result<(), WriteError> {
    let path = folder.join("tensorboard");
    let out = AtomicDir::create(&path).map_err(WriteError::writing(&path))?;
    let metrics: Vec<MetricColumn> = set.metrics.iter().map(|id| MetricColumn::by_id(id)).collect();
    let tags: Vec<String> = set.metrics.iter().map(|id| format!("final/{id}")).collect();
    let shown: Vec<(&str, &str)> = tags.iter().map(String::as_str).zip(metrics.iter().map(|m| &*m.head)).collect();
    let several = |f: &dyn Fn(&VariantOutcome) -> &str| set.outcomes.iter().map(f).collect::<BTreeSet<_>>().len() > 1;
    let (datasets, devices) = (several(&|o| &o.dataset), several(&|o| &o.device));
    let keys: BTreeSet<&String> = set.outcomes.iter().flat_map(|o| o.settings.keys()).collect();
    for (number, outcome) in set.outcomes.iter().enumerate().filter(|(_, o)| o.state != OutcomeState::Missing) {
        let mut settings: BTreeMap<String, HyperParameter> = keys
            .iter()
            .map(|k| {
                (
                    (*k).clone(),
                    outcome.settings.get(*k).map_or_else(|| HyperParameter::Text("base".into()), |v| parameter(v)),
                )
            })
            .collect();
        settings.insert(set.head.clone(), HyperParameter::Text(outcome.variant.clone()));
        settings.insert("seed".to_owned(), HyperParameter::Number(outcome.seed as f64));
        let mut group = outcome.variant.clone();
        for (on, name, value) in [(datasets, "dataset", &outcome.dataset), (devices, "device", &outcome.device)] {
            if on {
                settings.insert(name.to_owned(), HyperParameter::Text(value.clone()));
                group = format!("{group} {value}");
            }
        }
        if !outcome.segment.is_empty() {
            settings.insert("segment".to_owned(), HyperParameter::Text(outcome.segment.clone()));
            group = format!("{group} {}", outcome.segment);
        }
        let plain = |c: char| if c.is_alphanumeric() || "-_.+= ,".contains(c) { c } else { '-' };
        // folder names have at most 255 bytes; the settings are in the log itself
        let short: String = group.chars().take(50).collect();
        let name: String = format!("{number:03} {short} seed {}", outcome.seed).chars().map(plain).collect();
        let dir = out.dir().join(name);
        let mut events = EventWriter::create(&dir).map_err(WriteError::writing(&dir))?;
        let curves = curves::read(&outcome.run);
        let last = curves.train.last().or(curves.test.last()).map_or(0, |(s, _)| *s as u64);
        events.hparams(&settings, &shown, &group).map_err(WriteError::writing(&dir))?;
        for (tag, curve) in [("train/psnr", &curves.train), ("test/psnr", &curves.test)] {
            for (step, value) in curve {
                events.scalar(*step as u64, tag, *value as f32).map_err(WriteError::writing(&dir))?;
            }
        }
        // a stopped run has neither a final value nor an end: its live test PSNR is of fewer steps and views
        let end = match outcome.state {
            OutcomeState::Done => Some(SessionEnd::Success),
            OutcomeState::Failed(_) => Some(SessionEnd::Failure),
            OutcomeState::Stopped(_) | OutcomeState::Missing => None,
        };
        if end == Some(SessionEnd::Success) {
            for (id, tag) in set.metrics.iter().zip(&tags) {
                if let Some(value) = outcome.metrics.get(id) {
                    events.scalar(last, tag, *value as f32).map_err(WriteError::writing(&dir))?;
                }
            }
        }
        if let Some(end) = end {
            events.session_end(end).map_err(WriteError::writing(&dir))?;
        }
        events.flush().map_err(WriteError::writing(&dir))?;
    }
    // each run has a folder of its own in there, named after it
    let kind = FolderKind {
        what: "a TensorBoard log of a comparison",
        markers: &[MARKER],
        entries: &["[0-9]* seed */events.out.tfevents.*"],
    };
    std::fs::write(out.dir().join(MARKER), "").map_err(WriteError::writing(&path))?;
    out.commit_replacing(&kind, &[]).map_err(WriteError::writing(&path))
}

/// A setting's TOML text as a value.
fn parameter(text: &str) -> HyperParameter {
    if let Ok(number) = text.parse::<f64>() {
        return HyperParameter::Number(number);
    }
    match text {
        "true" => HyperParameter::Flag(true),
        "false" => HyperParameter::Flag(false),
        text => HyperParameter::Text(text.trim_matches('"').to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_finished_runs_have_final_metrics_in_tensorboard() {
        let states = [OutcomeState::Done, OutcomeState::Stopped(40), OutcomeState::Failed("not finite".into())];
        let of = |state| VariantOutcome {
            state,
            variant: "x".into(),
            metrics: BTreeMap::from([("psnr".to_owned(), 20.0)]),
            ..VariantOutcome::default()
        };
        let set = ResultSet {
            head: "variant".into(),
            metrics: vec!["psnr".into()],
            outcomes: states.map(of).to_vec(),
            ..ResultSet::default()
        };
        let dir = tempfile::tempdir().unwrap();
        tensorboard(dir.path(), &set).unwrap();
        for (number, values, ends) in [("000", 1, 1), ("001", 0, 0), ("002", 0, 1)] {
            let log = dir.path().join("tensorboard").join(format!("{number} x seed 0"));
            let file = std::fs::read_dir(log).unwrap().next().unwrap().unwrap().path();
            let bytes = std::fs::read(file).unwrap();
            let count = |text: &str| bytes.windows(text.len()).filter(|w| *w == text.as_bytes()).count();
            // once as the name of a metric of the page
            assert_eq!(count("final/psnr"), 1 + values, "{number}");
            assert_eq!(count("session_end_info"), ends, "{number}");
        }
    }
}
