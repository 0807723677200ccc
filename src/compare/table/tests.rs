//! Tests on tables of made-up numbers, and builders of such tables for other tests of the comparison.

use super::*;
use crate::compare::results::PaperTable;
use proptest::prelude::*;

/// A measured outcome on dataset `jets` and device `flex`.
pub(crate) fn outcome(variant: &str, seed: u64, metrics: &[(&str, f64)]) -> VariantOutcome {
    VariantOutcome {
        variant: variant.to_owned(),
        dataset: "jets".to_owned(),
        device: "flex".to_owned(),
        seed,
        run: PathBuf::from(format!("runs/{variant}-{seed}")),
        state: OutcomeState::Done,
        metrics: metrics.iter().map(|(id, v)| ((*id).to_owned(), *v)).collect(),
        ..VariantOutcome::default()
    }
}

/// The same for a segment.
pub(crate) fn part(segment: &str, variant: &str, seed: u64, metrics: &[(&str, f64)]) -> VariantOutcome {
    VariantOutcome { segment: segment.to_owned(), ..outcome(variant, seed, metrics) }
}

/// A set whose baseline is the first variant.
pub(crate) fn set(metrics: &[&str], outcomes: Vec<VariantOutcome>) -> ResultSet {
    ResultSet {
        name: "losses".to_owned(),
        title: "Losses".to_owned(),
        head: "loss".to_owned(),
        metrics: metrics.iter().map(|id| (*id).to_owned()).collect(),
        baseline: outcomes.first().map(|o| o.variant.clone()).unwrap_or_default(),
        outcomes,
        ..ResultSet::default()
    }
}

/// A table of the paper: key, metric, value.
pub(crate) fn paper(values: &[(&str, &str, f64)]) -> Option<PaperTable> {
    let mut out = PaperTable { source: "Table 2".to_owned(), ..PaperTable::default() };
    for (key, id, value) in values {
        out.rows.entry((*key).to_owned()).or_default().insert((*id).to_owned(), *value);
    }
    Some(out)
}

/// Three losses with three seeds each, of which the second cannot be distinguished from the first.
pub(crate) fn losses() -> ResultSet {
    let seeds = |variant: &'static str, values: [f64; 3]| {
        (0..3u64).zip(values).map(move |(seed, psnr)| outcome(variant, seed, &[("psnr", psnr), ("lpips_vgg", 0.1)]))
    };
    let mut all: Vec<VariantOutcome> = seeds("L2", [27.0, 27.1, 26.9]).collect();
    all.extend(seeds("L2+SSIM", [27.0, 27.2, 27.1]));
    all.extend(seeds("L1", [25.2, 25.3, 25.1]));
    set(&["psnr", "lpips_alex", "lpips_vgg"], all)
}

fn names<'t>(table: &'t ResultTable<'_>) -> Vec<[&'t str; 3]> {
    table.rows.iter().map(|r| [r.dataset.as_str(), r.segment.as_str(), r.variant.as_str()]).collect()
}

fn best(table: &ResultTable<'_>, at: usize) -> Vec<bool> {
    table.rows.iter().map(|row| row.cells[at].best).collect()
}

#[test]
fn rows_come_in_order_and_sum_up_their_seeds() {
    let losses = losses();
    let table = ResultTable::new(&losses);
    assert_eq!(names(&table), [["jets", "", "L2"], ["jets", "", "L2+SSIM"], ["jets", "", "L1"]]);
    assert_eq!(table.shows, Shows::default());
    let cell = &table.rows[1].cells[0];
    assert_eq!(cell.n(), 3);
    assert!((cell.mean.unwrap() - 27.1).abs() < 1e-9 && (cell.deviation.unwrap() - 0.1).abs() < 1e-9);
    assert_eq!(best(&table, 0), [false, true, false]);
    assert_eq!(best(&table, 1), [false; 3], "no value, no best");
    assert_eq!(best(&table, 2), [true; 3], "ties are all best");
    assert!(table.rows[0].cells[0].difference.is_none());
    let found = table.rows[2].cells[0].difference.unwrap();
    assert!(found.paired && (found.value + 1.8).abs() < 1e-9);
    assert_eq!(found.includes_zero(), Some(false));
}

#[test]
fn rows_are_grouped_by_segment() {
    let values = [("L1", "a", 1.0), ("L1", "b", 2.0), ("L2", "a", 3.0), ("L2", "b", 1.0)];
    let outcomes = values.map(|(variant, segment, iou)| part(segment, variant, 0, &[("iou", iou)]));
    let set = set(&["iou"], outcomes.to_vec());
    let table = ResultTable::new(&set);
    assert_eq!(names(&table), [["jets", "a", "L1"], ["jets", "a", "L2"], ["jets", "b", "L1"], ["jets", "b", "L2"]]);
    assert_eq!(table.shows, Shows { segment: true, ..Shows::default() });
    assert_eq!(best(&table, 0), [false, true, true, false]);
    let differences: Vec<Option<f64>> = table.rows.iter().map(|row| row.cells[0].difference.map(|d| d.value)).collect();
    assert_eq!(differences, [None, Some(2.0), None, Some(-1.0)]);
    assert_eq!(table.groups().count(), 2);
}

