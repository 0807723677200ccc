//! Analytic, time-varying scalar fields with known segments, for demos, tests and measuring: no file, the same values
//! everywhere. Each fixed scene has its own file; `families` draw scenes from seeds; shared shapes are in `field` and
//! `strand`. Nothing here reads, writes or renders.

mod beads;
mod families;
mod field;
mod filaments;
mod jets;
mod layers;
mod shells;
mod strand;
mod vortices;

#[cfg(test)]
mod tests;

pub use families::{Family, FamilyScene, Part};

use crate::data::lineage::LineageEvent;
use crate::volume::error::VolumeError;
use crate::volume::grid::{Grid, Volume, VolumeLabels};
use crate::volume::transfer::TransferFunction;
use rayon::prelude::*;
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// A synthetic scene: a scalar field over the box `[-1, 1]^3` (z up) and the time `[0, 1]`, with the segment of
/// every point known.
///
/// ```
/// use volseggs_volume::volume::synthetic::Synthetic;
/// let (value, segment) = Synthetic::Shells.value_and_label([0.0; 3], 0.5);
/// let names = Synthetic::Shells.segment_names();
/// assert!(value > 0.0 && names[usize::from(segment) - 1] == "core");
///
/// let drawn: Synthetic = "blobs:7".parse().unwrap();
/// assert!(drawn.segment_names().contains(&"blob-1".to_owned()));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Synthetic {
    /// Five rising, turbulent plumes that merge near the top.
    Jets,
    /// Moving tubes, which split, join, vanish and appear, inside two translucent shells.
    Vortices,
    /// Nested closed layers around a hidden core and a hidden orbiting seed.
    Shells,
    /// A translucent shell, a body in it and a core in the body, each of a different shape.
    Layers,
    /// Beads of one colour that touch, merge, separate and split.
    Beads,
    /// Thin curved filaments in two colours that turn, sway and bend.
    Filaments,
    /// A scene of a family, drawn from a seed.
    Drawn(FamilyScene),
}

/// The error for a name that is not a synthetic scene.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum SyntheticError {
    /// Neither a scene nor a family.
    #[error("synthetic scene {name:?}: no such scene; use one of {}, or FAMILY:SEED of {}", scenes(), families())]
    Unknown {
        /// The requested name.
        name: String,
    },
    /// A seed that is no whole number.
    #[error("synthetic scene {name:?}: {seed:?} is no seed; write a whole number from 0, such as {family}:7")]
    Seed {
        /// The requested name.
        name: String,
        /// The family in it.
        family: Family,
        /// What stands in the place of the seed.
        seed: String,
    },
    /// A seed for a scene that is always the same.
    #[error("synthetic scene {name:?}: {scene} has no seeds; write {scene}, or a family of {}", families())]
    Fixed {
        /// The requested name.
        name: String,
        /// The scene in it.
        scene: Synthetic,
    },
}

fn scenes() -> String {
    Synthetic::ALL.map(Synthetic::name).join(", ")
}

fn families() -> String {
    Family::all().map(Family::name).collect::<Vec<_>>().join(", ")
}

/// A scene at one time: what depends on time alone is computed once, what depends on height once per slice.
enum SyntheticFrame {
    Jets(jets::JetsFrame),
    Vortices(vortices::VorticesFrame),
    Shells(shells::ShellsFrame),
    Layers(layers::LayersFrame),
    Beads(beads::BeadsFrame),
    Filaments(filaments::FilamentsFrame),
    Drawn(families::FamilyFrame),
}

impl SyntheticFrame {
    fn new(scene: Synthetic, t: f64) -> Self {
        // a NaN time would spread into every voxel: it is treated as the start
        let t = if t.is_nan() { 0.0 } else { t.clamp(0.0, 1.0) };
        match scene {
            Synthetic::Jets => Self::Jets(jets::JetsFrame::new(t)),
            Synthetic::Vortices => Self::Vortices(vortices::VorticesFrame::new(t)),
            Synthetic::Shells => Self::Shells(shells::ShellsFrame::new(t)),
            Synthetic::Layers => Self::Layers(layers::LayersFrame::new(t)),
            Synthetic::Beads => Self::Beads(beads::BeadsFrame::new(t)),
            Synthetic::Filaments => Self::Filaments(filaments::FilamentsFrame::new(t)),
            Synthetic::Drawn(scene) => Self::Drawn(scene.frame(t)),
        }
    }

