//! Tests of each writer on made-up sets.

use super::*;
use crate::compare::results::{OutcomeState, ResultSet, VariantOutcome};
use crate::compare::table::tests::{losses, outcome, paper, part, set};
use crate::compare::table::{ResultTable, orderings};
use proptest::prelude::*;

fn judged() -> (ResultSet, String) {
    let mut set = losses();
    set.metrics = vec!["psnr".to_owned(), "lpips_vgg".to_owned()];
    set.note = "Three seeds.".to_owned();
    set.paper = paper(&[("L2", "psnr", 28.0), ("L1", "psnr", 26.0)]);
    set.outcomes[8].state = OutcomeState::Failed("out of\nmemory | 1 < 2".to_owned());
    let table = ResultTable::new(&set);
    let text = markdown(&table, &orderings(&table));
    (set, text)
}

#[test]
fn markdown_has_all_sections() {
    let (_, text) = judged();
    // by hand: half-widths are 4.303 * 0.1 / sqrt(3) seed by seed, and 3.26 * sqrt(0.005 / 2 + 0.01 / 3) by Welch
    let expected = "\
# Losses

Three seeds.

| loss    |       PSNR, dB ↑ |    LPIPS (VGG-16) ↓ |              runs |
| ------- | ---------------: | ------------------: | ----------------: |
| L2      |     27.00 ± 0.10 | **0.1000 ± 0.0000** |                 3 |
| L2+SSIM | **27.10 ± 0.10** | **0.1000 ± 0.0000** |                 3 |
| L1      |     25.25 ± 0.07 | **0.1000 ± 0.0000** | 2 of 3 (1 failed) |

## Difference to L2 (95 % confidence)

| loss    |           PSNR, dB ↑ |        LPIPS (VGG-16) ↓ |
| ------- | -------------------: | ----------------------: |
| L2+SSIM |  +0.10 [-0.15, 0.35] | 0.0000 [0.0000, 0.0000] |
| L1      | -1.75 [-2.00, -1.50] | 0.0000 [0.0000, 0.0000] |

Intervals are paired by seed where both sides have the same seeds, and Welch's otherwise.

## Order in the paper

Source: Table 2

- PSNR: L2 > L1 in the paper; here L2 27.00 > L1 25.25: the pair holds

## Failed runs

- L1, seed 2, in `runs/L1-2`: out of memory \\| 1 < 2
";
    assert_eq!(text, expected);
}

#[test]
fn markdown_of_single_seeds_has_no_deviations() {
    let one = set(&["psnr"], vec![outcome("a|b", 0, &[("psnr", 27.0)]), outcome("*c*", 0, &[("psnr", 27.311)])]);
    let text = markdown(&ResultTable::new(&one), &[]);
    assert!(!text.contains('±') && !text.contains("runs"), "{text}");
    assert!(!text.contains("95 %") && text.contains("No intervals"), "{text}");
    assert!(text.contains("| a\\|b  |      27.00 |"), "{text}");
    assert!(text.contains("| \\*c\\* |  **27.31** |"), "{text}");
    assert!(text.contains("| \\*c\\* |      +0.31 |"), "{text}");
}

#[test]
fn a_failed_run_is_listed_once_for_all_its_segments() {
    let fail =
        |segment: &str| VariantOutcome { state: OutcomeState::Failed("no".to_owned()), ..part(segment, "a", 0, &[]) };
    let text = markdown(&ResultTable::new(&set(&["iou"], vec![fail("x"), fail("y")])), &[]);
    assert_eq!(text.matches("runs/a-0").count(), 1, "{text}");
}

#[test]
fn an_empty_set_is_written_as_empty_tables() {
    let nothing = ResultSet::default();
    let table = ResultTable::new(&nothing);
    assert_eq!(markdown(&table, &[]), "No runs.\n");
    assert_eq!(csv(&nothing), "variant,dataset,device,seed,segment,state,run\n");
    assert!(latex(&table).contains("\\midrule\n    \\bottomrule"));
    assert_eq!(json(&table, &[])["rows"], serde_json::json!([]));
    assert_eq!(differences(&table), None);
}

#[test]
fn csv_is_quoted_and_long() {
    let mut first = outcome("a, \"b\"", 0, &[("psnr", 27.5), ("extra", f64::NAN)]);
    first.settings.insert("loss.kind".to_owned(), "\"l1\"".to_owned());
    first.settings.insert("seed".to_owned(), "7".to_owned());
    let mut second = outcome("c", 1, &[]);
    second.settings.insert("loss.weight".to_owned(), "0.05".to_owned());
    second.state = OutcomeState::Stopped(300);
    assert_eq!(
        csv(&set(&["psnr", "ssim"], vec![first, second])),
        "variant,dataset,device,seed,segment,state,run,loss.kind,loss.weight,setting.seed,psnr,ssim,extra\n\
         \"a, \"\"b\"\"\",jets,flex,0,,done,\"runs/a, \"\"b\"\"-0\",l1,,7,27.5,,\n\
         c,jets,flex,1,,stopped,runs/c-1,,0.05,,,,\n"
    );
}

