//! Behaviour of the page: texts are escaped, nothing is fetched, every block is present, tags balance.

use super::*;
use crate::draw::plot::{PlotSeries, line_plot};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::{ImageFormat, Rgba, RgbaImage};
use proptest::prelude::*;

fn png(width: u32, height: u32, shade: u8) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let picture = RgbaImage::from_fn(width, height, |x, y| Rgba([shade, x as u8, y as u8, 255]));
    picture.write_to(&mut bytes, ImageFormat::Png).unwrap();
    bytes.into_inner()
}

fn text(value: &str) -> String {
    value.to_owned()
}

fn report(blocks: Vec<ReportBlock>) -> Report {
    let section = ReportSection { id: text("part"), title: text("Part"), intro: text("Intro."), blocks };
    Report { title: text("Demo"), subtitle: text("Sub"), sections: vec![section] }
}

fn page(block: ReportBlock) -> String {
    report(vec![block]).to_html()
}

/// Every kind of block, with `word` in each text.
fn all_blocks(word: &str) -> Vec<ReportBlock> {
    let w = || text(word);
    let curve = PlotSeries { name: w(), points: vec![(0.0, 1.0), (1.0, 3.0)] };
    vec![
        ReportBlock::Text(w()),
        ReportBlock::Figure { png: png(3, 2, 1), alt: w(), caption: w() },
        ReportBlock::Figures { items: vec![(png(4, 4, 2), w()), (Vec::new(), w())], columns: 2 },
        ReportBlock::Compare { left: png(4, 4, 3), left_name: w(), right: png(4, 4, 4), right_name: w(), caption: w() },
        ReportBlock::Turntable { frames: vec![png(4, 4, 5), png(4, 4, 6)], labels: vec![w()], caption: w(), fps: 12.0 },
        ReportBlock::Svg { svg: line_plot(word, word, word, &[curve]), caption: w() },
        ReportBlock::Table { head: vec![w(), w()], rows: vec![vec![w(), w()]], caption: w(), highlight: Some(1) },
        ReportBlock::Numbers(vec![Headline { value: w(), unit: w(), name: w(), note: w() }]),
        ReportBlock::Commands(vec![(w(), w())]),
        ReportBlock::Timings(vec![(w(), 1.5)]),
        ReportBlock::Missing { what: w(), how: w() },
    ]
}

fn full(word: &str) -> Report {
    let section =
        |id: &str| ReportSection { id: text(id), title: text(word), intro: text(word), blocks: all_blocks(word) };
    Report { title: text(word), subtitle: text(word), sections: vec![section("a"), section(word)] }
}

/// Walks the tags of the page outside script and style; fails at the first that does not match.
fn check_balance(html: &str) -> Result<(), String> {
    let mut open: Vec<&str> = Vec::new();
    let mut rest = html.strip_prefix("<!DOCTYPE html>").ok_or("no doctype")?;
    while let Some(start) = rest.find('<') {
        rest = &rest[start + 1..];
        let end = rest.find('>').ok_or("a tag that does not end")?;
        let (tag, after) = (&rest[..end], &rest[end + 1..]);
        rest = after;
        if tag.contains('<') || tag.matches('"').count() % 2 != 0 {
            return Err(format!("broken tag <{tag}>"));
        }
        if let Some(name) = tag.strip_prefix('/') {
            let last = open.pop();
            if last != Some(name) {
                return Err(format!("</{name}> closes {last:?}"));
            }
        } else if !tag.ends_with('/') {
            let name = tag.split_whitespace().next().ok_or("a tag without a name")?;
            open.push(name);
            if matches!(name, "script" | "style") {
                rest = &rest[rest.find(&format!("</{name}>")).ok_or("script or style does not end")?..];
            }
        }
    }
    if open.is_empty() { Ok(()) } else { Err(format!("left open: {open:?}")) }
}

/// The page without the data of its pictures.
fn without_pictures(html: &str) -> String {
    let mut parts = html.split(";base64,");
    let mut out = text(parts.next().unwrap());
    for part in parts {
        out += &part[part.find('"').unwrap()..];
    }
    out
}

#[test]
fn markup_in_any_text_is_shown_literally() {
    let evil = "<script>alert(\"1\")</script>' onload='x & <!--";
    let html = full(evil).to_html();
    assert_eq!(html.matches("<script").count(), 1, "only the page's own script");
    assert!(!html.contains("onload='x"));
    assert!(!html.contains("<!--"));
    assert!(
        html.contains(
            "<title>&lt;script&gt;alert(&quot;1&quot;)&lt;/script&gt;&#39; onload=&#39;x &amp; &lt;!--</title>"
        )
    );
    check_balance(&html).unwrap();
}

