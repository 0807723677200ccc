//! What a picture shows of the Gaussians: their colour, depth, velocity, or the segments they belong to.

mod legend;

pub use legend::Legend;

use super::palette::Palette;
use super::selection::Selection;
use super::{OpenRun, RunError, affinity};
use crate::data::Calibration;
use crate::edit::Edit;
use crate::model::params::to_vec;
use crate::model::{HostGaussians, Model, Rendering, Scene};
use crate::segment::paint::{by_segment, depth_range, flat, highlight};
use crate::segment::pictures::picture;
use crate::segment::segmentation::Segmentation;
use crate::shell;
use crate::track::velocity::{Component, robust_size, velocities};
use burn::tensor::{Device, Tensor, TensorData};
use std::str::FromStr;
use volseggs_kernels::PinholeCamera;
use volseggs_kernels::shading::Light;
use volseggs_kernels::splat::{SplatInputs, splat};

/// What the colours of a picture stand for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Show {
    /// The Gaussians' own colours.
    Colour,
    /// Distance from the camera.
    Depth,
    /// Velocity of each Gaussian under the trained deformation, regardless of edits.
    Velocity(Component),
    /// The colour of the segment each Gaussian belongs to; grey and faint if it belongs to none.
    Segments,
    /// Affinity features of each Gaussian: the first three principal components of all features as red, green and blue,
    /// so that similar parts have similar colours.
    Affinity,
}

/// Parses the name used in saved views: `colour`, `depth`, `segments`, `velocity x`, ...
impl FromStr for Show {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Ok(match name {
            "colour" => Self::Colour,
            "depth" => Self::Depth,
            "segments" => Self::Segments,
            "affinity" => Self::Affinity,
            "velocity x" => Self::Velocity(Component::X),
            "velocity y" => Self::Velocity(Component::Y),
            "velocity z" => Self::Velocity(Component::Z),
            "velocity speed" => Self::Velocity(Component::Speed),
            _ => {
                return Err(
                    "look: must be colour, depth, segments, affinity, velocity x, velocity y, velocity z or velocity \
                     speed"
                        .into(),
                );
            }
        })
    }
}

/// Draws frames; the first frame sets the colour scale for all of them.
#[derive(Debug)]
pub struct Look {
    selection: Selection,
    kind: LookKind,
    /// The unedited Gaussians at the time of the last preview, kept because a drag requests the same ones repeatedly.
    still: Option<(f32, HostGaussians)>,
    light: Light,
    calibration: Calibration,
}

#[derive(Debug)]
enum LookKind {
    Colour,
    Depth {
        range: Option<[f32; 2]>,
        palette: Palette,
    },
    Velocity {
        component: Component,
        scale: Option<f32>,
        palette: Palette,
    },
    Segments(Segmentation),
    /// Colours of all Gaussians.
    Affinity(Vec<[f32; 3]>),
}

/// What a [`Look`] shows at one time, ready to be drawn from any camera.
#[derive(Clone, Debug)]
pub struct PreparedLook(LookContent);

#[derive(Clone, Debug)]
enum LookContent {
    /// Drawn in colour; `inputs` is `None` if there are no Gaussians. `shared` says whether the colours are the scene's
    /// own, which take memory only once.
    Colours { inputs: Option<Box<SplatInputs>>, degree: usize, shared: bool },
    /// Drawn by depth, which differs from camera to camera.
    Depth(HostGaussians),
}

impl PreparedLook {
    /// Prepares Gaussians to be drawn in colour.
    pub(crate) fn of(at: &HostGaussians, degree: usize, device: &Device) -> Self {
        // not every backend can hold an empty tensor
        Self(LookContent::Colours {
            inputs: (!at.is_empty()).then(|| Box::new(at.to_splat(device))),
            degree,
            shared: false,
        })
    }

    /// Returns the size of its arrays in bytes, without those it shares with the scene.
    pub fn bytes(&self) -> usize {
        match &self.0 {
            LookContent::Colours { inputs: None, .. } => 0,
            LookContent::Colours { inputs: Some(inputs), shared, .. } => {
                let normals = inputs.shading.as_ref().map_or(0, |shading| shading.normals.dims().iter().product());
                let colours = if *shared { 0 } else { inputs.sh.dims().iter().product::<usize>() + normals };
                4 * (11 * inputs.means.dims()[0] + colours)
            }
            LookContent::Depth(at) => 4 * at.columns().map(|column| column.values.len()).sum::<usize>(),
        }
    }
}

