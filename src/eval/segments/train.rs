//! What the methods need before a click: colours, masks, affinity fields, and the features and votes of the baselines.
//! Each method is timed for everything it needs, including masks. The ground truth is read here only if label images
//! are the masks.

use super::method::SelectionMethod;
use super::options::{SegmentEvalError, SegmentEvalOptions};
use super::setting::{Colouring, MethodSetting};
use super::truth::{LabelledTrainingView, labelled};
use crate::config::types::SegmentConfig;
use crate::config::types::segment::ColourSpace;
use crate::data::Truth;
use crate::data::paths::{Lens, Sphere, biased, training_cameras};
use crate::data::truth::LabelledView;
use crate::model::{HostGaussians, Scene, ToKernel};
use crate::segment::baselines::saga::{self, SagaError, SagaModel};
use crate::segment::baselines::sagd::SagdView;
use crate::segment::coarse::{Coarse, coarse, other_times};
use crate::segment::fine::AffinityField;
use crate::segment::fine::network::PositionBox;
use crate::segment::fine::train::{self as fine, FineError};
use crate::segment::fine::views::{FineView, read_views};
use crate::segment::masks::MaskReader;
use crate::segment::masks::handout::write_pictures;
use crate::segment::masks::make::{MakeError, MaskJob, MaskShot, make_masks};
use crate::segment::masks::registry::{ChosenSource, SourceInput, SourceViews};
use crate::segment::masks::source::{MaskGroup, MaskInput, MaskSource, ScoredMask, SourceError};
use burn::tensor::Device;
use std::collections::HashMap;
use std::path::Path;
use std::time::Instant;

/// A field of features, lifted from masks.
pub struct LiftedField {
    /// The field.
    pub field: AffinityField,
    /// The box of its positions.
    pub frame: PositionBox,
    /// Spreads of the masks, scene units, ascending.
    pub spreads: Vec<f32>,
}

/// What the methods have learnt before the clicks.
pub struct TrainedMethods {
    /// Gaussians by colour: first as `segment coarse` finds them, then at the settings that the oracle tries.
    pub colours: Vec<(Colouring, Coarse)>,
    /// Field trained on masks of each colour alone.
    pub parts: Option<LiftedField>,
    /// Field trained on masks of the whole scene.
    pub whole: Option<LiftedField>,
    /// SAGA's features.
    pub saga: Option<SagaModel>,
    /// SAGD's masks.
    pub votes: Option<Vec<SagdView>>,
    /// Seconds by method.
    pub seconds: HashMap<SelectionMethod, f64>,
}

impl TrainedMethods {
    /// Returns the Gaussians by colour, as `segment coarse` finds them.
    pub fn coarse(&self) -> &Coarse {
        &self.colours[0].1
    }
}

/// What training needs.
pub struct Trainers<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// The ground truth.
    pub truth: &'a Truth,
    /// The Gaussians at the time of the clicks.
    pub at: &'a HostGaussians,
    /// Labelled views of that time.
    pub views: &'a [LabelledTrainingView],
    /// Options of the evaluation.
    pub options: &'a SegmentEvalOptions,
    /// The options of segmentation.
    pub config: &'a SegmentConfig,
    /// The source of masks.
    pub source: &'a ChosenSource,
    /// Device to draw and train on.
    pub device: &'a Device,
}

/// Name of the group for methods with masks of the whole scene.
const SCENE: &str = "scene";