#[test]
fn a_script_in_a_plot_stays_inside_a_picture() {
    let html = page(ReportBlock::Svg { svg: text("<svg><script>steal()</script></svg>"), caption: String::new() });
    assert!(!html.contains("steal"));
    assert!(html.contains("<img src=\"data:image/svg+xml;base64,") && html.contains("alt=\"Plot\""));
}

#[test]
fn every_block_is_rendered() {
    let marks = [
        "<p>word</p>",
        "<figure class=\"single\"",
        "style=\"--columns:2\"",
        "class=\"card compare\"",
        "data-fps=\"12\"",
        "data:image/svg+xml",
        "<td class=\"best\">word</td>",
        "<span class=\"value\">word</span>",
        "<pre><code>word</code></pre>",
        "<td class=\"number\">1.5 s</td>",
        "Not available yet:</strong> word",
    ];
    let blocks = all_blocks("word");
    assert_eq!(blocks.len(), marks.len());
    let none = report(Vec::new()).to_html();
    for (block, mark) in blocks.into_iter().zip(marks) {
        let html = page(block);
        assert!(html.contains(mark) && !none.contains(mark), "{mark}");
        check_balance(&html).unwrap();
    }
}

#[test]
fn an_embedded_picture_survives_a_round_trip() {
    let picture = png(17, 9, 200);
    let html = page(ReportBlock::Figure { png: picture.clone(), alt: text("a"), caption: text("c") });
    let data = html.split("src=\"data:image/png;base64,").nth(1).unwrap();
    let bytes = STANDARD.decode(&data[..data.find('"').unwrap()]).unwrap();
    assert_eq!(bytes, picture);
    assert!(html.contains("width=\"17\" height=\"9\""));
    assert_eq!(image::load_from_memory(&bytes).unwrap().to_rgba8().get_pixel(16, 8), &Rgba([200, 16, 8, 255]));
}

#[test]
fn nothing_is_fetched_and_the_page_itself_is_small() {
    let html = full("plain words").to_html();
    for word in ["http://", "https://", "url(", "@import", "<iframe", "src=\"//", "fetch("] {
        assert!(!html.contains(word), "{word}");
    }
    assert!(html.contains("default-src 'none'"));
    for link in html.split("href=\"").skip(1) {
        assert!(link.starts_with('#') || link.starts_with("data:,"), "{}", &link[..20]);
    }
    for source in html.split("src=\"").skip(1) {
        assert!(source.starts_with("data:image/"), "{}", &source[..20]);
    }
    let size = without_pictures(&html).len();
    assert!(size < 30_000, "{size} bytes besides pictures");
}

#[test]
fn bytes_that_are_not_a_png_are_replaced_by_a_note() {
    for bytes in [vec![], b"\x89PNG\r\n\x1a\n".to_vec(), png(4, 4, 0)[..20].to_vec(), b"GIF89a".to_vec()] {
        let count = bytes.len();
        let html = page(ReportBlock::Figure { png: bytes, alt: text("slice"), caption: String::new() });
        assert!(html.contains(&format!("slice: cannot be shown, as these {count} bytes are not a PNG.")), "{count}");
        check_balance(&html).unwrap();
    }
}

#[test]
fn anchors_are_clean_unique_and_linked() {
    let section = |id: &str| ReportSection { id: text(id), ..ReportSection::default() };
    let ids = ["Quality", "quality", "", "main", "a \"b\"", "quality-2"];
    let html = Report { sections: ids.iter().map(|id| section(id)).collect(), ..Report::default() }.to_html();
    for id in ["quality", "quality-2", "section", "main-2", "a--b", "quality-2-2"] {
        assert_eq!(html.matches(&format!(" id=\"{id}\"")).count(), 1, "{id}");
        assert_eq!(html.matches(&format!("href=\"#{id}\"")).count(), 1, "{id}");
    }
}

#[test]
fn empty_and_ragged_content_still_gives_a_page() {
    check_balance(&Report::default().to_html()).unwrap();
    let blocks = vec![
        ReportBlock::Text(String::new()),
        ReportBlock::Figures { items: vec![], columns: 0 },
        ReportBlock::Turntable { frames: vec![], labels: vec![], caption: text("none"), fps: 1.0 },
        ReportBlock::Turntable { frames: vec![png(2, 2, 0)], labels: vec![], caption: String::new(), fps: f32::NAN },
        ReportBlock::Table { head: vec![], rows: vec![], caption: String::new(), highlight: Some(9) },
        ReportBlock::Numbers(vec![]),
        ReportBlock::Commands(vec![]),
        ReportBlock::Timings(vec![]),
    ];
    let html = report(blocks).to_html();
    check_balance(&html).unwrap();
    assert!(html.contains("Turntable without frames") && html.contains("data-fps=\"8\""));
    assert!(!html.contains("class=\"controls\""), "one frame needs no controls");
    let rows = vec![vec![text("a")], vec![text("b"), text("1"), text("2")]];
    let html = page(ReportBlock::Table { head: vec![text("h")], rows, caption: String::new(), highlight: None });
    assert_eq!((html.matches("<th scope=\"col\"").count(), html.matches("<td").count()), (3, 4));
}

