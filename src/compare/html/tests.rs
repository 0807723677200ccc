//! Tests of what the page shows of a set of runs, and that odd input does not break it.

use super::*;
use crate::compare::places::places;
use crate::compare::results::PaperTable;
use std::collections::BTreeMap;
use std::path::Path;

fn text(value: &str) -> String {
    value.to_owned()
}

fn outcome(root: &Path, variant: &str, seed: u64, psnr: f64) -> VariantOutcome {
    VariantOutcome {
        variant: text(variant),
        dataset: text("vortex"),
        device: text("cpu"),
        seed,
        run: root.join(format!("{variant}-{seed}")),
        state: OutcomeState::Done,
        metrics: BTreeMap::from([(text("psnr"), psnr), (text("training_minutes"), 2.0 + psnr / 10.0)]),
        ..VariantOutcome::default()
    }
}

/// Two variants with two seeds each and curves, and a failed one.
fn set(root: &Path) -> ResultSet {
    let mut outcomes = Vec::new();
    for (variant, psnr) in [("l1", 30.0), ("l2", 28.0)] {
        for seed in [1, 2] {
            let outcome = outcome(root, variant, seed, psnr + seed as f64);
            std::fs::create_dir_all(&outcome.run).unwrap();
            let line =
                |step: u32| format!("{{\"step\":{step},\"seconds\":{step},\"train_psnr\":20,\"test_psnr\":21}}\n");
            std::fs::write(outcome.run.join("metrics.jsonl"), line(1) + &line(2)).unwrap();
            outcomes.push(outcome);
        }
    }
    let failed = OutcomeState::Failed(text("out of <memory>"));
    outcomes.push(VariantOutcome { state: failed, ..outcome(root, "huge", 1, f64::NAN) });
    ResultSet {
        name: text("loss"),
        title: text("Loss"),
        head: text("loss"),
        metrics: vec![text("psnr"), text("training_minutes"), text("unheard_of")],
        baseline: text("l2"),
        outcomes,
        paper: Some(PaperTable { source: text("table 3"), ..PaperTable::default() }),
        ..ResultSet::default()
    }
}

/// A table with one row.
fn table(caption: &str, head: &[&str], row: &[&str]) -> ReportBlock {
    let [head, row] = [head, row].map(|cells| cells.iter().map(|cell| text(cell)).collect::<Vec<_>>());
    let rows = if row.is_empty() { Vec::new() } else { vec![row] };
    ReportBlock::Table { head, rows, caption: text(caption), highlight: None }
}

fn ids(report: &Report) -> Vec<&str> {
    report.sections.iter().map(|s| s.id.as_str()).collect()
}

#[test]
fn every_section_shows_what_was_measured() {
    let dir = tempfile::tempdir().unwrap();
    let shown = table("T", &["loss"], &["l1"]);
    let order = table("", &[], &["PSNR", "l1 > l2 agrees"]);
    let report = report(&set(dir.path()), vec![shown], Some(order));
    assert_eq!(ids(&report), ["summary", "table", "order", "curves", "cost", "runs", "failures"]);
    let ReportBlock::Numbers(numbers) = &report.sections[0].blocks[0] else { panic!("no numbers") };
    assert_eq!(
        (numbers[0].value.as_str(), numbers[0].unit.as_str(), numbers[0].note.as_str()),
        ("4", "of 5", "1 failed")
    );
    assert_eq!((numbers[1].value.as_str(), numbers[1].unit.as_str()), ("31.50", "dB"));
    assert_eq!(numbers[1].note, "l1; vortex; +2.00 to l2");
    assert_eq!((numbers[2].value.as_str(), numbers[2].unit.as_str()), ("20.2", "min"));
    assert_eq!(report.sections[3].blocks.len(), 3, "three plots");
    let html = report.to_html();
    for part in ["l1 &gt; l2 agrees", "The paper: table 3.", "out of &lt;memory&gt;", "<td class=\"number\">31.00</td>"]
    {
        assert!(html.contains(part), "{part}");
    }
    assert!(!html.contains("NaN"));
}

#[test]
fn nothing_measured_still_gives_a_page() {
    let report = report(&ResultSet { name: text("n"), ..ResultSet::default() }, Vec::new(), None);
    assert_eq!((report.title.as_str(), ids(&report)), ("n", vec!["summary", "table", "runs"]));
    assert!(report.to_html().contains("Not available yet:"));
}

#[test]
fn a_settings_plot_needs_two_keys_and_four_combinations() {
    let dir = tempfile::tempdir().unwrap();
    let rates = ["0.001", "0.01", "0.1"];
    let mut set = ResultSet { metrics: vec![text("psnr")], ..ResultSet::default() };
    for (i, rate) in rates.iter().enumerate() {
        for loss in ["\"l1\"", "\"l2\""] {
            let mut outcome = outcome(dir.path(), &format!("v{i}{loss}"), 0, 20.0 + i as f64);
            outcome.settings = [("optim.rate", *rate), ("loss.kind", loss), ("same", "true")]
                .map(|(key, value)| (text(key), text(value)))
                .into();
            set.outcomes.push(outcome);
        }
    }
    // the base's own value is only in its configuration
    let base = &mut set.outcomes[5];
    base.settings.remove("optim.rate");
    std::fs::create_dir_all(&base.run).unwrap();
    std::fs::write(base.run.join("config.toml"), "[optim]\nrate = 0.1\n").unwrap();
    let page = report(&set, Vec::new(), None);
    let section = page.sections.iter().find(|s| s.id == "settings").unwrap();
    let [ReportBlock::Svg { svg, caption }] = &section.blocks[..] else { panic!("one plot") };
    assert_eq!(caption, "Settings of each run (loss.kind, optim.rate) and PSNR, dB.");
    for part in [">kind<", ">rate<", ">l1<", ">l2<", ">0.01<", ">PSNR, dB<"] {
        assert!(svg.contains(part), "{part}");
    }
    assert!(!svg.contains("rate, seed"), "{svg}");
    set.outcomes.truncate(3);
    assert!(!ids(&report(&set, Vec::new(), None)).contains(&"settings"), "three ways");
}

#[test]
fn places_are_distinguished() {
    let dir = tempfile::tempdir().unwrap();
    let mut set = set(dir.path());
    let mut other = set.outcomes.clone();
    other.iter_mut().for_each(|o| o.device = text("gpu"));
    set.outcomes.extend(other);
    let names: Vec<String> = places(&set).into_iter().map(|p| p.name).collect();
    assert_eq!(names, ["vortex, cpu", "vortex, gpu"]);
    let page = report(&set, Vec::new(), None);
    let plots = |id: &str| page.sections.iter().find(|s| s.id == id).unwrap().blocks.len();
    assert_eq!((plots("curves"), plots("cost"), plots("runs")), (6, 2, 1));
}

#[test]
fn non_finite_values_and_odd_texts_are_harmless() {
    let dir = tempfile::tempdir().unwrap();
    let mut set = set(dir.path());
    for (outcome, odd) in set.outcomes.iter_mut().zip(["]]", "nan", "", "[1, 2]", "\n\"x"]) {
        outcome.settings = BTreeMap::from([(text("a..b"), text(odd)), (text(""), text(odd))]);
        outcome.metrics.insert(text("psnr"), if odd == "nan" { f64::INFINITY } else { 1e300 });
        outcome.run = std::path::PathBuf::new();
    }
    set.metrics[1] = text("training_minutes");
    let html = report(&set, vec![table("", &[], &[])], None).to_html();
    assert!(!html.contains("NaN") && html.contains("</html>"));
}
