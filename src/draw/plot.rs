//! Small line plots as SVG text.

use std::fmt::Write as _;

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 400.0;
/// Left, right, top and bottom edges of the area of the curves.
const AREA: [f64; 4] = [70.0, 620.0, 58.0, 345.0];
/// Height of the row of names, between the title and the curves.
const LEGEND: f64 = 43.0;
const COLORS: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];

/// One curve. Points that are not finite break it.
#[derive(Debug, Clone, Default)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// (x, y) in drawing order.
    pub points: Vec<(f64, f64)>,
}

/// A line plot with linear axes.
#[must_use]
pub fn line_plot(title: &str, x_label: &str, y_label: &str, series: &[Series]) -> String {
    plot(title, x_label, y_label, series, false)
}

/// A line plot with a logarithmic y axis; values that are not above zero break the curve.
#[must_use]
pub fn line_plot_log_y(title: &str, x_label: &str, y_label: &str, series: &[Series]) -> String {
    plot(title, x_label, y_label, series, true)
}

/// Range of an axis, in log10 where the axis is logarithmic.
struct Axis {
    low: f64,
    high: f64,
    log: bool,
}

impl Axis {
    fn of(values: impl Iterator<Item = f64>, log: bool) -> Self {
        let start = (f64::INFINITY, f64::NEG_INFINITY);
        let (low, high) = values.fold(start, |(low, high), v| (low.min(v), high.max(v)));
        let (low, high) = match (low, high) {
            (low, high) if low > high => (0.0, 1.0),
            (low, high) if high - low <= low.abs().max(high.abs()) * 1e-9 => {
                let half = if log { 0.5 } else { (low.abs() * 0.1).max(0.5) };
                (low - half, high + half)
            }
            range => range,
        };
        Self { low, high, log }
    }

    /// Part of the axis, 0 at the low end and 1 at the high.
    fn part(&self, value: f64) -> f64 {
        // Halved first, so that a range wider than the largest number does not overflow.
        (value / 2.0 - self.low / 2.0) / (self.high / 2.0 - self.low / 2.0)
    }

    /// Round positions of the ticks, about five.
    fn ticks(&self) -> Vec<f64> {
        let raw = self.high / 5.0 - self.low / 5.0;
        let power = 10f64.powf(raw.log10().floor());
        let nice = [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power);
        let mut step = nice.into_iter().find(|s| *s >= raw * 0.999).unwrap_or(raw);
        if self.log && self.high - self.low >= 1.0 {
            step = step.max(1.0).round();
        }
        let first = (self.low / step).ceil();
        (0..12).map(|i| (first + f64::from(i)) * step).take_while(|tick| *tick <= self.high + step * 1e-9).collect()
    }

    fn label(&self, tick: f64) -> String {
        if self.log && tick.fract() == 0.0 && !(-3.0..5.0).contains(&tick) {
            return format!("1e{tick}");
        }
        let value = if self.log { 10f64.powf(tick) } else { tick };
        let size = value.abs();
        let span = self.high - self.low;
        if size < span * 1e-9 && !self.log {
            return "0".to_owned();
        }
        if !(1e-3..1e5).contains(&size) {
            return format!("{value:.1e}");
        }
        let text = format!("{value:.4}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    }
}

fn plot(title: &str, x_label: &str, y_label: &str, series: &[Series], log: bool) -> String {
    let height = |y: f64| if log { y.log10() } else { y };
    let curves: Vec<Vec<(f64, f64)>> =
        series.iter().map(|s| s.points.iter().map(|(x, y)| (*x, height(*y))).collect()).collect();
    let drawn = |(x, y): &&(f64, f64)| x.is_finite() && y.is_finite();
    let points = || curves.iter().flatten().filter(drawn);
    let x_axis = Axis::of(points().map(|p| p.0), false);
    let y_axis = Axis::of(points().map(|p| p.1), log);
    let [left, right, top, bottom] = AREA;
    let to_x = |x: f64| left + x_axis.part(x) * (right - left);
    let to_y = |y: f64| bottom - y_axis.part(y) * (bottom - top);

    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" \
         font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"white\"/>\n"
    );
    let text = |x: f64, y: f64, anchor: &str, more: &str, content: &str| {
        let content = escape(content);
        format!("<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\"{more}>{content}</text>\n")
    };
    let middle = (left + right) / 2.0;
    svg += &text(middle, 24.0, "middle", " font-size=\"15\"", title);
    svg += &text(middle, HEIGHT - 14.0, "middle", "", x_label);
    let center = (top + bottom) / 2.0;
    let turned = format!(" transform=\"rotate(-90 16 {center})\"");
    svg += &text(16.0, center, "middle", &turned, y_label);
    let mut grid = String::new();
    for tick in x_axis.ticks() {
        let x = to_x(tick);
        grid += &format!("M{x:.1} {top}V{bottom}");
        svg += &text(x, bottom + 18.0, "middle", "", &x_axis.label(tick));
    }
    for tick in y_axis.ticks() {
        let y = to_y(tick);
        grid += &format!("M{left} {y:.1}H{right}");
        svg += &text(left - 6.0, y + 4.0, "end", "", &y_axis.label(tick));
    }
    svg += &format!("<path d=\"{grid}\" stroke=\"#ddd\" fill=\"none\"/>\n");
    svg += &format!("<path d=\"M{left} {top}V{bottom}H{right}\" stroke=\"#333\" fill=\"none\"/>\n");
    let mut legend = left;
    for (index, (entry, curve)) in series.iter().zip(&curves).enumerate() {
        let color = COLORS[index % COLORS.len()];
        let mut path = String::new();
        let mut pen = 'M';
        for (x, y) in curve {
            if !drawn(&&(*x, *y)) {
                pen = 'M';
                continue;
            }
            // Writing to a String cannot fail.
            let _ = write!(path, "{pen}{:.1} {:.1}", to_x(*x), to_y(*y));
            // A lone point is drawn by the round cap of a line of no length.
            if pen == 'M' {
                path.push_str("h0");
            }
            pen = 'L';
        }
        let style = format!("stroke=\"{color}\" stroke-width=\"1.8\" fill=\"none\"");
        svg += &format!("<path d=\"{path}\" {style} stroke-linecap=\"round\"/>\n");
        svg += &format!("<path d=\"M{legend:.1} {LEGEND}h22\" {style}/>\n");
        svg += &text(legend + 28.0, LEGEND + 4.0, "start", "", &entry.name);
        // letters are some 7 units wide
        legend += 48.0 + 7.0 * entry.name.chars().count() as f64;
    }
    svg + "</svg>\n"
}

/// Text as it may stand in XML.
fn escape(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn series(points: &[(f64, f64)]) -> Series {
        Series { name: "a<b & c".to_owned(), points: points.to_vec() }
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
    fn no_points_still_give_axes() {
        assert!(line_plot("", "", "", &[]).contains("</svg>"));
        assert!(line_plot("", "", "", &[series(&[(1.0, 2.0)])]).contains("h0"));
    }

    proptest! {
        #[test]
        fn any_numbers_give_finite_coordinates(points in proptest::collection::vec(any::<(f64, f64)>(), 0..6)) {
            for svg in [line_plot("", "", "", &[series(&points)]), line_plot_log_y("", "", "", &[series(&points)])] {
                prop_assert!(!svg.contains("NaN"), "{}", svg);
                prop_assert!(!svg.contains("inf"), "{}", svg);
            }
        }
    }
}
