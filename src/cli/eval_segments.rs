//! `volseggs eval --segments`

use super::eval::results;
use super::settings::SegmentSettings;
use super::time::TimeArg;
use super::{CliError, print_json, stop_flag};
use crate::data::{Camera, SplitName, Truth};
use crate::eval::segments::{
    KIND, SegmentEvalError, SegmentEvalOptions, SegmentOptionError, SelectionMethod, evaluate_segments, markdown,
    write_mask_pictures, write_results,
};
use crate::files::{AtomicDir, check_file};
use crate::log::progress;
use crate::memory::{MemoryBudget, product};
use crate::metrics::lpips::Lpips;
use crate::run::OpenRun;
use crate::run::measure::MeasuredOn;
use crate::segment::masks::source;
use clap::{Arg, Args, Command};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

/// Options of `--segments`.
#[derive(Debug, Args)]
#[command(next_help_heading = "Segments")]
pub(super) struct SegmentFlags {
    /// Measure segmentation and tracking against the dataset's known segments instead: one click on each, by each
    /// method, with settings fixed in advance and, for comparison, those an oracle would choose out of twelve.
    #[arg(long)]
    pub segments: bool,
    #[command(flatten)]
    options: SegmentEvalOptions,
    /// Time of the clicks, in [0, 1] or a time of the data, such as data:150; the nearest training time is used, and segments are tracked to the other times.
    #[arg(long, value_name = "T", default_value_t = TimeArg::Scene(SegmentEvalOptions::default().time), allow_negative_numbers = true, requires = "segments")]
    time: TimeArg,
    /// Write the pictures for another program to segment into this folder and measure nothing; then pass its masks with
    /// --masks dir and the same options.
    #[arg(long, value_name = "FOLDER", requires = "segments")]
    mask_pictures: Option<PathBuf>,
    #[command(flatten)]
    pub settings: SegmentSettings,
}

impl SegmentFlags {
    pub(super) fn run(
        &self,
        run: &OpenRun,
        data: Option<&Path>,
        out: Option<&Path>,
        networks: &[Lpips],
        json: bool,
    ) -> Result<(), CliError> {
        let views = product(&[self.options.views, 4 * size_of::<Camera>()]);
        MemoryBudget::now().check(format!("--mask-views {}", self.options.views), views).map_err(CliError::input)?;
        let gaussians = run.scene.gaussians.count();
        if let Some(k) = self.options.clusters.filter(|k| *k > gaussians) {
            return Err(CliError::input(format!("--clusters {k}: the scene has only {gaussians} Gaussians")));
        }
        self.check_mask_pictures()?;
        let mut options = self.options.clone();
        options.methods = SelectionMethod::ALL.into_iter().filter(|m| self.options.methods.contains(m)).collect();
        options.time = self.time.to_scene_time("--time", run.calibration())?;
        options.segment = run.config.segment.clone();
        options.check().map_err(option_error)?;
        let root = run.dataset_or(data)?;
        let truth = Truth::read(&root)?;
        let known = |name: &String| truth.file.segments.iter().any(|s| s.name == *name);
        if let Some(name) = options.only.iter().find(|n| !known(n)) {
            let names: Vec<&str> = truth.file.segments.iter().map(|s| s.name.as_str()).collect();
            return Err(CliError::input(format!(
                "--only {name}: no known segment has this name; available: {}",
                names.join(", ")
            )));
        }
        if let Some(folder) = &self.mask_pictures {
            return write_pictures(run, &truth, &options, folder, json);
        }
        let on = MeasuredOn::open(run, data, SplitName::Test)?;
        let what = match options.masks.as_str() {
            source::DEFAULT => "segments".to_owned(),
            other => format!("segments-{other}"),
        };
        let folder = results(run, &on, &what, out, &KIND)?;
        // never committed, so it is removed at the end
        let beside = folder.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let work = std::fs::create_dir_all(beside).and_then(|()| AtomicDir::create(&beside.join("masks")));
        let work = work.map_err(|e| CliError::failure(format!("{}: {e}", beside.display())))?;
        let widening = run.widening();
        let found =
            evaluate_segments(&run.scene, widening, &truth, &options, networks, work.dir(), |what| errln!("{what}"));
        let (mut evaluation, _) = found.map_err(eval_error)?;
        evaluation.data = on.data;
        write_results(&folder, &evaluation)?;
        if json {
            return print_json(&evaluation);
        }
        out!("{}", markdown(&evaluation));
        errln!("other times, pictures and curves: {}", folder.display());
        Ok(())
    }

    /// Checks that pictures for another program are not asked for together with a source of masks.
    fn check_mask_pictures(&self) -> Result<(), CliError> {
        let masks = &self.options.masks;
        if self.mask_pictures.is_none() || masks == source::DEFAULT {
            return Ok(());
        }
        Err(CliError::input(format!(
            "--mask-pictures cannot be combined with --masks {masks}: no masks are made; omit --masks, and give it once \
             the masks exist"
        )))
    }
}

/// Words what is wrong with an option for the command line, where keys are flags.
fn option_error(error: SegmentOptionError) -> CliError {
    let command = SegmentEvalOptions::augment_args(Command::new(""));
    let flag = |key: &str| {
        // the id of an argument is its key, of `views` with a prefix
        let long = command.get_arguments().find(|arg| arg.get_id().as_str().ends_with(key)).and_then(Arg::get_long);
        format!("--{}", long.unwrap_or(key))
    };
    CliError::input(match error {
        SegmentOptionError::Range { key, value, range } => format!("{} {value}: must be {range}", flag(key)),
        SegmentOptionError::NotRead { key, by, .. } => format!("{}: only for --masks {by}", flag(key)),
        SegmentOptionError::Missing { key, what, masks } => {
            format!("--masks {masks}: name {what} with {} PATH", flag(key))
        }
        SegmentOptionError::Unusable { key, problem } => format!("{}: {problem}", flag(key)),
    })
}

fn eval_error(error: SegmentEvalError) -> CliError {
    match error {
        SegmentEvalError::Data(error) => error.into(),
        SegmentEvalError::Masks(_) | SegmentEvalError::Input(_) => CliError::input(error),
        SegmentEvalError::Failed(_) => CliError::failure(error),
    }
}

/// Writes the pictures for another program.
fn write_pictures(
    run: &OpenRun,
    truth: &Truth,
    options: &SegmentEvalOptions,
    folder: &Path,
    json: bool,
) -> Result<(), CliError> {
    if folder.exists() {
        return Err(CliError::input(format!(
            "--mask-pictures {}: already exists; give a new folder",
            folder.display()
        )));
    }
    check_file(folder)?;
    let fail = |e: std::io::Error| CliError::failure(format!("{}: {e}", folder.display()));
    let stop = stop_flag("stopping; nothing is written")?;
    let building = AtomicDir::create(folder).map_err(fail)?;
    let bar = progress::bar(0, "pictures");
    let count = write_mask_pictures(&run.scene, truth, options, building.dir(), || {
        bar.inc(1);
        !stop.load(Ordering::Relaxed)
    })
    .map_err(eval_error)?;
    building.commit().map_err(fail)?;
    bar.finish_and_clear();
    if json {
        return print_json(&serde_json::json!({ "pictures": count, "folder": folder }));
    }
    outln!("{count} pictures");
    errln!(
        "pictures: {}; next: let your program write MASKS/GROUP/VIEW_NUMBER.png, then measure with --masks dir \
            --mask-dir MASKS",
        folder.display()
    );
    Ok(())
}