    /// Calls `put(index, value, label)` for every point of the plane `z`, x fastest.
    fn plane(&self, z: f64, xs: &[f64], ys: &[f64], mut put: impl FnMut(usize, f64, u16)) {
        let edges: Vec<f64> = xs.iter().map(|&x| field::window(x)).collect();
        // `at` returns value and label where the window is `edge`, above 0
        let mut within = |empty: f64, at: &dyn Fn(f64, f64, f64) -> (f64, u16)| {
            for (j, &y) in ys.iter().enumerate() {
                let side = field::window(y) * field::window(z);
                for (i, (&x, edge)) in xs.iter().zip(&edges).enumerate() {
                    let edge = edge * side;
                    // outside the box, and at NaN coordinates, there is nothing
                    let (value, label) = if edge > 0.0 { at(x, y, edge) } else { (empty, 0) };
                    put(j * xs.len() + i, value, label);
                }
            }
        };
        let mut fill = |at: &dyn Fn(f64, f64) -> (f64, u16)| {
            within(0.0, &|x, y, edge| {
                let (value, label) = at(x, y);
                let value = (value * edge).clamp(0.0, 1.0);
                (value, if value >= LABEL_FLOOR { label } else { 0 })
            });
        };
        match self {
            Self::Jets(frame) => {
                let slice = frame.slice(z);
                fill(&|x, y| slice.at(x, y));
            }
            Self::Vortices(frame) => {
                let slice = frame.slice(z);
                fill(&|x, y| slice.at(x, y));
            }
            Self::Shells(frame) => fill(&|x, y| frame.at([x, y, z])),
            Self::Layers(frame) => fill(&|x, y| frame.at([x, y, z])),
            Self::Beads(frame) => {
                let slice = frame.slice(z);
                fill(&|x, y| slice.at(x, y));
            }
            Self::Filaments(frame) => {
                let slice = frame.slice(z);
                fill(&|x, y| slice.at(x, y));
            }
            Self::Drawn(frame) => {
                let slice = frame.slice(z);
                within(frame.empty(), &|x, y, edge| slice.at(x, y, edge));
            }
        }
    }
}

/// Below this value a point belongs to no segment: every transfer function is transparent there.
const LABEL_FLOOR: f64 = 0.03;

impl Synthetic {
    /// Every scene but those of families.
    pub const ALL: [Self; 6] = [Self::Jets, Self::Vortices, Self::Shells, Self::Layers, Self::Beads, Self::Filaments];

