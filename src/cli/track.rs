//! `volseggs track`

use super::run_folder::RunFolder;
use super::{CliError, Common, print_json};
use crate::data::paths::orbit;
use crate::draw::plot::{Series, line_plot};
use crate::draw::views::view_sheet;
use crate::export::images::{encode_png, to_rgb8};
use crate::files::AtomicDir;
use crate::log::progress;
use crate::segment::pictures::draw;
use crate::track::events::EventKind;
use crate::track::follow::{FollowOptions, Followed, Followup, follow};
use crate::track::tables::{events_csv, statistics_csv, to_json, tracks_csv};
use clap::Args;
use image::RgbImage;
use std::path::{Path, PathBuf};

/// Follow segments through time: statistics, events, pictures.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs track RUN --segment red.1\n  volseggs track RUN --segment red.1 --segment red.2 --group pair\n  volseggs track RUN --segment red --from 0.5 --to 0     # backward\n\nWrites RUN/track/NAME/: statistics.csv and .json, events.csv, tracks.csv, over-time.svg, times.png."
)]
pub struct TrackArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Segment to follow; may be given many times.
    #[arg(long = "segment", value_name = "NAME", required = true)]
    segments: Vec<String>,
    /// Follow them as one, under this name.
    #[arg(long, value_name = "NAME")]
    group: Option<String>,
    /// First time in [0, 1].
    #[arg(long, default_value_t = 0.0)]
    from: f64,
    /// Last time in [0, 1]; before the first to go backward.
    #[arg(long, default_value_t = 1.0)]
    to: f64,
    /// Times, evenly spaced.
    #[arg(long, default_value_t = 51)]
    frames: usize,
    #[command(flatten)]
    common: Common,
}

impl TrackArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        for (flag, t) in [("--from", self.from), ("--to", self.to)] {
            if !(0.0..=1.0).contains(&t) {
                return Err(CliError::input(format!("{flag} {t}: between 0 and 1")));
            }
        }
        if self.frames < 2 {
            return Err(CliError::input(format!("--frames {}: at least 2", self.frames)));
        }
        let (_, device) = self.common.device()?;
        let run = RunFolder::open(&self.run, &device)?;
        let all = run.segments()?;
        let mut wanted: Vec<(String, Vec<u32>)> = Vec::new();
        for name in &self.segments {
            wanted.push((name.clone(), all.get(name).map_err(CliError::input)?.members.clone()));
        }
        if let Some(group) = &self.group {
            let mut members: Vec<u32> = wanted.iter().flat_map(|(_, m)| m).copied().collect();
            members.sort_unstable();
            members.dedup();
            wanted = vec![(group.clone(), members)];
        }
        if let Some((name, _)) = wanted.iter().find(|(_, m)| m.is_empty()) {
            return Err(CliError::input(format!("segment \"{name}\" is empty: there is nothing to follow")));
        }

        let step = (self.to - self.from) / (self.frames - 1) as f64;
        let times: Vec<f64> = (0..self.frames).map(|i| self.from + step * i as f64).collect();
        let segments: Vec<Followed<'_>> = wanted.iter().map(|(name, members)| Followed { name, members }).collect();
        let (lens, radius) = run.lens(None);
        let camera = orbit(8, radius, 20f64.to_radians(), lens)[0].to_kernel();
        let (background, degree) = (run.scene.spec.background, run.scene.spec.sh_degree);
        let count = self.frames.min(8);
        let shown: Vec<usize> = (0..count).map(|k| k * (self.frames - 1) / (count - 1)).collect();
        let mut pictures: Vec<Vec<(String, RgbImage)>> = vec![Vec::new(); segments.len()];
        let bar = progress::bar(self.frames, "times");
        let mut frame = 0;
        let scene = |time: f64| {
            let at = run.scene.host_at(time as f32);
            if shown.contains(&frame) {
                for (segment, pictures) in segments.iter().zip(&mut pictures) {
                    let image = draw(&at.subset(segment.members), camera, background, degree, &device);
                    pictures.push((format!("t = {time:.2}"), to_rgb8(&image, camera.width, camera.height)));
                }
            }
            frame += 1;
            bar.inc(1);
            at
        };
        let found = follow(scene, &segments, &times, &FollowOptions::default()).map_err(CliError::input)?;
        bar.finish_and_clear();
        for (followup, pictures) in found.iter().zip(&pictures) {
            let folder = run.path.join("track").join(&followup.name);
            write(&folder, followup, pictures).map_err(|e| CliError::failure(format!("{}: {e}", folder.display())))?;
        }
        if self.common.json {
            let report = |f: &Followup| serde_json::json!({ "segment": f.name, "statistics": f.statistics, "events": f.tracking.events });
            return print_json(&found.iter().map(report).collect::<Vec<_>>());
        }
        for followup in &found {
            println!("{}", followup.name);
            for event in followup.tracking.events.iter().filter(|e| e.kind != EventKind::Continue) {
                let list = |v: &[u32]| v.iter().map(ToString::to_string).collect::<Vec<_>>().join(" + ");
                let kind = format!("{:?}", event.kind);
                let (before, after) = (list(&event.parents), list(&event.children));
                println!("  t = {:.3} to {:.3}  {kind:14} {before} -> {after}", event.time_from, event.time_to);
            }
        }
        eprintln!("tables and pictures: {}", run.path.join("track").display());
        Ok(())
    }
}

fn write(folder: &Path, f: &Followup, pictures: &[(String, RgbImage)]) -> Result<(), Box<dyn std::error::Error>> {
    if let Some(parent) = folder.parent() {
        std::fs::create_dir_all(parent)?;
    }
    let out = AtomicDir::create(folder)?;
    let put = |name: &str, bytes: &[u8]| std::fs::write(out.dir().join(name), bytes);
    put("statistics.csv", statistics_csv(&f.statistics).as_bytes())?;
    put("statistics.json", to_json(&f.statistics)?.as_bytes())?;
    put("events.csv", events_csv(&f.name, &f.tracking.events).as_bytes())?;
    put("tracks.csv", tracks_csv(&f.name, &f.tracking.points).as_bytes())?;
    put("times.png", &encode_png(&view_sheet(pictures, 4, 320))?)?;
    let share = |name: &str, value: &dyn Fn(usize) -> f64| {
        let largest = (0..f.statistics.len()).map(value).fold(0.0, f64::max).max(1e-12);
        let points = f.statistics.iter().enumerate().map(|(i, s)| (s.time, value(i) / largest)).collect();
        Series { name: name.into(), points }
    };
    let series = [
        share("opacity", &|i| f.statistics[i].opacity),
        share("volume", &|i| f.statistics[i].volume),
        share("visible", &|i| f.statistics[i].visible as f64),
    ];
    put("over-time.svg", line_plot(&f.name, "time", "of the largest", &series).as_bytes())?;
    out.commit_replacing()?;
    Ok(())
}
