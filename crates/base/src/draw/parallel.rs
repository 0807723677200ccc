//! Parallel coordinates as SVG text: each run is a line through its settings, coloured by its outcome.

use super::frame::{PlotAxis, WIDTH, begin_svg, escape, shortened, text};
use std::fmt::Write as _;

const HEIGHT: f64 = 420.0;
/// Top and bottom ends of the axes.
const SPAN: [f64; 2] = [84.0, 396.0];
/// Room left of the first axis and right of the last.
const SIDES: [f64; 2] = [95.0, 95.0];
/// Minimum distance between two axes.
const MIN_DISTANCE: f64 = 118.0;
/// Heights of the names of axes, alternating where they would touch.
const NAME_HEIGHTS: [f64; 2] = [68.0, 50.0];
/// Colours at fractions 0, 0.2, .. 1 of the last axis: lightness rises evenly from dark violet to orange, which is
/// still visible on white paper, in grey too.
const COLORS: [[f64; 3]; 6] = [
    [20.0, 11.0, 110.0],
    [92.0, 2.0, 163.0],
    [155.0, 24.0, 152.0],
    [204.0, 72.0, 119.0],
    [236.0, 121.0, 82.0],
    [251.0, 178.0, 46.0],
];

/// How values are placed along an axis.
#[derive(Debug, Clone, PartialEq)]
pub enum Ticks {
    /// Evenly.
    Linear,
    /// By their logarithm; values that are not above zero count as missing.
    Log,
    /// By name, from the bottom; a value is the index of its name, from 0.
    Names(Vec<String>),
}

/// An axis of parallel coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct ParallelAxis {
    /// Its name, drawn above it.
    pub name: String,
    /// How its values are placed.
    pub ticks: Ticks,
}

/// A line through the axes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ParallelLine {
    /// Tooltip where the SVG is opened by itself.
    pub name: String,
    /// A value for each axis; the line has a gap where one is missing or not finite.
    pub values: Vec<Option<f64>>,
}

/// An axis with its position.
struct PlacedAxis {
    x: f64,
    range: PlotAxis,
}

impl PlacedAxis {
    fn to_y(&self, value: f64) -> f64 {
        SPAN[1] - self.range.part(value) * (SPAN[1] - SPAN[0])
    }
}

