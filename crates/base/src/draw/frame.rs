//! Shared by the plots: axes with round ticks, the frame around the curves, text and colours.

/// Width of a plot.
pub(super) const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 400.0;
/// Left, right, top and bottom edges of the area of the curves.
const AREA: [f64; 4] = [70.0, 620.0, 58.0, 345.0];
/// Colours that colour-blind readers can distinguish.
const COLORS: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
/// A range below this has no round ticks that a number can represent.
const TINY: f64 = 1e-290;

/// Range of an axis, in log10 where the axis is logarithmic.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PlotAxis {
    low: f64,
    high: f64,
    log: bool,
}

impl PlotAxis {
    /// An axis around finite `values`, which are log10 of the plotted values if `log`.
    pub(super) fn of(values: impl Iterator<Item = f64>, log: bool) -> Self {
        let start = (f64::INFINITY, f64::NEG_INFINITY);
        let (low, high) = values.fold(start, |(low, high), v| (low.min(v), high.max(v)));
        let (low, high) = match (low, high) {
            (low, high) if low > high => (0.0, 1.0),
            (low, high) if high - low <= (low.abs().max(high.abs()) * 1e-9).max(TINY) => {
                let half = if log { 0.5 } else { (low.abs() * 0.1).max(0.5) };
                ((low - half).max(f64::MIN), (high + half).min(f64::MAX))
            }
            range => range,
        };
        Self { low, high, log }
    }

    /// The same axis with room at both ends, so that no mark lies on the frame.
    pub(super) fn padded(self) -> Self {
        let room = (self.high / 2.0 - self.low / 2.0) * 0.12;
        let (low, high) = ((self.low - room).max(f64::MIN), (self.high + room).min(f64::MAX));
        Self { low, high, log: self.log }
    }

    /// Fraction of the axis, 0 at the low end and 1 at the high.
    pub(super) fn part(&self, value: f64) -> f64 {
        // Halved first, so that a range wider than the largest number does not overflow.
        (value / 2.0 - self.low / 2.0) / (self.high / 2.0 - self.low / 2.0)
    }

    /// Round positions of the ticks, about five.
    pub(super) fn ticks(&self) -> Vec<f64> {
        let raw = self.high / 5.0 - self.low / 5.0;
        let mut step = super::round_step(raw);
        if self.log && self.high - self.low >= 1.0 {
            step = step.max(1.0).round();
        }
        let first = (self.low / step).ceil();
        // Next to the largest number the sums below overflow.
        let on_axis = |tick: &f64| tick.is_finite() && *tick <= self.high + step * 1e-9;
        (0..12).map(|i| (first + f64::from(i)) * step).take_while(on_axis).collect()
    }

    /// The label of a tick.
    pub(super) fn label(&self, tick: f64) -> String {
        if self.log && tick.fract() == 0.0 && !(-3.0..5.0).contains(&tick) {
            return format!("1e{tick}");
        }
        let value = if self.log { 10f64.powf(tick) } else { tick };
        if !value.is_normal() && self.log {
            // beyond the largest and smallest numbers a logarithmic axis continues, but no number can hold its values
            return format!("{:.1}e{}", 10f64.powf(tick - tick.floor()), tick.floor());
        }
        let size = value.abs();
        let half_span = self.high / 2.0 - self.low / 2.0;
        if size < half_span * 2e-9 && !self.log {
            return "0".to_owned();
        }
        if !(1e-3..1e5).contains(&size) {
            return format!("{value:.1e}");
        }
        let text = format!("{value:.4}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    }
}

/// Two axes and their position.
pub(super) struct PlotFrame {
    x: PlotAxis,
    y: PlotAxis,
    /// Left, right, top and bottom edges of the area of the curves.
    pub(super) area: [f64; 4],
    height: f64,
}

impl PlotFrame {
    /// Left edge of the area of the curves.
    pub(super) const LEFT: f64 = AREA[0];

    /// A frame whose area of the curves begins `lowered` further down than under a legend of one row.
    pub(super) fn new(x: PlotAxis, y: PlotAxis, lowered: f64) -> Self {
        let [left, right, top, bottom] = AREA;
        Self { x, y, area: [left, right, top + lowered, bottom + lowered], height: HEIGHT + lowered }
    }

    pub(super) fn to_x(&self, x: f64) -> f64 {
        self.area[0] + self.x.part(x) * (self.area[1] - self.area[0])
    }

    pub(super) fn to_y(&self, y: f64) -> f64 {
        self.area[3] - self.y.part(y) * (self.area[3] - self.area[2])
    }

    /// The plot up to its curves; the caller ends it with `</svg>`.
    pub(super) fn begin(&self, title: &str, x_label: &str, y_label: &str) -> String {
        let [left, right, top, bottom] = self.area;
        let middle = (left + right) / 2.0;
        let mut svg = begin_svg(WIDTH, self.height, middle, title);
        svg += &text(middle, self.height - 14.0, "middle", "", x_label);
        let center = (top + bottom) / 2.0;
        let turned = format!(" transform=\"rotate(-90 16 {center})\"");
        svg += &text(16.0, center, "middle", &turned, y_label);
        let mut grid = String::new();
        for tick in self.x.ticks() {
            let x = self.to_x(tick);
            grid += &format!("M{x:.1} {top}V{bottom}");
            svg += &text(x, bottom + 18.0, "middle", "", &self.x.label(tick));
        }
        for tick in self.y.ticks() {
            let y = self.to_y(tick);
            grid += &format!("M{left} {y:.1}H{right}");
            svg += &text(left - 6.0, y + 4.0, "end", "", &self.y.label(tick));
        }
        svg += &format!("<path d=\"{grid}\" stroke=\"#ddd\" fill=\"none\"/>\n");
        svg + &format!("<path d=\"M{left} {top}V{bottom}H{right}\" stroke=\"#333\" fill=\"none\"/>\n")
    }
}

/// The head of an SVG on white, with its title centred at `middle`.
pub(super) fn begin_svg(width: f64, height: f64, middle: f64, title: &str) -> String {
    let title = shortened(title, 2.0 * middle.min(width - middle) - 10.0, 8.0);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" \
         font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n"
    ) + &text(middle, 24.0, "middle", " font-size=\"15\"", &title)
}

/// A line of text; `more` are further attributes.
pub(super) fn text(x: f64, y: f64, anchor: &str, more: &str, content: &str) -> String {
    format!("<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\"{more}>{}</text>\n", escape(content))
}

/// The colour of the curve or group `index`.
pub(super) fn color(index: usize) -> &'static str {
    COLORS[index % COLORS.len()]
}

