//! The picture of a transfer function over the histogram of a field. Drawing only: what the function means is in
//! `transfer`.

mod bins;

pub use bins::HistogramBins;

use crate::draw::font::{GLYPH_HEIGHT, draw_text, text_width};
use crate::draw::round_step;
use crate::volume::transfer::TransferFunction;
use image::{Rgb, RgbImage};

const SIZE: [u32; 2] = [900, 420];
/// Left, right, top and bottom edges of the area of the curve.
const AREA: [u32; 4] = [70, 876, 62, 296];
/// Top, middle and bottom of the colour bar: the upper half is solid, the lower half shows the opacity.
const BAR: [u32; 3] = [304, 316, 328];
const TICKS: u32 = 336;
const BRACKETS: u32 = 362;
const INK: [u8; 3] = [40, 44, 52];
const FAINT: [u8; 3] = [110, 116, 126];
const GRID: [u8; 3] = [232, 234, 238];
const HISTOGRAM: [u8; 3] = [208, 211, 217];
/// Thickness of the filled area and of the lower half of the bar, unit lengths.
const THICKNESS: f32 = 10.0;

/// The mapping of data values and opacities to the image.
struct HistogramFrame {
    /// Data values at the left and right edge.
    low: f64,
    high: f64,
    /// Data values at the fractions 0 and 1.
    span: [f64; 2],
    /// Opacity at the upper edge.
    top: f32,
}

impl HistogramFrame {
    fn x_of_value(&self, value: f64) -> f32 {
        let part = (value / 2.0 - self.low / 2.0) / (self.high / 2.0 - self.low / 2.0);
        AREA[0] as f32 + part as f32 * (AREA[1] - AREA[0]) as f32
    }

    fn x(&self, fraction: f64) -> f32 {
        self.x_of_value(self.span[0] * (1.0 - fraction) + self.span[1] * fraction)
    }

    fn value(&self, x: u32) -> f64 {
        let part = (f64::from(x) + 0.5 - f64::from(AREA[0])) / f64::from(AREA[1] - AREA[0]);
        self.low * (1.0 - part) + self.high * part
    }

    fn fraction(&self, x: u32) -> f64 {
        (self.value(x) / 2.0 - self.span[0] / 2.0) / (self.span[1] / 2.0 - self.span[0] / 2.0)
    }

    fn y(&self, opacity: f32) -> f32 {
        AREA[3] as f32 - (opacity / self.top).clamp(0.0, 1.0) * (AREA[3] - AREA[2]) as f32
    }
}

/// A picture of 900 x 420 pixels: the `histogram` (counts in equal bins over the data values `range`, logarithmic) in
/// grey, the opacity per unit length as a line with its control points over an area in the colours, a colour bar, the
/// axis in data values and the segments as brackets. The area and the lower half of the bar show the material ten unit
/// lengths thick on a checkerboard. The axis covers the data values `span` and the range of the function.
pub fn transfer_picture(
    histogram: &[u64],
    range: [f64; 2],
    span: [f64; 2],
    tf: &TransferFunction,
    title: &str,
) -> RgbImage {
    let mut image = RgbImage::from_pixel(SIZE[0], SIZE[1], Rgb([255; 3]));
    let data = if span[1] > span[0] { span } else { [span[0], span[0] + span[0].abs().max(1.0)] };
    let own = tf.span(span);
    let max_opacity = tf.opacity.iter().fold(0.0_f32, |m, p| m.max(p.1));
    let top = [0.05, 0.1, 0.2, 0.5, 1.0].into_iter().find(|t| max_opacity <= *t).unwrap_or(1.0);
    let frame = HistogramFrame { low: data[0].min(own[0]), high: data[1].max(own[1]), span: own, top };
    grid(&mut image, &frame);
    let range = if range[1] > range[0] { range } else { data };
    bars(&mut image, &frame, histogram, range);
    area(&mut image, &frame, tf);
    outline(&mut image, &frame, histogram, range);
    curve(&mut image, &frame, tf);
    color_bar(&mut image, &frame, tf);
    brackets(&mut image, &frame, tf);
    let [left, right, upper, lower] = AREA.map(|v| v as f32);
    line(&mut image, [left, upper], [left, lower], 1.2, INK);
    line(&mut image, [left, lower], [right, lower], 1.2, INK);
    draw_text(&mut image, AREA[0], 16, 2, INK, &printable(title, 60));
    let note = format!("OPACITY PER {}% OF THE LONGEST SIDE", label(tf.unit_length * 100.0, 0.0));
    draw_text(&mut image, AREA[0], 44, 1, FAINT, &note);
    let note = "GREY: HISTOGRAM - LOG";
    draw_text(&mut image, AREA[1] - text_width(note, 1), 44, 1, FAINT, note);
    image
}

