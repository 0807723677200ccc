//! `volseggs segment fine` and `segment split`

use super::super::run_folder::RunFolder;
use super::super::{CliError, Common, print_json, stop_flag};
use super::{affinity, write_picture};
use crate::data::paths::orbit;
use crate::draw::views::view_sheet;
use crate::export::images::to_rgb8;
use crate::files::Work;
use crate::log::progress;
use crate::model::GaussiansAt;
use crate::name::Name;
use crate::segment::fine::extract::{Clustering, cluster, without_strays};
use crate::segment::fine::file::{self, AffinitySpec};
use crate::segment::fine::network::Frame;
use crate::segment::fine::train::{FineOptions, train};
use crate::segment::fine::views::read_views;
use crate::segment::masks::MaskReader;
use crate::segment::masks::sheet::distinct_colour;
use crate::segment::pictures::draw;
use crate::segment::segmentation::{Origin, Segment};
use clap::Args;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Instant;
use volseggs_kernels::contrast::Repulsion;

/// Train the affinity field on the masks.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs segment fine RUN\n  volseggs segment fine RUN --margin -1 --pixels 8192   # the paper's loss\n\nReads RUN/segments/masks.jsonl, writes RUN/segments/affinity.safetensors."
)]
pub struct FineArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Steps.
    #[arg(long, default_value_t = 5000)]
    steps: usize,
    /// Pixels a step; with a margin, time grows with their square.
    #[arg(long, default_value_t = 2048)]
    pixels: usize,
    /// Learning rate.
    #[arg(long, default_value_t = 1e-3)]
    rate: f64,
    /// Pixels of different masks repel where their cosine exceeds this; -1 is the paper's loss, without a margin. With
    /// one, more parts find room beside each other.
    #[arg(long, value_name = "COSINE", default_value_t = 0.5, allow_negative_numbers = true)]
    margin: f32,
    /// Weight of the hierarchy loss: what is together at a scale stays together at larger ones.
    #[arg(long, value_name = "W", default_value_t = 0.0)]
    hierarchy: f64,
    /// Seed.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    common: Common,
}

impl FineArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        if self.hierarchy.is_nan() || self.hierarchy < 0.0 {
            return Err(CliError::input(format!("--hierarchy {}: at least 0", self.hierarchy)));
        }
        let (_, device) = self.common.device()?;
        let run = RunFolder::open_to_write(&self.run, &device, Work::Long)?;
        let all = run.segments()?;
        let path = run.path.join("segments/masks.jsonl");
        if !path.exists() {
            return Err(CliError::input(format!("{}: no masks yet; run `volseggs segment masks`", path.display())));
        }
        let stop = stop_flag("stopping after this step; nothing is written")?;
        let started = Instant::now();
        let masks = MaskReader::open(&path).map_err(CliError::input)?;
        let header = masks.header().clone();
        let at = run.scene.host_at(header.time as f32);
        let frame = Frame::around(&at.visible_means());
        let members = |name: &String| Ok(all.get(name).map_err(CliError::input)?.members.clone());
        let members = header.segments.iter().map(members).collect::<Result<Vec<_>, CliError>>()?;
        let bar = progress::bar(header.views.len(), "views");
        let (views, spreads) =
            read_views(&masks, &at, &frame, &members, self.seed, &device, |_| bar.inc(1)).map_err(CliError::input)?;
        bar.finish_and_clear();
        errln!("{} views of segments, {} masks, {:.1} s", views.len(), spreads.len(), started.elapsed().as_secs_f64());

        let repulsion = if self.margin <= -1.0 { Repulsion::Cosine } else { Repulsion::Margin(self.margin) };
        let options = FineOptions {
            steps: self.steps,
            pixels: self.pixels,
            rate: self.rate,
            repulsion,
            hierarchy: self.hierarchy,
            seed: self.seed,
        };
        let bar = progress::bar(self.steps, "steps");
        let mut smooth = None;
        let started = Instant::now();
        let field = train(&views, &options, &device, |step, loss| {
            let mean = smooth.map_or(loss, |s: f64| 0.98 * s + 0.02 * loss);
            smooth = Some(mean);
            bar.set_position(step as u64 + 1);
            bar.set_message(format!("loss {mean:.4}"));
            !stop.load(Ordering::Relaxed)
        })
        .map_err(CliError::failure)?;
        bar.finish_and_clear();
        if stop.load(Ordering::Relaxed) {
            return Err(CliError::failure("interrupted; the affinity field of before, if any, is as it was"));
        }
        let seconds = started.elapsed().as_secs_f64();
        let spec = AffinitySpec { frame, time: header.time, scene: run.scene.fingerprint(), spreads };
        let path = run.path.join(file::FILE);
        file::save(&path, &field, &spec).map_err(CliError::failure)?;
        let loss = smooth.unwrap_or_default();
        if self.common.json {
            return print_json(
                &serde_json::json!({ "file": path, "loss": loss, "seconds": seconds, "steps": self.steps }),
            );
        }
        outln!("{} steps in {seconds:.1} s, loss {loss:.4}", self.steps);
        errln!("next: volseggs segment split {} SEGMENT --scale 0.3", run.path.display());
        Ok(())
    }
}