    /// Names of the segments; label `k + 1` has name `k`, label 0 is no segment.
    pub fn segment_names(self) -> Vec<String> {
        let names: &[&str] = match self {
            Self::Jets => &jets::NAMES,
            Self::Vortices => &vortices::NAMES,
            Self::Shells => &shells::NAMES,
            Self::Layers => &layers::NAMES,
            Self::Beads => &beads::NAMES,
            Self::Filaments => &filaments::NAMES,
            Self::Drawn(scene) => return scene.names(),
        };
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    /// The segments that merge into others or split off them in a series of these times (in [0, 1], ascending). Fixed
    /// scenes have none: their segments keep their ids where they touch.
    pub fn lineage(self, times: &[f64]) -> Vec<LineageEvent> {
        match self {
            Self::Drawn(scene) => scene.lineage(times),
            _ => Vec::new(),
        }
    }

    /// The field at the point `p` in `[-1, 1]^3` (z up) and the time `t` in `[0, 1]` (clamped): the value in
    /// `[0, 1]`, which is 0 on and outside the faces of the box (0.5 in scenes of families whose values lie on both
    /// sides of an empty middle), and the label of the structure that dominates
    /// there, 0 for none. To fill a grid use [`Self::sample`], which shares the work between points.
    pub fn value_and_label(self, p: [f64; 3], t: f64) -> (f32, u16) {
        let mut answer = (0.0, 0);
        SyntheticFrame::new(self, t).plane(p[2], &[p[0]], &[p[1]], |_, value, label| answer = (value as f32, label));
        answer
    }

    /// The field at the centres of a grid of `dims` voxels (x, y, z) at the time `t`: the longest side spans `[-1, 1]`,
    /// the voxels are cubes of side `2 / longest`, and the grid is centred at the origin; a shorter side shows the
    /// middle of the box. Values and labels are `[z, y, x]`, x fastest, and bit-identical for any number of threads.
    pub fn sample(self, dims: [usize; 3], t: f64) -> (Volume, VolumeLabels) {
        let spacing = 2.0 / dims.into_iter().max().unwrap_or(1).max(1) as f64;
        let origin: [f64; 3] = std::array::from_fn(|a| 0.5 * spacing * (1.0 - dims[a] as f64));
        let grid = Grid::aligned(dims, [spacing; 3], origin);
        let axis = |a: usize| (0..dims[a]).map(|i| origin[a] + spacing * i as f64).collect::<Vec<f64>>();
        let (xs, ys, zs) = (axis(0), axis(1), axis(2));
        let mut values = vec![0.0_f32; grid.len()];
        let mut ids = vec![0_u16; grid.len()];
        let frame = SyntheticFrame::new(self, t);
        // a slice of no voxels has nothing to fill, and chunks may not be empty
        let slice = (dims[0] * dims[1]).max(1);
        values.par_chunks_mut(slice).zip(ids.par_chunks_mut(slice)).zip(&zs).for_each(|((values, ids), &z)| {
            frame.plane(z, &xs, &ys, |at, value, label| {
                values[at] = value as f32;
                ids[at] = label;
            });
        });
        (Volume { grid, values }, VolumeLabels { grid, ids })
    }

    /// A transfer function that shows the scene well: the preset of the scene's name, except for `layers`, which has
    /// `nested`, and for scenes of families, whose seeds draw one.
    ///
    /// # Errors
    /// If the preset is missing or invalid.
    pub fn transfer_function(self) -> Result<TransferFunction, VolumeError> {
        TransferFunction::load(match self {
            Self::Layers => "nested",
            Self::Drawn(scene) => return Ok(scene.transfer_function()),
            scene => scene.name(),
        })
    }

    /// The name by which it is requested, without the seed.
    pub fn name(self) -> &'static str {
        match self {
            Self::Jets => "jets",
            Self::Vortices => "vortices",
            Self::Shells => "shells",
            Self::Layers => "layers",
            Self::Beads => "beads",
            Self::Filaments => "filaments",
            Self::Drawn(scene) => scene.family.name(),
        }
    }
}

impl fmt::Display for Synthetic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Drawn(scene) => f.pad(&format!("{}:{}", scene.family, scene.seed)),
            scene => f.pad(scene.name()),
        }
    }
}

impl FromStr for Synthetic {
    type Err = SyntheticError;

    /// Reads the name of a scene, or `FAMILY:SEED`; a family without a seed is its scene 0.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let name = || text.to_owned();
        let (first, seed) = text.split_once(':').map_or((text, None), |(first, seed)| (first, Some(seed)));
        if let Some(scene) = Self::ALL.into_iter().find(|scene| scene.name() == first) {
            return if seed.is_none() { Ok(scene) } else { Err(SyntheticError::Fixed { name: name(), scene }) };
        }
        let family = Family::all().find(|family| family.name() == first);
        let family = family.ok_or_else(|| SyntheticError::Unknown { name: name() })?;
        let seed = seed.unwrap_or("0");
        // `parse` would accept a sign
        let number = seed.parse().ok().filter(|_| seed.bytes().all(|b| b.is_ascii_digit()));
        let seed = number.ok_or_else(|| SyntheticError::Seed { name: name(), family, seed: seed.to_owned() })?;
        Ok(Self::Drawn(FamilyScene { family, seed }))
    }
}
