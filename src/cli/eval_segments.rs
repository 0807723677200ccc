//! `volseggs eval --segments`

use super::eval::{data_of, folder};
use super::run_folder::RunFolder;
use super::values::{cosine_f32, count, fraction, fraction_f32};
use super::{CliError, print_json};
use crate::data::paths::Axis;
use crate::data::{Camera, Truth};
use crate::eval::segments::{
    KIND, MaskKind, Method, SegmentEvalError, SegmentOptions, evaluate_segments, markdown, write_results,
};
use crate::files::AtomicDir;
use crate::memory::{Budget, product};
use crate::metrics::lpips::Lpips;
use crate::segment::baselines::saga::SagaOptions;
use crate::segment::coarse::CoarseOptions;
use crate::segment::fine::train::FineOptions;
use clap::{Args, ValueEnum};
use std::f64::consts::FRAC_PI_4;
use std::path::Path;
use volseggs_kernels::contrast::Repulsion;

/// How `--segments` is measured.
#[derive(Debug, Args)]
#[command(next_help_heading = "Segments")]
pub(super) struct SegmentFlags {
    /// Measure segmentation and tracking against the dataset's known segments instead: one click on each, by each method.
    #[arg(long)]
    pub segments: bool,
    /// Methods: sagd, saga, coarse, fine, coarse+fine.
    #[arg(long, value_delimiter = ',', default_value = "sagd,saga,coarse,fine,coarse+fine", requires = "segments")]
    methods: Vec<Method>,
    /// Clicks on each segment at most; those after the first on what is still missing in the clicked view.
    #[arg(long, default_value_t = 1, value_parser = count, requires = "segments")]
    clicks: usize,
    /// Source of the masks: regions of rendered views, or the dataset's label images (an upper bound).
    #[arg(long, value_enum, default_value_t = Masks::Regions, requires = "segments")]
    masks: Masks,
    /// Known segments to measure; all if not given.
    #[arg(long = "only", value_name = "NAME,...", value_delimiter = ',', requires = "segments")]
    only: Vec<String>,
    /// Time of the clicks in [0, 1]; the nearest training time is taken, the other times are tracked.
    #[arg(long, default_value_t = 0.5, value_parser = fraction, requires = "segments")]
    time: f64,
    /// Views with masks.
    #[arg(long, default_value_t = 30, value_parser = count, requires = "segments")]
    mask_views: usize,
    /// Take these views near an axis (x, y or z), within 45 degrees, in place of the whole sphere.
    #[arg(long, value_name = "AXIS", requires = "segments")]
    mask_bias: Option<Axis>,
    /// Number of colours; suggested from the data if not given.
    #[arg(long, value_name = "K", value_parser = count, requires = "segments")]
    clusters: Option<usize>,
    /// Steps of the affinity field.
    #[arg(long, default_value_t = 5000, value_parser = count, requires = "segments")]
    fine_steps: usize,
    /// Steps of SAGA.
    #[arg(long, default_value_t = 10_000, value_parser = count, requires = "segments")]
    saga_steps: usize,
    /// Margin of the contrastive loss; -1 is the paper's loss, without one.
    #[arg(long, default_value_t = 0.5, value_parser = cosine_f32, allow_negative_numbers = true, requires = "segments")]
    margin: f32,
    /// Least alpha of a pixel of a mask; that of the dataset's masks if not given.
    #[arg(long, value_name = "ALPHA", value_parser = fraction_f32, requires = "segments")]
    mask_alpha: Option<f32>,
    /// Seed of clusters and fields.
    #[arg(long, default_value_t = 0, requires = "segments")]
    seed: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Masks {
    /// Regions of rendered views.
    Regions,
    /// Label images of the dataset.
    Labels,
}

impl SegmentFlags {
    pub(super) fn run(
        &self,
        run: &RunFolder,
        data: Option<&Path>,
        networks: &[Lpips],
        json: bool,
    ) -> Result<(), CliError> {
        if self.mask_alpha == Some(0.0) {
            return Err(CliError::input("--mask-alpha 0: above 0, up to 1"));
        }
        let views = product(&[self.mask_views, 4 * size_of::<Camera>()]);
        Budget::now().check(format!("--mask-views {}", self.mask_views), views).map_err(CliError::input)?;
        let gaussians = run.scene.gaussians.count();
        if let Some(k) = self.clusters.filter(|k| *k > gaussians) {
            return Err(CliError::input(format!("--clusters {k}: the scene has {gaussians} Gaussians")));
        }
        let root = data.unwrap_or(&run.record.dataset);
        let truth = Truth::read(root)?;
        let known = |name: &String| truth.file.segments.iter().any(|s| s.name == *name);
        if let Some(name) = self.only.iter().find(|n| !known(n)) {
            let names: Vec<&str> = truth.file.segments.iter().map(|s| s.name.as_str()).collect();
            return Err(CliError::input(format!("--only {name}: the dataset knows {}", names.join(", "))));
        }
        let repulsion = if self.margin <= -1.0 { Repulsion::Cosine } else { Repulsion::Margin(self.margin) };
        let (steps, seed) = (self.fine_steps, self.seed);
        let options = SegmentOptions {
            time: self.time,
            methods: Method::ALL.into_iter().filter(|m| self.methods.contains(m)).collect(),
            segments: self.only.clone(),
            clicks: self.clicks,
            masks: if self.masks == Masks::Labels { MaskKind::Labels } else { MaskKind::Regions },
            views: self.mask_views,
            bias: self.mask_bias.map(|axis| (axis, FRAC_PI_4)),
            coarse: CoarseOptions { clusters: self.clusters, seed, ..CoarseOptions::default() },
            fine: FineOptions { steps, repulsion, seed, ..FineOptions::default() },
            saga: SagaOptions { steps: self.saga_steps, seed, ..SagaOptions::default() },
            mask_alpha: self.mask_alpha,
        };
        let (id, _) = data_of(run, data)?;
        let what = if self.masks == Masks::Labels { "segments-labels" } else { "segments" };
        let folder = folder(run, what, &KIND, &id)?;
        // never published: it goes when this ends
        let eval = run.path.join("eval");
        let work = std::fs::create_dir_all(&eval).and_then(|()| AtomicDir::create(&eval.join("masks")));
        let work = work.map_err(|e| CliError::failure(format!("{}: {e}", eval.display())))?;
        let mut evaluation =
            evaluate_segments(&run.scene, &truth, &options, networks, work.dir(), |what| errln!("{what}")).map_err(
                |e| match e {
                    SegmentEvalError::Data(error) => error.into(),
                    SegmentEvalError::Failed(_) => CliError::failure(e),
                },
            )?;
        evaluation.data = id;
        write_results(&folder, &evaluation)?;
        if json {
            return print_json(&evaluation);
        }
        out!("{}", markdown(&evaluation));
        errln!("at time {:.3}; other times and pictures: {}", evaluation.time, folder.display());
        Ok(())
    }
}
