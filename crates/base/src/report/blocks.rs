//! The HTML of each kind of block. The page around them is in `page`, their styles in `report.css`, their behaviour in
//! `report.js`.

use super::page::escape;
use super::{Headline, ReportBlock};
use crate::durations::exact_duration;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

/// Frames per second if the requested number is out of range.
const DEFAULT_FPS: f32 = 8.0;
const PNG_SIGNATURE: [u8; 8] = *b"\x89PNG\r\n\x1a\n";

/// Appends `block` to the page.
pub(super) fn render(out: &mut String, block: &ReportBlock) {
    *out += &match block {
        ReportBlock::Text(text) => paragraphs(text),
        ReportBlock::Figure { png, alt, caption } => {
            let card = format!("<div class=\"card\">{}</div>\n", image(png, alt, ""));
            figure("single", &size_style(png), &card, caption)
        }
        ReportBlock::Figures { items, columns } => figures(items, *columns),
        ReportBlock::Compare { left, left_name, right, right_name, caption } => {
            figure("wide", &size_style(left), &compare([left, right], [left_name, right_name]), caption)
        }
        ReportBlock::Turntable { frames, labels, caption, fps } => turntable(frames, labels, caption, *fps),
        ReportBlock::Svg { svg, caption } => plot(svg, caption),
        ReportBlock::Table { head, rows, caption, highlight } => table(head, rows, caption, *highlight),
        ReportBlock::Numbers(numbers) => headline(numbers),
        ReportBlock::Commands(commands) => code(commands),
        ReportBlock::Timings(stages) => timings(stages),
        ReportBlock::Missing { what, how } => missing(what, how),
    };
}

fn paragraphs(text: &str) -> String {
    let text = text.replace("\r\n", "\n");
    let parts = text.split("\n\n").filter(|part| !part.trim().is_empty());
    parts.map(|part| format!("<p>{}</p>\n", escape(part.trim()))).collect()
}

/// Width and height in pixels, from the header; `None` if this is not a PNG.
fn png_size(png: &[u8]) -> Option<(u32, u32)> {
    let rest = png.strip_prefix(&PNG_SIGNATURE)?;
    let number = |at: usize| rest.get(at..at + 4)?.try_into().ok().map(u32::from_be_bytes);
    (rest.get(4..8)? == b"IHDR").then_some(())?;
    Some((number(8)?, number(12)?)).filter(|(width, height)| *width > 0 && *height > 0)
}

/// The picture's own width for the style sheet, which limits the enlargement of small pictures.
fn size_style(png: &[u8]) -> String {
    png_size(png).map_or_else(String::new, |(width, _)| format!(" style=\"--w:{width}px\""))
}

fn image(png: &[u8], alt: &str, attributes: &str) -> String {
    let alt = escape(alt);
    let Some((width, height)) = png_size(png) else {
        return format!(
            "<p class=\"broken\"{attributes}>{alt}: cannot be shown, as these {} bytes are not a PNG.</p>",
            png.len()
        );
    };
    let data = STANDARD.encode(png);
    format!(
        "<img src=\"data:image/png;base64,{data}\" alt=\"{alt}\" width=\"{width}\" height=\"{height}\"{attributes}/>"
    )
}

/// What `make` makes of a text, escaped; nothing of a blank one.
fn unless_blank(text: &str, make: impl FnOnce(String) -> String) -> String {
    let text = text.trim();
    if text.is_empty() { String::new() } else { make(escape(text)) }
}

/// A figure of one of the widths in the style sheet, with its caption below.
fn figure(class: &str, style: &str, content: &str, caption: &str) -> String {
    let caption = unless_blank(caption, |text| format!("<figcaption>{text}</figcaption>\n"));
    format!("<figure class=\"{class}\"{style}>\n{content}{caption}</figure>\n")
}

fn figures(items: &[(Vec<u8>, String)], columns: usize) -> String {
    let mut out = format!("<div class=\"grid\" style=\"--columns:{}\">\n", columns.clamp(1, 8));
    for (png, caption) in items {
        let card = format!("<div class=\"card\">{}</div>\n", image(png, caption, ""));
        out += &figure("cell", "", &card, caption);
    }
    out + "</div>\n"
}