/// How many times the colours are used up before `index`.
pub(super) fn round(index: usize) -> usize {
    index / COLORS.len()
}

/// `content`, cut so that letters of `letter` units fit into `width`.
pub(super) fn shortened(content: &str, width: f64, letter: f64) -> String {
    let max_letters = ((width / letter) as usize).max(1);
    if content.chars().count() <= max_letters {
        return content.to_owned();
    }
    content.chars().take(max_letters - 1).chain(['…']).collect()
}

/// Escapes text for XML.
pub(super) fn escape(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Any number, often one at the limits of the number range, where sums overflow.
    pub(in super::super) fn number() -> impl Strategy<Value = f64> {
        let ends = prop::sample::select(vec![f64::MAX, f64::MIN, 1.5e308, -1.5e308, 5e-324, f64::INFINITY, f64::NAN]);
        prop_oneof![any::<f64>(), ends]
    }

    #[test]
    fn ranges_that_have_no_ticks_are_widened() {
        let ends = [vec![f64::MAX], vec![f64::MIN], vec![f64::MAX, f64::MIN]];
        for values in [vec![], vec![3.0], vec![0.0, 5e-324]].into_iter().chain(ends) {
            for axis in
                [PlotAxis::of(values.iter().copied(), false), PlotAxis::of(values.iter().copied(), false).padded()]
            {
                let ticks = axis.ticks();
                assert!(!ticks.is_empty() && ticks.iter().all(|tick| tick.is_finite()), "{axis:?}");
                assert!(ticks.iter().filter(|tick| axis.label(**tick) == "0").count() <= 1, "{axis:?}");
                assert!(values.iter().all(|v| (0.0..=1.0).contains(&axis.part(*v))), "{axis:?}");
            }
        }
        assert_eq!(PlotAxis::of([-1.0, 2.0].into_iter(), true).ticks().len(), 4);
    }

    #[test]
    fn a_logarithmic_axis_goes_on_where_numbers_end() {
        // a lone value gets half a power of ten on either side, and rounding may leave slightly less than a whole one
        for (values, labels) in [([307.8, 308.7], ["1e308", "2.5e308"]), ([-324.0, -323.1], ["1e-324", "4.0e-324"])] {
            let axis = PlotAxis::of(values.into_iter(), true);
            let found: Vec<String> = axis.ticks().into_iter().map(|tick| axis.label(tick)).collect();
            assert!(labels.iter().all(|label| found.iter().any(|text| text == label)), "{found:?}");
            assert!(found.iter().all(|text| !text.contains("inf") && text != "0"), "{found:?}");
        }
    }

    #[test]
    fn long_names_are_cut() {
        assert_eq!(shortened("abcdef", 35.0, 7.0), "abcd…");
        assert_eq!(shortened("abcde", 35.0, 7.0), "abcde");
        assert_eq!(shortened("ab", 0.0, 7.0), "…");
    }
}