/// Lines through vertical axes. The last axis determines the colours, dark for low and bright for high; lines without a
/// value there are grey and drawn below the others.
pub fn parallel_plot(title: &str, axes: &[ParallelAxis], lines: &[ParallelLine]) -> String {
    let gaps = axes.len().saturating_sub(1).max(1) as f64;
    let width = (SIDES[0] + gaps * MIN_DISTANCE + SIDES[1]).max(WIDTH);
    let apart = (width - SIDES[0] - SIDES[1]) / gaps;
    let value = |line: &ParallelLine, axis: usize| -> Option<f64> {
        let value = line.values.get(axis).copied().flatten().filter(|v| v.is_finite())?;
        match &axes[axis].ticks {
            Ticks::Linear => Some(value),
            Ticks::Log => (value > 0.0).then(|| value.log10()),
            Ticks::Names(names) => (value >= 0.0 && value < names.len() as f64).then_some(value),
        }
    };
    let placed: Vec<PlacedAxis> = (0..axes.len())
        .map(|axis| {
            let range = match &axes[axis].ticks {
                Ticks::Names(names) => PlotAxis::of((0..names.len()).map(|i| i as f64), false),
                ticks => PlotAxis::of(lines.iter().filter_map(|l| value(l, axis)), *ticks == Ticks::Log),
            };
            PlacedAxis { x: SIDES[0] + apart * axis as f64, range }
        })
        .collect();
    let mut svg = begin_svg(width, HEIGHT, width / 2.0, title);

    let outcome = |line: &ParallelLine| {
        let last = axes.len().checked_sub(1)?;
        Some(placed[last].range.part(value(line, last)?))
    };
    let mut order: Vec<(Option<f64>, &ParallelLine)> = lines.iter().map(|line| (outcome(line), line)).collect();
    order.sort_by(|a, b| a.0.unwrap_or(-1.0).total_cmp(&b.0.unwrap_or(-1.0)));
    for (part, line) in order {
        let color = part.map_or_else(|| "#bbbbbb".to_owned(), color_of);
        let (mut path, mut dots) = (String::new(), String::new());
        let mut pen = 'M';
        for (axis, at) in placed.iter().enumerate() {
            let Some(value) = value(line, axis) else {
                pen = 'M';
                continue;
            };
            // Writing to a String cannot fail.
            let _ = write!(path, "{pen}{:.1} {:.1}", at.x, at.to_y(value));
            let _ = write!(dots, "M{:.1} {:.1}h0", at.x, at.to_y(value));
            pen = 'L';
        }
        svg += &format!(
            "<g stroke=\"{color}\" fill=\"none\"><title>{}</title><path d=\"{path}\" stroke-width=\"1.6\" \
             stroke-opacity=\"0.85\"/><path d=\"{dots}\" stroke-width=\"5\" stroke-linecap=\"round\"/></g>\n",
            escape(&line.name)
        );
    }
    for (index, (axis, at)) in axes.iter().zip(&placed).enumerate() {
        svg += &draw_axis(axis, at, index + 1 == axes.len(), apart);
    }
    let crowded = axes.iter().any(|axis| 7.0 * axis.name.chars().count() as f64 > apart - 8.0);
    for (index, (axis, at)) in axes.iter().zip(&placed).enumerate() {
        let y = if crowded { NAME_HEIGHTS[index % 2] } else { NAME_HEIGHTS[0] };
        let room = if crowded { 2.0 * apart - 10.0 } else { apart };
        svg += &text(at.x, y, "middle", " font-weight=\"bold\"", &shortened(&axis.name, room.min(185.0), 7.2));
    }
    svg + "</svg>\n"
}

/// The line of an axis and its ticks: on its left, with a white rim as curves pass below; those of the last axis are on
/// its right, beyond the colour bar.
fn draw_axis(axis: &ParallelAxis, at: &PlacedAxis, last: bool, apart: f64) -> String {
    let [top, bottom] = SPAN;
    let mut svg = format!("<path d=\"M{:.1} {top}V{bottom}\" stroke=\"#333\" fill=\"none\"/>\n", at.x);
    let room = if last { SIDES[1] - 24.0 } else { (apart - 14.0).min(SIDES[0] - 10.0) };
    let ticks: Vec<(f64, String)> = match &axis.ticks {
        Ticks::Names(names) => {
            let every = names.len().div_ceil(24).max(1);
            let names = names.iter().enumerate().step_by(every);
            names.map(|(i, name)| (i as f64, shortened(name, room, 6.4))).collect()
        }
        _ => at.range.ticks().into_iter().map(|tick| (tick, at.range.label(tick))).collect(),
    };
    if last {
        let steps = 48;
        let height = (bottom - top) / f64::from(steps);
        for step in 0..steps {
            let color = color_of((f64::from(step) + 0.5) / f64::from(steps));
            let y = bottom - height * f64::from(step + 1);
            // slightly taller than its share, so that no white shows between
            svg += &format!(
                "<rect x=\"{:.1}\" y=\"{y:.1}\" width=\"9\" height=\"{:.1}\" fill=\"{color}\"/>\n",
                at.x + 7.0,
                height + 0.4
            );
        }
    }
    for (tick, label) in ticks {
        let y = at.to_y(tick);
        let (x, anchor, mark) = if last { (at.x + 20.0, "start", at.x) } else { (at.x - 7.0, "end", at.x - 4.0) };
        svg += &format!("<path d=\"M{mark:.1} {y:.1}h4\" stroke=\"#333\"/>\n");
        let rim =
            " font-size=\"11\" stroke=\"white\" stroke-width=\"3\" stroke-opacity=\"0.85\" paint-order=\"stroke\"";
        svg += &text(x, y + 4.0, anchor, rim, &label);
    }
    svg
}

