//! Masks of a run's segments: which segments are drawn, from which views, and what finds their masks.

use super::segments::write_picture;
use super::{OpenRun, RunError};
use crate::data::paths::training_cameras;
use crate::data::truth::LabelledView;
use crate::data::{Surroundings, Truth};
use crate::draw::views::view_sheet;
use crate::export::images::to_rgb8;
use crate::files::AtomicDir;
use crate::memory::{MemoryBudget, product};
use crate::model::HostGaussians;
use crate::segment::masks::handout::{self, FILE, PictureList};
use crate::segment::masks::make::{MakeError, MaskJob, MaskShot, make_masks};
use crate::segment::masks::registry::{ChosenSource, SourceInput, SourceViews};
use crate::segment::masks::sheet::overlay;
use crate::segment::masks::source::{MaskGroup, ScoredMask};
use crate::segment::masks::store::MAX_VIEWS;
use crate::segment::pictures::GaussianPicture;
use crate::segment::segmentation::members_key;
use crate::shell;
use burn::tensor::Device;
use image::RgbImage;
use std::collections::BTreeSet;

/// Default number of views.
pub const VIEWS: usize = 30;

/// Maximum number of segments in the picture of masks.
const SHOWN: usize = 20;
/// Bytes per view in memory and in the header of the mask file.
const VIEW_BYTES: usize = 1000;
/// Bytes per pixel of a picture that is drawn and searched for masks.
const PIXEL_BYTES: usize = 100;
/// Maximum number of such pictures in memory at once.
const AT_ONCE: usize = 8;

/// A request for masks.
#[derive(Clone, Copy, Debug)]
pub struct MaskRequest<'a> {
    /// Names of segments; if empty, those of the pictures written for another program if the masks are its, else all
    /// that are not parts of another.
    pub segments: &'a [String],
    /// What finds the masks.
    pub source: &'a ChosenSource,
    /// Number of views on a Fibonacci sphere, [`VIEWS`] if `None`; for labels, the maximum number of the dataset's
    /// views at that time.
    pub views: Option<usize>,
    /// Time in [0, 1]; if `None`, the one at which the segments were found.
    pub time: Option<f64>,
}

/// What to draw.
#[derive(Clone, Debug)]
pub struct MaskPlan {
    /// The segments.
    pub groups: Vec<MaskGroup>,
    /// The views.
    pub shots: Vec<MaskShot>,
    /// Time in [0, 1].
    pub time: f64,
    /// Note for the user.
    pub note: Option<String>,
    /// What finds the masks.
    source: ChosenSource,
    /// Groups that it may know besides these.
    others: Vec<String>,
    /// The ground truth and its views, which are those of `shots`, if the masks are label images.
    labelled: Option<(Truth, Vec<LabelledView>)>,
}

impl MaskPlan {
    /// Determines what to draw, and checks that it fits into memory.
    ///
    /// # Errors
    /// If a name is unknown, there are no segments at all, or pictures, labels or the dataset do not match the run.
    pub fn new(run: &OpenRun, around: &Surroundings, request: &MaskRequest<'_>) -> Result<Self, RunError> {
        let plan = Self::drawn(run, around, request)?;
        let budget = MemoryBudget::now();
        let shown = plan.groups.len().min(SHOWN) * 4;
        if let Some(camera) = plan.shots.first().map(|s| &s.camera) {
            let [width, height] = [camera.width, camera.height].map(|n| n as usize);
            let all = product(&[width, height, PIXEL_BYTES * plan.shots.len().min(AT_ONCE) + 3 * shown]);
            budget.check(format!("pictures of {width}x{height} pixels"), all).map_err(RunError::input)?;
        }
        Ok(plan)
    }

