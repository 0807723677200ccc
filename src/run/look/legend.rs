//! What the colours of a picture stand for, in words and numbers, in the units of the data.

use super::{Look, LookKind};
use crate::segment::palette::hex;
use crate::track::velocity::Component;
use schemars::JsonSchema;
use serde::Serialize;

/// Legend for the colours of a picture.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Legend {
    /// Description in words.
    pub legend: String,
    /// Values at the ends of the scale, in `unit`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range: Option<[f64; 2]>,
    /// Unit of these values; `normalised` where the data have none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// The same values in scene units, as saved views hold them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scene_range: Option<[f32; 2]>,
    /// Colours of the scale at even steps from its low to its high end, 8 bits per channel.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub scale: Vec<[u8; 3]>,
}

impl Look {
    /// Returns what the colours of the frames drawn so far stand for, unless they are the Gaussians' own: lengths and
    /// speeds in the units of the data.
    pub fn legend(&self) -> Option<Legend> {
        let plain =
            |legend: String| Some(Legend { legend, range: None, unit: None, scene_range: None, scale: Vec::new() });
        let scaled = |legend: String, (factor, unit): (f64, String), range: [f32; 2], scale: Vec<[u8; 3]>| {
            let values = range.map(|v| factor * f64::from(v));
            Some(Legend { legend, range: Some(values), unit: Some(unit), scene_range: Some(range), scale })
        };
        let length = || (self.calibration.length_scale(), self.calibration.length_unit().to_owned());
        let speed = || (self.calibration.speed_scale(), self.calibration.speed_unit());
        let short = |factor: f64, v: f32| short(factor * f64::from(v));
        match &self.kind {
            LookKind::Colour => None,
            LookKind::Affinity(_) => {
                plain("affinity features: their first three principal components as red, green and blue".into())
            }
            LookKind::Depth { range: None, .. } => plain("depth: nothing is visible in any frame".into()),
            LookKind::Depth { range: Some([near, far]), palette } => {
                let [dark, light] = palette.ends();
                let (factor, unit) = length();
                let (low, high) = (short(factor, *near), short(factor, *far));
                let legend = format!("depth ({unit}): {light} is {low} or nearer, {dark} {high} or farther");
                scaled(legend, (factor, unit), [*near, *far], palette.scale(true))
            }
            LookKind::Velocity { scale: None, .. } => plain("velocity: nothing moves in any frame".into()),
            LookKind::Velocity { component: Component::Speed, scale: Some(full), palette } => {
                let [dark, light] = palette.ends();
                let (factor, unit) = speed();
                let legend = format!("speed ({unit}): {dark} is 0, {light} {} or more", short(factor, *full));
                scaled(legend, (factor, unit), [0.0, *full], palette.scale(false))
            }
            LookKind::Velocity { component, scale: Some(full), palette } => {
                let ([less, more], none) = (palette.ends(), palette.middle());
                let (factor, unit) = speed();
                let legend = format!(
                    "velocity along {} ({unit}): {more} is {full} or more, {none} 0, {less} -{full} or less",
                    format!("{component:?}").to_lowercase(),
                    full = short(factor, *full)
                );
                scaled(legend, (factor, unit), [-full, *full], palette.scale(false))
            }
            LookKind::Segments(all) => {
                let names = all.segments.iter().map(|s| format!("{} {}", s.name, hex(s.colour)));
                plain(format!("segments: {}", names.collect::<Vec<_>>().join(", ")))
            }
        }
    }
}

/// Formats a positive number with four significant digits, or all digits of its integer part if these are more.
fn short(v: f64) -> String {
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
