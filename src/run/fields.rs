//! Fields of a run on the voxels of its volume: density, velocity and colour of its Gaussians, for programs that show
//! volumes. How they are scattered is in `segment::place`; the files are written by `export::fields`.

use super::labels::{LabelGrid, grid};
use super::selection::Selection;
use super::{OpenRun, RunError};
use crate::data::Calibration;
use crate::data::calibration::NORMALISED;
use crate::export::fields::VoxelField;
use crate::model::HostGaussians;
use crate::model::params::to_vec;
use crate::prepare::PrepareRecord;
use crate::segment::colour::{fibonacci_sphere, mean_colour};
use crate::segment::place::{Cloud, DensityFields};
use crate::track::velocity::velocities;
use std::path::PathBuf;
use std::str::FromStr;

/// Directions over which the colour of a Gaussian is averaged.
const DIRECTIONS: usize = 64;

/// Weights of red, green and blue in luminance (Rec. 709).
const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// What a field holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FieldKind {
    /// The extinction coefficient, per length.
    Density,
    /// Velocity of the Gaussians under the trained deformation, averaged with the density as weight.
    Velocity,
    /// Red, green and blue in [0, 1], averaged likewise.
    Colour,
    /// The luminance of that colour.
    Luminance,
}

impl FieldKind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Density, Self::Velocity, Self::Colour, Self::Luminance];

    /// Returns the name that it is parsed from, which it has in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Density => "density",
            Self::Velocity => "velocity",
            Self::Colour => "colour",
            Self::Luminance => "luminance",
        }
    }

    /// Numbers per voxel.
    fn components(self) -> usize {
        match self {
            Self::Density | Self::Luminance => 1,
            Self::Velocity | Self::Colour => 3,
        }
    }

    fn unit(self, length: &str, time: &str) -> String {
        match self {
            Self::Density => format!("1/({length})"),
            Self::Velocity => format!("({length})/({time})"),
            Self::Colour | Self::Luminance => "1".to_owned(),
        }
    }
}

impl FromStr for FieldKind {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|kind| kind.name() == name.trim());
        found.ok_or_else(|| format!("expected names of {}", Self::ALL.map(Self::name).join(", ")))
    }
}

/// Which fields to compute, and on which voxels.
#[derive(Debug, Clone, Default)]
pub struct FieldPlan {
    /// The fields, in the order of the file.
    pub kinds: Vec<FieldKind>,
    /// Names of segments to restrict them to; the whole scene if empty.
    pub segments: Vec<String>,
    /// Voxels along x, y, z; those of the prepared volume if `None`.
    pub dims: Option<[usize; 3]>,
    /// Volume file whose voxels are used.
    pub like: Option<PathBuf>,
    /// Whether to take the scene with the run's edits, not as trained.
    pub edited: bool,
}

/// Bytes per voxel and number: what is computed, what is kept, and what is written.
const NUMBER_BYTES: usize = 16;

/// Fields of a run, which can be computed at any time.
pub struct RunFields<'r> {
    run: &'r OpenRun,
    selection: Selection,
    kinds: Vec<FieldKind>,
    /// The voxels.
    pub grid: LabelGrid,
    /// Units of lengths and times.
    pub calibration: Calibration,
    /// The dataset that the voxels come from.
    pub data: PathBuf,
    /// What had to be assumed about the voxels, and what the reader of their file reports, one sentence each.
    pub notes: Vec<String>,
}

impl<'r> RunFields<'r> {
    /// Chooses segments and voxels.
    ///
    /// # Errors
    /// If a name is unknown, or the voxels are unknown or do not fit the dataset or memory.
    pub fn new(run: &'r OpenRun, plan: &FieldPlan) -> Result<Self, RunError> {
        let selection = Selection::open(run, &plan.segments, plan.edited)?;
        let data = run.dataset()?;
        let record = PrepareRecord::read(&data).map_err(RunError::input)?;
        let record = record.map(|record| record.normalised(&run.record.normalisation));
        let (grid, notes) = grid::choose(run, &data, record.as_ref(), plan.dims, plan.like.as_deref())?;
        let numbers: usize = plan.kinds.iter().map(|kind| kind.components()).sum();
        grid::check_memory(&grid, plan.like.as_deref(), NUMBER_BYTES * (numbers + 1))?;
        let calibration = run.calibration().clone();
        Ok(Self { run, selection, kinds: plan.kinds.clone(), grid, calibration, data, notes })
    }

