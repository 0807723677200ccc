//! Scatter plots as SVG text: named points with whiskers, such as quality against cost.

use super::frame::{PlotAxis, PlotFrame, color, round, shortened, text};

/// There is no legend, so the area begins this much higher.
const TOP_OFFSET: f64 = -16.0;
/// Maximum number of named points; further points have no names.
const MAX_NAMES: usize = 60;
/// Width of a letter of a name, and height of a name.
const LETTER: (f64, f64) = (6.2, 12.0);
/// Distances of a name from its point; the nearest free one is used.
const DISTANCES: [f64; 7] = [8.0, 13.0, 20.0, 30.0, 42.0, 56.0, 72.0];

/// A point of a scatter plot. It is skipped if `x` or `y` is not finite.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ScatterPoint {
    /// Its name, drawn beside it.
    pub name: String,
    /// Position along the horizontal axis.
    pub x: f64,
    /// Position along the vertical axis.
    pub y: f64,
    /// Half the length of the horizontal whiskers.
    pub x_error: Option<f64>,
    /// Half the length of the vertical whiskers.
    pub y_error: Option<f64>,
    /// Its group; the points of a group share a colour.
    pub group: usize,
}

/// A scatter plot with linear axes and a name beside each point; names keep clear of each other where there is room.
pub fn scatter_plot(title: &str, x_label: &str, y_label: &str, points: &[ScatterPoint]) -> String {
    let points: Vec<&ScatterPoint> = points.iter().filter(|p| p.x.is_finite() && p.y.is_finite()).collect();
    let xs = points.iter().flat_map(|p| ends(p.x, p.x_error).into_iter().flatten().chain([p.x]));
    let ys = points.iter().flat_map(|p| ends(p.y, p.y_error).into_iter().flatten().chain([p.y]));
    let frame = PlotFrame::new(PlotAxis::of(xs, false).padded(), PlotAxis::of(ys, false).padded(), TOP_OFFSET);
    let mut svg = frame.begin(title, x_label, y_label);
    let mut taken = Vec::new();
    for point in &points {
        let (x, y) = (frame.to_x(point.x), frame.to_y(point.y));
        taken.push(Rect::around(x, y, 5.0, 5.0));
        let mut path = String::new();
        if let Some([low, high]) = ends(point.x, point.x_error) {
            let (low, high) = (frame.to_x(low), frame.to_x(high));
            path += &format!("M{low:.1} {y:.1}H{high:.1}M{low:.1} {:.1}v6M{high:.1} {:.1}v6", y - 3.0, y - 3.0);
            taken.push(Rect { left: low, right: high, top: y - 1.0, bottom: y + 1.0 });
        }
        if let Some([low, high]) = ends(point.y, point.y_error) {
            let (low, high) = (frame.to_y(low), frame.to_y(high));
            path += &format!("M{x:.1} {low:.1}V{high:.1}M{:.1} {low:.1}h6M{:.1} {high:.1}h6", x - 3.0, x - 3.0);
            taken.push(Rect { left: x - 1.0, right: x + 1.0, top: high, bottom: low });
        }
        if !path.is_empty() {
            svg += &format!("<path d=\"{path}\" stroke=\"{}\" fill=\"none\"/>\n", color(point.group));
        }
    }
    for point in &points {
        let color = color(point.group);
        // groups beyond the number of colours are distinguished by hollow marks
        let fill = if round(point.group) % 2 == 1 { "white" } else { color };
        let (x, y) = (frame.to_x(point.x), frame.to_y(point.y));
        let style = format!("stroke=\"{color}\" stroke-width=\"1.6\" fill=\"{fill}\"");
        svg += &format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\" {style}/>\n");
    }
    for point in points.iter().take(MAX_NAMES).filter(|p| !p.name.is_empty()) {
        let name = shortened(&point.name, 180.0, LETTER.0);
        let at = (frame.to_x(point.x), frame.to_y(point.y));
        let place = free_place(at, LETTER.0 * name.chars().count() as f64, &taken, frame.area);
        if let Some((x, y)) = place.leader(at) {
            svg += &format!("<path d=\"M{:.1} {:.1}L{x:.1} {y:.1}\" stroke=\"#999\" fill=\"none\"/>\n", at.0, at.1);
        }
        svg += &text((place.left + place.right) / 2.0, place.bottom - 2.5, "middle", " font-size=\"11\"", &name);
        taken.push(place);
    }
    svg + "</svg>\n"
}

/// Ends of a whisker, if it has a length that can be drawn.
fn ends(at: f64, error: Option<f64>) -> Option<[f64; 2]> {
    let error = error.filter(|e| *e != 0.0)?.abs();
    let ends = [at - error, at + error];
    ends.iter().all(|end| end.is_finite()).then_some(ends)
}

/// The area occupied by a mark or a name.
#[derive(Clone, Copy, Debug)]
struct Rect {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
}

impl Rect {
    fn around(x: f64, y: f64, half_width: f64, half_height: f64) -> Self {
        Self { left: x - half_width, right: x + half_width, top: y - half_height, bottom: y + half_height }
    }

