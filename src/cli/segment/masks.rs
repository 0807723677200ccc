//! `volseggs segment masks`

use super::super::camera::surroundings;
use super::super::data::DataArgs;
use super::super::settings::SegmentSettings;
use super::super::time::TimeArg;
use super::super::values::{count, pixels};
use super::super::{CliError, Common, command_line, print_json, stop_flag};
use crate::durations::rough_duration;
use crate::files::Work;
use crate::log::progress;
use crate::run::OpenRun;
use crate::run::cameras::check_lens;
use crate::run::masks::{Made, MaskPlan, MaskRequest, make, write_pictures};
use crate::segment::masks::origin::{MaskKind, SAM_POINTS};
use crate::segment::masks::sam::checkpoint;
use crate::segment::masks::source::sam::SamSource;
use crate::shell;
use burn::tensor::Device;
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use std::sync::atomic::Ordering;

/// Make 2D masks of each segment rendered alone, from views all around it.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs segment masks RUN\n  volseggs segment masks RUN --segment red --views 60 --size 400\n  volseggs segment masks RUN --source labels           # the ground truth, if the dataset has it\n  volseggs segment masks RUN --source sam --points 12  # MobileSAM\n\nMasks of another program, in three steps:\n  1. volseggs segment masks RUN --pictures\n     writes RUN/segments/pictures/SEGMENT/view-000.png and so on\n  2. run the program on them and let it write one of\n     MASKS/SEGMENT/view-000_1.png, view-000_2.png, ...: grey, non-zero in the mask\n     MASKS/SEGMENT/view-000.png: grey, one mask per non-zero value\n     a COCO file with run lengths, whose images are called SEGMENT/view-000.png\n  3. volseggs segment masks RUN --source dir --masks MASKS (or the COCO file)\n\nWrites RUN/segments/masks.jsonl (COCO run lengths) and masks.png to look at."
)]
pub struct MasksArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Segments to make masks of; if not given, all that are not part of another.
    #[arg(long = "segment", value_name = "NAME")]
    segments: Vec<String>,
    /// How masks are found.
    #[arg(long, value_enum, default_value_t = Kind::Regions)]
    source: Kind,
    /// Number of views on a Fibonacci sphere [default: 30]; for labels: number of the dataset's training views at that
    /// time, all if not given, with its test views at that time if there are fewer.
    #[arg(long, value_parser = count)]
    views: Option<usize>,
    /// Width in pixels; the height follows from the aspect ratio of the training images. If not given, these set both.
    #[arg(long, value_parser = pixels)]
    size: Option<u32>,
    /// Time in [0, 1], or a time of the data, such as data:150; the time at which the segments were found if not given.
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    time: Option<TimeArg>,
    /// For dir: the folder of masks, or the COCO file.
    #[arg(long, value_name = "PATH")]
    masks: Option<PathBuf>,
    /// For sam: the weights; looked up in the cache folder if not given.
    #[arg(long, value_name = "FILE")]
    sam_weights: Option<PathBuf>,
    /// For sam: points along each side of the prompt grid [default: 32].
    #[arg(long, value_name = "N", value_parser = count)]
    points: Option<usize>,
    /// Write the pictures for another program to segment, and make no masks.
    #[arg(long, conflicts_with = "replace")]
    pictures: bool,
    /// Replace the existing masks.
    #[arg(long)]
    replace: bool,
    #[command(flatten)]
    settings: SegmentSettings,
    #[command(flatten)]
    data: DataArgs,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// Regions between discontinuities of colour, alpha and depth.
    Regions,
    /// The dataset's label images, at the time nearest to the given one.
    Labels,
    /// Masks made by another program.
    Dir,
    /// MobileSAM.
    Sam,
}

