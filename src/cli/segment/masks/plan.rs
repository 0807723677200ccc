//! From the arguments of `segment masks` to what is drawn and what is asked for masks.

use super::{Kind, MasksArgs};
use crate::cli::CliError;
use crate::cli::run_folder::RunFolder;
use crate::data::Truth;
use crate::data::dataset::{Dataset, OpenOptions};
use crate::data::paths::training_cameras;
use crate::data::truth::LabelledView;
use crate::durations::rough_duration;
use crate::memory::{Budget, product};
use crate::model::GaussiansAt;
use crate::segment::masks::RegionOptions;
use crate::segment::masks::handout::{FILE, Handout};
use crate::segment::masks::make::{MaskJob, Shot};
use crate::segment::masks::origin::{MaskOrigin, SAM_POINTS};
use crate::segment::masks::sam::checkpoint;
use crate::segment::masks::source::sam::SamSource;
use crate::segment::masks::source::{Group, MaskSource};
use burn::tensor::Device;
use std::path::{Path, PathBuf};

/// Views if not told otherwise.
const VIEWS: usize = 30;

/// Bytes of a view in memory and in the header of the file of masks.
const VIEW: usize = 1000;
/// Bytes of a pixel of a picture that is drawn and asked for masks.
const PIXEL: usize = 100;
/// Pictures at once, and those kept to look at.
const AT_ONCE: usize = 8;
/// Bytes of a point of the grid that the network is asked at.
const POINT: usize = 64;

/// What is drawn.
pub(super) struct Plan {
    pub groups: Vec<Group>,
    pub shots: Vec<Shot>,
    pub time: f64,
    /// The truth, of the same views, where that is the source.
    labels: Option<(Truth, Vec<LabelledView>)>,
}

impl Plan {
    pub fn job<'a>(&'a self, run: &RunFolder, at: &'a GaussiansAt, device: &'a Device) -> MaskJob<'a> {
        let spec = &run.scene.spec;
        MaskJob {
            at,
            groups: &self.groups,
            shots: &self.shots,
            time: self.time,
            background: spec.background,
            sh_degree: spec.sh_degree,
            device,
        }
    }
}

/// Where pictures for other programs lie.
pub(super) fn pictures_folder(run: &RunFolder) -> PathBuf {
    run.path.join("segments/pictures")
}

impl MasksArgs {
    /// The weights file, if one is needed; asked for first, so that a missing one shows at once.
    pub(super) fn weights(&self) -> Result<Option<PathBuf>, CliError> {
        let needed = self.source == Kind::Sam;
        needed.then(|| checkpoint::locate(self.sam_weights.as_deref())).transpose().map_err(CliError::input)
    }

    pub(super) fn plan(&self, run: &RunFolder) -> Result<Plan, CliError> {
        let all = run.segments()?;
        let handout = (self.source == Kind::Dir).then(|| read_handout(run)).transpose()?;
        let names: Vec<String> = match &handout {
            _ if !self.segments.is_empty() => self.segments.clone(),
            Some(list) => list.groups.iter().map(|g| g.name.clone()).collect(),
            None => all.segments.iter().filter(|s| s.parent.is_none()).map(|s| s.name.to_string()).collect(),
        };
        let segments = names.iter().map(|n| all.get(n)).collect::<Result<Vec<_>, _>>().map_err(CliError::input)?;
        let first =
            segments.first().ok_or_else(|| CliError::input("no segments yet: run `volseggs segment coarse`"))?;
        let time = self.time.unwrap_or(first.time);
        let groups: Vec<Group> =
            segments.iter().map(|s| Group { name: s.name.to_string(), members: s.members.clone() }).collect();
        if let Some(list) = handout {
            check_groups(run, &list, &groups)?;
            return Ok(Plan { groups, shots: list.views, time: list.time, labels: None });
        }
        if self.source == Kind::Labels {
            return self.labels_plan(run, groups, time);
        }
        let views = self.views.unwrap_or(VIEWS);
        Budget::now().check(format!("--views {views}"), product(&[views, VIEW])).map_err(CliError::input)?;
        let (lens, sphere) = run.lens(self.size);
        let shots = Shot::numbered(training_cameras(views, sphere, lens));
        Ok(Plan { groups, shots, time, labels: None })
    }

    /// Refuses pictures and grids that memory has no room for.
    pub(super) fn check_memory(&self, plan: &Plan) -> Result<(), CliError> {
        let budget = Budget::now();
        let shown = plan.groups.len().min(super::SHOWN) * 4;
        if let Some(camera) = plan.shots.first().map(|s| &s.camera) {
            let [width, height] = [camera.width, camera.height].map(|n| n as usize);
            let all = product(&[width, height, PIXEL * plan.shots.len().min(AT_ONCE) + 3 * shown]);
            let what = self.size.map_or(format!("pictures of {width}x{height} pixels"), |n| format!("--size {n}"));
            budget.check(what, all).map_err(CliError::input)?;
        }
        let points = self.points.unwrap_or(SAM_POINTS);
        budget.check(format!("--points {points}"), product(&[points, points, POINT])).map_err(CliError::input)
    }