fn compare([left, right]: [&[u8]; 2], [left_name, right_name]: [&str; 2]) -> String {
    let pictures = image(left, left_name, " class=\"left\"") + &image(right, right_name, " class=\"right\"");
    let (left_name, right_name) = (escape(left_name), escape(right_name));
    format!(
        "<div class=\"card compare\">{pictures}\n\
         <span class=\"tag at-left\" aria-hidden=\"true\">{left_name}</span>\
         <span class=\"tag at-right\" aria-hidden=\"true\">{right_name}</span>\n\
         <input type=\"range\" min=\"0\" max=\"100\" value=\"50\" \
         aria-label=\"Border between {left_name} and {right_name}, in percent from the left\"/>\
         <span class=\"border\" aria-hidden=\"true\"></span>\n</div>\n"
    )
}

fn turntable(frames: &[Vec<u8>], labels: &[String], caption: &str, fps: f32) -> String {
    let Some(first) = frames.first() else {
        return missing("Turntable without frames", caption);
    };
    let count = frames.len();
    let fps = if (0.5..=60.0).contains(&fps) { fps } else { DEFAULT_FPS };
    let label = |index: usize| labels.get(index).cloned().unwrap_or_else(|| format!("{} of {count}", index + 1));
    let mut out = format!("<div class=\"turntable\" data-fps=\"{fps}\">\n<div class=\"card stage\">\n");
    for (index, png) in frames.iter().enumerate() {
        let class = if index == 0 { " class=\"on\"" } else { "" };
        out += &image(png, &label(index), &format!("{class} data-label=\"{}\"", escape(&label(index))));
        out.push('\n');
    }
    out += "</div>\n";
    if count > 1 {
        out += &format!(
            "<div class=\"controls\"><button type=\"button\">Play</button>\
             <input type=\"range\" min=\"0\" max=\"{}\" value=\"0\" aria-label=\"Frame\" aria-valuetext=\"{1}\"/>\
             <output>{1}</output></div>\n",
            count - 1,
            escape(&label(0))
        );
    }
    out += "</div>\n";
    figure("wide", &size_style(first), &out, caption)
}

fn plot(svg: &str, caption: &str) -> String {
    let alt = if caption.trim().is_empty() { "Plot" } else { caption.trim() };
    let card = format!(
        "<div class=\"card plot\" tabindex=\"0\" role=\"group\" aria-label=\"Plot\">\
         <img src=\"data:image/svg+xml;base64,{}\" alt=\"{}\"/></div>\n",
        STANDARD.encode(svg),
        escape(alt)
    );
    figure("plots", "", &card, caption)
}

/// True for `12`, `-0.5`, `30.1 dB`, `98 %`, and for what is shown in place of a missing number.
fn numeric(cell: &str) -> bool {
    let first = bold(cell).unwrap_or(cell).split_whitespace().next().unwrap_or("");
    let number = first.trim_end_matches(['%', '×', 'x']).replace(['−', '–', '—'], "-").replace(',', "");
    matches!(number.as_str(), "" | "-" | "n/a")
        || number.trim_start_matches(['±', '<', '>', '≈']).parse::<f64>().is_ok()
}

/// The text enclosed in `**`, if the cell is marked in this way.
fn bold(cell: &str) -> Option<&str> {
    let inner = cell.trim().strip_prefix("**")?.strip_suffix("**")?.trim();
    (!inner.is_empty() && !inner.contains("**")).then_some(inner)
}

