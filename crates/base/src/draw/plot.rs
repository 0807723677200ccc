//! Small line plots as SVG text.

use super::frame::{PlotAxis, PlotFrame, WIDTH, color, round, shortened, text};
use std::fmt::Write as _;

/// Height of the first row of names, between the title and the curves, and distance between rows.
const LEGEND: (f64, f64) = (43.0, 17.0);
/// Maximum number of names in the legend.
const MAX_NAMES: usize = 12;
/// Dashes that distinguish curves beyond the number of colours.
const DASHES: [&str; 3] = ["", " stroke-dasharray=\"8 5\"", " stroke-dasharray=\"2 5\""];

/// One curve. Points that are not finite break it.
#[derive(Debug, Clone, Default)]
pub struct PlotSeries {
    /// Name in the legend.
    pub name: String,
    /// (x, y) in drawing order.
    pub points: Vec<(f64, f64)>,
}

/// A line plot with linear axes. The legend names at most 12 curves.
pub fn line_plot(title: &str, x_label: &str, y_label: &str, series: &[PlotSeries]) -> String {
    plot(title, x_label, y_label, series, false)
}

/// A line plot with a logarithmic y axis; values that are not above zero break the curve.
pub fn line_plot_log_y(title: &str, x_label: &str, y_label: &str, series: &[PlotSeries]) -> String {
    plot(title, x_label, y_label, series, true)
}

/// An entry of the legend: a name, its curve, if it has one, and its position.
struct LegendEntry {
    curve: Option<usize>,
    name: String,
    x: f64,
    row: usize,
}

/// Lays out the names from `left` on, in rows that fit the width of the picture.
fn legend(series: &[PlotSeries], left: f64) -> Vec<LegendEntry> {
    let shown = if series.len() > MAX_NAMES { MAX_NAMES - 1 } else { series.len() };
    let names = series[..shown].iter().enumerate().map(|(index, s)| (Some(index), s.name.as_str()));
    let (mut x, mut row) = (left, 0);
    let mut entries = Vec::new();
    for (curve, name) in names.chain((shown < series.len()).then_some((None, "..."))) {
        let name = shortened(name, WIDTH - left - 38.0, 7.0);
        let width = 28.0 + 7.0 * name.chars().count() as f64;
        if x + width > WIDTH - 8.0 && x > left {
            (x, row) = (left, row + 1);
        }
        entries.push(LegendEntry { curve, name, x, row });
        x += width + 20.0;
    }
    entries
}

fn plot(title: &str, x_label: &str, y_label: &str, series: &[PlotSeries], log: bool) -> String {
    let height = |y: f64| if log { y.log10() } else { y };
    let curves: Vec<Vec<(f64, f64)>> =
        series.iter().map(|s| s.points.iter().map(|(x, y)| (*x, height(*y))).collect()).collect();
    let drawn = |(x, y): &&(f64, f64)| x.is_finite() && y.is_finite();
    let points = || curves.iter().flatten().filter(drawn);
    let x_axis = PlotAxis::of(points().map(|p| p.0), false);
    let y_axis = PlotAxis::of(points().map(|p| p.1), log);
    let names = legend(series, PlotFrame::LEFT);
    let frame = PlotFrame::new(x_axis, y_axis, LEGEND.1 * names.last().map_or(0.0, |entry| entry.row as f64));

    let mut svg = frame.begin(title, x_label, y_label);
    let style = |index: usize| {
        let dashes = DASHES[round(index) % DASHES.len()];
        format!("stroke=\"{}\" stroke-width=\"1.8\" fill=\"none\"{dashes}", color(index))
    };
    for (index, curve) in curves.iter().enumerate() {
        let mut path = String::new();
        let mut pen = 'M';
        for (x, y) in curve {
            if !drawn(&&(*x, *y)) {
                pen = 'M';
                continue;
            }
            // Writing to a String cannot fail.
            let _ = write!(path, "{pen}{:.1} {:.1}", frame.to_x(*x), frame.to_y(*y));
            // a lone point is drawn by the round cap of a line of length 0
            if pen == 'M' {
                path.push_str("h0");
            }
            pen = 'L';
        }
        svg += &format!("<path d=\"{path}\" {} stroke-linecap=\"round\"/>\n", style(index));
    }
    for LegendEntry { curve, name, x, row } in names {
        let y = LEGEND.0 + LEGEND.1 * row as f64;
        if let Some(index) = curve {
            svg += &format!("<path d=\"M{x:.1} {y:.1}h22\" {}/>\n", style(index));
        }
        svg += &text(x + 28.0, y + 4.0, "start", "", &name);
    }
    svg + "</svg>\n"
}

