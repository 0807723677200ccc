//! `volseggs segment masks`

use super::super::run_folder::RunFolder;
use super::super::{CliError, Common, print_json};
use super::{check_time, write_picture};
use crate::data::paths::training_cameras;
use crate::draw::views::view_sheet;
use crate::log::progress;
use crate::segment::masks::sheet::overlay;
use crate::segment::masks::{Annotation, Header, MaskWriter, RegionImage, RegionOptions, View, find_regions};
use crate::segment::pictures::{Picture, picture};
use clap::Args;
use image::RgbImage;
use rayon::prelude::*;
use std::path::PathBuf;

/// 2D masks of each segment rendered alone from views all around.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs segment masks RUN\n  volseggs segment masks RUN --segment red --views 60 --size 400\n\nWrites RUN/segments/masks.jsonl (COCO run lengths) and masks.png to look at."
)]
pub struct MasksArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Segments to make masks of; all that are no part of another if not given.
    #[arg(long = "segment", value_name = "NAME")]
    segments: Vec<String>,
    /// Views on a Fibonacci sphere.
    #[arg(long, default_value_t = 30)]
    views: usize,
    /// Pixels a side; those of the training images if not given.
    #[arg(long)]
    size: Option<u32>,
    /// Time in [0, 1]; that at which the segments were found if not given.
    #[arg(long)]
    time: Option<f64>,
    #[command(flatten)]
    common: Common,
}

impl MasksArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        if self.views == 0 || self.size == Some(0) {
            return Err(CliError::input("--views and --size: at least 1"));
        }
        let (_, device) = self.common.device()?;
        let run = RunFolder::open(&self.run, &device)?;
        let all = run.segments()?;
        let mut names = self.segments.clone();
        if names.is_empty() {
            names = all.segments.iter().filter(|s| s.parent.is_none()).map(|s| s.name.clone()).collect();
        }
        let segments = names.iter().map(|n| all.get(n)).collect::<Result<Vec<_>, _>>().map_err(CliError::input)?;
        let first =
            segments.first().ok_or_else(|| CliError::input("no segments yet: run `volseggs segment coarse`"))?;
        let time = self.time.unwrap_or(first.time);
        check_time(time)?;

        let at = run.scene.host_at(time as f32);
        let (lens, radius) = run.lens(self.size);
        let cameras = training_cameras(self.views, radius, lens);
        let views = cameras.iter().enumerate().map(|(i, c)| View {
            file: format!("view-{i:03}"),
            camera_to_world: c.camera_to_world.transpose().to_cols_array().map(|v| v as f32),
            fov_x: c.fov_x() as f32,
        });
        let header = Header::new(lens.width, lens.height, time, views.collect(), names.clone(), "regions".into());
        let path = run.path.join("segments/masks.jsonl");
        let mut writer = MaskWriter::create(&path, header).map_err(CliError::failure)?;
        let bar = progress::bar(self.views * names.len(), "pictures");
        let (background, degree) = (run.scene.spec.background, run.scene.spec.sh_degree);
        let mut shown = Vec::new();
        for (k, segment) in segments.iter().enumerate() {
            let alone = at.subset(&segment.members);
            // pictures one after the other (each uses all threads), then their masks side by side, a few at a time
            for (batch, cameras) in cameras.chunks(8).enumerate() {
                let pictures: Vec<Picture> =
                    cameras.iter().map(|c| picture(&alone, c.to_kernel(), background, degree, &device)).collect();
                let found = pictures
                    .par_iter()
                    .map(|p| find_regions(&region_image(p, background)?, &RegionOptions::default()))
                    .collect::<Result<Vec<_>, _>>()
                    .map_err(CliError::failure)?;
                for (i, (picture, masks)) in pictures.iter().zip(found).enumerate() {
                    let view = 8 * batch + i;
                    if view % self.views.div_ceil(4) == 0 {
                        shown.push((format!("{} {view}", segment.name), outlined(picture, &masks)));
                    }
                    for m in masks {
                        let annotation = Annotation {
                            image_id: view as u32,
                            segment: k as u32,
                            mask: m.mask,
                            predicted_iou: m.contrast,
                            stability_score: m.stability_score,
                            scale: 0.0,
                        };
                        writer.write(&annotation).map_err(CliError::failure)?;
                    }
                    bar.inc(1);
                }
            }
        }
        bar.finish_and_clear();
        let count = writer.finish().map_err(CliError::failure)?;
        let sheet = run.path.join("segments/masks.png");
        write_picture(&sheet, &view_sheet(&shown, 4, 400))?;
        if self.common.json {
            return print_json(&serde_json::json!({ "masks": count, "file": path, "time": time }));
        }
        println!("{count} masks of {} segments in {} views at time {time}", names.len(), self.views);
        eprintln!("masks: {}; to look at: {}", path.display(), sheet.display());
        Ok(())
    }
}

/// Straight colour and alpha, from what was drawn over the background.
fn region_image(
    picture: &Picture,
    background: [f32; 3],
) -> Result<RegionImage, crate::segment::masks::regions::RegionError> {
    let mut rgba = picture.rgba.clone();
    for p in rgba.chunks_exact_mut(4) {
        let a = p[3].max(1e-3);
        for c in 0..3 {
            p[c] = ((p[c] - (1.0 - p[3]) * background[c]) / a).clamp(0.0, 1.0);
        }
    }
    RegionImage::from_floats(picture.width as u32, picture.height as u32, &rgba, background, Some(&picture.depth))
}

fn outlined(picture: &Picture, masks: &[crate::segment::masks::RegionMask]) -> RgbImage {
    let byte = |v: &f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    let rgba: Vec<u8> =
        picture.rgba.chunks_exact(4).flat_map(|p| [byte(&p[0]), byte(&p[1]), byte(&p[2]), 255]).collect();
    let masks: Vec<_> = masks.iter().map(|m| m.mask.clone()).collect();
    let out = overlay(picture.width as u32, picture.height as u32, &rgba, &masks);
    RgbImage::from_fn(out.width, out.height, |x, y| {
        let at = 4 * (y * out.width + x) as usize;
        image::Rgb([out.rgba[at], out.rgba[at + 1], out.rgba[at + 2]])
    })
}
