//! What a render shows of the Gaussians: their colour, depth, velocity, or the segments they belong to.

use super::super::CliError;
use super::super::run_folder::RunFolder;
use super::super::shown::Selection;
use crate::segment::paint::{by_segment, depth_colours, depth_range, flat, signed, sizes};
use crate::segment::palette::hex;
use crate::segment::pictures::{draw, picture};
use crate::segment::segmentation::Segmentation;
use crate::track::velocity::{Component, robust_size, velocities};
use burn::tensor::Device;
use clap::{Args, ValueEnum};
use serde::Serialize;
use volseggs_kernels::Camera;

/// What to show, as it is typed.
#[derive(Debug, Clone, Args)]
pub(super) struct LookArgs {
    /// What the colours stand for. Depth and velocity are scaled by the first frame that has any.
    #[arg(long, value_enum, default_value_t = Show::Colour)]
    show: Show,
    /// Velocity along an axis (red forward, green backward; the default is x) or speed.
    #[arg(long, value_enum, value_name = "AXIS")]
    velocity_axis: Option<Axis>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Show {
    /// What they look like.
    Colour,
    /// Distance from the camera: yellow near, dark blue far.
    Depth,
    /// How fast the trained deformation moves each Gaussian, edits aside; brighter is faster.
    Velocity,
    /// The colour of the segment each Gaussian belongs to; grey and faint in none.
    Segments,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Axis {
    X,
    Y,
    Z,
    Speed,
}

impl From<Axis> for Component {
    fn from(axis: Axis) -> Self {
        match axis {
            Axis::X => Self::X,
            Axis::Y => Self::Y,
            Axis::Z => Self::Z,
            Axis::Speed => Self::Speed,
        }
    }
}

/// What the colours of a render stand for.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Legend {
    /// In words.
    pub legend: String,
    /// The values at the ends of the scale.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range: Option<[f32; 2]>,
}

/// Draws frames; what sets the scale of the first holds for all.
pub(super) struct Look<'a> {
    run: &'a RunFolder,
    device: &'a Device,
    selection: Selection,
    kind: Kind,
}

enum Kind {
    Colour,
    Depth { range: Option<[f32; 2]> },
    Velocity { component: Component, scale: Option<f32> },
    Segments(Segmentation),
}

impl LookArgs {
    /// What is shown, as it is typed.
    pub(super) fn name(&self) -> String {
        let name = |v: &dyn std::fmt::Debug| format!("{v:?}").to_lowercase();
        match self.velocity_axis {
            Some(axis) => format!("{} {}", name(&self.show), name(&axis)),
            None => name(&self.show),
        }
    }

    /// # Errors
    /// Options that do not go together, or no segments to show.
    pub(super) fn open<'a>(
        &self,
        run: &'a RunFolder,
        device: &'a Device,
        selection: Selection,
    ) -> Result<Look<'a>, CliError> {
        if self.velocity_axis.is_some() && self.show != Show::Velocity {
            return Err(CliError::input("--velocity-axis: goes with --show velocity alone"));
        }
        let kind = match self.show {
            Show::Colour => Kind::Colour,
            Show::Depth => Kind::Depth { range: None },
            Show::Velocity => Kind::Velocity { component: self.velocity_axis.unwrap_or(Axis::X).into(), scale: None },
            Show::Segments => {
                let all = run.segments()?;
                if all.segments.is_empty() {
                    let run = run.path.display();
                    return Err(CliError::input(format!(
                        "--show segments: {run} has none yet; run `volseggs segment coarse {run}`"
                    )));
                }
                Kind::Segments(all)
            }
        };
        Ok(Look { run, device, selection, kind })
    }
}

impl Look<'_> {
    /// One frame `[H, W, 4]`: colour over the scene's background, and alpha.
    pub(super) fn draw(&mut self, camera: Camera, time: f32) -> Result<Vec<f32>, CliError> {
        let (scene, shown, device) = (&self.run.scene, &self.selection, self.device);
        let (background, degree) = (scene.spec.background, scene.spec.sh_degree);
        Ok(match &mut self.kind {
            Kind::Colour if shown.is_plain() => scene.render(camera, time),
            Kind::Colour => draw(&shown.at(scene, time)?, camera, background, degree, device),
            Kind::Depth { range } => {
                let picture = picture(&shown.at(scene, time)?, camera, background, degree, device);
                *range = range.or_else(|| depth_range(&picture));
                depth_colours(&picture, range.unwrap_or_default(), background)
            }
            Kind::Velocity { component, scale } => {
                let all = velocities(|t| crate::model::params::to_vec(scene.at(t).means), time);
                let values = component.of(&all);
                let at = shown.edited(scene, time)?;
                let alone =
                    |v: &[f32]| shown.members().map_or(v.to_vec(), |m| m.iter().map(|&i| v[i as usize]).collect());
                *scale = scale.or_else(|| robust_size(&alone(&values), &alone(&at.opacity())));
                let full = scale.unwrap_or(1.0);
                let painted = match component {
                    Component::Speed => flat(at, sizes(&values, full)),
                    _ => flat(at, signed(&values, full)),
                };
                draw(&shown.cut(painted), camera, background, 0, device)
            }
            Kind::Segments(all) => {
                let painted = by_segment(shown.edited(scene, time)?, all);
                draw(&shown.cut(painted), camera, background, 0, device)
            }
        })
    }

    /// What the colours of the frames drawn so far stand for, where that is not what things look like.
    pub(super) fn legend(&self) -> Option<Legend> {
        const SPEED: &str = "world units per unit of time";
        Some(match &self.kind {
            Kind::Colour => return None,
            Kind::Depth { range: None } => Legend { legend: "depth: nothing shows in any frame".into(), range: None },
            Kind::Depth { range: Some([near, far]) } => Legend {
                legend: format!(
                    "depth in world units: yellow is {} or nearer, dark blue {} or farther",
                    short(*near),
                    short(*far)
                ),
                range: Some([*near, *far]),
            },
            Kind::Velocity { scale: None, .. } => {
                Legend { legend: "velocity: nothing moves in any frame".into(), range: None }
            }
            Kind::Velocity { component: Component::Speed, scale: Some(full) } => Legend {
                legend: format!("speed in {SPEED}: black is 0, light yellow {} or more", short(*full)),
                range: Some([0.0, *full]),
            },
            Kind::Velocity { component, scale: Some(full) } => Legend {
                legend: format!(
                    "velocity along {} in {SPEED}: bright red is {full} or more, black 0, bright green -{full} or less",
                    format!("{component:?}").to_lowercase(),
                    full = short(*full)
                ),
                range: Some([-full, *full]),
            },
            Kind::Segments(all) => {
                let names = all.segments.iter().map(|s| format!("{} {}", s.name, hex(s.colour)));
                Legend { legend: format!("segments: {}", names.collect::<Vec<_>>().join(", ")), range: None }
            }
        })
    }
}

/// A number above 0 with four digits that count.
fn short(v: f32) -> String {
    let decimals = (3.0 - v.log10().floor()).clamp(0.0, 12.0);
    format!("{v:.*}", decimals as usize)
}

#[cfg(test)]
mod tests {
    #[test]
    fn small_numbers_keep_their_digits() {
        assert_eq!(
            [0.000_123_46, 0.5, 4.123_456, 12_345.6].map(super::short),
            ["0.0001235", "0.5000", "4.123", "12346"]
        );
    }
}
