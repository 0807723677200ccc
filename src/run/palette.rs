//! Colours for numbers: maps for magnitudes, which run from dark to light, and for signed values.

use super::look::Show;
use crate::segment::paint::{depth_colours, diverging, signed, sizes};
use crate::segment::pictures::GaussianPicture;
use crate::track::velocity::Component;
use crate::volume::transfer::colormap::{colour_at, named};
use std::str::FromStr;

/// Number of colours of a scale in a legend.
const STEPS: usize = 33;

/// A colour map. All but [`Palette::RedGreen`] can be read with any kind of colour blindness.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Palette {
    /// Dark blue through green to yellow, for magnitudes.
    Viridis,
    /// Dark blue through grey to yellow, made for colour blindness, for magnitudes.
    Cividis,
    /// Black through red to light yellow, for magnitudes.
    Inferno,
    /// Blue through light grey to red, for signed values.
    CoolWarm,
    /// Green through black to red, as in the paper, for signed values.
    RedGreen,
}

impl Palette {
    /// All palettes.
    pub const ALL: [Self; 5] = [Self::Viridis, Self::Cividis, Self::Inferno, Self::CoolWarm, Self::RedGreen];

    /// Returns the name that it is parsed from.
    pub fn name(self) -> &'static str {
        match self {
            Self::Viridis => "viridis",
            Self::Cividis => "cividis",
            Self::Inferno => "inferno",
            Self::CoolWarm => "cool-warm",
            Self::RedGreen => "red-green",
        }
    }

    /// Returns the colours at its low and its high end, in words.
    pub fn ends(self) -> [&'static str; 2] {
        match self {
            Self::Viridis | Self::Cividis => ["dark blue", "yellow"],
            Self::Inferno => ["black", "light yellow"],
            Self::CoolWarm => ["blue", "red"],
            Self::RedGreen => ["bright green", "bright red"],
        }
    }

    /// Returns the colour of 0 in a map for signed values, in words.
    pub fn middle(self) -> &'static str {
        if self == Self::RedGreen { "black" } else { "light grey" }
    }

    /// Returns the default palette for `show`; `None` if its colours stand for no numbers.
    pub fn for_show(show: Show) -> Option<Self> {
        match show {
            Show::Depth => Some(Self::Viridis),
            Show::Velocity(Component::Speed) => Some(Self::Inferno),
            Show::Velocity(_) => Some(Self::RedGreen),
            Show::Colour | Show::Segments | Show::Affinity => None,
        }
    }

    /// Returns whether it is for signed values.
    fn is_signed(self) -> bool {
        matches!(self, Self::CoolWarm | Self::RedGreen)
    }

    /// Returns the requested palette, or the default for `show`.
    ///
    /// # Errors
    /// If the requested palette is for other values than those of `show`.
    pub fn choose(asked: Option<Self>, show: Show) -> Result<Option<Self>, String> {
        let usual = Self::for_show(show);
        match (asked, usual) {
            (None, _) => Ok(usual),
            (Some(asked), Some(usual)) if asked.is_signed() == usual.is_signed() => Ok(Some(asked)),
            (Some(asked), Some(usual)) => {
                let fits = Self::ALL.into_iter().filter(|p| p.is_signed() == usual.is_signed());
                let fits = fits.map(Self::name).collect::<Vec<_>>().join(", ");
                Err(format!("palette {}: does not suit these values; use {fits}", asked.name()))
            }
            (Some(asked), None) => Err(format!("palette {}: applies only to depth and velocity", asked.name())),
        }
    }

    /// Maps values `[N]` to colours; the ends of the scale are at `full` and, for signed values, at `-full`.
    pub fn colours(self, values: &[f32], full: f32) -> Vec<[f32; 3]> {
        match self {
            Self::RedGreen => signed(values, full).collect(),
            Self::CoolWarm => diverging(values, full, self.name()).collect(),
            _ => sizes(values, full, self.name()).collect(),
        }
    }

    /// Maps the depth of a picture to colours `[H, W, 4]`, near ones light.
    pub fn depth(self, picture: &GaussianPicture, range: [f32; 2], background: [f32; 3]) -> Vec<f32> {
        depth_colours(picture, range, background, self.name())
    }

    /// Returns the colours of the scale at even steps from its low to its high end, 8 bits each; `far` if high values
    /// are dark.
    pub fn scale(self, far: bool) -> Vec<[u8; 3]> {
        let map = named(self.name()).unwrap_or_default();
        let colour = |k: usize| {
            let way = k as f32 / (STEPS - 1) as f32;
            match self {
                Self::RedGreen => self.colours(&[2.0 * way - 1.0], 1.0)[0],
                _ => colour_at(&map, (if far { 1.0 - way } else { way }).into()),
            }
        };
        (0..STEPS).map(|k| colour(k).map(|v| (255.0 * v).round() as u8)).collect()
    }
}

impl FromStr for Palette {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|p| p.name() == name);
        found.ok_or_else(|| format!("palette: must be one of {}", Self::ALL.map(Self::name).join(", ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn palettes_go_with_values_of_their_kind() {
        for palette in Palette::ALL {
            assert_eq!(palette.name().parse(), Ok(palette));
            assert_eq!(palette.scale(false).len(), STEPS);
            let for_depth = Palette::choose(Some(palette), Show::Depth);
            let for_x = Palette::choose(Some(palette), Show::Velocity(Component::X));
            assert!(for_depth.is_ok() != for_x.is_ok());
            assert!(Palette::choose(Some(palette), Show::Colour).is_err());
        }
        assert!("jet".parse::<Palette>().is_err());
        assert_eq!(Palette::choose(None, Show::Velocity(Component::Z)), Ok(Some(Palette::RedGreen)));
        assert_eq!(Palette::choose(None, Show::Segments), Ok(None));
    }

    #[test]
    fn scales_have_the_colours_of_the_pictures() {
        for palette in Palette::ALL {
            let scale = palette.scale(false);
            let ends = if palette.is_signed() { [-2.0, 2.0] } else { [0.0, 2.0] };
            let colours = palette.colours(&ends, 2.0);
            for (end, colour) in [scale[0], scale[STEPS - 1]].into_iter().zip(colours) {
                assert_eq!(end, colour.map(|v| (255.0 * v).round() as u8), "{palette:?}");
            }
        }
        assert_eq!(Palette::RedGreen.scale(false)[STEPS / 2], [0, 0, 0]);
        let (near, far) = (Palette::Viridis.scale(true), Palette::Viridis.scale(false));
        assert_eq!(near[0], far[STEPS - 1]);
    }
}
