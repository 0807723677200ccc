//! What one picture of a run shows: camera, time, look, and what is hidden. A viewer requests pictures by it, and files
//! store it ([`super::saved`]).

use super::look::{Look, Show};
use super::palette::Palette;
use super::selection::Selection;
use super::{OpenRun, RunError};
use crate::data::Camera;
use glam::DVec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Largest side of a picture, pixels.
const MAX_SIDE: u32 = 4096;

/// What a picture shows.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct View {
    /// Position of the camera, scene units.
    pub eye: [f64; 3],
    /// Point it looks at.
    pub target: [f64; 3],
    /// Up direction.
    pub up: [f64; 3],
    /// Full horizontal field of view, radians.
    pub fov: f64,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Time in [0, 1].
    pub time: f64,
    /// What the colours stand for, by the name that [`Show`] parses.
    pub look: String,
    /// Segments shown alone; the whole scene if empty.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub alone: Vec<String>,
    /// Segments that are hidden.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub hidden: Vec<String>,
    /// Whether the edits apply.
    pub edits: bool,
    /// Palette for numbers, by the name that [`Palette`] parses; the one that `render` uses if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub palette: Option<String>,
    /// Values at the ends of the colour scale; those that suit the first picture if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<[f32; 2]>,
}

impl View {
    /// Checks that a picture can be drawn of it.
    ///
    /// # Errors
    /// If not; the error says why.
    pub fn check(&self) -> Result<(), String> {
        check_pose(self.eye, self.target, self.up, self.fov)?;
        if !self.size.iter().all(|n| (1..=MAX_SIDE).contains(n)) {
            return Err(format!("size: sides must be 1 to {MAX_SIDE} pixels"));
        }
        if !(0.0..=1.0).contains(&self.time) {
            return Err("time: must be between 0 and 1".into());
        }
        self.shows()?;
        if self.range.is_some_and(|[low, high]| !low.is_finite() || !high.is_finite() || low > high) {
            return Err("range: must be two finite numbers, the lower one first".into());
        }
        Ok(())
    }

    /// Returns what the colours stand for, and the palette if one is given.
    fn shows(&self) -> Result<(Show, Option<Palette>), String> {
        let show = self.look.parse()?;
        let palette = self.palette.as_deref().map(str::parse).transpose()?;
        Palette::choose(palette, show)?;
        Ok((show, palette))
    }

    /// Returns the camera for the fraction `part` of the full size.
    pub fn camera(&self, part: f64) -> Camera {
        let side = |n: u32| ((f64::from(n) * part).round() as u32).max(1);
        let [eye, target, up] = [self.eye, self.target, self.up].map(DVec3::from_array);
        Camera::look_at(eye, target, up, self.fov, side(self.size[0]), side(self.size[1]))
    }

    /// Creates the look that draws it.
    ///
    /// # Errors
    /// If the look or a segment is unknown, or a file of the run is damaged.
    pub fn open_look(&self, run: &OpenRun) -> Result<Look, RunError> {
        self.look_at(run, Selection::open(run, &self.alone, self.edits)?)
    }

    /// Like [`View::look`], for a view of another run: segments that this run does not have are not shown.
    ///
    /// # Errors
    /// As for [`View::look`], except for names of segments.
    pub fn look_of_another(&self, run: &OpenRun) -> Result<Look, RunError> {
        self.look_at(run, Selection::open_known(run, &self.alone, self.edits)?)
    }

    fn look_at(&self, run: &OpenRun, selection: Selection) -> Result<Look, RunError> {
        let (show, palette) = self.shows().map_err(RunError::input)?;
        let mut away = Vec::new();
        if !self.hidden.is_empty() {
            let all = run.segments()?;
            for name in &self.hidden {
                // a segment that no longer exists hides nothing
                away.extend(all.get(name).map(|s| s.members.clone()).unwrap_or_default());
            }
        }
        let look = Look::open(run, selection.hiding(away), show, palette)?;
        Ok(match self.range {
            Some(range) => look.with_range(range),
            None => look,
        })
    }
}

/// Checks that a camera pose is valid.
///
/// # Errors
/// If not; the error says why.
pub(super) fn check_pose(eye: [f64; 3], target: [f64; 3], up: [f64; 3], fov: f64) -> Result<(), String> {
    let far = |v: &[f64; 3]| v.iter().any(|x| !x.is_finite() || x.abs() > 1e12);
    if far(&eye) || far(&target) || far(&up) {
        return Err("eye, target and up: must be three finite numbers each".into());
    }
    let [eye, target, up] = [eye, target, up].map(DVec3::from_array);
    let along = target - eye;
    if along.length() < 1e-9 || up.length() < 1e-9 || up.cross(along).length() < 1e-9 * up.length() * along.length() {
        return Err(
            "eye and target: must be two distinct points, and up must not be along the line between them".into()
        );
    }
    if !(0.001..3.1).contains(&fov) {
        return Err("fov: must be between 0.001 and 3.1".into());
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn view() -> View {
        View {
            eye: [4.0, 0.0, 0.0],
            target: [0.0; 3],
            up: [0.0, 0.0, 1.0],
            fov: 0.5,
            size: [800, 600],
            time: 0.5,
            look: "colour".into(),
            alone: Vec::new(),
            hidden: Vec::new(),
            edits: true,
            palette: None,
            range: None,
        }
    }

    #[test]
    fn views_that_cannot_be_drawn_are_refused() {
        view().check().unwrap();
        let bad = |change: fn(&mut View)| {
            let mut view = view();
            change(&mut view);
            view.check().unwrap_err()
        };
        bad(|v| v.eye[0] = f64::NAN);
        bad(|v| v.eye = v.target);
        bad(|v| v.up = [1.0, 0.0, 0.0]);
        bad(|v| v.up = [0.0; 3]);
        bad(|v| v.fov = f64::INFINITY);
        bad(|v| v.size = [0, 600]);
        bad(|v| v.size = [800, 1 << 20]);
        bad(|v| v.time = 1.5);
        bad(|v| v.look = "x".into());
        bad(|v| v.palette = Some("viridis".into()));
        bad(|v| v.range = Some([1.0, 0.0]));
        bad(|v| v.range = Some([0.0, f32::NAN]));
    }
}