#[test]
fn the_best_is_judged_by_displayed_digits() {
    let of = |id: &str, values: &[f64]| {
        let names = ["a", "b", "c"];
        let outcomes = names.iter().zip(values).map(|(name, v)| outcome(name, 0, &[(id, *v)])).collect();
        best(&ResultTable::new(&set(&[id], outcomes)), 0)
    };
    assert_eq!(of("psnr", &[27.101, 27.104, 27.0]), [true, true, false]);
    assert_eq!(of("lpips_alex", &[0.1, 0.2]), [true, false]);
    assert_eq!(of("edge_error", &[0.1, 0.2]), [true, false]);
    assert_eq!(of("edge_score", &[0.1, 0.2]), [false, true]);
    assert_eq!(of("gaussians", &[1.0, 2.0]), [false, false]);
    assert_eq!(of("psnr", &[1.0]), [false], "no choice");
    assert_eq!(of("psnr", &[f64::NAN, 1.0]), [false, false], "no choice");
}

#[test]
fn runs_that_did_not_end_well_are_counted_not_measured() {
    let mut outcomes: Vec<VariantOutcome> = (0..5).map(|seed| outcome("a", seed, &[("psnr", seed as f64)])).collect();
    outcomes[0].state = OutcomeState::Failed("first".to_owned());
    outcomes[1].state = OutcomeState::Failed("second".to_owned());
    outcomes[2].state = OutcomeState::Stopped(300);
    outcomes[3].state = OutcomeState::Missing;
    let set = set(&["psnr", "psnr"], outcomes);
    let table = ResultTable::new(&set);
    assert_eq!(table.metrics.len(), 1);
    let row = &table.rows[0];
    assert_eq!((row.done, row.missing, row.stopped, row.failures.len(), row.outcomes()), (1, 1, 1, 2, 5));
    assert_eq!(row.failures[0].error, "first");
    assert_eq!(row.cells[0].values, [(4, 4.0)]);
}

#[test]
fn empty_and_failed_sets_make_tables() {
    let nothing = ResultSet::default();
    let empty = ResultTable { set: &nothing, metrics: Vec::new(), shows: Shows::default(), rows: Vec::new() };
    assert_eq!(ResultTable::new(&nothing), empty);
    assert!(orderings(&ResultTable::new(&nothing)).is_empty());
    let mut failed = losses();
    failed.paper = paper(&[("L2", "psnr", 27.0), ("L1", "psnr", 26.0)]);
    failed.outcomes.iter_mut().for_each(|o| o.state = OutcomeState::Failed("no".to_owned()));
    let table = ResultTable::new(&failed);
    assert!(table.rows.iter().all(|row| row.cells.iter().all(|cell| cell == &MetricCell::default())));
    assert!(!table.has_differences());
    let found = orderings(&table);
    assert_eq!(found[0].pairs[0].verdict, Verdict::Unmeasured);
    assert!(!found[0].holds);
    assert_eq!(found[0].text, "PSNR: L2 > L1 in the paper; here nothing was measured: L2 > L1 is not measured");
    let mut stray = losses();
    stray.baseline = "another".to_owned();
    assert!(!ResultTable::new(&stray).has_differences());
}

#[test]
fn the_papers_order_is_judged_by_intervals() {
    let mut losses = losses();
    losses.paper = paper(&[
        ("L2", "psnr", 28.0),
        ("L2+SSIM", "psnr", 27.5),
        ("L1", "psnr", 26.0),
        ("SAD", "psnr", 20.0),
        ("L2", "lpips", 0.2),
        ("L1", "lpips", 0.2),
    ]);
    let found = orderings(&ResultTable::new(&losses));
    assert_eq!(found.len(), 1, "equal LPIPS values have no order");
    assert_eq!(
        found[0].text,
        "PSNR: L2 > L2+SSIM > L1 in the paper; here L2+SSIM 27.10 > L2 27.00 > L1 25.20: \
         2 of 3 pairs hold, L2 > L2+SSIM is within noise"
    );
    let verdicts: Vec<Verdict> = found[0].pairs.iter().map(|pair| pair.verdict).collect();
    assert_eq!(verdicts, [Verdict::Undecided, Verdict::Holds, Verdict::Holds]);
    assert!(!found[0].holds);
}

