//! A picture of the camera positions: from above and from the front, coloured by time.

use glam::{DVec2, DVec3};
use image::{Rgb, RgbImage};

use super::dataset::Frame;
use super::hull::Aabb;
use crate::draw::font::{draw_text, text_width};
use crate::draw::round_step;

const PANEL: u32 = 640;
const MARGIN: u32 = 32;
const HEADER: u32 = 48;
const FOOTER: u32 = 72;
const PAPER: [u8; 3] = [250, 250, 248];
const GRID: [u8; 3] = [226, 228, 230];
const INK: [u8; 3] = [52, 58, 64];
const BOX: [u8; 3] = [200, 60, 40];

/// One orthographic view: the world axes that point to the right, up and towards the viewer.
struct Panel {
    title: &'static str,
    right: usize,
    up: usize,
    near: DVec3,
    left: f64,
}

/// Draws the cameras of `frames` and the box of the data, from above (x right, y up) and from the front (x right, z
/// up), both at the same scale; 1376 x 760 pixels. Dots and small frusta are coloured by time.
pub fn layout_picture(frames: &[Frame], bounds: &Aabb) -> RgbImage {
    let (width, height) = (2 * PANEL + 3 * MARGIN, HEADER + PANEL + FOOTER);
    let mut canvas = Canvas(RgbImage::from_pixel(width, height, Rgb(PAPER)));
    let reach = frames.iter().map(|f| f.camera.position()).filter(|p| p.is_finite());
    let ends = reach.chain([bounds.min, bounds.max]).map(|p| p.abs().max_element()).fold(1e-9, f64::max);
    let scale = 0.5 * f64::from(PANEL) / (1.12 * ends);
    let left = |i: u32| f64::from(MARGIN + i * (PANEL + MARGIN));
    let panels = [
        Panel { title: "FROM ABOVE: X RIGHT, Y UP", right: 0, up: 1, near: DVec3::Z, left: left(0) },
        Panel { title: "FROM THE FRONT: X RIGHT, Z UP", right: 0, up: 2, near: -DVec3::Y, left: left(1) },
    ];
    for panel in &panels {
        canvas.panel(panel, frames, bounds, scale, ends);
    }
    canvas.legend(frames, width, height);
    canvas.0
}

struct Canvas(RgbImage);

impl Canvas {
    fn panel(&mut self, panel: &Panel, frames: &[Frame], bounds: &Aabb, scale: f64, ends: f64) {
        let half = 0.5 * f64::from(PANEL);
        let middle = DVec2::new(panel.left + half, f64::from(HEADER) + half);
        let at = |p: DVec3| middle + scale * DVec2::new(p[panel.right], -p[panel.up]);
        draw_text(&mut self.0, panel.left as u32, 16, 2, INK, panel.title);
        // lines at whole units of 1, 2 or 5 times a power of ten
        let step = round_step(ends / 4.0);
        // 5 at most, unless the cameras or the box lie beyond the drawable range
        let lines = (half / scale / step).floor().clamp(0.0, 8.0) as i64;
        for k in -lines..=lines {
            let off = scale * step * k as f64;
            let shade = if k == 0 { [170, 174, 178] } else { GRID };
            self.line(middle + DVec2::new(off, -half), middle + DVec2::new(off, half), 1.0, shade, 1.0);
            self.line(middle + DVec2::new(-half, off), middle + DVec2::new(half, off), 1.0, shade, 1.0);
        }
        let corner = DVec2::splat(half);
        self.rectangle(middle - corner, middle + corner, 1.0, INK);
        // far ones first, so that near ones lie on top; far ones are paler
        let mut order: Vec<&Frame> = frames.iter().filter(|f| f.camera.position().is_finite()).collect();
        order.sort_by(|a, b| {
            let depth = |f: &Frame| f.camera.position().dot(panel.near);
            depth(a).total_cmp(&depth(b))
        });
        let length = 0.06 * ends;
        let (behind, before) = order.split_at(order.partition_point(|f| f.camera.position().dot(panel.near) < 0.0));
        for (group, strength) in [(behind, 0.3), (before, 1.0)] {
            for frame in group {
                let colour = time_colour(frame.time);
                let camera = &frame.camera;
                let eye = camera.position();
                let [tan_x, tan_y] = [camera.fov_x(), camera.fov_y()].map(|a| (0.5 * a).tan() * length);
                let [right, up] = [camera.camera_to_world.x_axis, camera.camera_to_world.y_axis].map(|a| a.truncate());
                let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                    .map(|(x, y)| at(eye + camera.forward() * length + right * tan_x * x + up * tan_y * y));
                for k in 0..4 {
                    self.line(at(eye), corners[k], 1.0, colour, 0.5 * strength);
                    self.line(corners[k], corners[(k + 1) % 4], 1.0, colour, 0.5 * strength);
                }
                self.dot(at(eye), 3.2, colour, strength);
            }
            if strength < 1.0 {
                let (a, b) = (at(bounds.min), at(bounds.max));
                self.rectangle(a.min(b), a.max(b), 2.0, BOX);
            }
        }
        let text = format!("GRID {step}");
        let x = (panel.left + f64::from(PANEL) - f64::from(text_width(&text, 2))).max(0.0);
        draw_text(&mut self.0, x as u32, 16, 2, [130, 136, 142], &text);
    }

