//! Measures the viewer as a window sees it: frame rates and response times.
//!
//! `cargo bench --bench view -- RUN [--size 800]`: serves the run, opens a window on it over the loopback interface
//! that acknowledges each frame at once, and prints a table. Clicks are measured if the run has an affinity field.
//! Last, playback is measured over a line of 2 Mbit/s with a delay of 100 ms each way.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

#[path = "view/slow.rs"]
mod slow;
#[path = "view/window.rs"]
mod window;

use serde_json::json;
use slow::{Lags, proxy};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use volseggs::device::DeviceName;
use volseggs::model::ToKernel;
use volseggs::run::OpenRun;
use volseggs::run::look::{Look, Show};
use volseggs::run::selection::Selection;
use volseggs::view::protocol::View;
use window::{Window, parts};

/// Base duration of a measurement.
const SPAN: Duration = Duration::from_secs(6);
/// Size limit of the viewer's cache of prepared times, in bytes.
const CACHE: u64 = 1 << 30;

/// Median and 95th percentile.
fn quantiles(mut values: Vec<f64>) -> [f64; 2] {
    values.sort_by(f64::total_cmp);
    [0.5, 0.95].map(|q| values[((values.len() - 1) as f64 * q).round() as usize])
}

fn line(what: &str, value: impl std::fmt::Display) {
    println!("| {what} | {value} |");
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|w| w != "--bench").collect();
    let Some(run) = words.first().map(PathBuf::from) else {
        println!("cargo bench --bench view -- RUN [--size 800]");
        return;
    };
    let size = words.iter().position(|w| w == "--size").map_or(800, |i| words[i + 1].parse().unwrap());
    let device = DeviceName::all()[0].open().unwrap();

    // the same drawing without a server
    let open = OpenRun::open(&run, &device).unwrap();
    let mut look = Look::open(&open, Selection::open(&open, &[], true).unwrap(), Show::Colour, None).unwrap();
    let prepared = look.prepare(&open.scene, 0.5).unwrap();
    let around = open.record.surroundings;
    let (eye, target) = ([around.sphere.radius, 0.0, 1.0], open.scene.spec.centre().to_array());
    let camera =
        json!({ "eye": eye, "target": target, "up": [0, 0, 1], "fov": around.lens.fov_x, "size": [size, size] });
    let mut view = json!({ "time": 0.5, "look": "colour", "edits": true });
    view.as_object_mut().unwrap().extend(camera.as_object().unwrap().clone());
    let view: View = serde_json::from_value(view).unwrap();
    let camera = view.camera(1.0).to_kernel();
    let (started, mut bare) = (Instant::now(), 0);
    while started.elapsed() < SPAN {
        look.draw(&open.scene, &prepared, camera);
        bare += 1;
    }
    let bare = f64::from(bare) / started.elapsed().as_secs_f64();
    println!(
        "{} Gaussians, {size}x{size}, {} threads\n\n| | |\n|---|--:|",
        open.scene.gaussians.count(),
        rayon::current_num_threads()
    );
    line("bare drawing, time held, frames/s", format!("{bare:.1}"));
    let scene_bytes = std::fs::metadata(&open.scene_path).unwrap().len();
    drop((open, look, prepared));

    let started = Instant::now();
    let server = Server::start(&run);
    let mut window = Window::open(&server.url, size, None);
    let first = window.view(0.0, 0.5, false);
    window.say(&first);
    window.frame();
    line("first frame after the start, s", format!("{:.2}", started.elapsed().as_secs_f64()));
    window.rest();
    server.memory("at rest, one time prepared", scene_bytes);
    full_size(&mut window, bare);
    moving(&mut window);
    playback(&mut window);
    resting(&mut window);
    if window.welcome["clicks"] == true {
        clicks(&mut window);
    }
    drop(window);
    far_away(&server.url, size);
    server.memory(&format!("at the end, of which up to {} MB cached times", CACHE >> 20), scene_bytes);
}

/// `volseggs view RUN` in its own process.
struct Server {
    child: Child,
    url: String,
}

impl Server {
    fn start(run: &Path) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_volseggs"));
        command.arg("view").arg(run).args(["--read-only", "--cache", &format!("{}M", CACHE >> 20), "--port", "0"]);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut url = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut url).unwrap();
        Self { child, url: url.trim().to_owned() }
    }

    /// Prints the memory that the server holds beyond the scene's size; nothing where the system does not report it.
    fn memory(&self, when: &str, scene: u64) {
        let Ok(status) = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())) else { return };
        let held = status.lines().find_map(|l| l.strip_prefix("VmRSS:")).unwrap();
        let held = 1024 * held.trim().trim_end_matches(" kB").parse::<u64>().unwrap();
        line(&format!("memory over the scene, {when}, MB"), format!("{:.0}", held.saturating_sub(scene) >> 20));
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

