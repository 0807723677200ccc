//! `volseggs segment masks`

use super::super::camera::surroundings;
use super::super::data::DataArgs;
use super::super::settings::SegmentSettings;
use super::super::time::TimeArg;
use super::super::values::{count, pixels};
use super::super::{CliError, CommonArgs, print_json, stop_flag};
use crate::durations::rough_duration;
use crate::eval::segments::mask_source_names;
use crate::files::LockDuration;
use crate::log::progress;
use crate::run::OpenRun;
use crate::run::cameras::check_lens;
use crate::run::masks::{MadeMasks, MaskPlan, MaskRequest, make, write_pictures};
use crate::segment::masks::registry::{ChooseSourceError, ChosenSource, SourceOption, SourceOptions, SourceViews};
use crate::segment::masks::source::{self, MASK_SOURCES};
use crate::shell;
use clap::Args;
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
    #[arg(long, value_parser = mask_source_names(), default_value = source::DEFAULT)]
    source: String,
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
    common: CommonArgs,
}

impl MasksArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let source = self.source()?;
        let run =
            self.settings.apply_to(self.data.apply_to(self.common.open_to_write(&self.run, LockDuration::Long)?)?)?;
        let path = run.paths().masks();
        if path.exists() && !self.pictures && !self.replace {
            return Err(CliError::input(format!(
                "{}: masks exist already; pass --replace to make them again",
                path.display()
            )));
        }
        let request = MaskRequest {
            segments: &self.segments,
            source: &source,
            views: self.views,
            time: self.time.map(|time| time.to_scene_time("--time", run.calibration())).transpose()?,
        };
        let around = surroundings(&run, self.size);
        if let Some(size) = self.size {
            check_lens(&format!("--size {size}"), around.lens)?;
        }
        let plan = MaskPlan::new(&run, &around, &request)?;
        if let Some(note) = &plan.note {
            errln!("{note}");
        }
        if self.pictures {
            return self.write_pictures(&run, &plan);
        }
        let pictures = plan.pictures();
        if let Some(seconds) = source.kind.seconds(pictures, &source.options) {
            let points = source.options.points.map(|n| format!(" with {n}x{n} points each")).unwrap_or_default();
            errln!(
                "{pictures} pictures{points}: about {} on two cores; fewer --points or --views are faster",
                rough_duration(seconds)
            );
        }
        let stop = stop_flag("stopping; any existing masks are kept")?;
        let bar = progress::bar(pictures, "pictures");
        let made = make(&run, &plan, || {
            bar.inc(1);
            !stop.load(Ordering::Relaxed)
        })?;
        bar.finish_and_clear();
        let Some(MadeMasks { masks: count, source }) = made else {
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

    /// The mask source with its files, after a check of all that can be checked without the run: a missing file is
    /// reported at once.
    fn source(&self) -> Result<ChosenSource, CliError> {
        let name = &self.source;
        let options =
            SourceOptions { path: self.masks.clone(), weights: self.sam_weights.clone(), points: self.points };
        let refuse = |given: bool, option: &str, why: &str| match given {
            true => Err(CliError::input(format!("{option} cannot be combined with --source {name}: {why}"))),
            false => Ok(()),
        };
        match MASK_SOURCES.get(name).map(|kind| kind.views()) {
            Ok(SourceViews::Labelled) => {
                refuse(self.size.is_some(), "--size", "views are as large as the dataset's images")?;
            }
            Ok(SourceViews::HandedOut) => {
                let why = "views, size and time are those of the pictures that --pictures wrote";
                refuse(self.views.is_some(), "--views", why)?;
                refuse(self.size.is_some(), "--size", why)?;
                refuse(self.time.is_some(), "--time", why)?;
            }
            Ok(SourceViews::Around) | Err(_) => {}
        }
        if self.pictures && name != source::DEFAULT {
            return Err(CliError::input("--pictures makes no masks; omit --source, and give it once the masks exist"));
        }
        let flag = |option| match option {
            SourceOption::Path => "--masks",
            SourceOption::Weights => "--sam-weights",
            SourceOption::Points => "--points",
        };
        ChosenSource::new(name, options).map_err(|error| {
            CliError::input(match error {
                ChooseSourceError::Unknown { .. } => format!("--source: {error}"),
                ChooseSourceError::NotRead { option, by } => {
                    format!("{} is for --source {by}, not --source {name}", flag(option))
                }
                ChooseSourceError::Missing { option, what } => {
                    format!("--source {name}: name {what} with {} PATH", flag(option))
                }
                ChooseSourceError::Unusable { option, problem } => format!("{}: {problem}", flag(option)),
            })
        })
    }

    /// Writes the pictures for another program.
    fn write_pictures(&self, run: &OpenRun, plan: &MaskPlan) -> Result<(), CliError> {
        let stop = stop_flag("stopping; nothing is written")?;
        let (count, folder) = (plan.pictures(), run.paths().mask_pictures());
        let bar = progress::bar(count, "pictures");
        let done = write_pictures(run, plan, || {
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