/// Part a segment by its affinity features.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs segment split RUN red --scale 0.3\n  volseggs segment split RUN red --clusters 5\n\nThe parts are called SEGMENT.1, SEGMENT.2, ... from the largest; a picture is in RUN/segments/."
)]
pub struct SplitArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Segment to part.
    segment: String,
    /// Mask scale in [0, 1], from small parts to large ones.
    #[arg(long, default_value_t = 0.5)]
    scale: f32,
    /// Into so many parts; as many as the density of the features shows if not given.
    #[arg(long, value_name = "K")]
    clusters: Option<usize>,
    /// Keep small pieces that do not touch the rest of their part.
    #[arg(long)]
    keep_strays: bool,
    /// Seed of the clustering.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    common: Common,
}

impl SplitArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        if !(0.0..=1.0).contains(&self.scale) {
            return Err(CliError::input(format!("--scale {}: between 0 and 1", self.scale)));
        }
        let (_, device) = self.common.device()?;
        let run = RunFolder::open_to_write(&self.run, &device, Work::Short)?;
        let mut all = run.segments()?;
        let whole = all.get(&self.segment).map_err(CliError::input)?.clone();
        let (field, spec) = affinity(&run, &device)?;
        let at = run.scene.host_at(spec.time as f32);
        let alone = at.subset(&whole.members);
        let clustering = self.clusters.map_or(Clustering::Density, Clustering::KMeans);
        let labels =
            cluster(&field, &spec.frame, &alone.means, self.scale, clustering, self.seed).map_err(CliError::input)?;
        // parts of an earlier time give way
        all.remove(|s| s.parent.as_deref() == Some(&self.segment));
        let count = labels.iter().max().copied().unwrap_or(0);
        let mut painted = alone.clone();
        for label in 1..=count {
            let colour = distinct_colour(label as usize - 1).map(|c| f32::from(c) / 255.0);
            let mut members: Vec<u32> =
                whole.members.iter().zip(&labels).filter(|(_, l)| **l == label).map(|(m, _)| *m).collect();
            if !self.keep_strays {
                members = without_strays(&at, &members).map_err(CliError::failure)?;
            }
            let origin = Origin::Fine { scale: self.scale };
            let name = Name::new(format!("{}.{label}", whole.name)).map_err(CliError::input)?;
            let parent = Some(whole.name.clone());
            all.add(Segment { name, parent, colour, time: spec.time, origin, members }).map_err(CliError::failure)?;
            for (i, _) in labels.iter().enumerate().filter(|(_, l)| **l == label) {
                let sh = &mut painted.sh[3 * painted.sh_stride * i..][..3 * painted.sh_stride];
                sh.fill(0.0);
                (0..3).for_each(|c| sh[c] = (colour[c] - 0.5) / 0.282_094_79);
            }
        }
        all.save(&run.segments_path()).map_err(CliError::failure)?;
        let (lens, radius) = run.lens(None);
        let pictures: Vec<_> = orbit(5, radius, 20f64.to_radians(), lens)[..4]
            .iter()
            .flat_map(|camera| {
                [("as it is", &alone), ("parts", &painted)].map(|(label, gaussians): (&str, &GaussiansAt)| {
                    let image = draw(gaussians, camera.to_kernel(), run.scene.spec.background, 0, &device);
                    (label.to_owned(), to_rgb8(&image, lens.width as usize, lens.height as usize))
                })
            })
            .collect();
        let sheet = run.path.join(format!("segments/{}.png", whole.name));
        write_picture(&sheet, &view_sheet(&pictures, 4, 400))?;
        let parts: Vec<&Segment> = all.segments.iter().filter(|s| s.parent.as_deref() == Some(&whole.name)).collect();
        if self.common.json {
            return print_json(&parts);
        }
        for part in &parts {
            outln!("{:20} {:>8} Gaussians", part.name, part.members.len());
        }
        errln!("pictures: {}", sheet.display());
        Ok(())
    }
}
