//! `volseggs segment masks`

mod plan;

use super::super::run_folder::RunFolder;
use super::super::values::{count, fraction, pixels};
use super::super::{CliError, Common, print_json, stop_flag};
use super::write_picture;
use crate::draw::views::view_sheet;
use crate::export::images::to_rgb8;
use crate::files::{AtomicDir, Work};
use crate::log::progress;
use crate::segment::masks::handout::{HandoutError, write_pictures};
use crate::segment::masks::make::{MakeError, make_masks};
use crate::segment::masks::sheet::overlay;
use crate::segment::masks::source::Found;
use crate::segment::pictures::Picture;
use clap::{Args, ValueEnum};
use image::RgbImage;
use plan::Plan;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

/// Segments that the picture of masks shows at most.
const SHOWN: usize = 20;

/// 2D masks of each segment rendered alone from views all around.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs segment masks RUN\n  volseggs segment masks RUN --segment red --views 60 --size 400\n  volseggs segment masks RUN --source labels           # the truth, if the dataset has it\n  volseggs segment masks RUN --source sam --points 12  # MobileSAM\n\nMasks of another program, in three steps:\n  1. volseggs segment masks RUN --pictures\n     writes RUN/segments/pictures/SEGMENT/view-000.png and so on\n  2. run the program on them and let it write one of\n     MASKS/SEGMENT/view-000_1.png, view-000_2.png, ...: grey, not 0 in the mask\n     MASKS/SEGMENT/view-000.png: grey, each value but 0 a mask\n     a COCO file with run lengths, its images called SEGMENT/view-000.png\n  3. volseggs segment masks RUN --source dir --masks MASKS (or the COCO file)\n\nWrites RUN/segments/masks.jsonl (COCO run lengths) and masks.png to look at."
)]
pub struct MasksArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Segments to make masks of; all that are no part of another if not given.
    #[arg(long = "segment", value_name = "NAME")]
    segments: Vec<String>,
    /// What finds the masks.
    #[arg(long, value_enum, default_value_t = Kind::Regions)]
    source: Kind,
    /// Views on a Fibonacci sphere [default: 30]; for labels: so many of the dataset's training views of the time, all
    /// if not given, and its test views of the time where they are fewer.
    #[arg(long, value_parser = count)]
    views: Option<usize>,
    /// Pixels a side; those of the training images if not given.
    #[arg(long, value_parser = pixels)]
    size: Option<u32>,
    /// Time in [0, 1]; that at which the segments were found if not given.
    #[arg(long, value_parser = fraction)]
    time: Option<f64>,
    /// For labels: the dataset that the run was trained on, if it is not where it was then.
    #[arg(long, value_name = "DATASET")]
    data: Option<PathBuf>,
    /// For dir: the folder of masks, or the COCO file.
    #[arg(long, value_name = "PATH")]
    masks: Option<PathBuf>,
    /// For sam: the weights; looked for in the cache folder if not given.
    #[arg(long, value_name = "FILE")]
    sam_weights: Option<PathBuf>,
    /// For sam: points along a side of the grid that is asked [default: 32].
    #[arg(long, value_name = "N", value_parser = count)]
    points: Option<usize>,
    /// Write the pictures for another program to segment, and no masks.
    #[arg(long, conflicts_with = "replace")]
    pictures: bool,
    /// Take the place of the masks that are there.
    #[arg(long)]
    replace: bool,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// Regions between jumps of colour, alpha and depth.
    Regions,
    /// The dataset's label images, of the time nearest to that asked for.
    Labels,
    /// Masks that another program made.
    Dir,
    /// MobileSAM.
    Sam,
}