    /// Length of one scene unit, in the units of the voxels' positions.
    fn length_scale(&self) -> f64 {
        self.grid.file.spacing[0] / self.grid.scene.spacing[0]
    }

    /// Signs of vectors of the scene along the axes that the file states: from LPS to RAS, x and y turn.
    fn signs(&self) -> [f64; 3] {
        let scene = self.calibration.space.as_ref().and_then(|space| space.axes);
        match (scene, self.grid.axes) {
            (Some(scene), Some(file)) if scene != file => [-1.0, -1.0, 1.0],
            _ => [1.0; 3],
        }
    }

    /// The unit of these positions in words.
    pub fn length_unit(&self) -> &str {
        let unnamed = if self.grid.file == self.grid.scene { NORMALISED } else { "data units" };
        self.grid.unit.as_deref().unwrap_or(unnamed)
    }

    /// Computes the fields at `time` in [0, 1]: lengths in the units of the voxels' positions, times in those of the data.
    ///
    /// # Errors
    /// If an edit cannot be applied.
    pub fn fields_at(&self, time: f64) -> Result<Vec<VoxelField>, RunError> {
        let scene = &self.run.scene;
        let at = self.grid.along(self.selection.gaussians_at(scene, time as f32)?.widened(self.run.widening()));
        let opacity = at.opacity();
        let labels = vec![0; at.len()];
        let fields =
            DensityFields::new(&Cloud::new(&at, &opacity, &labels), &self.grid.scene).map_err(RunError::input)?;
        let field = |kind: FieldKind| {
            let components = kind.components();
            let values = match kind {
                FieldKind::Density => {
                    let scale = self.length_scale();
                    fields.density.iter().map(|v| (f64::from(*v) / scale) as f32).collect()
                }
                FieldKind::Velocity => {
                    let all = velocities(|t| to_vec(scene.deformed(t).means), time as f32);
                    let scale = self.signs().map(|sign| sign * self.length_scale() / self.calibration.duration());
                    let of = |i: usize| self.selection.members().map_or(i, |members| members[i] as usize);
                    interleaved(components, |c| fields.average(|i| (f64::from(all[3 * of(i) + c]) * scale[c]) as f32))
                }
                FieldKind::Colour => {
                    let colours = colours(&at)?;
                    interleaved(components, |c| fields.average(|i| colours[3 * i + c]))
                }
                FieldKind::Luminance => {
                    let colours = colours(&at)?;
                    fields.average(|i| (0..3).map(|c| LUMINANCE[c] * colours[3 * i + c]).sum())
                }
            };
            Ok(VoxelField {
                name: kind.name(),
                unit: kind.unit(self.length_unit(), self.calibration.time_unit()),
                components,
                values,
            })
        };
        self.kinds.iter().copied().map(field).collect()
    }
}

/// The colours of Gaussians, averaged over all directions, `[N, 3]` in [0, 1]; unlit base colours of shaded ones.
fn colours(at: &HostGaussians) -> Result<Vec<f32>, RunError> {
    let (sh, coefficients) = at.material_colours();
    let mut colours = mean_colour(&sh, coefficients, &fibonacci_sphere(DIRECTIONS)).map_err(RunError::failure)?;
    colours.iter_mut().for_each(|v| *v = v.min(1.0));
    Ok(colours)
}

/// Joins `components` scalar fields into one of vectors.
fn interleaved(components: usize, field: impl Fn(usize) -> Vec<f32>) -> Vec<f32> {
    let mut out = Vec::new();
    for c in 0..components {
        let values = field(c);
        out.resize(components * values.len(), 0.0);
        out.iter_mut().skip(c).step_by(components).zip(values).for_each(|(out, value)| *out = value);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_have_names_and_units() {
        for kind in FieldKind::ALL {
            assert_eq!(kind.name().parse(), Ok(kind));
        }
        assert!("heat".parse::<FieldKind>().unwrap_err().contains("density, velocity, colour, luminance"));
        let unit = |kind: FieldKind| kind.unit("mm", "s");
        assert_eq!(FieldKind::ALL.map(unit), ["1/(mm)", "(mm)/(s)", "1", "1"]);
        assert_eq!(interleaved(2, |c| vec![c as f32, 10.0 + c as f32]), [0.0, 1.0, 10.0, 11.0]);
    }
}