    fn drawn(run: &OpenRun, around: &Surroundings, request: &MaskRequest<'_>) -> Result<Self, RunError> {
        let all = run.segments()?;
        let views = request.source.kind.views();
        let handout = (views == SourceViews::HandedOut).then(|| read_handout(run)).transpose()?;
        let mut names: Vec<String> = match &handout {
            _ if !request.segments.is_empty() => request.segments.to_vec(),
            Some(list) => list.groups.iter().map(|g| g.name.clone()).collect(),
            None => all.wholes().map(|s| s.name.to_string()).collect(),
        };
        // a segment named twice is drawn once
        let mut named = BTreeSet::new();
        names.retain(|name| named.insert(name.clone()));
        let segments = names.iter().map(|n| all.get(n)).collect::<Result<Vec<_>, _>>().map_err(RunError::input)?;
        let first =
            segments.first().ok_or_else(|| RunError::input("no segments yet; run `volseggs segment coarse`"))?;
        let time = request.time.unwrap_or(first.time);
        let groups: Vec<MaskGroup> =
            segments.iter().map(|s| MaskGroup { name: s.name.to_string(), members: s.members.clone() }).collect();
        if let Some(list) = &handout {
            check_groups(run, list, &groups)?;
        }
        let source = request.source.clone();
        let mut plan = Self { groups, shots: Vec::new(), time, note: None, source, others: Vec::new(), labelled: None };
        if let Some(list) = handout {
            plan.time = list.time;
            plan.others = list.groups.into_iter().map(|g| g.name).filter(|name| !names.contains(name)).collect();
            plan.shots = list.views;
        } else if views == SourceViews::Labelled {
            let (truth, views) = labels(run, request, time)?;
            plan.time = views.first().map_or(time, |v| v.time);
            if plan.time != time {
                plan.note = Some(format!("label images are of time {}, the nearest to {time} that has any", plan.time));
            }
            let shot = |v: &LabelledView| MaskShot { file: v.name.clone(), camera: v.camera.clone() };
            plan.shots = views.iter().map(shot).collect();
            plan.labelled = Some((truth, views));
        } else {
            let views = request.views.unwrap_or(VIEWS);
            if views > MAX_VIEWS {
                return Err(RunError::input(format!("--views {views}: a mask file holds at most {MAX_VIEWS} views")));
            }
            MemoryBudget::now()
                .check(format!("--views {views}"), product(&[views, VIEW_BYTES]))
                .map_err(RunError::input)?;
            plan.shots = MaskShot::numbered(training_cameras(views, around.sphere, around.lens));
        }
        Ok(plan)
    }

    /// Returns the number of pictures to draw.
    pub fn pictures(&self) -> usize {
        self.shots.len() * self.groups.len()
    }

    fn job<'a>(&'a self, run: &'a OpenRun, at: &'a HostGaussians, device: &'a Device) -> MaskJob<'a> {
        MaskJob {
            at,
            groups: &self.groups,
            shots: &self.shots,
            time: self.time,
            rendering: run.scene.spec.rendering(),
            config: &run.config.segment.masks,
            device,
        }
    }
}

/// Outcome of making masks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MadeMasks {
    /// Number of masks.
    pub masks: u64,
    /// Name of the source that found them.
    pub source: String,
}

/// Finds the masks and writes them, with a picture of some, into the run. Returns `None` if `goes_on`, called after
/// each picture, stopped it; earlier masks are then unchanged.
///
/// # Errors
/// If the source cannot be opened or fails, or a file cannot be written.
pub fn make(run: &OpenRun, plan: &MaskPlan, mut goes_on: impl FnMut() -> bool) -> Result<Option<MadeMasks>, RunError> {
    let device = &run.device();
    let at = run.scene.host_at(plan.time as f32);
    let job = plan.job(run, &at, device);
    let labelled = plan.labelled.as_ref().map(|(truth, views)| (truth, &views[..]));
    let input = SourceInput { job: &job, options: &plan.source.options, others: &plan.others, labelled };
    let source = plan.source.kind.open(&input).map_err(RunError::input)?;
    let every = plan.shots.len().div_ceil(4);
    let mut shown = Vec::new();
    let made = make_masks(&job, source.as_ref(), &run.paths().masks(), |seen, found| {
        if seen.view % every == 0 && seen.group < SHOWN {
            let label = format!("{} {}", plan.groups[seen.group].name, seen.view);
            shown.push((label, outlined(seen.picture, found)));
        }
        goes_on()
    });
    let masks = match made {
        Ok(masks) => masks,
        Err(MakeError::Stopped) => return Ok(None),
        Err(error) => return Err(make_error(error)),
    };
    write_picture(&run.paths().segment_sheet("masks"), &view_sheet(&shown, 4, 400))?;
    Ok(Some(MadeMasks { masks, source: source.name().to_owned() }))
}