fn grid(image: &mut RgbImage, frame: &HistogramFrame) {
    for i in 0..=4 {
        let opacity = frame.top * i as f32 / 4.0;
        let y = frame.y(opacity);
        line(image, [AREA[0] as f32, y], [AREA[1] as f32, y], 1.0, GRID);
        let text = label(f64::from(opacity), 0.0);
        let left = (AREA[0] - 8).saturating_sub(text_width(&text, 1));
        draw_text(image, left, y as u32 - GLYPH_HEIGHT / 2, 1, INK, &text);
    }
    let ticks = ticks(frame.low, frame.high);
    let step = ticks.get(1).map_or(0.0, |b| b - ticks[0]);
    for tick in ticks {
        let x = frame.x_of_value(tick);
        line(image, [x, AREA[2] as f32], [x, AREA[3] as f32], 1.0, GRID);
        line(image, [x, BAR[2] as f32], [x, BAR[2] as f32 + 4.0], 1.0, INK);
        centered(image, x, TICKS, INK, &label(tick, step));
    }
}

/// Height of the histogram at a column, from 0 to 1.
fn level(histogram: &[u64], data: [f64; 2], value: f64) -> f32 {
    let highest = histogram.iter().copied().max().unwrap_or(0);
    if highest == 0 || !(data[0]..=data[1]).contains(&value) {
        return 0.0;
    }
    let part = (value / 2.0 - data[0] / 2.0) / (data[1] / 2.0 - data[0] / 2.0);
    let bin = ((part * histogram.len() as f64) as usize).min(histogram.len() - 1);
    ((1.0 + histogram[bin] as f64).ln() / (1.0 + highest as f64).ln()) as f32
}

fn histogram_y(level: f32) -> f32 {
    AREA[3] as f32 - level * (AREA[3] - AREA[2]) as f32 * 0.94
}

fn bars(image: &mut RgbImage, frame: &HistogramFrame, histogram: &[u64], data: [f64; 2]) {
    for x in AREA[0]..AREA[1] {
        let y = histogram_y(level(histogram, data, frame.value(x)));
        for row in y.round() as u32..AREA[3] {
            image.put_pixel(x, row, Rgb(HISTOGRAM));
        }
    }
}

/// The outline of the histogram, drawn above the filled area so that it stays visible.
fn outline(image: &mut RgbImage, frame: &HistogramFrame, histogram: &[u64], data: [f64; 2]) {
    let ys: Vec<f32> = (AREA[0]..AREA[1]).map(|x| histogram_y(level(histogram, data, frame.value(x)))).collect();
    if histogram.iter().all(|n| *n == 0) {
        return;
    }
    for (x, pair) in (AREA[0]..).zip(ys.windows(2)) {
        let x = x as f32 + 0.5;
        line(image, [x, pair[0]], [x + 1.0, pair[1]], 0.8, [158, 163, 172]);
    }
}

/// The colours under the opacity curve, as thick material on a checkerboard.
fn area(image: &mut RgbImage, frame: &HistogramFrame, tf: &TransferFunction) {
    for x in AREA[0]..AREA[1] {
        let fraction = frame.fraction(x);
        let opacity = tf.opacity_at(fraction);
        for y in frame.y(opacity).round() as u32..AREA[3] {
            image.put_pixel(x, y, Rgb(material(tf, fraction, x, y)));
        }
    }
}

fn color_bar(image: &mut RgbImage, frame: &HistogramFrame, tf: &TransferFunction) {
    for x in AREA[0]..AREA[1] {
        let fraction = frame.fraction(x);
        let solid = tf.color_at(fraction).map(byte);
        for y in BAR[0]..BAR[2] {
            let color = if y < BAR[1] { solid } else { material(tf, fraction, x, y) };
            image.put_pixel(x, y, Rgb(color));
        }
    }
    let [left, right] = [AREA[0] as f32, AREA[1] as f32];
    for y in [BAR[0], BAR[2]] {
        line(image, [left, y as f32], [right, y as f32], 1.0, INK);
    }
    for x in [left, right] {
        line(image, [x, BAR[0] as f32], [x, BAR[2] as f32], 1.0, INK);
    }
    for (y, text) in [(BAR[0], "COLOR"), (BAR[1], "10 UNITS")] {
        draw_text(image, AREA[0] - 8 - text_width(text, 1), y + 3, 1, FAINT, text);
    }
}