impl MasksArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        self.check()?;
        let weights = self.weights()?;
        let (_, device) = self.common.device()?;
        let run = RunFolder::open_to_write(&self.run, &device, Work::Long)?;
        let path = run.path.join("segments/masks.jsonl");
        if path.exists() && !self.pictures && !self.replace {
            return Err(CliError::input(format!(
                "{}: masks are there already; pass --replace to make them anew",
                path.display()
            )));
        }
        let plan = self.plan(&run)?;
        self.check_memory(&plan)?;
        if self.pictures {
            return self.hand_out(&run, &plan, &device);
        }
        let stop = stop_flag("stopping; the masks of before, if any, stay as they are")?;
        let at = run.scene.host_at(plan.time as f32);
        let job = plan.job(&run, &at, &device);
        let source = self.source(&plan, &job, weights.as_deref())?;
        let (views, every) = (plan.shots.len(), plan.shots.len().div_ceil(4));
        let bar = progress::bar(views * plan.groups.len(), "pictures");
        let mut shown = Vec::new();
        let count = make_masks(&job, source.as_ref(), &path, |seen, found| {
            if seen.view % every == 0 && seen.group < SHOWN {
                let label = format!("{} {}", plan.groups[seen.group].name, seen.view);
                shown.push((label, outlined(seen.picture, found)));
            }
            bar.inc(1);
            !stop.load(Ordering::Relaxed)
        })
        .map_err(make_error)?;
        bar.finish_and_clear();
        let sheet = run.path.join("segments/masks.png");
        write_picture(&sheet, &view_sheet(&shown, 4, 400))?;
        if self.common.json {
            return print_json(
                &serde_json::json!({ "masks": count, "file": path, "time": plan.time, "source": source.name() }),
            );
        }
        outln!("{count} masks of {} segments in {views} views at time {}", plan.groups.len(), plan.time);
        errln!("masks: {}; to look at: {}", path.display(), sheet.display());
        Ok(())
    }

    /// What can be known to be wrong without the run.
    fn check(&self) -> Result<(), CliError> {
        let source = self.source;
        let name = source.to_possible_value().map(|v| v.get_name().to_owned()).unwrap_or_default();
        for (given, option, of) in [
            (self.data.is_some(), "--data", Kind::Labels),
            (self.masks.is_some(), "--masks", Kind::Dir),
            (self.sam_weights.is_some(), "--sam-weights", Kind::Sam),
            (self.points.is_some(), "--points", Kind::Sam),
        ] {
            if given && source != of {
                let of = of.to_possible_value().map(|v| v.get_name().to_owned()).unwrap_or_default();
                return Err(CliError::input(format!("{option} is for --source {of}, not --source {name}")));
            }
        }
        let refuse = |given: bool, option: &str, why: &str| {
            if given {
                Err(CliError::input(format!("{option} does not go with --source {name}: {why}")))
            } else {
                Ok(())
            }
        };
        match source {
            Kind::Labels => refuse(self.size.is_some(), "--size", "views are as large as the dataset's images")?,
            Kind::Dir => {
                let why = "views, size and time are those of the pictures that --pictures wrote";
                refuse(self.views.is_some(), "--views", why)?;
                refuse(self.size.is_some(), "--size", why)?;
                refuse(self.time.is_some(), "--time", why)?;
                if self.masks.is_none() {
                    return Err(CliError::input("--source dir: name the folder or COCO file with --masks PATH"));
                }
            }
            Kind::Regions | Kind::Sam => {}
        }
        if self.pictures && source != Kind::Regions {
            return Err(CliError::input(
                "--pictures makes no masks; leave --source out, and give it when masks are there",
            ));
        }
        Ok(())
    }

    /// Writes the pictures for another program.
    fn hand_out(&self, run: &RunFolder, plan: &Plan, device: &burn::tensor::Device) -> Result<(), CliError> {
        let folder = plan::pictures_folder(run);
        if folder.exists() {
            return Err(CliError::input(format!(
                "{}: pictures are there already; remove the folder to write them anew",
                folder.display()
            )));
        }
        let stop = stop_flag("stopping; nothing is written")?;
        let at = run.scene.host_at(plan.time as f32);
        let job = plan.job(run, &at, device);
        let fail = |e: std::io::Error| CliError::failure(format!("{}: {e}", folder.display()));
        let building = AtomicDir::create(&folder).map_err(fail)?;
        let count = plan.shots.len() * plan.groups.len();
        let bar = progress::bar(count, "pictures");
        write_pictures(&job, &run.scene.fingerprint(), building.dir(), || {
            bar.inc(1);
            !stop.load(Ordering::Relaxed)
        })
        .map_err(|e| match e {
            HandoutError::Job(MakeError::Stopped) => CliError::failure("stopped; nothing was written"),
            e => CliError::failure(e),
        })?;
        building.commit().map_err(fail)?;
        bar.finish_and_clear();
        if self.common.json {
            return print_json(&serde_json::json!({ "pictures": count, "folder": folder, "time": plan.time }));
        }
        outln!("{count} pictures of {} segments at time {}", plan.groups.len(), plan.time);
        errln!(
            "pictures: {}; next: let your program write MASKS/SEGMENT/VIEW_NUMBER.png, then volseggs segment masks {} \
             --source dir --masks MASKS",
            folder.display(),
            run.path.display()
        );
        Ok(())
    }
}

fn make_error(error: MakeError) -> CliError {
    match error {
        MakeError::Camera { .. } | MakeError::NoViews | MakeError::Member { .. } => CliError::input(error),
        MakeError::Source(e) if e.is_input() => CliError::input(e),
        _ => CliError::failure(error),
    }
}

fn outlined(picture: &Picture, found: &[Found]) -> RgbImage {
    let rgba: Vec<u8> = to_rgb8(&picture.rgba, picture.width, picture.height)
        .pixels()
        .flat_map(|p| [p.0[0], p.0[1], p.0[2], 255])
        .collect();
    let masks: Vec<_> = found.iter().map(|f| f.mask.clone()).collect();
    let out = overlay(picture.width as u32, picture.height as u32, &rgba, &masks);
    RgbImage::from_fn(out.width, out.height, |x, y| {
        let at = 4 * (y * out.width + x) as usize;
        image::Rgb([out.rgba[at], out.rgba[at + 1], out.rgba[at + 2]])
    })
}