/// Writes the pictures for another program into the run. Returns `None` if `goes_on`, called after each picture,
/// stopped it; nothing is then written.
///
/// # Errors
/// If there are pictures already, or they cannot be written.
pub fn write_pictures(run: &OpenRun, plan: &MaskPlan, goes_on: impl FnMut() -> bool) -> Result<Option<()>, RunError> {
    let device = &run.device();
    let folder = run.paths().mask_pictures();
    if folder.exists() {
        return Err(RunError::input(format!(
            "{}: the pictures already exist; remove the folder to write them again",
            folder.display()
        )));
    }
    let at = run.scene.host_at(plan.time as f32);
    let fail = |e: std::io::Error| RunError::failure(format!("{}: {e}", folder.display()));
    let building = AtomicDir::create(&folder).map_err(fail)?;
    match handout::write_pictures(&plan.job(run, &at, device), &run.scene.fingerprint(), building.dir(), goes_on) {
        Ok(()) => {}
        Err(MakeError::Stopped) => return Ok(None),
        Err(error) => return Err(RunError::failure(error)),
    }
    building.commit().map_err(fail)?;
    Ok(Some(()))
}

/// Returns the dataset's known segments, and its views with a label image at the time nearest to `time`.
fn labels(run: &OpenRun, request: &MaskRequest<'_>, time: f64) -> Result<(Truth, Vec<LabelledView>), RunError> {
    let root = run.dataset()?;
    let truth = Truth::read(&root)?;
    run.check_dataset(&root)?;
    let mut views = truth.views_near(time, request.views.unwrap_or(VIEWS), run.config.data.downscale)?;
    if let Some(count) = request.views.filter(|n| *n < views.len()) {
        views = (0..count).map(|i| views[i * views.len() / count].clone()).collect();
    }
    Ok((truth, views))
}

fn read_handout(run: &OpenRun) -> Result<PictureList, RunError> {
    let folder = run.paths().mask_pictures();
    if !folder.join(FILE).exists() {
        return Err(RunError::input(format!(
            "{}: no pictures yet, so there can be no masks of them; run `volseggs segment masks {} --pictures` first, then \
             your program on them",
            folder.display(),
            shell::path(&run.path)
        )));
    }
    PictureList::read(&folder).map_err(RunError::input)
}

/// Checks that the pictures still show these segments.
fn check_groups(run: &OpenRun, list: &PictureList, groups: &[MaskGroup]) -> Result<(), RunError> {
    let bad = |why: String| {
        let again = "remove the folder, write them again with --pictures and make new masks";
        let path = run.paths().mask_pictures().join(FILE);
        Err(RunError::input(format!("{}: {why}; {again}", path.display())))
    };
    if list.scene != run.scene.fingerprint() {
        return bad("the pictures are of another state of this scene (it was trained further since)".to_owned());
    }
    for MaskGroup { name, members } in groups {
        let Some(drawn) = list.groups.iter().find(|g| g.name == *name) else {
            let names: Vec<&str> = list.groups.iter().map(|g| g.name.as_str()).collect();
            return bad(format!("there are no pictures of {name}, only of {}", names.join(", ")));
        };
        let (before, now) = (drawn.gaussians, members.len());
        if before != now {
            return bad(format!(
                "segment {name} had {before} Gaussians when the pictures were written and has {now} now"
            ));
        }
        if drawn.members != members_key(members) {
            return bad(format!("segment {name} has other Gaussians now than when the pictures were written"));
        }
    }
    Ok(())
}

fn make_error(error: MakeError) -> RunError {
    match error {
        MakeError::Camera { .. } | MakeError::NoViews | MakeError::Member { .. } => RunError::input(error),
        MakeError::Source(e) if e.is_input() => RunError::input(e),
        _ => RunError::failure(error),
    }
}

fn outlined(picture: &GaussianPicture, found: &[ScoredMask]) -> RgbImage {
    let masks: Vec<_> = found.iter().map(|f| f.mask.clone()).collect();
    overlay(to_rgb8(&picture.rgba, picture.width, picture.height), &masks)
}
