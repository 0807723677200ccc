//! `volseggs eval --segments`

use super::eval::results;
use super::settings::{SegmentSettings, put};
use super::time::TimeArg;
use super::values::{cosine_f32, count, fraction_f32};
use super::{CliError, print_json, stop_flag};
use crate::config::types::SegmentConfig;
use crate::config::types::segment::MaskScale;
use crate::data::paths::Axis;
use crate::data::{Camera, SplitName, Truth};
use crate::eval::segments::{
    KIND, Method, SegmentEvalError, SegmentOptions, Union, evaluate_segments, markdown, write_mask_pictures,
    write_results,
};
use crate::files::{AtomicDir, check_file};
use crate::log::progress;
use crate::memory::{Budget, product};
use crate::metrics::lpips::Lpips;
use crate::run::OpenRun;
use crate::run::measure::MeasuredOn;
use crate::segment::baselines::saga::SagaOptions;
use crate::segment::masks::origin::{MaskKind, SAM_POINTS};
use crate::segment::masks::sam::checkpoint;
use clap::{Args, ValueEnum};
use std::f64::consts::FRAC_PI_4;
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
    /// Methods: sagd, saga, coarse, fine, coarse+fine.
    #[arg(long, value_delimiter = ',', default_value = "sagd,saga,coarse,fine,coarse+fine", requires = "segments")]
    methods: Vec<Method>,
    /// Maximum number of clicks on each segment; those after the first go on what is still missing in the clicked view.
    /// The ground truth places them.
    #[arg(long, default_value_t = SegmentOptions::default().clicks, value_parser = count, requires = "segments")]
    clicks: usize,
    /// Skip the oracle, which halves the time.
    #[arg(long, requires = "segments")]
    no_oracle: bool,
    /// Source of the masks.
    #[arg(long, value_enum, default_value_t = Masks::Regions, requires = "segments")]
    masks: Masks,
    /// For dir: the folder of masks, GROUP/VIEW_NUMBER.png, or the COCO file.
    #[arg(long, value_name = "PATH", requires = "segments")]
    mask_dir: Option<PathBuf>,
    /// Write the pictures for another program to segment into this folder and measure nothing; then pass its masks with
    /// --masks dir and the same options.
    #[arg(long, value_name = "FOLDER", requires = "segments")]
    mask_pictures: Option<PathBuf>,
    /// For sam: the weights; looked up in the cache folder if not given.
    #[arg(long, value_name = "FILE", requires = "segments")]
    sam_weights: Option<PathBuf>,
    /// For sam: points along each side of the prompt grid [default: 32].
    #[arg(long, value_name = "N", value_parser = count, requires = "segments")]
    sam_points: Option<usize>,
    /// Known segments to measure; all if not given.
    #[arg(long = "only", value_name = "NAME,...", value_delimiter = ',', requires = "segments")]
    only: Vec<String>,
    /// Several known segments to click and measure as one, in addition to the others; may be repeated.
    #[arg(long = "score", value_name = "NAME=SEGMENT+SEGMENT", requires = "segments")]
    unions: Vec<Union>,
    /// Time of the clicks, in [0, 1] or a time of the data, such as data:150; the nearest training time is used, and segments are tracked to the other times.
    #[arg(long, value_name = "T", default_value_t = TimeArg::Scene(SegmentOptions::default().time), allow_negative_numbers = true, requires = "segments")]
    time: TimeArg,
    /// Number of views with masks; for labels, at most this many of the dataset's views.
    #[arg(long, default_value_t = SegmentOptions::default().views, value_parser = count, requires = "segments")]
    mask_views: usize,
    /// Restrict these views to within 45 degrees of an axis (x, y or z), instead of the whole sphere.
    #[arg(long, value_name = "AXIS", requires = "segments")]
    mask_bias: Option<Axis>,
    /// Number of colours (`segment.colour.clusters`); estimated from the data by default.
    #[arg(long, value_name = "K", value_parser = count, requires = "segments")]
    clusters: Option<usize>,
    /// Training steps of the affinity field (`segment.affinity.steps`) [default: 5000].
    #[arg(long, value_name = "N", value_parser = count, requires = "segments")]
    fine_steps: Option<usize>,
    /// Pixels per step of the affinity field; the paper uses 8192 (`segment.affinity.pixels`) [default: 2048].
    #[arg(long, value_name = "N", value_parser = count, requires = "segments")]
    fine_pixels: Option<usize>,
    /// Training steps of SAGA.
    #[arg(long, default_value_t = SagaOptions::default().steps, value_parser = count, requires = "segments")]
    saga_steps: usize,
    /// Margin of the contrastive loss; -1 is the paper's loss, which has none (`segment.affinity.margin`) [default: 0.5].
    #[arg(long, value_parser = cosine_f32, allow_negative_numbers = true, requires = "segments")]
    margin: Option<f32>,
    /// Scale at which a training step queries the field: one drawn for all Gaussians, or that of each Gaussian's own
    /// mask, as in the paper (`segment.affinity.mask_scale`) [default: drawn].
    #[arg(long, value_name = "WHICH", value_enum, requires = "segments")]
    mask_scale: Option<MaskScale>,
    /// Minimum alpha of a silhouette's pixels; that of the dataset's masks if not given.
    #[arg(long, value_name = "ALPHA", value_parser = fraction_f32, requires = "segments")]
    mask_alpha: Option<f32>,
    /// Seed of the clusters and fields.
    #[arg(long, default_value_t = 0, requires = "segments")]
    seed: u64,
    #[command(flatten)]
    pub settings: SegmentSettings,
}