    fn legend(&mut self, frames: &[Frame], width: u32, height: u32) {
        let (y, bar) = (f64::from(height - FOOTER + 26), 360.0);
        let left = f64::from(MARGIN);
        draw_text(&mut self.0, left as u32, y as u32 + 3, 2, INK, "TIME 0");
        let start = left + f64::from(text_width("TIME 0", 2)) + 12.0;
        for x in 0..bar as u32 {
            let colour = time_colour(f64::from(x) / bar);
            let at = DVec2::new(start + f64::from(x) + 0.5, y);
            self.line(at, at + DVec2::new(0.0, 20.0), 1.0, colour, 1.0);
        }
        draw_text(&mut self.0, (start + bar) as u32 + 12, y as u32 + 3, 2, INK, "1");
        let x = f64::from(width / 2 + MARGIN / 2);
        self.rectangle(DVec2::new(x, y), DVec2::new(x + 20.0, y + 20.0), 2.0, BOX);
        draw_text(&mut self.0, x as u32 + 32, y as u32 + 3, 2, INK, "BOX OF THE DATA");
        let text = format!("{} VIEWS", frames.len());
        let x = width.saturating_sub(MARGIN + text_width(&text, 2));
        draw_text(&mut self.0, x, y as u32 + 3, 2, INK, &text);
    }

    fn rectangle(&mut self, a: DVec2, b: DVec2, thickness: f64, colour: [u8; 3]) {
        let corners = [a, DVec2::new(b.x, a.y), b, DVec2::new(a.x, b.y)];
        for k in 0..4 {
            self.line(corners[k], corners[(k + 1) % 4], thickness, colour, 1.0);
        }
    }

    /// An antialiased line: the coverage of a pixel follows from the distance of its centre to the line.
    fn line(&mut self, a: DVec2, b: DVec2, thickness: f64, colour: [u8; 3], strength: f64) {
        let along = b - a;
        let square = along.length_squared();
        self.cover(a.min(b), a.max(b), 0.5 * thickness, colour, strength, |p| {
            let k = if square > 0.0 { ((p - a).dot(along) / square).clamp(0.0, 1.0) } else { 0.0 };
            p.distance(a + along * k)
        });
    }

    fn dot(&mut self, centre: DVec2, radius: f64, colour: [u8; 3], strength: f64) {
        // a rim in the colour of the paper separates neighbouring dots
        self.cover(centre, centre, radius + 0.8, PAPER, strength, |p| p.distance(centre));
        self.cover(centre, centre, radius, colour, strength, |p| p.distance(centre));
    }