#[test]
fn numeric_columns_are_right_aligned() {
    let row = |cells: [&str; 4]| cells.map(text).to_vec();
    let rows = vec![row(["8", "30.1 dB", "–", "fine"]), row(["16", "−2.5", "98 %", "3"])];
    let head = row(["Views", "PSNR", "Hits", "Word"]);
    let html = page(ReportBlock::Table { head, rows, caption: text("T"), highlight: Some(1) });
    assert!(html.contains("<th scope=\"col\" class=\"number best\">PSNR</th>"));
    assert!(html.contains("<td class=\"number\">98 %</td>"));
    assert!(html.contains("<td>fine</td>") && html.contains("<th scope=\"row\">16</th>"));
}

#[test]
fn cells_in_double_asterisks_are_bold_and_still_numeric() {
    let row = |cells: [&str; 3]| cells.map(text).to_vec();
    let rows = vec![row(["a", "**30.1 ± 0.2**", "** <b> **"]), row(["**", "29", "****"])];
    let html =
        page(ReportBlock::Table { head: row(["v", "PSNR", "w"]), rows, caption: String::new(), highlight: None });
    assert!(html.contains("<td class=\"number\"><strong>30.1 ± 0.2</strong></td>"));
    assert!(html.contains("<strong>&lt;b&gt;</strong>"));
    assert!(html.contains("<th scope=\"row\">**</th>") && html.contains("<td>****</td>"));
    check_balance(&html).unwrap();
}

#[test]
fn times_are_readable_and_non_finite_values_do_not_spread() {
    let times = [0.0421, 3.11, 59.4, 59.7, 245.0, 7_199.0, f64::NAN, f64::INFINITY, -1.0];
    let stages = times.iter().enumerate().map(|(i, seconds)| (format!("stage {i}"), *seconds)).collect();
    let html = page(ReportBlock::Timings(stages));
    for shown in ["0.042 s", "3.1 s", "59 s", "1 min 00 s", "4 min 05 s", "2 h 00 min", "2 h 06 min"] {
        assert!(html.contains(&format!(">{shown}<")), "{shown}");
    }
    assert_eq!(html.matches(">–<").count(), 3);
    let table = html.split("class=\"timings\"").nth(1).unwrap();
    let table = &table[..table.find("</table>").unwrap()];
    assert!(!table.contains("NaN") && !table.contains("inf"), "{table}");
    assert!(table.contains("width:100.0%"));
}

#[test]
fn frames_without_a_label_are_numbered() {
    let frames = vec![png(2, 2, 0), png(2, 2, 1), png(2, 2, 2)];
    let html = page(ReportBlock::Turntable { frames, labels: vec![text("t = 0")], caption: text("c"), fps: 10.0 });
    assert!(html.contains("data-label=\"t = 0\"") && html.contains("data-label=\"3 of 3\""));
    assert!(html.contains("max=\"2\"") && html.matches("class=\"on\"").count() == 1);
}

#[test]
fn write_replaces_the_page_and_reports_failures() {
    let dir = std::env::temp_dir().join(format!("volseggs-report-{}", std::process::id()));
    std::fs::create_dir_all(&dir).unwrap();
    let path = dir.join("report.html");
    std::fs::write(&path, "old").unwrap();
    let report = full("w");
    report.write(&path).unwrap();
    assert_eq!(std::fs::read_to_string(&path).unwrap(), report.to_html());
    assert_eq!(std::fs::read_dir(&dir).unwrap().count(), 1, "no temporary is left");
    let message = report.write(&dir.join("absent").join("report.html")).unwrap_err().to_string();
    assert!(message.contains("absent") && message.contains("check that its folder exists"), "{message}");
    std::fs::remove_dir_all(&dir).unwrap();
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn any_text_gives_balanced_tags(word in "\\PC{0,12}|[<>\"'&/!\\x00-\\x1f-]{0,12}") {
        let html = full(&word).to_html();
        prop_assert_eq!(check_balance(&html), Ok(()));
        prop_assert!(!html.chars().any(|c| c.is_control() && c != '\n' && c != '\t'));
    }
}
