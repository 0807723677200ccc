//! Which cameras and times a render shows.

use super::super::CliError;
use super::super::camera::surroundings;
use super::RenderArgs;
use crate::data::paths::{Lens, test_spiral};
use crate::data::{Camera, Transforms};
use crate::memory::{Budget, product};
use crate::run::OpenRun;
use crate::run::cameras::{ViewChoice, check_lens};
use std::path::Path;

/// Frames of an orbit if not told otherwise.
const ORBIT: usize = 60;

impl RenderArgs {
    /// The cameras with the times they show; at least one, all of one size.
    pub(super) fn views(&self, run: &OpenRun, choice: Option<&ViewChoice>) -> Result<Vec<(Camera, f64)>, CliError> {
        let mut around = surroundings(run, self.view.size);
        let lens @ Lens { width, height, .. } = around.lens;
        let size = self.view.size.map_or(format!("pictures of {width}x{height}"), |s| format!("--size {s}"));
        check_lens(&size, lens)?;
        if let Some(choice) = choice {
            for (given, flag) in [(self.frames.is_some(), "--frames"), (self.radius.is_some(), "--radius")] {
                if given {
                    return Err(CliError::input(format!("{flag}: does not go with {choice}, which is one view")));
                }
            }
            let (camera, time) = run.view(choice, lens)?;
            return Ok(vec![(camera, self.time.or(time).unwrap_or(0.5))]);
        }
        if let Some(radius) = self.radius {
            run.check_radius(radius)?;
            around.sphere.radius = radius;
        }
        let hold = |views: Vec<(Camera, f64)>| match self.time {
            Some(t) => views.into_iter().map(|(c, _)| (c, t)).collect(),
            None => views,
        };
        if self.frames.is_some() && self.path.to_str() != Some("orbit") {
            return Err(CliError::input("--frames: is the length of an orbit; add --path orbit"));
        }
        match self.path.to_str() {
            Some("test") => Ok(hold(test_spiral(181, 100, around.sphere, lens))),
            Some("orbit") => {
                let n = self.frames.unwrap_or(ORBIT);
                // the cameras twice, as they are listed and as they get their times
                let bytes = product(&[n, 2 * size_of::<(Camera, f64)>()]);
                Budget::now().check(format!("--frames {n}"), bytes).map_err(CliError::input)?;
                let last = (n - 1).max(1) as f64;
                Ok(hold(around.orbit(n).into_iter().enumerate().map(|(i, c)| (c, i as f64 / last)).collect()))
            }
            _ => Ok(hold(from_file(&self.path, lens)?)),
        }
    }
}

/// The cameras and times of a `transforms_*.json`.
fn from_file(path: &Path, lens: Lens) -> Result<Vec<(Camera, f64)>, CliError> {
    if path.extension().is_none_or(|e| !e.eq_ignore_ascii_case("json")) {
        return Err(CliError::input(format!(
            "--path {}: is no path of cameras; say test, orbit, or the name of a transforms_*.json file",
            path.display()
        )));
    }
    let json = Transforms::read(path)?;
    let view = |f: &crate::data::transforms::FrameRecord| {
        (json.intrinsics.camera(lens.width, lens.height, f.camera_to_world), f.time)
    };
    Ok(json.frames.iter().map(view).collect())
}