/// Measures a full-size view that changes 60 times a second, as if moved by a mouse: frames per second, and how much
/// longer a frame takes than bare drawing.
fn full_size(window: &mut Window, bare: f64) {
    let (started, mut frames) = (Instant::now(), 0);
    for step in 0.. {
        let at = started + step * Duration::from_micros(16_667);
        while let Some(left) = at.checked_duration_since(Instant::now()) {
            let Some(frame) = window.frame_within(left) else { continue };
            frames += i32::from(!frame.png && u32::from(frame.width) == window.size);
        }
        if started.elapsed() > SPAN {
            break;
        }
        let view = window.view(0.001 * f64::from(step), 0.5, false);
        window.say(&view);
    }
    let rate = f64::from(frames) / started.elapsed().as_secs_f64();
    line("full size, time held, frames/s", format!("{rate:.1}"));
    line("the same, time of a frame over bare drawing, %", format!("{:.0}", 100.0 * (bare / rate - 1.0)));
    window.rest();
}

/// Measures a turning view, each sent as soon as the previous frame has arrived: frames per second, and the time from a
/// view to its frame.
fn moving(window: &mut Window) {
    let (started, mut waits, mut widths, mut shares) = (Instant::now(), Vec::new(), Vec::new(), Vec::new());
    let mut turn = 0.0;
    while started.elapsed() < SPAN {
        turn += 0.003;
        let (view, asked) = (window.view(turn, 0.5, true), Instant::now());
        window.say(&view);
        let frame = window.frame();
        waits.push(1e3 * asked.elapsed().as_secs_f64());
        widths.push(f64::from(frame.width));
        shares.push(f64::from(frame.encode_ms / (frame.render_ms + frame.encode_ms)));
    }
    let rate = waits.len() as f64 / started.elapsed().as_secs_f64();
    let [median, late] = quantiles(waits);
    line("turning, frames/s", format!("{rate:.1}"));
    line("turning, median width, pixels", format!("{:.0}", quantiles(widths)[0]));
    line("turning, input to frame, ms, median and 95th percentile", format!("{median:.0}, {late:.0}"));
    line("encoding's share of a frame, %", format!("{:.0}", 100.0 * quantiles(shares)[0]));
    window.rest();
}

/// Measures two playback loops over 100 points in time.
fn playback(window: &mut Window) {
    for name in ["first", "second"] {
        let started = Instant::now();
        for step in 0..100 {
            let view = window.view(0.0, f64::from(step) / 100.0, true);
            window.say(&view);
            while (window.frame().time - step as f32 / 100.0).abs() > 1e-4 {}
        }
        line(&format!("playback, {name} loop, frames/s"), format!("{:.1}", 100.0 / started.elapsed().as_secs_f64()));
    }
    window.rest();
}

/// Measures playback over a slow line, requesting a time every 33 ms regardless of the responses: frames per second,
/// and how far frames lag behind their requests, at the beginning and at the end.
fn far_away(url: &str, size: u32) {
    let via = proxy(parts(url).0, 2e6 / 8.0, Duration::from_millis(100));
    let mut window = Window::open(url, size, Some(via));
    let (started, mut lags, mut late, mut widths) = (Instant::now(), Lags::default(), Vec::new(), Vec::new());
    for step in 0.. {
        let (at, time) = (started + step * Duration::from_millis(33), f64::from(step % 100) / 100.0);
        while let Some(left) = at.checked_duration_since(Instant::now()) {
            let Some(frame) = window.frame_within(left) else { continue };
            late.extend(lags.received(frame.time));
            widths.push(f64::from(frame.width));
        }
        if started.elapsed() > 3 * SPAN {
            break;
        }
        let view = window.view(0.0, time, true);
        window.say(&view);
        lags.requested(time as f32);
    }
    let rate = late.len() as f64 / started.elapsed().as_secs_f64();
    let (first, last) = (late[..late.len() / 3].to_vec(), late[late.len() - late.len() / 3..].to_vec());
    line("2 Mbit/s with 100 ms either way, frames/s", format!("{rate:.1}"));
    line("the same, median width, pixels", format!("{:.0}", quantiles(widths)[0]));
    let [first, last] = [first, last].map(|part| quantiles(part)[0]);
    line("the same, lag in the first and the last third, ms", format!("{first:.0}, {last:.0}"));
}

/// Measures the time from the last input to the lossless picture.
fn resting(window: &mut Window) {
    let mut waits = Vec::new();
    for turn in 0..10 {
        let view = window.view(0.1 + 0.02 * f64::from(turn), 0.5, true);
        window.say(&view);
        window.frame();
        let asked = Instant::now();
        let view = window.view(0.1 + 0.02 * f64::from(turn), 0.5, false);
        window.say(&view);
        window.rest();
        waits.push(1e3 * asked.elapsed().as_secs_f64());
    }
    line("rest to lossless, ms", format!("{:.0}", quantiles(waits)[0]));
}

/// Measures the time from a click, and from a slider change, to the picture that shows the selection.
fn clicks(window: &mut Window) {
    let middle = window.size / 2;
    for (name, message) in [
        ("first click to highlight, ms", json!({ "type": "pick", "id": 1, "pixel": [middle, middle], "within": null })),
        (
            "another click to highlight, ms",
            json!({ "type": "pick", "id": 2, "pixel": [middle, middle], "within": null }),
        ),
        (
            "slider to highlight, ms",
            json!({ "type": "adjust", "id": 3, "meaning": { "by": { "scale": 0.4, "threshold": 0.7 } } }),
        ),
    ] {
        let asked = Instant::now();
        window.say(&message);
        window.answer("picked");
        window.frame();
        line(name, format!("{:.0}", 1e3 * asked.elapsed().as_secs_f64()));
        window.rest();
    }
}