impl MasksArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        self.check()?;
        let kind = self.kind()?;
        let (_, device) = self.common.device()?;
        let run = self.data.of(OpenRun::open_to_write(&self.run, &device, &command_line(), Work::Long)?)?;
        let run = self.settings.of(run)?;
        let path = run.paths().masks();
        if path.exists() && !self.pictures && !self.replace {
            return Err(CliError::input(format!(
                "{}: masks exist already; pass --replace to make them again",
                path.display()
            )));
        }
        let request = MaskRequest {
            segments: &self.segments,
            kind: &kind,
            views: self.views,
            time: self.time.map(|time| time.of("--time", run.calibration())).transpose()?,
        };
        let around = surroundings(&run, self.size)?;
        if let Some(size) = self.size {
            check_lens(&format!("--size {size}"), around.lens)?;
        }
        let plan = MaskPlan::new(&run, &around, &request)?;
        if let Some(note) = &plan.note {
            errln!("{note}");
        }
        if self.pictures {
            return self.write_pictures(&run, &plan, &device);
        }
        if let MaskKind::Sam { points, .. } = kind {
            let pictures = plan.pictures();
            errln!(
                "{pictures} pictures with {points}x{points} points each: about {} on two cores; fewer --points or \
                 --views are faster",
                rough_duration(SamSource::seconds(pictures, points))
            );
        }
        let stop = stop_flag("stopping; any existing masks are kept")?;
        let bar = progress::bar(plan.pictures(), "pictures");
        let made = make(&run, &plan, &device, || {
            bar.inc(1);
            !stop.load(Ordering::Relaxed)
        })?;
        bar.finish_and_clear();
        let Some(Made { masks: count, source }) = made else {
            return Err(CliError::failure("stopped; any existing masks are unchanged"));
        };
        if self.common.json {
            return print_json(
                &serde_json::json!({ "masks": count, "file": path, "time": plan.time, "source": source }),
            );
        }
        let (segments, views) = (plan.groups.len(), plan.shots.len());
        outln!("{count} masks of {segments} segments in {views} views at time {}", plan.time);
        errln!("masks: {}; picture of them: {}", path.display(), run.paths().segment_sheet("masks").display());
        Ok(())
    }

    /// The mask source with its files; resolved first, so that a missing file is reported at once.
    fn kind(&self) -> Result<MaskKind, CliError> {
        Ok(match (self.source, &self.masks) {
            (Kind::Regions, _) => MaskKind::Regions,
            (Kind::Labels, _) => MaskKind::Labels,
            (Kind::Dir, Some(path)) => MaskKind::Dir(path.clone()),
            (Kind::Dir, None) => {
                return Err(CliError::input("--source dir: name the folder or COCO file with --masks PATH"));
            }
            (Kind::Sam, _) => MaskKind::Sam {
                weights: checkpoint::locate(self.sam_weights.as_deref()).map_err(CliError::input)?,
                points: self.points.unwrap_or(SAM_POINTS),
            },
        })
    }

    /// Checks what can be checked without the run.
    fn check(&self) -> Result<(), CliError> {
        let source = self.source;
        let name = source.to_possible_value().map(|v| v.get_name().to_owned()).unwrap_or_default();
        for (given, option, of) in [
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
                Err(CliError::input(format!("{option} cannot be combined with --source {name}: {why}")))
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
            }
            Kind::Regions | Kind::Sam => {}
        }
        if self.pictures && source != Kind::Regions {
            return Err(CliError::input("--pictures makes no masks; omit --source, and give it once the masks exist"));
        }
        Ok(())
    }

    /// Writes the pictures for another program.
    fn write_pictures(&self, run: &OpenRun, plan: &MaskPlan, device: &Device) -> Result<(), CliError> {
        let stop = stop_flag("stopping; nothing is written")?;
        let (count, folder) = (plan.pictures(), run.paths().mask_pictures());
        let bar = progress::bar(count, "pictures");
        let done = write_pictures(run, plan, device, || {
            bar.inc(1);
            !stop.load(Ordering::Relaxed)
        })?;
        bar.finish_and_clear();
        if done.is_none() {
            return Err(CliError::failure("stopped; nothing was written"));
        }
        if self.common.json {
            return print_json(&serde_json::json!({ "pictures": count, "folder": folder, "time": plan.time }));
        }
        outln!("{count} pictures of {} segments at time {}", plan.groups.len(), plan.time);
        errln!(
            "pictures: {}; next: let your program write MASKS/SEGMENT/VIEW_NUMBER.png, then volseggs segment masks {} \
             --source dir --masks MASKS",
            folder.display(),
            shell::path(&run.path)
        );
        Ok(())
    }
}
