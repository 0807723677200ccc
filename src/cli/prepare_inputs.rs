//! Groups of `prepare` arguments: surface lighting, and segments of volumes without labels.

use super::CliError;
use super::values::{count, finite_f32, not_negative_f32, positive_f32};
use crate::memory::{MemoryBudget, product};
use crate::prepare::{FileLabels, SegmentSteps};
use crate::volume::components::{DEFAULT_MIN_VOXELS, PartOptions, PartsError, VOXEL_BYTES};
use crate::volume::series::Series;
use crate::volume::transfer::Lighting;
use clap::Args;

/// Lighting that overrides the transfer function's; any of these options turns shading on.
#[derive(Clone, Copy, Debug, Args)]
pub(super) struct ShadingArgs {
    /// Fraction of the colour present without light, overriding the transfer function; near 0 for dark rims.
    #[arg(long, value_name = "SHARE", value_parser = not_negative_f32)]
    ambient: Option<f32>,
    /// Fraction of the colour that depends on the angle to the light, overriding the transfer function.
    #[arg(long, value_name = "SHARE", value_parser = not_negative_f32)]
    diffuse: Option<f32>,
    /// Strength of the white highlight, overriding the transfer function.
    #[arg(long, value_name = "STRENGTH", value_parser = not_negative_f32)]
    specular: Option<f32>,
    /// Exponent of the highlight, its `power`; larger values give smaller highlights.
    #[arg(long, value_name = "POWER", value_parser = positive_f32)]
    shininess: Option<f32>,
}

impl ShadingArgs {
    /// The options that were given.
    pub(super) fn lighting(self) -> Lighting {
        let Self { ambient, diffuse, specular, shininess } = self;
        Lighting { ambient, diffuse, specular, power: shininess }
    }
}

/// Segments of volumes without labels.
#[derive(Clone, Copy, Debug, Args)]
pub(super) struct ComponentArgs {
    /// Use as segments the connected components of voxels of at least this value, tracked from step to step: part-1,
    /// part-2, ...
    #[arg(
        long,
        value_name = "VALUE",
        value_parser = finite_f32,
        conflicts_with_all = ["labels", "synthetic", "label_names"]
    )]
    components: Option<f32>,
    /// Minimum number of voxels of a component; smaller ones are not segments.
    #[arg(long, default_value_t = DEFAULT_MIN_VOXELS, value_name = "VOXELS", value_parser = count, requires = "components")]
    smallest_component: usize,
}

impl ComponentArgs {
    /// The components of a series, if they are asked for. Reads the whole series.
    pub(super) fn labels(self, series: &Series) -> Result<Option<FileLabels>, CliError> {
        let Some(value) = self.components else { return Ok(None) };
        let [x, y, z] = series.grid().dims;
        let bytes = product(&[x, y, z, size_of::<f32>() + VOXEL_BYTES]);
        let what = format!("--components in a volume of {x} x {y} x {z} voxels");
        MemoryBudget::now().check(what, bytes).map_err(CliError::input)?;
        let options = PartOptions { value, smallest: self.smallest_component };
        let labels = FileLabels::parts(series, options).map_err(|e| match e {
            PartsError::Volume(e) => e.into(),
            other => CliError::input(format!("--components: {other}")),
        })?;
        Ok(Some(labels))
    }
}

/// Parses steps: numbers separated by commas, or `own`.
pub(super) fn segment_steps(text: &str) -> Result<SegmentSteps, String> {
    if text.trim() == "own" {
        return Ok(SegmentSteps::OfViews);
    }
    let steps = text.split(',').map(|step| step.trim().parse::<usize>());
    let steps = steps.collect::<Result<Vec<_>, _>>();
    steps.map(SegmentSteps::These).map_err(|_| "expected steps from 0, separated by commas, or own".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_numbers_or_own() {
        assert_eq!(segment_steps("own"), Ok(SegmentSteps::OfViews));
        assert_eq!(segment_steps("3, 0"), Ok(SegmentSteps::These(vec![3, 0])));
        for bad in ["", "-1", "1,,2", "1.5", "all"] {
            assert!(segment_steps(bad).is_err(), "{bad}");
        }
    }
}