fn table(head: &[String], rows: &[Vec<String>], caption: &str, highlight: Option<usize>) -> String {
    let columns = rows.iter().map(Vec::len).chain([head.len()]).max().unwrap_or(0);
    let cell = |row: &[String], column: usize| match row.get(column) {
        None => String::new(),
        Some(text) => match bold(text) {
            Some(inner) => format!("<strong>{}</strong>", escape(inner)),
            None => escape(text),
        },
    };
    let classes: Vec<String> = (0..columns)
        .map(|column| {
            let cells = || rows.iter().filter_map(|row| row.get(column));
            let number = column > 0 && cells().any(|text| !text.trim().is_empty()) && cells().all(|text| numeric(text));
            let names = [(number, "number"), (highlight == Some(column), "best")];
            let names: Vec<&str> = names.iter().filter(|(on, _)| *on).map(|(_, name)| *name).collect();
            if names.is_empty() { String::new() } else { format!(" class=\"{}\"", names.join(" ")) }
        })
        .collect();
    let name = if caption.trim().is_empty() { "Table".to_owned() } else { escape(caption.trim()) };
    let mut out = format!("<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"{name}\">\n<table>\n");
    if !caption.trim().is_empty() {
        out += &format!("<caption>{name}</caption>\n");
    }
    out += "<thead><tr>";
    for (column, class) in classes.iter().enumerate() {
        out += &format!("<th scope=\"col\"{class}>{}</th>", cell(head, column));
    }
    out += "</tr></thead>\n<tbody>\n";
    for row in rows {
        out += "<tr>";
        for (column, class) in classes.iter().enumerate() {
            let (open, close) = if column == 0 { ("th scope=\"row\"", "th") } else { ("td", "td") };
            out += &format!("<{open}{class}>{}</{close}>", cell(row, column));
        }
        out += "</tr>\n";
    }
    out + "</tbody>\n</table>\n</div>\n"
}

fn headline(numbers: &[Headline]) -> String {
    let optional = |class, text| unless_blank(text, |text| format!(" <span class=\"{class}\">{text}</span>"));
    if numbers.is_empty() {
        return String::new();
    }
    let mut out = "<dl class=\"numbers\">\n".to_owned();
    for Headline { value, unit, name, note } in numbers {
        out += &format!(
            "<div><dt>{}</dt><dd><span class=\"value\">{}</span>{}{}</dd></div>\n",
            escape(name),
            escape(value),
            optional("unit", unit),
            optional("note", note)
        );
    }
    out + "</dl>\n"
}

fn code(commands: &[(String, String)]) -> String {
    if commands.is_empty() {
        return String::new();
    }
    let mut out = "<ul class=\"commands\">\n".to_owned();
    for (comment, command) in commands {
        let comment = unless_blank(comment, |text| format!("<p class=\"comment\"># {text}</p>"));
        out += &format!(
            "<li>{comment}<div><pre><code>{0}</code></pre>\
             <button type=\"button\" aria-label=\"Copy: {0}\">Copy</button></div></li>\n",
            escape(command)
        );
    }
    out + "</ul>\n"
}

fn timings(stages: &[(String, f64)]) -> String {
    let known = || stages.iter().map(|(_, seconds)| *seconds).filter(|s| s.is_finite() && *s >= 0.0);
    let longest = known().fold(0.0, f64::max);
    let mut out = "<table class=\"timings\">\n<thead class=\"unseen\"><tr><th scope=\"col\">Stage</th>\
                   <th scope=\"col\">Share</th><th scope=\"col\">Time</th></tr></thead>\n<tbody>\n"
        .to_owned();
    for (name, seconds) in stages {
        let part = if longest > 0.0 && *seconds > 0.0 { (seconds / longest * 100.0).min(100.0) } else { 0.0 };
        out += &format!(
            "<tr><th scope=\"row\">{}</th><td class=\"bar\"><span style=\"width:{part:.1}%\"></span></td>\
             <td class=\"number\">{}</td></tr>\n",
            escape(name),
            exact_duration(*seconds)
        );
    }
    out + &format!(
        "</tbody>\n<tfoot><tr><th scope=\"row\">Total</th><td></td><td class=\"number\">{}</td></tr></tfoot>\n</table>\n",
        exact_duration(known().sum())
    )
}

fn missing(what: &str, how: &str) -> String {
    let how = unless_blank(how, |text| format!("<p>{text}</p>"));
    format!("<div class=\"missing\"><p><strong>Not available yet:</strong> {}</p>{how}</div>\n", escape(what))
}
