//! The skeleton of the page: head, heading, table of contents, sections, script. The HTML of a block is in `blocks`.

use super::{Report, ReportSection, blocks};
use std::collections::BTreeSet;

const CSS: &str = include_str!("report.css");
const JS: &str = include_str!("report.js");
/// Makes the browser refuse whatever is not in the file itself.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'";

/// Renders the page as HTML; every tag is closed.
pub(super) fn render(report: &Report) -> String {
    let ids = anchors(&report.sections);
    let title = escape(&report.title);
    let mut out = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n\
         <meta name=\"color-scheme\" content=\"light dark\"/>\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\"/>\n\
         <meta name=\"generator\" content=\"volseggs\"/>\n         <link rel=\"icon\" href=\"data:,\"/>\n<title>{title}</title>\n<style>\n{CSS}</style>\n</head>\n\
         <body id=\"top\">\n<a class=\"skip\" href=\"#main\">Skip to content</a>\n<header>\n<h1>{title}</h1>\n"
    );
    paragraph(&mut out, "lead", &report.subtitle);
    out += "</header>\n";
    contents(&mut out, &report.sections, &ids);
    out += "<main id=\"main\">\n";
    for (section, id) in report.sections.iter().zip(&ids) {
        out += &format!(
            "<section id=\"{id}\" aria-labelledby=\"{id}.title\">\n<h2 id=\"{id}.title\">{}</h2>\n",
            escape(&section.title)
        );
        paragraph(&mut out, "intro", &section.intro);
        for block in &section.blocks {
            blocks::render(&mut out, block);
        }
        out += "</section>\n";
    }
    out += "</main>\n<footer><p>Made by <code>volseggs</code>. This file is self-contained and loads nothing \
            from a network.</p></footer>\n<p id=\"status\" class=\"unseen\" role=\"status\"></p>\n";
    out + &format!("<script>\n{JS}</script>\n</body>\n</html>\n")
}

fn contents(out: &mut String, sections: &[ReportSection], ids: &[String]) {
    if sections.is_empty() {
        return;
    }
    *out += "<nav aria-label=\"Contents\">\n<ol>\n";
    for (section, id) in sections.iter().zip(ids) {
        *out += &format!("<li><a href=\"#{id}\">{}</a></li>\n", escape(&section.title));
    }
    *out += "</ol>\n</nav>\n";
}

fn paragraph(out: &mut String, class: &str, text: &str) {
    if !text.trim().is_empty() {
        *out += &format!("<p class=\"{class}\">{}</p>\n", escape(text));
    }
}

/// One anchor for each section, all different, of lower-case ASCII letters, digits and `-`.
fn anchors(sections: &[ReportSection]) -> Vec<String> {
    // the page's own ids
    let mut used = BTreeSet::from(["top", "main", "status"].map(String::from));
    let clean = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' };
    let mut ids = Vec::with_capacity(sections.len());
    for section in sections {
        let name: String = section.id.trim().chars().map(clean).collect();
        let name = match name.trim_matches('-') {
            "" => "section",
            name => name,
        };
        let mut id = name.to_owned();
        let mut number = 1;
        while !used.insert(id.clone()) {
            number += 1;
            id = format!("{name}-{number}");
        }
        ids.push(id);
    }
    ids
}

/// Escapes text for use between tags and in quoted attributes.
pub(super) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            '"' => out += "&quot;",
            '\'' => out += "&#39;",
            '\n' | '\t' => out.push(c),
            // neither HTML nor XML may contain these
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => out.push(' '),
            c => out.push(c),
        }
    }
    out
}
