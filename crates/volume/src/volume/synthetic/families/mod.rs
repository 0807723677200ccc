//! Families of scenes: what all scenes of a family have in common is written once, and the rest is drawn from a seed:
//! numbers, sizes, positions, colours, opacities, speeds, noise, light.
//!
//! ```text
//! scattered, contact, thin, inside:  family, seed -> BodyScene        one function per family
//! scene:   bodies (a cell each): shape, path, material, when it is there; cells that merge into or split off others
//! shape:   ball, tube, sheet; hollow ones are walls              motion: drifts, sways, arms, spins, growth
//! look:    materials: bands of the values; the transfer function that shows them; the light
//! frame:   BodyScene at a time -> value and label at a point
//! ```
//!
//! A body's value rises over its soft edge to the band of its material; of several bodies at a point the highest value
//! counts, and the body that has it gives the label. A change of what a seed draws is a change of
//! [`IMAGES`](crate::prepare::IMAGES).

mod contact;
mod draw;
mod frame;
mod inside;
mod look;
mod motion;
mod scattered;
mod scene;
mod shape;
#[cfg(test)]
mod tests;
mod thin;

pub(super) use frame::FamilyFrame;

use crate::data::lineage::LineageEvent;
use crate::volume::transfer::TransferFunction;
use draw::Draw;
use scene::BodyScene;
use std::fmt;

/// A family of scenes; [`FamilyScene`] is one of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Family {
    /// Well separated bodies, several of one colour.
    Blobs,
    /// Balls of one colour in contact, from just touching to overlapping by a quarter.
    Touching,
    /// Curved tubes that pass near one another.
    Tubes,
    /// Layers in layers: shells, bodies, cores.
    Nested,
    /// Bodies that fade in and out while they move.
    Fading,
    /// Pairs of one colour that meet and coalesce, or part again.
    Merging,
    /// Strands of one colour twisted around one another.
    Braids,
    /// Thin concentric shells around a core.
    Onions,
    /// Small bodies that move once to three times their diameter between two of fifteen times.
    Fast,
    /// Cells that divide.
    Splitting,
    /// Thin sheets that wave.
    Sheets,
    /// Translucent plumes with noise in density and hue, and bodies in them.
    Noisy,
}

/// What a family is for. The families were divided once, so that each kind of difficulty is in each part: contact of
/// one colour, thin bodies, bodies in bodies, change over time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Part {
    /// To fit thresholds and weights on.
    Fit,
    /// To choose between variants by.
    Choose,
    /// To report: nothing may be chosen by it.
    Report,
}

/// Name, part and drawing of a family.
type Row = (Family, &'static str, Part, fn(&mut Draw, u64, u64) -> BodyScene);

/// The families, by number: a number is part of what a seed draws.
const FAMILIES: [Row; 12] = [
    (Family::Blobs, "blobs", Part::Fit, scattered::blobs),
    (Family::Touching, "touching", Part::Fit, contact::touching),
    (Family::Tubes, "tubes", Part::Fit, thin::tubes),
    (Family::Nested, "nested", Part::Fit, inside::nested),
    (Family::Merging, "merging", Part::Choose, contact::merging),
    (Family::Braids, "braids", Part::Choose, thin::braids),
    (Family::Onions, "onions", Part::Choose, inside::onions),
    (Family::Fading, "fading", Part::Choose, scattered::fading),
    (Family::Splitting, "splitting", Part::Report, contact::splitting),
    (Family::Sheets, "sheets", Part::Report, thin::sheets),
    (Family::Noisy, "noisy", Part::Report, inside::noisy),
    (Family::Fast, "fast", Part::Report, scattered::fast),
];

impl Family {
    /// Every family.
    pub fn all() -> impl Iterator<Item = Self> {
        FAMILIES.iter().map(|row| row.0)
    }

    fn number(self) -> usize {
        FAMILIES.iter().position(|row| row.0 == self).unwrap_or(0)
    }

    /// The name by which it is requested.
    pub fn name(self) -> &'static str {
        FAMILIES[self.number()].1
    }

    /// What it is for.
    pub fn part(self) -> Part {
        FAMILIES[self.number()].2
    }
}

impl fmt::Display for Family {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// One scene of a family.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FamilyScene {
    /// The family.
    pub family: Family,
    /// Draws all that its scenes differ in.
    pub seed: u64,
}

impl FamilyScene {
    fn scene(self) -> BodyScene {
        let number = self.family.number();
        let family = number as u64;
        (FAMILIES[number].3)(&mut Draw::new(family, self.seed), family, self.seed)
    }

    pub(super) fn frame(self, t: f64) -> FamilyFrame {
        FamilyFrame::new(&self.scene(), t)
    }

    pub(super) fn names(self) -> Vec<String> {
        self.scene().names()
    }

    pub(super) fn transfer_function(self) -> TransferFunction {
        look::transfer_function(&self.scene(), format!("{}-{}", self.family, self.seed))
    }

    /// The ends and beginnings of cells in a series of these times, in [0, 1], ascending.
    pub(super) fn lineage(self, times: &[f64]) -> Vec<LineageEvent> {
        let event = |(segment, joined): (u16, scene::Joined)| {
            let after = times.iter().position(|t| *t >= joined.at)?;
            // what is over before the first step never happens in the series
            let time = times[after];
            let other = Some(joined.with as u16 + 1);
            (after > 0).then_some(LineageEvent { time, segment, change: joined.change, other })
        };
        self.scene().events().into_iter().filter_map(event).collect()
    }
}