    /// Blends `colour` into the pixels whose centre is within `radius` by `distance`, soft over one pixel.
    fn cover(
        &mut self,
        low: DVec2,
        high: DVec2,
        radius: f64,
        colour: [u8; 3],
        strength: f64,
        distance: impl Fn(DVec2) -> f64,
    ) {
        if !(low.is_finite() && high.is_finite()) {
            return;
        }
        let size = DVec2::new(f64::from(self.0.width()), f64::from(self.0.height()));
        let low = (low - radius - 1.0).floor().clamp(DVec2::ZERO, size);
        let high = (high + radius + 1.0).ceil().clamp(DVec2::ZERO, size);
        for y in low.y as u32..high.y as u32 {
            for x in low.x as u32..high.x as u32 {
                let d = distance(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
                let a = strength * (radius + 0.5 - d).clamp(0.0, 1.0);
                let pixel = self.0.get_pixel_mut(x, y);
                for c in 0..3 {
                    let old = f64::from(pixel.0[c]);
                    pixel.0[c] = (old + a * (f64::from(colour[c]) - old)).round() as u8;
                }
            }
        }
    }
}

/// Blue over green to amber, with brightness even enough that no time stands out.
fn time_colour(time: f64) -> [u8; 3] {
    const STOPS: [[f64; 3]; 5] =
        [[68.0, 40.0, 130.0], [50.0, 100.0, 160.0], [30.0, 150.0, 138.0], [110.0, 190.0, 80.0], [240.0, 170.0, 30.0]];
    let x = if time.is_finite() { time.clamp(0.0, 1.0) * 4.0 } else { 0.0 };
    let i = (x as usize).min(3);
    let k = x - i as f64;
    [0, 1, 2].map(|c| (STOPS[i][c] + k * (STOPS[i + 1][c] - STOPS[i][c])).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::camera::Camera;
    use crate::data::paths::{Lens, training_cameras};

    fn frames(cameras: Vec<Camera>) -> Vec<Frame> {
        let n = cameras.len().max(1) as f64;
        let frame = |(i, camera)| Frame { name: String::new(), path: "".into(), camera, time: i as f64 / n };
        cameras.into_iter().enumerate().map(frame).collect()
    }

    #[test]
    fn cameras_and_box_are_where_they_should_be() {
        let lens = Lens { fov_x: 0.5, width: 4, height: 4 };
        let eye = DVec3::new(2.0, -4.0, 0.0);
        let one = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, lens.fov_x, 4, 4);
        let picture = layout_picture(&frames(vec![one]), &Aabb::cube(DVec3::ZERO, 1.0));
        assert_eq!(picture.dimensions(), (1376, 760));
        let scale = 320.0 / (1.12 * 4.0);
        let pixel = |x: f64, y: f64| picture.get_pixel(x as u32, y as u32).0;
        let purple = time_colour(0.0);
        assert_eq!(pixel(352.0 + 2.0 * scale, 368.0 + 4.0 * scale), purple);
        assert_eq!(pixel(1024.0 + 2.0 * scale, 368.0), purple);
        assert_eq!(pixel(352.0 + scale, 368.0 + 0.3 * scale), BOX);
    }

    #[test]
    fn odd_input_still_gives_a_picture() {
        let lens = Lens { fov_x: 0.5, width: 4, height: 4 };
        let mut some = frames(training_cameras(3, 1.0, lens));
        some[0].camera.camera_to_world.w_axis.x = f64::NAN;
        some[1].camera.camera_to_world.x_axis.x = f64::INFINITY;
        some[2].time = f64::NAN;
        let _ = layout_picture(&some, &Aabb::cube(DVec3::ZERO, 0.0));
        // the scale is then 0
        some[2].camera.camera_to_world.w_axis.y = 1.7e308;
        let _ = layout_picture(&some, &Aabb::cube(DVec3::ZERO, 1.0));
        let _ = layout_picture(&[], &Aabb::cube(DVec3::ZERO, 1e-30));
    }

    #[test]
    fn steps_are_round() {
        assert_eq!([0.9, 1.0, 1.1, 3.0, 6.0].map(round_step), [1.0, 1.0, 2.0, 5.0, 10.0]);
    }

    /// Writes the picture of the published data to the folder `VOLSEGGS_TEST_OUT`, for viewing.
    #[test]
    fn published_dataset() {
        use crate::data::dataset::{Dataset, OpenOptions, test_data};
        let Some(root) = test_data() else { return };
        let options = OpenOptions { downscale: 1, splits: &[], max_views: None };
        let dataset = Dataset::open(&root, &options).unwrap();
        let picture = layout_picture(&dataset.train.frames, &Aabb::cube(DVec3::ZERO, 0.54));
        let marked = picture.pixels().filter(|p| p.0 != PAPER).count();
        assert!(marked > 20_000, "{marked}");
        if let Some(folder) = std::env::var_os("VOLSEGGS_TEST_OUT") {
            picture.save(std::path::Path::new(&folder).join("layout.png")).unwrap();
        }
    }
}