#[test]
fn lpips_is_whichever_was_measured() {
    let mut losses = losses();
    for (i, outcome) in losses.outcomes.iter_mut().enumerate() {
        outcome.metrics.insert("lpips_vgg".to_owned(), 0.1 + (i / 3) as f64);
    }
    losses.paper = paper(&[("L2", "lpips", 0.1), ("L1", "lpips", 0.2)]);
    let found = orderings(&ResultTable::new(&losses));
    assert_eq!(found[0].metric.id, "lpips_vgg");
    assert!(found[0].holds);
    assert_eq!(found[0].text, "LPIPS (VGG-16): L2 < L1 in the paper; here L2 0.1000 < L1 2.1000: the pair holds");
}

#[test]
fn one_seed_is_judged_by_displayed_digits() {
    let verdict = |ours: f64| {
        let mut one = set(&["psnr"], vec![outcome("a", 0, &[("psnr", ours)]), outcome("b", 0, &[("psnr", 27.0)])]);
        one.paper = paper(&[("a", "psnr", 30.0), ("b", "psnr", 29.0)]);
        let found = orderings(&ResultTable::new(&one)).remove(0);
        assert!(found.text.ends_with("without confidence intervals, which need two seeds"), "{}", found.text);
        found.pairs[0].verdict
    };
    assert_eq!(verdict(27.5), Verdict::Holds);
    assert_eq!(verdict(26.5), Verdict::Reversed);
    assert_eq!(verdict(27.001), Verdict::Undecided);
}

#[test]
fn means_over_segments_are_compared_with_the_papers() {
    // the paper's means: a 0.6, b 0.5; ours over x and y: a 4 (seed 1 lacks y), b 2
    let mut outcomes = vec![
        part("x", "a", 0, &[("iou", 3.0)]),
        part("y", "a", 0, &[("iou", 5.0)]),
        part("x", "a", 1, &[("iou", 90.0)]),
        part("x", "b", 0, &[("iou", 4.0)]),
        part("y", "b", 0, &[("iou", 0.0)]),
    ];
    outcomes.push(part("x", "a/b", 0, &[("iou", 1.0)]));
    let mut parts = set(&["iou"], outcomes);
    parts.paper = paper(&[
        ("a/dragon", "iou", 0.4),
        ("a/bunny", "iou", 0.8),
        ("b/dragon", "iou", 0.5),
        ("b/bunny", "iou", 0.5),
        ("a/b/bunny", "iou", 0.1),
        ("a/b/dragon", "iou", 0.1),
    ]);
    let found = orderings(&ResultTable::new(&parts)).remove(0);
    assert!(
        found.text.starts_with(
            "IoU: a > b > a/b in the paper; here a 4.00 > b 2.00: 1 of 3 pairs hold, a > a/b is not measured"
        ),
        "{}",
        found.text
    );
}

#[test]
fn each_dataset_is_judged_alone() {
    let mut two = losses();
    for outcome in losses().outcomes {
        two.outcomes.push(VariantOutcome { dataset: "vortex".to_owned(), ..outcome });
    }
    two.paper = paper(&[("L2", "psnr", 28.0), ("L1", "psnr", 27.5)]);
    let found = orderings(&ResultTable::new(&two));
    assert_eq!(found.len(), 2);
    assert!(found[1].holds && found[1].text.starts_with("PSNR (vortex): L2 > L1 in the paper"));
}

proptest! {
    #[test]
    fn any_numbers_make_a_table(
        runs in prop::collection::vec((0usize..3, 0u64..3, 0usize..2, prop::num::f64::ANY, prop::num::f64::ANY), 0..20),
        theirs in prop::collection::vec(prop::num::f64::ANY, 3),
    ) {
        let names = ["a", "b", "c"];
        let outcomes = runs
            .iter()
            .map(|(v, seed, s, psnr, n)| part(["", "x"][*s], names[*v], *seed, &[("psnr", *psnr), ("gaussians", *n)]));
        let mut set = set(&["psnr", "gaussians", "ssim"], outcomes.collect());
        set.paper = paper(&[("a", "psnr", theirs[0]), ("b", "psnr", theirs[1]), ("c", "psnr", theirs[2])]);
        let table = ResultTable::new(&set);
        prop_assert_eq!(table.rows.iter().map(TableRow::outcomes).sum::<usize>(), runs.len());
        for cell in table.rows.iter().flat_map(|row| &row.cells) {
            prop_assert!(cell.mean.is_none_or(f64::is_finite) && cell.deviation.is_none_or(f64::is_finite));
            prop_assert!(!cell.best || cell.mean.is_some());
        }
        for group in table.groups() {
            let best: Vec<f64> =
                group.iter().filter(|r| r.cells[0].best).filter_map(|r| r.cells[0].mean).collect();
            prop_assert!(best.windows(2).all(|p| table.metrics[0].looks_same(p[0], p[1])));
        }
        let orderings = orderings(&table);
        let _ = crate::compare::text::markdown(&table, &orderings);
        let _ = crate::compare::text::latex(&table);
        let _ = crate::compare::text::json(&table, &orderings);
        let _ = crate::compare::text::csv(&set);
    }
}
