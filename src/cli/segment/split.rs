//! `volseggs segment split`

use super::super::run_folder::RunFolder;
use super::super::values::{count, fraction_f32};
use super::super::{CliError, Common, print_json};
use super::history::History;
use super::{affinity, check_clusters, write_picture};
use crate::data::paths::orbit;
use crate::draw::views::view_sheet;
use crate::export::images::to_rgb8;
use crate::files::Work;
use crate::model::GaussiansAt;
use crate::segment::fine::extract::{Clustering, cluster};
use crate::segment::fine::network::FEATURES;
use crate::segment::masks::sheet::distinct_colour;
use crate::segment::paint::flat;
use crate::segment::pictures::draw;
use crate::segment::pieces::without_strays;
use crate::segment::segmentation::{Origin, Segment, Segmentation};
use clap::Args;
use std::path::PathBuf;

/// Colour in the picture of what is in no part.
const NO_PART: [f32; 3] = [0.5; 3];

/// Part a segment by its affinity features.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs segment split RUN red --scale 0.3\n  volseggs segment split RUN red --clusters 5\n\nThe parts are called SEGMENT.1, SEGMENT.2, ... from the largest, without names that are taken; a picture is in RUN/segments/. Parts of an earlier split of the segment give way; `volseggs segment undo RUN` brings them back. What was picked in the segment itself stays."
)]
pub struct SplitArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Segment to part.
    segment: String,
    /// Mask scale in [0, 1], from small parts to large ones.
    #[arg(long, default_value_t = 0.5, value_parser = fraction_f32)]
    scale: f32,
    /// Into so many parts; as many as the density of the features shows if not given.
    #[arg(long, value_name = "K", value_parser = count)]
    clusters: Option<usize>,
    /// Keep small pieces that do not touch the rest of their part.
    #[arg(long)]
    keep_strays: bool,
    /// Seed of the clustering.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Remove also segments that were picked in the parts of an earlier split.
    #[arg(long)]
    replace: bool,
    #[command(flatten)]
    common: Common,
}

impl SplitArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let run = RunFolder::open_to_write(&self.run, &device, Work::Short)?;
        let mut history = History::open(&run)?;
        let mut all = history.now().clone();
        let whole = all.get(&self.segment).map_err(CliError::input)?.clone();
        self.make_room(&mut all)?;
        if let Some(clusters) = self.clusters {
            check_clusters(clusters, whole.members.len(), &format!("{} has", whole.name), FEATURES)?;
        }
        let (field, spec) = affinity(&run, &device)?;
        let at = run.scene.host_at(spec.time as f32);
        let alone = at.subset(&whole.members);
        let clustering = self.clusters.map_or(Clustering::Density, Clustering::KMeans);
        let labels =
            cluster(&field, &spec.frame, &alone.means, self.scale, clustering, self.seed).map_err(CliError::input)?;

        let mut parts = Vec::new();
        let mut shades = vec![None; labels.len()];
        let mut number = 1;
        for label in 1..=labels.iter().max().copied().unwrap_or(0) {
            let mut members: Vec<u32> =
                whole.members.iter().zip(&labels).filter(|(_, l)| **l == label).map(|(m, _)| *m).collect();
            if !self.keep_strays {
                members = without_strays(&at, &members).map_err(CliError::failure)?;
            }
            if members.is_empty() {
                continue;
            }
            let (name, taken) = all.free_part(&whole.name, number).map_err(CliError::input)?;
            number = taken + 1;
            let colour = distinct_colour(parts.len()).map(|c| f32::from(c) / 255.0);
            for (shade, _) in shades.iter_mut().zip(&labels).filter(|(_, l)| **l == label) {
                *shade = Some(colour);
            }
            let (parent, origin) = (Some(whole.name.clone()), Origin::Fine { scale: self.scale });
            let part = Segment { name: name.clone(), parent, colour, time: spec.time, origin, members };
            all.add(part).map_err(CliError::failure)?;
            parts.push(name);
        }
        if parts.is_empty() {
            return Err(CliError::input(format!(
                "{}: no parts show at --scale {}; choose another scale, or a number of parts with --clusters",
                whole.name, self.scale
            )));
        }
        history.change(format!("split {}", whole.name), all.segments.clone());
        history.save()?;

        let sheet = run.path.join(format!("segments/{}.png", whole.name));
        let painted = flat(alone.clone(), shades.into_iter().map(|shade| shade.unwrap_or(NO_PART)));
        let (lens, sphere) = run.lens(None);
        let pictures: Vec<_> = orbit(5, sphere, 20f64.to_radians(), lens)[..4]
            .iter()
            .flat_map(|camera| {
                [("as it is", &alone), ("parts", &painted)].map(|(label, gaussians): (&str, &GaussiansAt)| {
                    let image = draw(gaussians, camera.to_kernel(), run.scene.spec.background, 0, &device);
                    (label.to_owned(), to_rgb8(&image, lens.width as usize, lens.height as usize))
                })
            })
            .collect();
        write_picture(&sheet, &view_sheet(&pictures, 4, 400))?;
        let parts: Vec<&Segment> = all.segments.iter().filter(|s| parts.contains(&s.name)).collect();
        if self.common.json {
            return print_json(&parts);
        }
        for part in &parts {
            outln!("{:20} {:>8} Gaussians", part.name, part.members.len());
        }
        errln!("pictures: {}", sheet.display());
        Ok(())
    }

    /// Removes the parts of an earlier split, unless something that a person made would go with them.
    fn make_room(&self, all: &mut Segmentation) -> Result<(), CliError> {
        let made: Vec<&str> = all.made_below_parts(&self.segment).iter().map(|s| s.name.as_str()).collect();
        if !made.is_empty() && !self.replace {
            let (list, it) = (made.join(", "), if made.len() == 1 { "it" } else { "them" });
            return Err(CliError::input(format!(
                "{list}: picked in a part of {0}, which a new split of {0} would replace; pass --replace to remove {it} too",
                self.segment
            )));
        }
        all.remove_parts(&self.segment);
        Ok(())
    }
}