/// Bytes per point of the grid of prompts.
const POINT_BYTES: usize = 64;

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Masks {
    /// Regions of rendered views.
    Regions,
    /// Label images of the dataset, as an upper bound.
    Labels,
    /// Masks made by another program.
    Dir,
    /// MobileSAM.
    Sam,
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
        if self.mask_alpha == Some(0.0) {
            return Err(CliError::input("--mask-alpha 0: must be above 0, at most 1"));
        }
        let views = product(&[self.mask_views, 4 * size_of::<Camera>()]);
        Budget::now().check(format!("--mask-views {}", self.mask_views), views).map_err(CliError::input)?;
        if self.masks == Masks::Sam {
            let side = self.sam_points();
            let points = product(&[side, side, POINT_BYTES]);
            Budget::now().check(format!("--sam-points {side}"), points).map_err(CliError::input)?;
        }
        let gaussians = run.scene.gaussians.count();
        if let Some(k) = self.clusters.filter(|k| *k > gaussians) {
            return Err(CliError::input(format!("--clusters {k}: the scene has only {gaussians} Gaussians")));
        }
        self.check_mask_pictures()?;
        let masks = self.kind()?;
        let root = run.dataset_or(data)?;
        let truth = Truth::read(&root)?;
        let known = |name: &String| truth.file.segments.iter().any(|s| s.name == *name);
        if let Some(name) = self.only.iter().find(|n| !known(n)) {
            let names: Vec<&str> = truth.file.segments.iter().map(|s| s.name.as_str()).collect();
            return Err(CliError::input(format!(
                "--only {name}: no known segment has this name; available: {}",
                names.join(", ")
            )));
        }
        let config = self.config(&run.config.segment);
        let options = self.options(masks, self.time.of("--time", run.calibration())?, config);
        if let Some(folder) = &self.mask_pictures {
            return write_pictures(run, &truth, &options, folder, json);
        }
        let on = MeasuredOn::open(run, data, SplitName::Test)?;
        let what = match &options.masks {
            MaskKind::Regions => "segments".to_owned(),
            other => format!("segments-{}", other.name()),
        };
        let folder = results(run, &on, &what, out, &KIND)?;
        // never committed, so it is removed at the end
        let beside = folder.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let work = std::fs::create_dir_all(beside).and_then(|()| AtomicDir::create(&beside.join("masks")));
        let work = work.map_err(|e| CliError::failure(format!("{}: {e}", beside.display())))?;
        let widening = run.widening()?;
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

    /// The run's options of segmentation, with those given here.
    fn config(&self, of: &SegmentConfig) -> SegmentConfig {
        let mut config = of.clone();
        put(&mut config.colour.clusters, self.clusters);
        put(&mut config.affinity.steps, self.fine_steps);
        put(&mut config.affinity.pixels, self.fine_pixels);
        put(&mut config.affinity.margin, self.margin);
        put(&mut config.affinity.mask_scale, self.mask_scale);
        config
    }

    fn options(&self, masks: MaskKind, time: f64, config: SegmentConfig) -> SegmentOptions {
        let seed = self.seed;
        SegmentOptions {
            time,
            methods: Method::ALL.into_iter().filter(|m| self.methods.contains(m)).collect(),
            segments: self.only.clone(),
            unions: self.unions.clone(),
            clicks: self.clicks,
            oracle: !self.no_oracle,
            masks,
            views: self.mask_views,
            bias: self.mask_bias.map(|axis| (axis, FRAC_PI_4)),
            config,
            seed,
            saga: SagaOptions { steps: self.saga_steps, seed, ..SagaOptions::default() },
            mask_alpha: self.mask_alpha,
        }
    }

    /// Checks that pictures for another program are not asked for together with a source of masks.
    fn check_mask_pictures(&self) -> Result<(), CliError> {
        if self.mask_pictures.is_none() || self.masks == Masks::Regions {
            return Ok(());
        }
        let masks = self.masks.to_possible_value().map(|v| v.get_name().to_owned()).unwrap_or_default();
        Err(CliError::input(format!(
            "--mask-pictures cannot be combined with --masks {masks}: no masks are made; omit --masks, and give it once \
             the masks exist"
        )))
    }

    /// The source of the masks, with its files.
    fn kind(&self) -> Result<MaskKind, CliError> {
        for (given, option, of, name) in [
            (self.mask_dir.is_some(), "--mask-dir", Masks::Dir, "dir"),
            (self.sam_weights.is_some(), "--sam-weights", Masks::Sam, "sam"),
            (self.sam_points.is_some(), "--sam-points", Masks::Sam, "sam"),
        ] {
            if given && self.masks != of {
                return Err(CliError::input(format!("{option}: only for --masks {name}")));
            }
        }
        if self.mask_bias.is_some() && self.masks == Masks::Labels {
            return Err(CliError::input("--mask-bias: label images have the dataset's own views; use other masks"));
        }
        Ok(match self.masks {
            Masks::Regions => MaskKind::Regions,
            Masks::Labels => MaskKind::Labels,
            Masks::Dir => MaskKind::Dir(self.mask_dir.clone().ok_or_else(|| {
                CliError::input("--masks dir: name the folder of masks or the COCO file with --mask-dir PATH")
            })?),
            Masks::Sam => MaskKind::Sam {
                weights: checkpoint::locate(self.sam_weights.as_deref()).map_err(CliError::input)?,
                points: self.sam_points(),
            },
        })
    }

    fn sam_points(&self) -> usize {
        self.sam_points.unwrap_or(SAM_POINTS)
    }
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
    options: &SegmentOptions,
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
