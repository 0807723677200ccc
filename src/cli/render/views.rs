//! The cameras and times of a render.

use super::super::CliError;
use super::super::camera::surroundings;
use super::super::error::refuse;
use super::RenderArgs;
use crate::data::paths::{Lens, test_spiral};
use crate::data::{Camera, Normalisation, Transforms};
use crate::files::read_text;
use crate::memory::{MemoryBudget, product};
use crate::run::cameras::{ViewChoice, check_lens};
use crate::run::keyframes::{CameraPath, SavedPath};
use crate::run::saved::SavedView;
use crate::run::view::View;
use crate::run::{OpenRun, TrainedModel};
use std::fmt::Display;
use std::path::Path;

/// Default number of frames of an orbit.
const ORBIT: usize = 60;

impl RenderArgs {
    /// The contents of a saved view or path of keyframes, if one was given, with its name.
    pub(super) fn saved(&self) -> Result<Option<ViewFromFile>, CliError> {
        if let Some(choice) = self.view.choice()? {
            return Ok(match choice {
                ViewChoice::Saved { name, saved } => {
                    Some(ViewFromFile { name: format!("--view {name}"), view: saved, path: None })
                }
                _ => None,
            });
        }
        if self.path.extension().is_none_or(|e| !e.eq_ignore_ascii_case("json")) {
            return Ok(None);
        }
        let file = self.path.display();
        let text = read_text(&self.path).map_err(|e| CliError::input(format!("{file}: {e}")))?;
        if !SavedPath::is_in(&text) {
            return Ok(None);
        }
        let (view, path) = SavedPath::parse(&file, &text)?;
        let view = Box::new(match self.view.size {
            Some(width) => view.sized(width)?,
            None => view,
        });
        Ok(Some(ViewFromFile { name: format!("--path {file}"), view, path: Some(path) }))
    }

    /// The cameras and their times; at least one, all of the same size.
    pub(super) fn views<S: TrainedModel>(
        &self,
        run: &OpenRun<S>,
        saved: Option<&ViewFromFile>,
    ) -> Result<Vec<(Camera, f64)>, CliError> {
        let held = self.time.map(|time| time.to_scene_time("--time", run.calibration())).transpose()?;
        let radius = ("--radius", self.radius.is_some());
        let no_radius = |path: &dyn Display| {
            refuse(&[radius], format!("cannot be combined with {path}, which defines the cameras"))
        };
        if let Some(ViewFromFile { name, view, path: Some(path) }) = saved {
            no_radius(name)?;
            return self.along(name, &view.view, path, held);
        }
        let mut around = surroundings(run, self.view.size);
        let lens @ Lens { width, height, .. } = around.lens;
        let size = self.view.size.map_or(format!("pictures of {width}x{height}"), |s| format!("--size {s}"));
        check_lens(&size, lens)?;
        if let Some(choice) = self.view.choice()? {
            let why = format!("cannot be combined with {choice}, which is a single view");
            refuse(&[("--frames", self.frames.is_some()), radius], why)?;
            let (camera, time) = run.view(&choice, lens)?;
            return Ok(vec![(camera, held.or(time).unwrap_or(0.5))]);
        }
        if let Some(radius) = self.radius {
            around.sphere.radius = run.radius(radius)?;
        }
        let hold = |views: Vec<(Camera, f64)>| match held {
            Some(t) => views.into_iter().map(|(c, _)| (c, t)).collect(),
            None => views,
        };
        let fixed = self.frames.is_some() && self.path.to_str() != Some("orbit");
        refuse(&[("--frames", fixed)], "only for an orbit or a path of keyframes; add --path orbit")?;
        match self.path.to_str() {
            Some("test") => Ok(hold(test_spiral(181, 100, around.sphere, lens))),
            Some("orbit") => {
                let n = self.frames.unwrap_or(ORBIT);
                // the cameras exist twice, in the list and with their times
                let bytes = product(&[n, 2 * size_of::<(Camera, f64)>()]);
                MemoryBudget::now().check(format!("--frames {n}"), bytes).map_err(CliError::input)?;
                let last = (n - 1).max(1) as f64;
                Ok(hold(around.orbit(n).into_iter().enumerate().map(|(i, c)| (c, i as f64 / last)).collect()))
            }
            _ => {
                no_radius(&format_args!("--path {}", self.path.display()))?;
                Ok(hold(from_file(&self.path, lens, &run.record.normalisation)?))
            }
        }
    }

    /// The views along a path of keyframes: as many frames as its duration gives, unless a number is given; all at the
    /// time `held`, if there is one.
    fn along(
        &self,
        name: &str,
        shown: &View,
        path: &CameraPath,
        held: Option<f64>,
    ) -> Result<Vec<(Camera, f64)>, CliError> {
        let [width, height] = shown.size;
        check_lens(name, Lens { fov_x: shown.fov, width, height })?;
        let n = self.frames.unwrap_or((path.seconds() * f64::from(self.fps)).round() as usize + 1);
        let bytes = product(&[n, size_of::<(Camera, f64)>()]);
        MemoryBudget::now().check(format!("--frames {n}"), bytes).map_err(CliError::input)?;
        Ok(path.frames(n).map(|key| (key.view(shown).camera(1.0), held.unwrap_or(key.time))).collect())
    }
}

/// What to show, as stored in a file.
pub(super) struct ViewFromFile {
    /// The argument that named it.
    pub name: String,
    /// What is shown.
    pub view: Box<SavedView>,
    /// The path to follow, if any.
    pub path: Option<CameraPath>,
}

/// The cameras and times of a `transforms_*.json`.
fn from_file(path: &Path, lens: Lens, normalisation: &Normalisation) -> Result<Vec<(Camera, f64)>, CliError> {
    if path.extension().is_none_or(|e| !e.eq_ignore_ascii_case("json")) {
        return Err(CliError::input(format!(
            "--path {}: not a camera path; give test, orbit, or the name of a transforms_*.json file",
            path.display()
        )));
    }
    let json = Transforms::read(path)?.normalised(normalisation);
    let view = |f: &crate::data::transforms::FrameRecord| {
        (json.intrinsics.camera(lens.width, lens.height, f.camera_to_world), f.time)
    };
    Ok(json.frames.iter().map(view).collect())
}