/// The colour of material [`THICKNESS`] unit lengths thick over the checkerboard at a pixel.
fn material(tf: &TransferFunction, fraction: f64, x: u32, y: u32) -> [u8; 3] {
    let alpha = 1.0 - (1.0 - tf.opacity_at(fraction)).max(0.0).powf(THICKNESS);
    let board = if (x / 6 + y / 6).is_multiple_of(2) { 0.98 } else { 0.86 };
    tf.color_at(fraction).map(|c| byte(c * alpha + board * (1.0 - alpha)))
}

fn curve(image: &mut RgbImage, frame: &HistogramFrame, tf: &TransferFunction) {
    let point = |p: &(f64, f32)| [frame.x(p.0), frame.y(p.1)];
    let points: Vec<[f32; 2]> = tf.opacity.iter().map(point).collect();
    let (Some(first), Some(last)) = (points.first(), points.last()) else { return };
    let path: Vec<[f32; 2]> = std::iter::once([AREA[0] as f32, first[1]])
        .chain(points.iter().copied())
        .chain(std::iter::once([AREA[1] as f32, last[1]]))
        .collect();
    for pair in path.windows(2) {
        line(image, pair[0], pair[1], 2.0, INK);
    }
    for (at, control) in points.iter().zip(&tf.opacity) {
        line(image, *at, *at, 9.0, INK);
        line(image, *at, *at, 6.0, tf.color_at(control.0).map(byte));
    }
}

/// Segments as brackets under the axis; labels that would touch move one line down.
fn brackets(image: &mut RgbImage, frame: &HistogramFrame, tf: &TransferFunction) {
    let mut order: Vec<_> = tf.segments.iter().collect();
    order.sort_by(|a, b| a.range[0].total_cmp(&b.range[0]));
    let mut ends = [0.0_f32; 3];
    for segment in order {
        let [from, to] = [frame.x(segment.range[0]) + 1.0, frame.x(segment.range[1]) - 1.0];
        let color = tf.segment_color(segment).map(byte);
        let y = BRACKETS as f32;
        // shorter because of the round ends
        let inset = 2.5_f32.min((to - from).max(0.0) / 2.0);
        line(image, [from + inset, y + 3.0], [to - inset, y + 3.0], 5.0, color);
        for x in [from, to] {
            line(image, [x, y - 3.0], [x, y + 6.0], 1.4, INK);
        }
        line(image, [from, y + 6.0], [to, y + 6.0], 1.4, INK);
        let text = printable(&segment.name, 40);
        let half = text_width(&text, 1) as f32 / 2.0;
        let middle = f32::midpoint(from, to).clamp(half + 2.0, SIZE[0] as f32 - half - 2.0);
        let row = (0..ends.len()).find(|r| ends[*r] + 6.0 <= middle - half).unwrap_or(ends.len() - 1);
        ends[row] = middle + half;
        centered(image, middle, BRACKETS + 13 + row as u32 * 11, INK, &text);
    }
}

/// A line with round ends and soft edges; one of length 0 is a disc.
fn line(image: &mut RgbImage, from: [f32; 2], to: [f32; 2], width: f32, color: [u8; 3]) {
    let reach = width / 2.0 + 1.0;
    let bounds = |axis: usize, size: u32| {
        let low = (from[axis].min(to[axis]) - reach).max(0.0) as u32;
        let high = (from[axis].max(to[axis]) + reach).clamp(0.0, size as f32) as u32;
        low..high.saturating_add(1).min(size)
    };
    let way = [to[0] - from[0], to[1] - from[1]];
    let length2 = way[0] * way[0] + way[1] * way[1];
    for y in bounds(1, image.height()) {
        for x in bounds(0, image.width()) {
            let at = [x as f32 + 0.5 - from[0], y as f32 + 0.5 - from[1]];
            let t = if length2 > 0.0 { ((at[0] * way[0] + at[1] * way[1]) / length2).clamp(0.0, 1.0) } else { 0.0 };
            let distance = (at[0] - t * way[0]).hypot(at[1] - t * way[1]);
            let cover = (width / 2.0 + 0.5 - distance).clamp(0.0, 1.0);
            let pixel = image.get_pixel_mut(x, y);
            for (below, ink) in pixel.0.iter_mut().zip(color) {
                *below = byte((f32::from(ink) * cover + f32::from(*below) * (1.0 - cover)) / 255.0);
            }
        }
    }
}