/// The colour at a fraction of the last axis.
fn color_of(part: f64) -> String {
    let at = part.clamp(0.0, 1.0) * (COLORS.len() - 1) as f64;
    let low = (at as usize).min(COLORS.len() - 2);
    let mix = |c: usize| (COLORS[low][c] + (COLORS[low + 1][c] - COLORS[low][c]) * (at - low as f64)).round() as u8;
    format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn axis(name: &str, ticks: Ticks) -> ParallelAxis {
        ParallelAxis { name: name.to_owned(), ticks }
    }

    fn line(values: &[Option<f64>]) -> ParallelLine {
        ParallelLine { name: "a<b".to_owned(), values: values.to_vec() }
    }

    #[test]
    fn lines_have_gaps_and_the_colour_of_their_outcome() {
        let names = Ticks::Names(vec!["l1".to_owned(), "l2".to_owned()]);
        let axes = [axis("loss", names), axis("rate", Ticks::Log), axis("PSNR, dB", Ticks::Linear)];
        let lines = [
            line(&[Some(0.0), Some(0.01), Some(30.0)]),
            line(&[Some(1.0), Some(-1.0), Some(20.0)]),
            line(&[Some(7.0), Some(0.1)]),
        ];
        let svg = parallel_plot("T", &axes, &lines);
        assert!(svg.contains("M95.0 396.0L320.0 396.0L545.0 84.0"), "{svg}");
        assert!(svg.contains("d=\"M95.0 84.0M545.0 396.0\""), "a log of a negative number is missing");
        assert!(svg.contains("d=\"M320.0 84.0\""), "an unknown name and a missing value");
        for part in [">l1<", ">0.01<", ">30<", ">PSNR, dB<", "<title>a&lt;b</title>", "#bbbbbb"] {
            assert!(svg.contains(part), "{part}");
        }
        let (grey, low, high) = (svg.find("#bbbbbb"), svg.find(&color_of(0.0)), svg.find(&color_of(1.0)));
        assert!(grey < low && low < high, "the best line is drawn last");
    }

    #[test]
    fn colours_rise_in_lightness() {
        let light = |part: f64| {
            let hex = color_of(part);
            let channel = |i: usize| f64::from(u8::from_str_radix(&hex[i..i + 2], 16).unwrap());
            0.2126 * channel(1) + 0.7152 * channel(3) + 0.0722 * channel(5)
        };
        assert!((1..=40).all(|i| light(f64::from(i) / 40.0) > light(f64::from(i - 1) / 40.0)));
        assert_eq!(color_of(-3.0), color_of(0.0));
    }

    #[test]
    fn few_or_no_axes_and_lines_still_give_a_picture() {
        assert!(parallel_plot("", &[], &[line(&[Some(1.0)])]).contains("</svg>"));
        assert!(parallel_plot("", &[axis("a", Ticks::Names(vec![]))], &[]).contains("</svg>"));
        let many: Vec<ParallelAxis> = (0..9).map(|i| axis(&format!("a.long.name{i}"), Ticks::Linear)).collect();
        assert!(parallel_plot("", &many, &[]).contains("viewBox=\"0 0 1134 420\""));
    }

    proptest! {
        #[test]
        fn any_numbers_give_finite_coordinates(
            values in proptest::collection::vec(proptest::collection::vec(any::<Option<f64>>(), 0..4), 0..6)
        ) {
            let names = Ticks::Names(vec!["x".to_owned()]);
            let axes = [axis("a", Ticks::Linear), axis("b", names), axis("c", Ticks::Log)];
            let lines: Vec<ParallelLine> = values.iter().map(|v| line(v)).collect();
            let svg = parallel_plot("", &axes, &lines);
            prop_assert!(!svg.contains("NaN"), "{}", svg);
            prop_assert!(!svg.contains("inf"), "{}", svg);
        }
    }
}
