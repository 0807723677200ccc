//! Transfer functions: the colour and opacity of a data value. The type and its evaluation live here; reading and
//! writing files is in `file` and `paraview`, colour arithmetic in `color`, named colour maps in `colormap`. Nothing
//! here knows about rays or Gaussians.

pub mod color;
pub mod colormap;
mod file;
pub mod paraview;

use crate::volume::error::VolumeError;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The built-in transfer functions: name and TOML text.
const PRESETS: &[(&str, &str)] = &[
    ("ramp", include_str!("../../../../../configs/transfer-functions/ramp.toml")),
    ("density", include_str!("../../../../../configs/transfer-functions/density.toml")),
    ("fire", include_str!("../../../../../configs/transfer-functions/fire.toml")),
    ("vortex", include_str!("../../../../../configs/transfer-functions/vortex.toml")),
    ("layers", include_str!("../../../../../configs/transfer-functions/layers.toml")),
    ("storm", include_str!("../../../../../configs/transfer-functions/storm.toml")),
    ("fingers", include_str!("../../../../../configs/transfer-functions/fingers.toml")),
    ("ct-bone", include_str!("../../../../../configs/transfer-functions/ct-bone.toml")),
    ("ct-bone-raw", include_str!("../../../../../configs/transfer-functions/ct-bone-raw.toml")),
    ("jets", include_str!("../../../../../configs/transfer-functions/jets.toml")),
    ("vortices", include_str!("../../../../../configs/transfer-functions/vortices.toml")),
    ("shells", include_str!("../../../../../configs/transfer-functions/shells.toml")),
    ("nested", include_str!("../../../../../configs/transfer-functions/nested.toml")),
    ("beads", include_str!("../../../../../configs/transfer-functions/beads.toml")),
    ("filaments", include_str!("../../../../../configs/transfer-functions/filaments.toml")),
];

/// Maps data values to colours and opacities. Positions are fractions of [`TransferFunction::span`], so that one
/// function fits any field.
///
/// ```
/// use volseggs_volume::volume::transfer::TransferFunction;
/// let fire = TransferFunction::load("fire")?;
/// assert!(fire.opacity_at(0.0) == 0.0 && fire.opacity_at(1.0) > 0.5);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct TransferFunction {
    /// Name, of `a-z 0-9 - _`.
    pub name: String,
    /// Data values at the fractions 0 and 1; `None` for the range of the data.
    pub range: Option<[f64; 2]>,
    /// Control points (fraction, sRGB colour in [0, 1] as stored in images), sorted, at least one; linear between
    /// them, equal positions are a step.
    pub colors: Vec<(f64, [f32; 3])>,
    /// Control points (fraction, opacity in [0, 1] per `unit_length`), sorted, at least one; linear between them,
    /// equal positions are a step.
    pub opacity: Vec<(f64, f32)>,
    /// Length over which the opacity accrues, as a fraction of the volume's longest side: over a length `d` it is
    /// `1 - (1 - opacity)^(d / unit_length)`.
    pub unit_length: f64,
    /// How surfaces are lit.
    pub shading: Shading,
    /// Named, non-overlapping parts of the range.
    pub segments: Vec<SegmentRange>,
}

/// Blinn-Phong shading with the gradient of the field as the normal.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Shading {
    /// If false, the colour is used as it is.
    pub enabled: bool,
    /// Fraction of the colour present without light.
    pub ambient: f32,
    /// Fraction that depends on the angle to the light.
    pub diffuse: f32,
    /// Strength of the white highlight.
    pub specular: f32,
    /// Exponent of the highlight; the larger, the smaller the highlight.
    pub power: f32,
}

impl Default for Shading {
    fn default() -> Self {
        Self { enabled: true, ambient: 0.3, diffuse: 0.7, specular: 0.2, power: 20.0 }
    }
}

/// Lighting values that, where given, replace those of a transfer function.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lighting {
    /// [`Shading::ambient`], at least 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ambient: Option<f32>,
    /// [`Shading::diffuse`], at least 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diffuse: Option<f32>,
    /// [`Shading::specular`], at least 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub specular: Option<f32>,
    /// [`Shading::power`], above 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub power: Option<f32>,
}

impl Lighting {
    /// Copies the given values to `shading`; any of them turns shading on.
    pub fn apply(self, shading: &mut Shading) {
        for (given, value) in [
            (self.ambient, &mut shading.ambient),
            (self.diffuse, &mut shading.diffuse),
            (self.specular, &mut shading.specular),
            (self.power, &mut shading.power),
        ] {
            if let Some(given) = given {
                (*value, shading.enabled) = (given, true);
            }
        }
    }

    /// Rejects values that no light has.
    ///
    /// # Errors
    /// The first such value, with its key.
    pub fn check(self) -> Result<(), String> {
        for (key, value) in [("ambient", self.ambient), ("diffuse", self.diffuse), ("specular", self.specular)] {
            if let Some(value) = value.filter(|v| !(*v >= 0.0 && v.is_finite())) {
                return Err(format!("{key} = {value}: must be finite and at least 0"));
            }
        }
        match self.power.filter(|v| !(*v > 0.0 && v.is_finite())) {
            Some(value) => Err(format!("power = {value}: must be finite and above 0")),
            None => Ok(()),
        }
    }
}

