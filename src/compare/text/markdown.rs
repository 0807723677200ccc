//! A table, its differences to the baseline, the paper's order and failures as Markdown.

use super::grid::{TextGrid, differences, names, results};
use crate::compare::table::{Ordering, ResultTable};
use std::collections::BTreeSet;

/// Writes the table as Markdown that is also readable as plain text.
pub fn markdown(table: &ResultTable<'_>, orderings: &[Ordering]) -> String {
    let mut parts = Vec::new();
    if !table.set.title.is_empty() {
        parts.push(format!("# {}", escape(&table.set.title)));
    }
    if !table.set.note.is_empty() {
        parts.push(escape(&table.set.note));
    }
    parts.push(if table.rows.is_empty() { "No runs.".to_owned() } else { grid(&results(table)) });
    let builds = table.set.builds();
    if !builds.is_empty() {
        parts.push(escape(&builds));
    }
    if let Some(found) = differences(table) {
        let sure = if table.has_intervals() { " (95 % confidence)" } else { "" };
        parts.push(format!("## Difference to {}{sure}", escape(&table.set.baseline)));
        parts.push(grid(&found));
        parts.push(
            if table.has_intervals() {
                "Intervals are paired by seed where both sides have the same seeds, and Welch's otherwise."
            } else {
                "No intervals: both sides need at least two seeds."
            }
            .to_owned(),
        );
    }
    if !orderings.is_empty() {
        parts.push("## Order in the paper".to_owned());
        let sources: BTreeSet<&str> = orderings.iter().map(|o| o.source.as_str()).filter(|s| !s.is_empty()).collect();
        parts.extend(sources.into_iter().map(|source| format!("Source: {}", escape(source))));
        parts.push(list(orderings.iter().map(|o| escape(&o.text))));
    }
    let failures = failures(table);
    if !failures.is_empty() {
        parts.push("## Failed runs".to_owned());
        parts.push(list(failures));
    }
    parts.join("\n\n") + "\n"
}

fn list(items: impl IntoIterator<Item = String>) -> String {
    items.into_iter().map(|item| format!("- {item}")).collect::<Vec<_>>().join("\n")
}

/// One line per failed run, even if it was to be measured on many segments.
fn failures(table: &ResultTable<'_>) -> Vec<String> {
    let mut seen = BTreeSet::new();
    let mut out = Vec::new();
    for row in &table.rows {
        for failure in &row.failures {
            if seen.insert((&row.dataset, &row.device, &row.variant, failure.seed, &failure.run, &failure.error)) {
                let name: Vec<String> = names(table, row).into_iter().map(|name| escape(&name.text)).collect();
                let run = code(&failure.run.to_string_lossy());
                out.push(format!("{}, seed {}, in {run}: {}", name.join(", "), failure.seed, escape(&failure.error)));
            }
        }
    }
    out
}

/// A table with aligned columns.
fn grid(grid: &TextGrid) -> String {
    let head: Vec<String> = grid.head.iter().map(|text| escape(text)).collect();
    let rows: Vec<Vec<String>> = grid
        .rows
        .iter()
        .map(|row| {
            row.iter()
                .map(|entry| {
                    let text = escape(&entry.text);
                    if entry.bold { format!("**{text}**") } else { text }
                })
                .collect()
        })
        .collect();
    let width = |column: usize| {
        let cells = rows.iter().map(|row| row[column].chars().count());
        cells.chain([head[column].chars().count(), 3]).max().unwrap_or(3)
    };
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let line = |cells: &[String]| {
        let pad = |(i, text): (usize, &String)| {
            let space = " ".repeat(widths[i].saturating_sub(text.chars().count()));
            if i < grid.words { format!("{text}{space}") } else { format!("{space}{text}") }
        };
        format!("| {} |", cells.iter().enumerate().map(pad).collect::<Vec<_>>().join(" | "))
    };
    let rule: Vec<String> = widths
        .iter()
        .enumerate()
        .map(|(i, width)| if i < grid.words { "-".repeat(*width) } else { format!("{}:", "-".repeat(width - 1)) })
        .collect();
    let mut lines = vec![line(&head), line(&rule)];
    lines.extend(rows.iter().map(|row| line(row)));
    lines.join("\n")
}

/// Puts text on one line and escapes what Markdown would interpret. Underscores within words and signs between
/// spaces are kept.
fn escape(text: &str) -> String {
    let text: Vec<char> = text.split_whitespace().collect::<Vec<_>>().join(" ").chars().collect();
    let mut out = String::new();
    for (i, &c) in text.iter().enumerate() {
        let before = i.checked_sub(1).and_then(|i| text.get(i));
        let after = text.get(i + 1);
        let word = |c: Option<&char>| c.is_some_and(|c| c.is_alphanumeric());
        let special = match c {
            '\\' | '|' | '*' | '`' | '~' => true,
            // an interval is not a link
            '[' => !after.is_some_and(|c| c.is_ascii_digit() || *c == '-'),
            '_' => !(word(before) && word(after)),
            '<' => after.is_some_and(|c| !c.is_whitespace()),
            '#' | '>' => i == 0,
            _ => false,
        };
        if special {
            out.push('\\');
        }
        out.push(c);
    }
    out
}

/// A code span, of text that may contain backticks.
fn code(text: &str) -> String {
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    if text.contains('`') { format!("`` {text} ``") } else { format!("`{text}`") }
}