    fn overlap(&self, other: &Self) -> f64 {
        let width = self.right.min(other.right) - self.left.max(other.left);
        let height = self.bottom.min(other.bottom) - self.top.max(other.top);
        width.max(0.0) * height.max(0.0)
    }

    fn area(&self) -> f64 {
        (self.right - self.left) * (self.bottom - self.top)
    }

    /// The end of a line from the point at `at`, if the name is far enough away to need one.
    fn leader(&self, at: (f64, f64)) -> Option<(f64, f64)> {
        let near = (at.0.clamp(self.left, self.right), at.1.clamp(self.top, self.bottom));
        ((near.0 - at.0).hypot(near.1 - at.1) > 15.0).then_some(near)
    }
}

/// The nearest place for a name that covers nothing in `taken`; where there is none, the one that overlaps least.
fn free_place(at: (f64, f64), width: f64, taken: &[Rect], [left, right, top, bottom]: [f64; 4]) -> Rect {
    let inside = Rect { left, right: right + 15.0, top, bottom };
    let mut best = (f64::INFINITY, Rect::around(at.0, at.1, width / 2.0, LETTER.1 / 2.0));
    for distance in DISTANCES {
        for (dx, dy) in
            [(1.0, 0.0), (-1.0, 0.0), (0.0, -1.0), (0.0, 1.0), (0.7, -0.7), (-0.7, -0.7), (0.7, 0.7), (-0.7, 0.7)]
        {
            let x = at.0 + dx * distance + f64::signum(dx) * width / 2.0 * f64::from(dx != 0.0);
            let y = at.1 + dy * distance + f64::signum(dy) * LETTER.1 / 2.0 * f64::from(dy != 0.0);
            let place = Rect::around(x, y, width / 2.0, LETTER.1 / 2.0);
            // A name that is cut off is worse than one on a whisker.
            let outside = 10.0 * (place.area() - place.overlap(&inside));
            let cost = outside + taken.iter().map(|other| place.overlap(other)).sum::<f64>();
            if cost < best.0 - 1e-9 {
                best = (cost, place);
            }
        }
        if best.0 < 1e-6 {
            break;
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::super::frame::tests::number;
    use super::*;
    use proptest::prelude::*;

    fn point(name: &str, x: f64, y: f64) -> ScatterPoint {
        ScatterPoint { name: name.to_owned(), x, y, ..ScatterPoint::default() }
    }

    #[test]
    fn points_names_and_whiskers_are_there() {
        let with_error =
            ScatterPoint { x_error: Some(0.5), y_error: Some(-1.0), group: 7, ..point("b & c", 2.0, 30.0) };
        let svg = scatter_plot("T", "min", "dB", &[point("a", 1.0, 20.0), with_error]);
        assert_eq!(svg.matches("<circle").count(), 2);
        assert!(svg.contains(">a</text>") && svg.contains(">b &amp; c</text>"));
        assert_eq!((svg.matches("v6").count(), svg.matches("h6").count()), (2, 2));
        assert_eq!(svg.matches("fill=\"white\"/>\n<").count(), 2, "the ground and a hollow mark");
    }

    #[test]
    fn names_of_near_points_keep_clear_of_each_other() {
        let area = [70.0, 620.0, 42.0, 329.0];
        let mut taken: Vec<Rect> = (0..8).map(|i| Rect::around(300.0 + f64::from(i), 200.0, 5.0, 5.0)).collect();
        for i in 0..8 {
            let place = free_place((300.0 + f64::from(i), 200.0), 80.0, &taken, area);
            assert!(taken.iter().all(|other| place.overlap(other) < 1e-6), "{i}: {place:?}");
            assert!(place.left >= 70.0 && place.right <= 635.0 && place.top >= 42.0 && place.bottom <= 329.0);
            taken.push(place);
        }
        let corner = free_place((620.0, 42.0), 80.0, &[], area);
        assert!(corner.right <= 635.0 && corner.top >= 42.0, "{corner:?}");
    }

    #[test]
    fn non_finite_points_are_skipped_and_no_points_still_give_axes() {
        assert!(scatter_plot("", "", "", &[]).contains("</svg>"));
        let broken = ScatterPoint { x_error: Some(f64::NAN), y_error: Some(f64::INFINITY), ..point("ok", 1.0, 1.0) };
        let svg = scatter_plot("", "", "", &[point("no", f64::NAN, 1.0), broken]);
        assert!(svg.contains(">ok<") && !svg.contains(">no<") && !svg.contains("NaN"), "{svg}");
    }

    proptest! {
        #[test]
        fn any_numbers_give_finite_coordinates(
            points in proptest::collection::vec((number(), number(), prop::option::of(number()), prop::option::of(number()), any::<usize>()), 0..6)
        ) {
            let points: Vec<ScatterPoint> = points
                .into_iter()
                .map(|(x, y, x_error, y_error, group)| ScatterPoint { name: "p".to_owned(), x, y, x_error, y_error, group })
                .collect();
            let svg = scatter_plot("", "", "", &points);
            prop_assert!(!svg.contains("NaN"), "{}", svg);
            prop_assert!(!svg.contains("inf"), "{}", svg);
        }
    }
}