impl Trainers<'_> {
    /// Makes everything that the chosen methods need; masks are kept in files in `work`.
    pub fn train(
        &self,
        time: f64,
        work: &Path,
        say: &mut impl FnMut(&str),
    ) -> Result<TrainedMethods, SegmentEvalError> {
        let mut seconds = HashMap::new();
        say("coarse: colours");
        let started = Instant::now();
        // the tries differ in the number of colours and the space only: what materials need serves all
        let (config, seed) = (self.config, self.options.seed);
        let own = Colouring::fixed(config);
        let materials = Colouring { space: ColourSpace::Material, ..own }.within(config);
        let other_times = other_times(self.scene, self.at, &materials);
        let coloured = |colouring: Colouring| {
            coarse(self.at, Some(&other_times), &colouring.within(config), seed).map_err(|e| e.to_string())
        };
        let found = coloured(own)?;
        let coarse_seconds = started.elapsed().as_secs_f64();
        seconds.insert(SelectionMethod::Coarse, coarse_seconds);
        let mut colours = vec![(own, found)];
        if self.wants(SelectionMethod::Coarse) && self.options.oracle {
            for setting in MethodSetting::tries(SelectionMethod::Coarse, config) {
                let MethodSetting::Coarse(colouring) = setting else { continue };
                if !colours.iter().any(|(known, _)| *known == colouring) {
                    colours.push((colouring, coloured(colouring)?));
                }
            }
        }
        let frame = PositionBox::around(&self.at.visible_means());
        let (parts, scene) = self.groups(&colours[0].1);
        let masker =
            Masker { trainers: self, shots: self.shots()?, time, work, all: [&parts[..], &scene[..]].concat() };
        let mut trained = TrainedMethods { colours, parts: None, whole: None, saga: None, votes: None, seconds };

        if self.wants(SelectionMethod::CoarseFine) {
            let started = Instant::now();
            let masks = masker.make(0..parts.len(), "parts.jsonl", say)?;
            let read = self.fine_views(&masks, &parts, &frame)?;
            trained.parts = Some(self.lift(&read, frame, "coarse+fine", say)?);
            trained.seconds.insert(SelectionMethod::CoarseFine, coarse_seconds + started.elapsed().as_secs_f64());
        }
        if !scene.is_empty() {
            let started = Instant::now();
            let masks = masker.make(parts.len()..parts.len() + 1, "whole.jsonl", say)?;
            let mask_seconds = started.elapsed().as_secs_f64();
            if self.wants(SelectionMethod::Sagd) {
                trained.votes = Some(votes(&masks)?);
                trained.seconds.insert(SelectionMethod::Sagd, started.elapsed().as_secs_f64());
            }
            if !self.wants(SelectionMethod::Fine) && !self.wants(SelectionMethod::Saga) {
                return Ok(trained);
            }
            let started = Instant::now();
            let read = self.fine_views(&masks, &scene, &frame)?;
            let before = mask_seconds + started.elapsed().as_secs_f64();
            if self.wants(SelectionMethod::Fine) {
                let started = Instant::now();
                trained.whole = Some(self.lift(&read, frame, "fine", say)?);
                trained.seconds.insert(SelectionMethod::Fine, before + started.elapsed().as_secs_f64());
            }
            if self.wants(SelectionMethod::Saga) {
                let options = self.options.saga();
                say(&format!("saga: {} steps", options.steps));
                let started = Instant::now();
                let model = saga::train(&read.0, &self.at.means, &options, |_, _| true);
                trained.saga = Some(model.map_err(|e| match e {
                    SagaError::NoMasks => SegmentEvalError::Input(e.to_string()),
                    e => SegmentEvalError::Failed(e.to_string()),
                })?);
                trained.seconds.insert(SelectionMethod::Saga, before + started.elapsed().as_secs_f64());
            }
        }
        Ok(trained)
    }

    fn wants(&self, method: SelectionMethod) -> bool {
        self.options.methods.contains(&method)
    }

    /// Returns the number of views that have masks.
    pub fn mask_views(&self) -> usize {
        if self.has_labels() { self.labelled().count() } else { self.options.views }
    }

    fn has_labels(&self) -> bool {
        self.source.kind.views() == SourceViews::Labelled
    }

    /// Returns the labelled views that serve as masks: all, or as many as requested, evenly spaced.
    fn labelled(&self) -> impl Iterator<Item = &LabelledTrainingView> {
        let (all, count) = (self.views.len(), self.options.views.min(self.views.len()));
        (0..count).map(move |k| &self.views[k * all / count])
    }

    /// Returns the groups to draw alone: each colour, if `coarse+fine` is requested, and the whole scene, if another
    /// method that needs masks is.
    fn groups(&self, coarse: &Coarse) -> (Vec<MaskGroup>, Vec<MaskGroup>) {
        let by_colour = coarse.groups().map(|(name, _, members)| MaskGroup { name, members });
        let parts = if self.wants(SelectionMethod::CoarseFine) { by_colour.collect() } else { Vec::new() };
        let whole =
            [SelectionMethod::Fine, SelectionMethod::Saga, SelectionMethod::Sagd].into_iter().any(|m| self.wants(m));
        let all = || MaskGroup { name: SCENE.into(), members: (0..self.at.len() as u32).collect() };
        (parts, whole.then(all).into_iter().collect())
    }

    /// Returns the views that groups are drawn from.
    fn shots(&self) -> Result<Vec<MaskShot>, String> {
        if self.has_labels() {
            let shot = |v: &LabelledTrainingView| MaskShot { file: v.view.name.clone(), camera: v.view.camera.clone() };
            return Ok(self.labelled().map(shot).collect());
        }
        let camera = &self.views.first().ok_or("no labelled views at this time")?.view.camera;
        let lens = Lens { fov_x: camera.fov_x(), width: camera.width, height: camera.height };
        let (views, sphere) = (self.options.views, Sphere::through(camera, self.scene.spec.centre()));
        let cameras = match self.options.bias {
            Some(axis) => biased(views, sphere, axis, self.options.bias_angle.to_radians(), lens),
            None => training_cameras(views, sphere, lens),
        };
        Ok(MaskShot::numbered(cameras))
    }

    fn job<'b>(&'b self, groups: &'b [MaskGroup], shots: &'b [MaskShot], time: f64) -> MaskJob<'b> {
        let (rendering, config) = (self.scene.spec.rendering(), &self.config.masks);
        MaskJob { at: self.at, groups, shots, time, rendering, config, device: self.device }
    }

    /// Reads the views with masks and the spreads of these.
    fn fine_views(
        &self,
        masks: &MaskReader,
        groups: &[MaskGroup],
        frame: &PositionBox,
    ) -> Result<(Vec<FineView>, Vec<f32>), String> {
        let members: Vec<Vec<u32>> = groups.iter().map(|g| g.members.clone()).collect();
        let seed = self.options.seed;
        let views =
            read_views(masks, (self.at, self.scene.spec.rendering()), frame, &members, seed, self.device, |_| {});
        views.map_err(|e| e.to_string())
    }

    fn lift(
        &self,
        (views, spreads): &(Vec<FineView>, Vec<f32>),
        frame: PositionBox,
        name: &str,
        say: &mut impl FnMut(&str),
    ) -> Result<LiftedField, SegmentEvalError> {
        let (config, seed) = (&self.config.affinity, self.options.seed);
        say(&format!("{name}: {} steps", config.steps));
        let field = fine::train(views, config, seed, self.device, |_, _| true).map_err(|e| match e {
            FineError::NoMasks => SegmentEvalError::Input(e.to_string()),
            e => SegmentEvalError::Failed(e.to_string()),
        })?;
        Ok(LiftedField { field, frame, spreads: spreads.clone() })
    }
}

