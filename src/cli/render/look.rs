//! Command-line options for what a render shows.

use super::super::CliError;
use super::super::error::refuse;
use super::super::values::point;
use crate::run::OpenRun;
use crate::run::look::{Look, Show};
use crate::run::numbers::PixelQuantity;
use crate::run::palette::Palette;
use crate::run::selection::Selection;
use crate::track::velocity::Component;
use clap::{Args, ValueEnum};
use glam::DVec3;

/// Options for what to show.
#[derive(Debug, Clone, Args)]
pub(super) struct LookArgs {
    /// What to show; colour if not given. Depth and velocity are scaled by the first frame that shows any.
    #[arg(long, value_enum)]
    show: Option<ShowArg>,
    /// Colour map: viridis, cividis or inferno for depth (viridis if not given) and speed (inferno), cool-warm or
    /// red-green for velocity along an axis (red-green).
    #[arg(long, value_name = "NAME")]
    palette: Option<Palette>,
    /// Velocity along an axis (red forward, green backward; the default is x) or speed.
    #[arg(long, value_enum, value_name = "AXIS")]
    velocity_axis: Option<ComponentArg>,
    /// Light from far away in this direction, world axes, instead of the light at the eye; for scenes trained with
    /// model.appearance = "headlight".
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    pub light: Option<DVec3>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ShowArg {
    /// The rendered colours.
    Colour,
    /// Distance from the camera: yellow near, dark blue far.
    Depth,
    /// Velocity of each Gaussian under the trained deformation, ignoring edits; brighter is faster.
    Velocity,
    /// The colour of each Gaussian's segment; grey and faint outside all segments.
    Segments,
    /// The affinity features of each Gaussian: similar colours are similar parts.
    Affinity,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ComponentArg {
    X,
    Y,
    Z,
    Speed,
}

impl From<ComponentArg> for Component {
    fn from(axis: ComponentArg) -> Self {
        match axis {
            ComponentArg::X => Self::X,
            ComponentArg::Y => Self::Y,
            ComponentArg::Z => Self::Z,
            ComponentArg::Speed => Self::Speed,
        }
    }
}

impl LookArgs {
    /// Draws `selection` as they say.
    pub(super) fn open(&self, run: &OpenRun, selection: Selection) -> Result<Look, CliError> {
        let look = Look::open(run, selection, self.show()?, self.palette)?;
        Ok(match self.light {
            Some(direction) => look.lit_from(run, direction.as_vec3().to_array())?,
            None => look,
        })
    }

    /// The first option that was given.
    pub(super) fn given(&self) -> Option<&'static str> {
        self.show
            .map(|_| "--show")
            .or(self.velocity_axis.map(|_| "--velocity-axis"))
            .or(self.palette.map(|_| "--palette"))
            .or(self.light.map(|_| "--light"))
    }

    /// What is shown, as typed on the command line.
    pub(super) fn name(&self) -> String {
        let name = |v: &dyn std::fmt::Debug| format!("{v:?}").to_lowercase();
        let show = name(&self.show.unwrap_or(ShowArg::Colour));
        match self.velocity_axis {
            Some(axis) => format!("{show} {}", name(&axis)),
            None => show,
        }
    }

    /// The numbers that are shown; `None` if the colours stand for no numbers.
    ///
    /// # Errors
    /// If options do not go together, or are for pictures alone.
    pub(super) fn quantity(&self) -> Result<Option<PixelQuantity>, CliError> {
        self.show()?;
        let of_pictures = [("--palette", self.palette.is_some()), ("--light", self.light.is_some())];
        refuse(&of_pictures, "only for pictures; omit it, or write NAME.png")?;
        Ok(match self.show {
            Some(ShowArg::Depth) => Some(PixelQuantity::Depth),
            Some(ShowArg::Velocity) => Some(PixelQuantity::Velocity(self.velocity_axis.map(Into::into))),
            _ => None,
        })
    }

    /// What is shown.
    ///
    /// # Errors
    /// If options do not go together.
    fn show(&self) -> Result<Show, CliError> {
        let axis_alone = self.velocity_axis.is_some() && self.show != Some(ShowArg::Velocity);
        refuse(&[("--velocity-axis", axis_alone)], "only for --show velocity")?;
        Ok(match self.show.unwrap_or(ShowArg::Colour) {
            ShowArg::Colour => Show::Colour,
            ShowArg::Depth => Show::Depth,
            ShowArg::Velocity => Show::Velocity(self.velocity_axis.unwrap_or(ComponentArg::X).into()),
            ShowArg::Segments => Show::Segments,
            ShowArg::Affinity => Show::Affinity,
        })
    }
}
