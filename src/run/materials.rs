//! Which colours of a dataset's transfer function the segments of a run have: the names that the user gave, where the
//! names of segments are only those of mixed colours.

use super::OpenRun;
use crate::model::HostGaussians;
use crate::prepare::PrepareRecord;
use crate::segment::colour::{fibonacci_sphere, mean_colour};
use crate::segment::palette::{hex, nearest_colour};
use crate::volume::transfer::TransferFunction;
use serde::Serialize;
use std::path::Path;

/// Directions over which the colour of a Gaussian is averaged.
const DIRECTIONS: usize = 64;

/// A colour of a transfer function.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NamedMaterial {
    /// The name of a range of values or, where the function names none, the value of a control point.
    pub name: String,
    /// Its colour, `#rrggbb`.
    pub hex: String,
    #[serde(skip)]
    rgb: [f32; 3],
}

/// The material of a segment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SegmentMaterial {
    /// The material that most of the segment is nearest to.
    #[serde(flatten)]
    pub material: NamedMaterial,
    /// The fraction of the segment's opacity that is, in (0, 1].
    pub share: f64,
}

/// The materials of the transfer function that a dataset was prepared with: its named ranges or, where it has none, its
/// control points. Empty for a dataset from elsewhere.
pub fn materials(dataset: &Path) -> Vec<NamedMaterial> {
    let path = dataset.join("transfer-function.toml");
    let Some(function) = path.is_file().then(|| TransferFunction::load(&path.to_string_lossy()).ok()).flatten() else {
        return Vec::new();
    };
    let material = |name: String, rgb: [f32; 3]| NamedMaterial { name, hex: hex(rgb), rgb };
    if !function.segments.is_empty() {
        return function.segments.iter().map(|s| material(s.name.clone(), function.segment_color(s))).collect();
    }
    let span = PrepareRecord::read(dataset).ok().flatten().map_or([0.0, 1.0], |record| record.span);
    let value = |fraction: f64| span[0] + fraction * (span[1] - span[0]);
    function.colors.iter().map(|(fraction, rgb)| material(format!("value {}", short(value(*fraction))), *rgb)).collect()
}

/// Four significant digits.
fn short(value: f64) -> String {
    let digits = if value == 0.0 { 0.0 } else { (3.0 - value.abs().log10().floor()).clamp(0.0, 12.0) };
    let text = format!("{value:.*}", digits as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// Assigns each Gaussian of a scene to the nearest of some materials.
#[derive(Debug)]
pub struct AssignedMaterials<'a> {
    materials: &'a [NamedMaterial],
    /// Material of each Gaussian.
    nearest: Vec<Option<usize>>,
    opacity: Vec<f32>,
}

impl<'a> AssignedMaterials<'a> {
    /// Assigns the canonical Gaussians of a run by their unlit colours.
    pub fn new(run: &OpenRun, materials: &'a [NamedMaterial]) -> Self {
        Self::of(&run.scene.gaussians.to_host(), materials)
    }

    fn of(gaussians: &HostGaussians, materials: &'a [NamedMaterial]) -> Self {
        let (sh, coefficients) = gaussians.material_colours();
        let palette: Vec<[f32; 3]> = materials.iter().map(|m| m.rgb).collect();
        // coefficients that do not fit have no colours, and so no material
        let colours = mean_colour(&sh, coefficients, &fibonacci_sphere(DIRECTIONS)).unwrap_or_default();
        let mut nearest: Vec<_> =
            colours.chunks_exact(3).map(|c| nearest_colour(&palette, [c[0], c[1], c[2]])).collect();
        nearest.resize(gaussians.len(), None);
        Self { materials, nearest, opacity: gaussians.opacity() }
    }

    /// The material that most of the opacity of `members` is nearest to; `None` if they are invisible, or there are no
    /// materials.
    pub fn most(&self, members: &[u32]) -> Option<SegmentMaterial> {
        let mut weights = vec![0.0; self.materials.len()];
        for &i in members {
            if let Some(material) = self.nearest[i as usize] {
                weights[material] += f64::from(self.opacity[i as usize]);
            }
        }
        let total: f64 = weights.iter().sum();
        let (most, weight) = weights.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
        (weight > 0.0).then(|| SegmentMaterial { material: self.materials[most].clone(), share: weight / total })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::sh::C0;

    fn of(colours: &[[f32; 3]], logits: &[f32]) -> HostGaussians {
        let sh = colours.iter().flatten().map(|c| (c - 0.5) / C0).collect();
        HostGaussians { sh, opacity_logits: logits.to_vec(), ..HostGaussians::zeros(colours.len(), 1) }
    }

    #[test]
    fn a_segment_is_what_most_of_its_opacity_is_nearest_to() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(materials(folder.path()), []);
        let mut function = TransferFunction::load("shells").unwrap();
        let write = |function: &TransferFunction| {
            std::fs::write(folder.path().join("transfer-function.toml"), function.to_toml()).unwrap();
            materials(folder.path())
        };
        function.segments.clear();
        function.colors = vec![(0.0, [1.0, 0.0, 0.0]), (0.5, [0.0, 0.2, 1.0])];
        let known = write(&function);
        let names: Vec<(&str, &str)> = known.iter().map(|m| (m.name.as_str(), m.hex.as_str())).collect();
        assert_eq!(names, [("value 0", "#ff0000"), ("value 0.5", "#0033ff")]);
        let gaussians = of(&[[0.7, 0.2, 0.1], [0.1, 0.3, 0.8], [0.2, 0.3, 0.8]], &[3.0, -3.0, -3.0]);
        let assigned = AssignedMaterials::of(&gaussians, &known);
        let name =
            |members: &[u32]| assigned.most(members).map(|made| (made.material.name, (10.0 * made.share).round()));
        assert_eq!(name(&[0, 1, 2]), Some(("value 0".to_owned(), 9.0)));
        assert_eq!(name(&[1, 2]), Some(("value 0.5".to_owned(), 10.0)));
        assert_eq!(name(&[]), None);
        assert!(write(&TransferFunction::load("shells").unwrap()).iter().all(|m| !m.name.starts_with("value")));
    }

    #[test]
    fn values_have_four_digits() {
        assert_eq!([0.0, 0.5, -12.3456, 12345.6, 0.000123456].map(short), ["0", "0.5", "-12.35", "12346", "0.0001235"]);
    }
}