impl Look {
    /// Prepares to draw `show` for the selection, with numbers in the requested palette.
    ///
    /// # Errors
    /// If there are no segments or no affinity field to show, or the palette does not suit the values.
    pub fn open(run: &OpenRun, selection: Selection, show: Show, palette: Option<Palette>) -> Result<Self, RunError> {
        let palette = Palette::choose(palette, show).map_err(RunError::input)?.unwrap_or(Palette::Viridis);
        let kind = match show {
            Show::Colour => LookKind::Colour,
            Show::Depth => LookKind::Depth { range: None, palette },
            Show::Velocity(component) => LookKind::Velocity { component, scale: None, palette },
            Show::Affinity => LookKind::Affinity(affinity::colours(run)?),
            Show::Segments => {
                let all = run.segments()?;
                if all.segments.is_empty() {
                    let (path, word) = (run.path.display(), shell::path(&run.path));
                    return Err(RunError::input(format!(
                        "--show segments: {path} has none yet; run `volseggs segment coarse {word}`"
                    )));
                }
                LookKind::Segments(all)
            }
        };
        Ok(Self { selection, kind, still: None, light: Light::Head, calibration: run.calibration().clone() })
    }

    /// Returns this look lit from far away in `direction` (world axes, of any length but 0) instead of by the
    /// headlight.
    ///
    /// # Errors
    /// If the scene's colours are not made by shading, something other than colours is shown, or the direction is zero
    /// or not finite.
    pub fn lit_from(mut self, run: &OpenRun, direction: [f32; 3]) -> Result<Self, RunError> {
        if run.scene.gaussians.headlight.is_none() {
            return Err(RunError::input(format!(
                "--light: {} was trained with model.appearance = \"sh\", whose colours include the light; train with \
                 model.appearance = \"headlight\" to move it",
                run.path.display()
            )));
        }
        if !matches!(self.kind, LookKind::Colour) {
            return Err(RunError::input("--light: applies to colours only; omit --show"));
        }
        if !(direction.iter().all(|v| v.is_finite()) && direction.iter().any(|v| *v != 0.0)) {
            return Err(RunError::input(
                "--light: 0,0,0 is not a direction; give the direction to the light, such as 0,0,1",
            ));
        }
        self.light = Light::Far(direction);
        Ok(self)
    }

    /// Calls [`Selection::preview`].
    ///
    /// # Errors
    /// As for [`Selection::preview`].
    pub fn preview(&mut self, run: &OpenRun, edits: Vec<Edit>) -> Result<(), RunError> {
        self.selection.preview(run, edits)
    }

    /// Returns the scale that prepared colours depend on, as text, empty if on none; `None` if the first frame has yet to
    /// set it.
    pub fn settled(&self) -> Option<String> {
        match &self.kind {
            LookKind::Velocity { scale, .. } => scale.map(|scale| scale.to_bits().to_string()),
            _ => Some(String::new()),
        }
    }

    /// Returns this look with the values at the ends of its scale, if it has one, fixed instead of set by the first
    /// frame.
    #[must_use]
    pub fn with_range(mut self, [low, high]: [f32; 2]) -> Self {
        match &mut self.kind {
            LookKind::Depth { range, .. } => *range = Some([low, high]),
            LookKind::Velocity { scale, .. } if high > 0.0 => *scale = Some(high),
            LookKind::Velocity { .. } | LookKind::Colour | LookKind::Segments(_) | LookKind::Affinity(_) => {}
        }
        self
    }

    /// Returns the part of the scene that it draws.
    pub fn selection(&self) -> &Selection {
        &self.selection
    }