/// Makes mask files.
struct Masker<'a> {
    trainers: &'a Trainers<'a>,
    shots: Vec<MaskShot>,
    time: f64,
    work: &'a Path,
    /// All groups that may have masks.
    all: Vec<MaskGroup>,
}

impl Masker<'_> {
    /// Makes masks of some of the groups.
    fn make(
        &self,
        which: std::ops::Range<usize>,
        file: &str,
        say: &mut impl FnMut(&str),
    ) -> Result<MaskReader, SegmentEvalError> {
        let (first, groups) = (which.start, &self.all[which]);
        let names = groups.iter().map(|g| g.name.as_str()).collect::<Vec<_>>().join(", ");
        say(&format!("masks of {names} in {} views", self.shots.len()));
        let source = self.trainers.source;
        if let Some(seconds) = source.kind.seconds(self.shots.len() * groups.len(), &source.options) {
            say(&format!("{}: about {:.0} min on two cores", source.name, seconds / 60.0));
        }
        // opened for all groups, so that one mask file may hold those of every method
        let every = self.trainers.job(&self.all, &self.shots, self.time);
        let views: Vec<LabelledView> = self.trainers.labelled().map(|v| v.view.clone()).collect();
        let labelled = self.trainers.has_labels().then_some((self.trainers.truth, &views[..]));
        let input = SourceInput { job: &every, options: &source.options, others: &[], labelled };
        let inner = source.kind.open(&input).map_err(|e| SegmentEvalError::Masks(e.to_string()))?;
        let path = self.work.join(file);
        let job = MaskJob { groups, ..every };
        make_masks(&job, &Shifted { inner, first }, &path, |_, _| true).map_err(|e| match e {
            MakeError::Source(e) if e.is_input() => SegmentEvalError::Masks(e.to_string()),
            e => SegmentEvalError::Failed(e.to_string()),
        })?;
        Ok(MaskReader::open(&path).map_err(|e| e.to_string())?)
    }
}