#[cfg(test)]
mod tests {
    use super::super::frame::tests::number;
    use super::*;
    use proptest::prelude::*;

    fn series(points: &[(f64, f64)]) -> PlotSeries {
        PlotSeries { name: "a<b & c".to_owned(), points: points.to_vec() }
    }

    #[test]
    fn curves_legend_and_ticks_are_there() {
        let svg = line_plot("T", "step", "dB", &[series(&[(0.0, 0.0), (10.0, 5.0)])]);
        assert!(svg.contains("M70.0 345.0h0L620.0 58.0"), "{svg}");
        assert!(svg.contains(">a&lt;b &amp; c</text>"));
        for tick in [">0<", ">2<", ">4<", ">10<", ">step<", ">dB<", ">T<"] {
            assert!(svg.contains(tick), "{tick}");
        }
    }

    #[test]
    fn a_bad_value_breaks_the_curve() {
        let points = [(0.0, 1.0), (1.0, f64::NAN), (2.0, 10.0), (3.0, 100.0)];
        let svg = line_plot("", "", "", &[series(&points)]);
        assert!(!svg.contains("NaN"), "{svg}");
        assert_eq!(svg.matches("h0").count(), 2);
        let mut points = points;
        points[1].1 = -1.0;
        let svg = line_plot_log_y("", "", "", &[series(&points)]);
        assert!(svg.contains(">100<") && svg.contains(">1<"), "{svg}");
        assert_eq!(svg.matches("h0").count(), 2);
    }

    #[test]
    fn many_names_wrap_and_the_rest_is_dots() {
        let named = |count: usize| -> Vec<PlotSeries> {
            (0..count).map(|i| PlotSeries { name: format!("variant-{i}"), points: vec![(i as f64, 1.0)] }).collect()
        };
        let twelve = line_plot("", "", "", &named(12));
        assert!(twelve.contains(">variant-11<") && !twelve.contains(">...<"));
        let many = line_plot("", "", "", &named(13));
        assert!(many.contains(">variant-10<") && !many.contains(">variant-11<") && many.contains(">...<"));
        let entries = legend(&named(12), 70.0);
        assert!(entries.iter().all(|e| e.x + 28.0 + 7.0 * e.name.len() as f64 <= WIDTH));
        assert_eq!((entries[0].row, entries[11].row), (0, 2));
        assert!(twelve.contains("viewBox=\"0 0 640 434\"") && twelve.matches("stroke-dasharray").count() == 12);
        let long = PlotSeries { name: "x".repeat(300), points: vec![] };
        assert!(line_plot("", "", "", &[long]).contains("x…<"));
    }

    #[test]
    fn no_points_still_give_axes() {
        assert!(line_plot("", "", "", &[]).contains("</svg>"));
        assert!(line_plot("", "", "", &[series(&[(1.0, 2.0)])]).contains("h0"));
    }

    proptest! {
        #[test]
        fn any_numbers_give_finite_coordinates(points in proptest::collection::vec((number(), number()), 0..6)) {
            for svg in [line_plot("", "", "", &[series(&points)]), line_plot_log_y("", "", "", &[series(&points)])] {
                prop_assert!(!svg.contains("NaN"), "{}", svg);
                prop_assert!(!svg.contains("inf"), "{}", svg);
            }
        }
    }
}