fn byte(value: f32) -> u8 {
    (value * 255.0).round() as u8
}

/// About eight round values from `low` to `high`.
fn ticks(low: f64, high: f64) -> Vec<f64> {
    let raw = high / 8.0 - low / 8.0;
    let step = round_step(raw);
    let first = (low / step).ceil();
    (0..12).map(|i| (first + f64::from(i)) * step).take_while(|t| *t <= high + step * 1e-9).collect()
}

/// Formats a number briefly; one that is negligible beside the distance `step` to the next label becomes 0. `step` is 0
/// for a label on its own.
fn label(value: f64, step: f64) -> String {
    if value.abs() < step * 1e-6 || value == 0.0 {
        return "0".to_owned();
    }
    if !(1e-3..1e5).contains(&value.abs()) {
        return format!("{value:.2e}");
    }
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn centered(image: &mut RgbImage, x: f32, y: u32, color: [u8; 3], text: &str) {
    let left = x - text_width(text, 1) as f32 / 2.0;
    draw_text(image, left.round().max(0.0) as u32, y, 1, color, text);
}

/// The characters of a text that the font can draw, others as spaces, cut to `max_length` characters.
fn printable(text: &str, max_length: usize) -> String {
    let known = |c: char| if c.is_ascii_alphanumeric() || " .:-/%_".contains(c) { c } else { ' ' };
    text.chars().take(max_length).map(known).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bell(n: usize) -> Vec<u64> {
        let count = |i: usize| {
            let x = i as f64 / n as f64;
            2e6 * (-x * 14.0).exp() + 4e3 * (-((x - 0.6) * 9.0).powi(2)).exp() + 20.0 * (1.0 - x)
        };
        (0..n).map(|i| count(i) as u64).collect()
    }

    #[test]
    fn presets_give_pictures_with_color_where_there_is_opacity() {
        for name in TransferFunction::presets() {
            let tf = TransferFunction::load(name).unwrap();
            let span = tf.span([0.0, 7.5]);
            let image = transfer_picture(&bell(256), span, span, &tf, name);
            assert_eq!(image.dimensions(), (900, 420));
            let solid = image.get_pixel(400, BAR[0] + 6).0;
            let fraction = (400.5 - 70.0) / 806.0;
            assert_eq!(solid, tf.color_at(fraction).map(byte), "{name}");
            if let Ok(folder) = std::env::var("TRANSFER_PICTURES") {
                image.save(std::path::Path::new(&folder).join(format!("{name}.png"))).unwrap();
            }
        }
    }

    #[test]
    fn odd_input_is_drawn_without_panic() {
        let mut tf = TransferFunction::load("vortex").unwrap();
        for span in [[0.0, 0.0], [-1e300, 1e300], [3.0, 2.0], [1e-12, 2e-12]] {
            let _ = transfer_picture(
                &[],
                span,
                span,
                &tf,
                "a \"title\" \u{e9} that is far too long to be drawn in one line",
            );
            let _ = transfer_picture(&[0, u64::MAX], span, span, &tf, "");
        }
        tf.range = Some([-5.0, 400.0]);
        tf.opacity = vec![(0.5, 0.0), (0.5, 1.0)];
        let _ = transfer_picture(&[1, 2, 3], [-0.5, 1.5], [0.0, 1.0], &tf, "wide");
        tf.opacity.clear();
        tf.colors.clear();
        let _ = transfer_picture(&[1], [0.0; 2], [0.0, 1.0], &tf, "empty");
    }

    #[test]
    fn labels_are_short() {
        assert_eq!(ticks(-1000.0, 2000.0).len(), 7);
        assert_eq!(label(0.30000000000000004, 0.1), "0.3");
        assert_eq!(label(1e-17, 0.1), "0");
        assert_eq!(label(2.5e7, 1e6), "2.50e7");
    }
}