/// A source opened for more groups than it is queried for: group 0 of the job is its group `first`.
struct Shifted {
    inner: Box<dyn MaskSource>,
    first: usize,
}

impl MaskSource for Shifted {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn find(&self, seen: &MaskInput<'_>) -> Result<Vec<ScoredMask>, SourceError> {
        self.inner.find(&MaskInput { group: self.first + seen.group, ..*seen })
    }

    fn needs_front(&self) -> bool {
        self.inner.needs_front()
    }

    fn batch_size(&self) -> usize {
        self.inner.batch_size()
    }
}

/// Writes the pictures for which another program is to make masks into `folder`:
/// `GROUP/view-000.png` and so on, for the groups of the chosen methods, and a list of them. Returns the number of
/// pictures; `progress` is called after each and says whether to go on.
///
/// # Errors
/// If the ground truth is missing, no method needs masks, or a file cannot be written.
pub fn write_mask_pictures(
    scene: &Scene,
    truth: &Truth,
    options: &SegmentEvalOptions,
    folder: &Path,
    progress: impl FnMut() -> bool,
) -> Result<usize, SegmentEvalError> {
    let views = labelled(truth, options.time)?;
    let time = views.first().map_or(options.time, |v| v.view.time);
    let device = scene.gaussians.means.val().device();
    let at = scene.host_at(time as f32);
    let (source, config) = (options.check()?, options.config());
    let (config, source, device) = (&config, &source, &device);
    let trainers = Trainers { scene, truth, at: &at, views: &views, options, config, source, device };
    let other_times = other_times(scene, &at, config);
    let coarse = coarse(&at, Some(&other_times), config, options.seed).map_err(|e| e.to_string())?;
    let (parts, whole) = trainers.groups(&coarse);
    let groups = [parts, whole].concat();
    if groups.is_empty() {
        let problem = "none of the methods needs masks, so there are no pictures to write";
        return Err(SegmentEvalError::Input(problem.to_owned()));
    }
    let shots = trainers.shots()?;
    let job = trainers.job(&groups, &shots, time);
    write_pictures(&job, &scene.fingerprint(), folder, progress).map_err(|e| e.to_string())?;
    Ok(groups.len() * shots.len())
}

/// Reads the masks of each view, for votes.
fn votes(masks: &MaskReader) -> Result<Vec<SagdView>, String> {
    let header = masks.header();
    let views = header.views.iter().enumerate();
    views
        .map(|(i, view)| {
            let found = masks.view(i).map_err(|e| e.to_string())?;
            let camera = view.camera(header.width, header.height).to_kernel();
            Ok(SagdView { camera, masks: found.into_iter().map(|a| a.mask).collect() })
        })
        .collect()
}
