//! A table in LaTeX, in the form of the paper's; it needs the booktabs package.

use super::grid::{is_complete, names, names_head, runs};
use crate::compare::metric::{Better, MetricColumn};
use crate::compare::table::{MetricCell, ResultTable, TableRow};

/// Writes a `table` with caption and label `tab:NAME`. Names of groups appear only in the first row of their group.
pub fn latex(table: &ResultTable<'_>) -> String {
    let heads = names_head(table);
    let complete = is_complete(table);
    let columns = "l".repeat(heads.len()) + &"r".repeat(table.metrics.len() + usize::from(!complete));
    let mut head: Vec<String> = heads.iter().map(|text| escape(text)).collect();
    head.extend(table.metrics.iter().map(|metric| heading(table, metric)));
    head.extend((!complete).then(|| "runs".to_owned()));
    let groups: Vec<String> = table.groups().map(|rows| group(table, rows)).collect();
    let label: String = table.set.name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
    let lines = [
        r"% needs \usepackage{booktabs}".to_owned(),
        r"\begin{table}".to_owned(),
        r"  \centering".to_owned(),
        format!(r"  \caption{{{}}}", caption(table)),
        format!(r"  \label{{tab:{label}}}"),
        format!(r"  \begin{{tabular}}{{{columns}}}"),
        r"    \toprule".to_owned(),
        format!(r"    {} \\", head.join(" & ")),
        r"    \midrule".to_owned(),
        groups.join("    \\midrule\n") + r"    \bottomrule",
        r"  \end{tabular}".to_owned(),
        r"\end{table}".to_owned(),
    ];
    lines.join("\n") + "\n"
}

/// Title and note as sentences.
fn caption(table: &ResultTable<'_>) -> String {
    let mut parts = Vec::new();
    for text in [&table.set.title, &table.set.note].map(|text| text.trim()) {
        if !text.is_empty() {
            let end = if text.ends_with(['.', '?', '!', ':']) { "" } else { "." };
            parts.push(escape(text) + end);
        }
    }
    parts.join(" ")
}

/// The paper's abbreviation, or the heading without its unit if two columns share the abbreviation.
fn heading(table: &ResultTable<'_>, metric: &MetricColumn) -> String {
    let shared = table.metrics.iter().filter(|m| m.short == metric.short).count() > 1;
    let text = escape(if shared { metric.name() } else { &metric.short });
    match metric.better {
        Better::Higher => text + r"$\uparrow$",
        Better::Lower => text + r"$\downarrow$",
        Better::Neither => text,
    }
}

fn group(table: &ResultTable<'_>, rows: &[TableRow]) -> String {
    let complete = is_complete(table);
    let mut out = String::new();
    for (i, row) in rows.iter().enumerate() {
        let names = names(table, row);
        let last = names.len() - 1;
        let name = |(at, text): (usize, &str)| if i > 0 && at < last { String::new() } else { escape(text) };
        let mut cells: Vec<String> = names.iter().map(|e| e.text.as_str()).enumerate().map(name).collect();
        cells.extend(table.metrics.iter().zip(&row.cells).map(|(metric, cell)| value(metric, cell, row)));
        cells.extend((!complete).then(|| escape(&runs(row))));
        out += &format!("    {} \\\\\n", cells.join(" & "));
    }
    out
}

fn value(metric: &MetricColumn, cell: &MetricCell, row: &TableRow) -> String {
    let Some(mean) = cell.mean else {
        return "--".to_owned();
    };
    let mean = metric.format(mean);
    let mean = if cell.best { format!(r"\textbf{{{mean}}}") } else { mean };
    let text = match cell.deviation {
        Some(deviation) => format!(r"{mean}{{\scriptsize$\pm${}}}", metric.format(deviation)),
        None => mean,
    };
    if cell.n() == row.done { text } else { format!(r"{text} {{\scriptsize ($n={}$)}}", cell.n()) }
}

/// Puts text on one line and escapes what LaTeX would interpret. A star or bracket after `\\` would be its argument.
fn escape(text: &str) -> String {
    let mut out = String::new();
    for c in text.split_whitespace().collect::<Vec<_>>().join(" ").chars() {
        match c {
            '\\' => out += r"\textbackslash{}",
            '~' => out += r"\textasciitilde{}",
            '^' => out += r"\textasciicircum{}",
            '<' => out += r"\textless{}",
            '>' => out += r"\textgreater{}",
            '|' => out += r"\textbar{}",
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => out.extend(['\\', c]),
            '[' | ']' | '*' => out.extend(['{', c, '}']),
            _ => out.push(c),
        }
    }
    out
}