/// A named part of the range of values.
#[derive(Clone, Debug, PartialEq)]
pub struct SegmentRange {
    /// Name, of `a-z 0-9 - _`.
    pub name: String,
    /// Fractions `[low, high)`; a range that ends at 1 includes 1.
    pub range: [f64; 2],
    /// sRGB colour for legends and label pictures; `None` for the colour in the middle of the range.
    pub color: Option<[f32; 3]>,
}

impl SegmentRange {
    /// Whether a fraction is in the range.
    pub fn contains(&self, fraction: f64) -> bool {
        let [low, high] = self.range;
        low <= fraction && (fraction < high || (high >= 1.0 && fraction <= high))
    }
}

/// Default of [`TransferFunction::unit_length`].
pub const DEFAULT_UNIT_LENGTH: f64 = 0.01;

impl TransferFunction {
    /// Data values at the fractions 0 and 1 for a field with values in `data_range`. Never empty: a field of one value
    /// `v` gives a span that starts at `v`.
    pub fn span(&self, data_range: [f64; 2]) -> [f64; 2] {
        let [low, high] = self.range.unwrap_or(data_range);
        if high > low { [low, high] } else { [low, low + low.abs().max(1.0)] }
    }

    /// sRGB colour at a fraction; the end values hold outside [0, 1]. At a step the upper side counts.
    pub fn color_at(&self, fraction: f64) -> [f32; 3] {
        colormap::colour_at(&self.colors, fraction)
    }

    /// Opacity per `unit_length` at a fraction; the end values hold outside [0, 1]. At a step the upper side counts.
    pub fn opacity_at(&self, fraction: f64) -> f32 {
        bracket(&self.opacity, fraction).map_or(0.0, |(a, b, t)| a + (b - a) * t as f32)
    }

    /// `[n, 4]` samples at the fractions `i / (n - 1)`: sRGB, not premultiplied, and opacity per `unit_length`.
    pub fn table(&self, n: usize) -> Vec<[f32; 4]> {
        let last = n.saturating_sub(1).max(1) as f64;
        let sample = |i: usize| {
            let fraction = i as f64 / last;
            let [r, g, b] = self.color_at(fraction);
            [r, g, b, self.opacity_at(fraction)]
        };
        (0..n).map(sample).collect()
    }

    /// Index into `segments` of the one that contains a fraction; `None` outside all of them.
    pub fn segment_of(&self, fraction: f64) -> Option<usize> {
        self.segments.iter().position(|s| s.contains(fraction))
    }

    /// Colour of a segment: its own or the one in the middle of its range.
    pub fn segment_color(&self, segment: &SegmentRange) -> [f32; 3] {
        segment.color.unwrap_or_else(|| self.color_at(f64::midpoint(segment.range[0], segment.range[1])))
    }

    /// Reads a `.toml` file, a ParaView `.json` file (`maps.json#Name` picks one of several maps) or a preset.
    ///
    /// # Errors
    /// An unknown preset (the message lists all), a file that cannot be read, or an invalid field in it.
    pub fn load(spec: &str) -> Result<Self, VolumeError> {
        if has_extension(spec, "toml") {
            return file::read(Path::new(spec));
        }
        if let Some((path, map)) = paraview::split_spec(spec) {
            return paraview::read(Path::new(path), map);
        }
        let Some((name, text)) = PRESETS.iter().find(|(name, _)| *name == spec) else {
            return Err(VolumeError::invalid(
                Path::new(spec),
                "transfer function",
                "there is no such preset, and the name does not end in .toml or .json",
                format!("use a file or one of {}", Self::presets().join(", ")),
            ));
        };
        file::parse(text, Path::new(&format!("{name}.toml")))
    }

    /// Names of the presets.
    pub fn presets() -> Vec<&'static str> {
        PRESETS.iter().map(|(name, _)| *name).collect()
    }

    /// The function as a TOML file that reads back equal, with fractions as units.
    pub fn to_toml(&self) -> String {
        file::write(self)
    }

    /// Checks that all fields are as documented; `path` is used in messages.
    ///
    /// # Errors
    /// The first field that is not as documented.
    pub fn check(&self, path: &Path) -> Result<(), VolumeError> {
        file::check(self, path)
    }
}

/// The neighbours of a fraction and its relative position between them.
fn bracket<T: Copy>(points: &[(f64, T)], fraction: f64) -> Option<(T, T, f64)> {
    let after = points.partition_point(|p| p.0 <= fraction);
    match (after.checked_sub(1).map(|i| points[i]), points.get(after)) {
        (Some(a), Some(b)) => Some((a.1, b.1, (fraction - a.0) / (b.0 - a.0))),
        (Some(end), None) => Some((end.1, end.1, 0.0)),
        (None, Some(end)) => Some((end.1, end.1, 0.0)),
        (None, None) => None,
    }
}

fn has_extension(path: &str, extension: &str) -> bool {
    Path::new(path).extension().is_some_and(|e| e.eq_ignore_ascii_case(extension))
}

/// A name of `a-z 0-9 - _` for any text: "Cool to Warm" becomes "cool-to-warm".
fn slug(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars().map(|c| c.to_ascii_lowercase()) {
        match c {
            'a'..='z' | '0'..='9' | '_' => out.push(c),
            _ if !out.is_empty() && !out.ends_with('-') => out.push('-'),
            _ => {}
        }
    }
    let out = out.trim_end_matches('-');
    if out.is_empty() { "unnamed".to_owned() } else { out.to_owned() }
}

#[cfg(test)]
mod tests;