#[test]
fn json_has_rows_and_can_be_read_back() {
    let (mut set, _) = judged();
    let table = ResultTable::new(&set);
    let value = json(&table, &orderings(&table));
    let row = &value["rows"][1];
    assert_eq!((row["variant"].as_str(), row["done"].as_u64()), (Some("L2+SSIM"), Some(3)));
    let cell = &row["metrics"]["psnr"];
    assert_eq!((cell["n"].as_u64(), cell["best"].as_bool()), (Some(3), Some(true)));
    assert!((cell["mean"].as_f64().unwrap() - 27.1).abs() < 1e-9 && (cell["std"].as_f64().unwrap() - 0.1).abs() < 1e-9);
    assert_eq!(cell["difference"]["interval"].as_array().unwrap().len(), 2);
    assert_eq!(value["rows"][2]["failures"][0]["run"], "runs/L1-2");
    assert_eq!(value["columns"][0]["better"], "higher");
    assert_eq!(value["orderings"][0]["pairs"][0]["verdict"], "holds");
    assert_eq!(serde_json::from_value::<ResultSet>(value["set"].clone()).unwrap(), set);
    // non-finite values are omitted, so that the set can still be read
    set.outcomes[0].metrics.insert("psnr".to_owned(), f64::NAN);
    let value = json(&ResultTable::new(&set), &[]);
    assert!(serde_json::from_value::<ResultSet>(value["set"].clone()).is_ok());
}

#[test]
fn latex_says_which_seeds_are_missing() {
    let (mut set, _) = judged();
    let text = latex(&ResultTable::new(&set));
    assert!(text.contains(r"{tabular}{lrrr}") && text.contains(r"& runs \\"), "{text}");
    assert!(text.contains(r"& 3 \\") && text.contains(r"& 2 of 3 (1 failed) \\") && !text.contains("$n="), "{text}");
    // a measured run without one of the metrics
    set.outcomes[0].metrics.remove("lpips_vgg");
    let text = latex(&ResultTable::new(&set));
    assert_eq!(text.matches(r"($n=2$)").count(), 1, "{text}");
}

#[test]
fn latex_has_the_papers_shape() {
    let mut losses = losses();
    losses.metrics = ["psnr", "ssim", "lpips_vgg", "training_minutes"].map(str::to_owned).to_vec();
    losses.title = "Losses & 100 % of {it}".to_owned();
    losses.note = "Of three seeds".to_owned();
    losses.name = "my_losses".to_owned();
    let text = latex(&ResultTable::new(&losses));
    assert!(text.contains(r"\caption{Losses \& 100 \% of \{it\}. Of three seeds.}"), "{text}");
    assert!(text.contains(r"\label{tab:my-losses}"), "{text}");
    assert!(text.contains(r"\begin{tabular}{lrrrr}"), "{text}");
    let head = r"loss & PSNR$\uparrow$ & SSIM$\uparrow$ & LPIPS$\downarrow$ & TT$\downarrow$ \\";
    assert!(text.contains(&format!("\\toprule\n    {head}\n    \\midrule\n")), "{text}");
    let best = r"L2+SSIM & \textbf{27.10}{\scriptsize$\pm$0.10} & -- & \textbf{0.1000}{\scriptsize$\pm$0.0000} & -- \\";
    assert!(text.contains(best), "{text}");
    assert!(text.contains("\\\\\n    \\bottomrule\n"), "{text}");
}

#[test]
fn latex_names_a_segment_once_and_distinguishes_networks() {
    let metrics = [("lpips_alex", 0.1), ("lpips_vgg", 0.2)];
    let outcomes = vec![part("x", "a", 0, &metrics), part("x", "[b]", 0, &metrics), part("y", "a", 0, &metrics)];
    let text = latex(&ResultTable::new(&set(&["lpips_alex", "lpips_vgg"], outcomes)));
    assert!(text.contains(r"segment & loss & LPIPS (AlexNet)$\downarrow$ & LPIPS (VGG-16)$\downarrow$ \\"), "{text}");
    assert!(text.contains("    x & a & "), "{text}");
    assert!(text.contains("     & {[}b{]} & "), "{text}");
    assert!(text.contains("    \\midrule\n    y & a & 0.1000 & 0.2000 \\\\\n"), "{text}");
}

#[test]
fn stars_mark_the_best() {
    let grid = results(&ResultTable::new(&losses()));
    assert_eq!(grid.words, 1);
    assert_eq!(grid.starred()[1][..2], ["L2+SSIM", "**27.10 ± 0.10**"]);
}

/// Fields of the first record.
fn first_record(csv: &str) -> Vec<String> {
    let (mut fields, mut quoted) = (vec![String::new()], false);
    for c in csv.chars() {
        match c {
            '"' => quoted = !quoted,
            ',' if !quoted => fields.push(String::new()),
            '\n' if !quoted => break,
            _ => fields.last_mut().unwrap().push(c),
        }
    }
    fields
}

proptest! {
    #[test]
    fn any_names_keep_the_shape(name in any::<String>(), other in any::<String>()) {
        let set = set(&["psnr"], vec![outcome(&name, 0, &[("psnr", 1.0)]), part(&other, "b", 0, &[("psnr", 2.0)])]);
        let table = ResultTable::new(&set);
        for line in markdown(&table, &[]).lines().filter(|line| line.starts_with("| ")) {
            let pipes = line.replace("\\\\", "").replace("\\|", "").matches('|').count();
            prop_assert_eq!(pipes, if table.shows.segment { 4 } else { 3 }, "{}", line);
        }
        let ends = latex(&table).lines().filter(|line| line.starts_with("    ") && line.ends_with(" \\\\")).count();
        prop_assert_eq!(ends, 3);
        let text = csv(&set);
        let record = text.strip_prefix("variant,dataset,device,seed,segment,state,run,psnr\n").unwrap();
        let fields = first_record(record);
        prop_assert_eq!(fields.len(), 8);
        // texts that a spreadsheet would take for formulas begin with an apostrophe
        let name = name.replace('"', "");
        prop_assert!(fields[0] == name || fields[0] == format!("'{name}"), "{} {}", fields[0], name);
    }
}
