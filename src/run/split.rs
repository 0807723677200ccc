//! Splitting a segment into parts by its affinity features.

use super::segments::{RunSegments, check_clusters};
use super::{OpenRun, RunError, affinity};
use crate::data::Surroundings;
use crate::draw::views::view_sheet;
use crate::export::images::to_rgb8;
use crate::model::{HostGaussians, ToKernel};
use crate::name::Name;
use crate::numbers::{count, fraction_f32};
use crate::points::PointsError;
use crate::segment::fine::extract::{Clustering, cluster};
use crate::segment::fine::network::FEATURES;
use crate::segment::paint::flat;
use crate::segment::pictures::draw_each;
use crate::segment::pieces::without_strays;
use crate::segment::segmentation::{Segment, SegmentOrigin, Segmentation};
use clap::Args;
use image::RgbImage;

/// Colour, in the picture, of Gaussians that are in no part.
const NO_PART: [f32; 3] = [0.5; 3];

/// How to split a segment.
#[derive(Clone, Copy, Debug, PartialEq, Args)]
pub struct SplitOptions {
    /// Mask scale in [0, 1], from small parts to large ones.
    #[arg(long, default_value_t = 0.5, value_parser = fraction_f32)]
    pub scale: f32,
    /// Number of parts; determined from the density of the features if not given.
    #[arg(long, value_name = "K", value_parser = count)]
    pub clusters: Option<usize>,
    /// Seed of the clustering.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Also remove segments that were picked in the parts of an earlier split.
    #[arg(long)]
    pub replace: bool,
}

/// The parts of a segment.
#[derive(Clone, Debug)]
pub struct SegmentParts {
    /// Their names, largest part first.
    pub names: Vec<Name>,
    /// The Gaussians of the whole segment, at the time of the field.
    alone: HostGaussians,
    /// Colour of the part that each Gaussian was clustered into; `None` if that cluster did not become a part.
    shades: Vec<Option<[f32; 3]>>,
}

/// Splits a segment, replacing an earlier split of it; the parts are called `WHOLE.1`, `WHOLE.2` and so on. Returns
/// `None` if `goes_on`, called repeatedly, stopped it; `segments` are then unchanged.
///
/// # Errors
/// If there is no such segment or no affinity field, no parts are found, or something that the user made would be
/// removed.
pub fn split(
    run: &OpenRun,
    segments: &mut RunSegments,
    name: &str,
    options: &SplitOptions,
    goes_on: &dyn Fn() -> bool,
) -> Result<Option<SegmentParts>, RunError> {
    let mut all = segments.now().clone();
    let whole = all.get(name).map_err(RunError::input)?.clone();
    make_room(&mut all, name, options.replace)?;
    if let Some(clusters) = options.clusters {
        check_clusters(clusters, whole.members.len(), &format!("{} has", whole.name), FEATURES)?;
    }
    let (field, spec) = affinity::open(run)?;
    let at = run.scene.host_at(spec.time as f32);
    let alone = at.subset(&whole.members);
    let clustering = options.clusters.map_or(Clustering::Density, Clustering::KMeans);
    let (means, scale) = (&alone.means, options.scale);
    let labels = match cluster(&field, &spec.frame, means, scale, clustering, options.seed, goes_on) {
        Err(PointsError::Stopped) => return Ok(None),
        found => found.map_err(RunError::input)?,
    };

    // edits and tracks of earlier parts must not become those of other Gaussians
    let (edits, tracks) = (run.edits()?, run.paths().tracks());
    let used = |name: &str| edits.names(name) || tracks.join(name).exists();
    let mut names = Vec::new();
    let mut shades = vec![None; labels.len()];
    let mut number = 1;
    for label in 1..=labels.iter().max().copied().unwrap_or(0) {
        if !goes_on() {
            return Ok(None);
        }
        let of = whole.members.iter().zip(&labels).filter(|(_, l)| **l == label);
        let mut members: Vec<u32> = of.map(|(m, _)| *m).collect();
        let pieces = &run.config.segment.pieces;
        if pieces.strays {
            members = without_strays(&at, &members, None, pieces).map_err(RunError::failure)?;
        }
        if members.is_empty() {
            continue;
        }
        let (name, taken) = all.free_part(&whole.name, number, &used).map_err(RunError::input)?;
        number = taken + 1;
        let colour = all.free_colour();
        for (shade, _) in shades.iter_mut().zip(&labels).filter(|(_, l)| **l == label) {
            *shade = Some(colour);
        }
        let (parent, origin) = (Some(whole.name.clone()), SegmentOrigin::Fine { scale: options.scale });
        let part = Segment { name: name.clone(), parent, colour, time: spec.time, origin, members };
        all.add(part).map_err(RunError::failure)?;
        names.push(name);
    }
    if names.is_empty() {
        return Err(RunError::input(format!(
            "{}: no parts were found at --scale {}; choose another scale, or a number of parts with --clusters",
            whole.name, options.scale
        )));
    }
    segments.change(format!("split {}", whole.name), all.segments);
    Ok(Some(SegmentParts { names, alone, shades }))
}

/// Draws the whole segment from four sides, as it is and coloured by part.
pub fn sheet(run: &OpenRun, around: &Surroundings, parts: &SegmentParts) -> RgbImage {
    let painted = flat(parts.alone.clone(), parts.shades.iter().map(|shade| shade.unwrap_or(NO_PART)));
    let (width, height) = (around.lens.width as usize, around.lens.height as usize);
    let (rendering, device) = (run.scene.spec.rendering().flat(), run.device());
    let cameras = &around.orbit(5)[..4];
    let each = |gaussians: HostGaussians, label: &'static str| {
        let seen = cameras.iter().map(|camera| rendering.seen_by(camera.to_kernel()));
        draw_each(gaussians, seen, &device).map(move |image| (label.to_owned(), to_rgb8(&image, width, height)))
    };
    let pairs = each(parts.alone.clone(), "as it is").zip(each(painted, "parts"));
    let pictures: Vec<_> = pairs.flat_map(|(as_it_is, parts)| [as_it_is, parts]).collect();
    view_sheet(&pictures, 4, 400)
}

/// Removes the parts of an earlier split, unless something that the user made would be removed with them.
fn make_room(all: &mut Segmentation, segment: &str, replace: bool) -> Result<(), RunError> {
    let made: Vec<&str> = all.made_below_parts(segment).iter().map(|s| s.name.as_str()).collect();
    if !made.is_empty() && !replace {
        let (list, it) = (made.join(", "), if made.len() == 1 { "it" } else { "them" });
        return Err(RunError::input(format!(
            "{list}: picked in a part of {segment}, which a new split of {segment} would replace; pass --replace to \
             remove {it} too"
        )));
    }
    all.remove_parts(segment);
    Ok(())
}