    /// Prepares what is shown at `time` in [0, 1].
    ///
    /// # Errors
    /// If an edit cannot be applied.
    pub fn prepare(&mut self, scene: &Scene, time: f32) -> Result<PreparedLook, RunError> {
        let Self { selection: shown, still, light, .. } = self;
        let (shown, degree, device) = (&*shown, scene.spec.sh_degree, &scene.device());
        let mut prepared = match &mut self.kind {
            LookKind::Colour if shown.is_plain() => PreparedLook(LookContent::Colours {
                inputs: Some(Box::new(scene.inputs_at(time))),
                degree,
                shared: true,
            }),
            LookKind::Colour => PreparedLook::of(&shown.cut(edited(shown, still, scene, time)?), degree, device),
            LookKind::Depth { .. } => PreparedLook(LookContent::Depth(shown.cut(edited(shown, still, scene, time)?))),
            LookKind::Velocity { component, scale, palette } => {
                let all = velocities(|t| to_vec(scene.deformed(t).means), time);
                let values = component.values(&all);
                let at = edited(shown, still, scene, time)?;
                let alone =
                    |v: &[f32]| shown.members().map_or(v.to_vec(), |m| m.iter().map(|&i| v[i as usize]).collect());
                *scale = scale.or_else(|| robust_size(&alone(&values), &alone(&at.opacity())));
                let full = scale.unwrap_or(1.0);
                let painted = flat(at, palette.colours(&values, full));
                PreparedLook::of(&shown.cut(painted), 0, device)
            }
            LookKind::Affinity(colours) => {
                let painted = flat(edited(shown, still, scene, time)?, colours.iter().copied());
                PreparedLook::of(&shown.cut(painted), 0, device)
            }
            LookKind::Segments(all) => {
                let painted = by_segment(edited(shown, still, scene, time)?, all);
                PreparedLook::of(&shown.cut(painted), 0, device)
            }
        };
        if let LookContent::Colours { inputs: Some(inputs), .. } = &mut prepared.0
            && let Some(shading) = &mut inputs.shading
        {
            shading.light = *light;
        }
        Ok(prepared)
    }

    /// Returns what this look prepared, with all Gaussians but the `members` (indices below N, ascending) made faint.
    /// Only opacities change, so this is cheap.
    pub fn highlight(&self, prepared: &PreparedLook, members: &[u32]) -> PreparedLook {
        let shown = self.selection.members();
        let stays = |i: usize| {
            let gaussian = shown.map_or(i as u32, |shown| shown[i]);
            members.binary_search(&gaussian).is_ok()
        };
        let mut out = prepared.clone();
        match &mut out.0 {
            LookContent::Colours { inputs: None, .. } => {}
            LookContent::Colours { inputs: Some(inputs), .. } => {
                let mut logits = to_vec(inputs.opacity_logits.clone());
                highlight(&mut logits, stays);
                let (dims, device) = (inputs.opacity_logits.dims(), inputs.opacity_logits.device());
                inputs.opacity_logits = Tensor::from_data(TensorData::new(logits, dims), &device);
            }
            LookContent::Depth(at) => highlight(&mut at.opacity_logits, stays),
        }
        out
    }

    /// Draws one frame `[H, W, 4]` with [`Look::prepare`] and [`Look::draw`].
    ///
    /// # Errors
    /// As for [`Look::prepare`].
    pub fn frame(&mut self, scene: &Scene, (camera, time): (PinholeCamera, f32)) -> Result<Vec<f32>, RunError> {
        let prepared = self.prepare(scene, time)?;
        Ok(self.draw(scene, &prepared, camera))
    }

    /// Draws one frame `[H, W, 4]` of what was prepared: colour over the scene's background, and alpha.
    pub fn draw(&mut self, scene: &Scene, prepared: &PreparedLook, camera: PinholeCamera) -> Vec<f32> {
        let background = scene.spec.background;
        match &prepared.0 {
            LookContent::Colours { inputs: None, .. } => {
                let [r, g, b] = background;
                [r, g, b, 0.0].repeat(camera.width * camera.height)
            }
            LookContent::Colours { inputs: Some(inputs), degree, .. } => {
                let rendering = Rendering { sh_degree: *degree, ..scene.spec.rendering() };
                to_vec(splat(*inputs.clone(), rendering.seen_by(camera)).image)
            }
            LookContent::Depth(at) => {
                let picture = picture(at, scene.spec.rendering().seen_by(camera), &scene.device());
                let LookKind::Depth { range, palette } = &mut self.kind else { return picture.rgba };
                *range = range.or_else(|| depth_range(&picture));
                palette.depth(&picture, range.unwrap_or_default(), background)
            }
        }
    }
}

/// Like [`Selection::edited`]; during a preview, the unedited scene is taken from `still` or kept there.
fn edited(
    shown: &Selection,
    still: &mut Option<(f32, HostGaussians)>,
    scene: &Scene,
    time: f32,
) -> Result<HostGaussians, RunError> {
    if !shown.has_preview() {
        *still = None;
        return shown.edited(scene, time);
    }
    let at = match still.take() {
        Some((then, at)) if then == time => at,
        _ => scene.host_at(time),
    };
    let edited = shown.edit(at.clone());
    *still = Some((time, at));
    edited
}