    /// The views of the dataset that have a label image, of the time nearest to `time`.
    fn labels_plan(&self, run: &RunFolder, groups: Vec<Group>, time: f64) -> Result<Plan, CliError> {
        let root = self.data.as_deref().unwrap_or(&run.record.dataset);
        if !root.is_dir() {
            return Err(CliError::input(format!(
                "{}: the dataset is not there any more; point to it with --data",
                root.display()
            )));
        }
        let truth = Truth::read(root)?;
        check_dataset(run, root)?;
        let mut views = truth.views_near(time, self.views.unwrap_or(VIEWS), run.config.data.downscale)?;
        if let Some(count) = self.views.filter(|n| *n < views.len()) {
            views = (0..count).map(|i| views[i * views.len() / count].clone()).collect();
        }
        let found = views.first().map_or(time, |v| v.time);
        if found != time {
            errln!("label images are of time {found}, the nearest to {time} that has any");
        }
        let shots = views.iter().map(|v| Shot { file: v.name.clone(), camera: v.camera.clone() }).collect();
        Ok(Plan { groups, shots, time: found, labels: Some((truth, views)) })
    }

    /// Opens the source for what is drawn.
    pub(super) fn source(
        &self,
        plan: &Plan,
        job: &MaskJob<'_>,
        weights: Option<&Path>,
    ) -> Result<Box<dyn MaskSource>, CliError> {
        self.origin(plan, weights).open(job).map_err(CliError::input)
    }

    fn origin(&self, plan: &Plan, weights: Option<&Path>) -> MaskOrigin {
        if let Some((truth, views)) = &plan.labels {
            return MaskOrigin::Labels(truth.clone(), views.clone());
        }
        if let Some(path) = &self.masks {
            return MaskOrigin::Dir(path.clone());
        }
        let Some(weights) = weights else { return MaskOrigin::Regions(RegionOptions::default()) };
        let points = self.points.unwrap_or(SAM_POINTS);
        let pictures = plan.shots.len() * plan.groups.len();
        errln!(
            "{pictures} pictures with {points}x{points} points each: about {} on two cores; fewer --points or --views \
             are quicker",
            rough_duration(SamSource::seconds(pictures, points))
        );
        MaskOrigin::Sam { weights: weights.to_owned(), points }
    }
}

/// Refuses a dataset that the run was not trained on: masks of one scene on the Gaussians of another look right to
/// everything that comes after.
fn check_dataset(run: &RunFolder, root: &Path) -> Result<(), CliError> {
    let options = OpenOptions { downscale: run.config.data.downscale, splits: &[], max_views: Some(1) };
    if Dataset::open(root, &options)?.fingerprint() == run.record.fingerprint {
        return Ok(());
    }
    Err(CliError::input(format!(
        "{}: its training images or cameras are not those that the run was trained on, so its labels are of another scene; \
         name the dataset of the run with --data",
        root.display()
    )))
}

fn read_handout(run: &RunFolder) -> Result<Handout, CliError> {
    let folder = pictures_folder(run);
    if !folder.join(FILE).exists() {
        return Err(CliError::input(format!(
            "{}: no pictures yet, so there can be no masks of them; run `volseggs segment masks {} --pictures` first, then \
             your program on them",
            folder.display(),
            run.path.display()
        )));
    }
    Handout::read(&folder).map_err(CliError::input)
}

/// Whether the pictures still show these segments.
fn check_groups(run: &RunFolder, list: &Handout, groups: &[Group]) -> Result<(), CliError> {
    let path = pictures_folder(run).join(FILE);
    let again = "remove the folder, write them again with --pictures and make new masks";
    if list.scene != run.scene.fingerprint() {
        let why = "the pictures are of another state of this scene (it was trained on since)";
        return Err(CliError::input(format!("{}: {why}; {again}", path.display())));
    }
    for group in groups {
        match list.groups.iter().find(|g| g.name == group.name) {
            None => {
                let names: Vec<&str> = list.groups.iter().map(|g| g.name.as_str()).collect();
                let names = names.join(", ");
                return Err(CliError::input(format!(
                    "{}: there are no pictures of {}, only of {names}; {again}",
                    path.display(),
                    group.name
                )));
            }
            Some(drawn) if drawn.gaussians != group.members.len() => {
                return Err(CliError::input(format!(
                    "{}: segment {} had {} Gaussians when the pictures were written and has {} now; {again}",
                    path.display(),
                    group.name,
                    drawn.gaussians,
                    group.members.len()
                )));
            }
            Some(_) => {}
        }
    }
    Ok(())
}
