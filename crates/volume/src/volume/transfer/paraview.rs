//! Colour maps as ParaView saves them in JSON, read into transfer functions. Opacity functions are read if the file has
//! `Points`; `NanColor` is ignored, since the values of a volume are finite.

use super::{DEFAULT_UNIT_LENGTH, Shading, TransferFunction, color, has_extension, slug};
use crate::volume::error::VolumeError;
use crate::words::plain;
use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_json::Value;
use std::path::Path;

/// Minimum number of pieces into which a map in a space other than RGB is divided.
const PIECES: usize = 64;

/// The fields used; ParaView writes more (`Creator`, `License`, `DefaultMap`), which are ignored.
#[derive(Deserialize)]
struct Map {
    #[serde(rename = "ColorSpace")]
    color_space: Option<String>,
    #[serde(rename = "HSVWrap")]
    hsv_wrap: Option<Value>,
    #[serde(rename = "RGBPoints")]
    rgb_points: Option<Vec<f64>>,
    #[serde(rename = "Points")]
    points: Option<Vec<f64>>,
    #[serde(rename = "IndexedColors")]
    indexed_colors: Option<IgnoredAny>,
    #[serde(rename = "UseLogScale")]
    log_scale: Option<Value>,
}

#[derive(Clone, Copy)]
enum ParaViewColorSpace {
    Rgb,
    Hsv { wrap: bool },
    Lab,
    Diverging,
    Step,
}

/// Path and map name of `maps.json` or `maps.json#Name`; `None` if the text is neither.
pub(super) fn split_spec(spec: &str) -> Option<(&str, Option<&str>)> {
    if has_extension(spec, "json") {
        return Some((spec, None));
    }
    let (path, name) = spec.split_once('#')?;
    has_extension(path, "json").then_some((path, Some(name)))
}

/// Reads one colour map of a ParaView file: the named one, else the first. The positions become fractions of their own
/// span, separately for colours and opacities, as ParaView does when it applies a preset to data; the range stays that
/// of the data. Without `Points` the opacity is a ramp from 0 to 1. A midpoint of the opacity is kept as a control
/// point and a sharpness of 1 as a step; other sharpness values are treated as 0. `Lab/CIEDE2000` is mixed as `Lab`. A
/// file without `ColorSpace` is `RGB`.
///
/// # Errors
/// A file that cannot be read or is not JSON, no map of that name, a categorical or logarithmic map, or invalid points.
pub fn read(path: &Path, name: Option<&str>) -> Result<TransferFunction, VolumeError> {
    let text = crate::files::read_text(path).map_err(|e| {
        VolumeError::io(path, "read the ParaView color map", e, "check that the file is there and is text")
    })?;
    parse(&text, name, path)
}

fn parse(text: &str, name: Option<&str>, path: &Path) -> Result<TransferFunction, VolumeError> {
    let wrong = |field: &str, problem: String, hint: &str| VolumeError::invalid(path, field, problem, hint);
    let export = "export the color map from ParaView again";
    let value: Value = serde_json::from_str(text)
        .map_err(|e| wrong(&format!("line {}", e.line()), format!("is not JSON: {e}"), export))?;
    let maps = match value {
        Value::Array(maps) => maps,
        map => vec![map],
    };
    let name_of = |map: &Value| map.get("Name").and_then(Value::as_str).unwrap_or("").to_owned();
    let names: Vec<String> = maps.iter().map(name_of).collect();
    let at = match name {
        Some(name) => names.iter().position(|n| n == name),
        None => (!maps.is_empty()).then_some(0),
    };
    let Some(at) = at else {
        let problem = name.map_or("there is no color map".to_owned(), |n| format!("there is no map named {n:?}"));
        return Err(wrong("Name", problem, &format!("the file has: {}", names.join(", "))));
    };
    let name = &names[at];
    let field = |key: &str| format!("{key} of {name:?}");
    let map: Map =
        Map::deserialize(&maps[at]).map_err(|e| wrong(&field("the fields"), plain(&e.to_string()), export))?;
    let Some(list) = &map.rgb_points else {
        let (key, problem, hint) = if map.indexed_colors.is_some() {
            ("IndexedColors", "the map is categorical", "use a continuous map, one with RGBPoints")
        } else {
            ("RGBPoints", "there are none", "use a map with RGBPoints")
        };
        return Err(wrong(&field(key), problem.to_owned(), hint));
    };
    if map.log_scale.as_ref().is_some_and(is_on) {
        let problem = "the map is logarithmic, but positions are fractions of the range of the data";
        let hint = "turn off \"Use log scale\" in ParaView and export it again, or prepare the logarithm of the data";
        return Err(wrong(&field("UseLogScale"), problem.to_owned(), hint));
    }
    let points = spread(list, path, &field("RGBPoints"))?;
    if let Some((i, _)) = points.iter().enumerate().find(|(_, p)| !p.1.iter().all(|v| (0.0..=1.0).contains(v))) {
        let problem = format!("the color of point {i}, counted by position, is outside [0, 1]");
        return Err(wrong(&field("RGBPoints"), problem, "write x, r, g, b with channels in [0, 1]"));
    }
    let space = space_of(&map).ok_or_else(|| {
        let problem = format!("{:?} is not supported", map.color_space.as_deref().unwrap_or(""));
        wrong(&field("ColorSpace"), problem, "use RGB, HSV, Lab, CIELAB, LabCIEDE2000, Diverging or Step")
    })?;
    let opacity = match &map.points {
        Some(list) => opacity(&spread(list, path, &field("Points"))?),
        None => vec![(0.0, 0.0), (1.0, 1.0)],
    };
    let function = TransferFunction {
        name: slug(name),
        range: None,
        colors: resampled(&points, space),
        opacity,
        unit_length: DEFAULT_UNIT_LENGTH,
        shading: Shading::default(),
        segments: Vec::new(),
    };
    function.check(path)?;
    Ok(function)
}

/// Whether a switch is on: `true`, or a number that is not 0.
fn is_on(value: &Value) -> bool {
    value.as_bool() == Some(true) || value.as_f64().is_some_and(|v| v != 0.0)
}

fn space_of(map: &Map) -> Option<ParaViewColorSpace> {
    let Some(name) = &map.color_space else { return Some(ParaViewColorSpace::Rgb) };
    let plain: String = name.chars().filter(char::is_ascii_alphanumeric).collect();
    let wrap = map.hsv_wrap.as_ref().is_some_and(is_on);
    Some(match plain.to_ascii_lowercase().as_str() {
        "rgb" => ParaViewColorSpace::Rgb,
        "hsv" => ParaViewColorSpace::Hsv { wrap },
        "lab" | "cielab" | "labciede2000" => ParaViewColorSpace::Lab,
        "diverging" => ParaViewColorSpace::Diverging,
        "step" => ParaViewColorSpace::Step,
        _ => return None,
    })
}

/// Groups of four numbers, sorted by the first, which becomes a fraction of the span of all first numbers.
fn spread(list: &[f64], path: &Path, field: &str) -> Result<Vec<(f64, [f64; 3])>, VolumeError> {
    let (groups, rest) = list.as_chunks::<4>();
    let wrong = |problem: String, hint: &str| Err(VolumeError::invalid(path, field, problem, hint));
    if !rest.is_empty() || groups.is_empty() {
        return wrong(format!("there are {} numbers", list.len()), "write four numbers for each point");
    }
    let mut groups = groups.to_vec();
    groups.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let (low, high) = (groups[0][0], groups[groups.len() - 1][0]);
    let width = high - low;
    if !(width > 0.0 && width.is_finite()) {
        return wrong(format!("the positions go from {low} to {high}"), "give at least two positions that differ");
    }
    Ok(groups.into_iter().map(|[x, a, b, c]| ((x - low) / width, [a, b, c])).collect())
}

/// Control points of opacity points (fraction, [alpha, midpoint, sharpness]), without midpoints and sharpness.
fn opacity(points: &[(f64, [f64; 3])]) -> Vec<(f64, f32)> {
    let mut out = Vec::new();
    for (i, (x, [alpha, midpoint, sharpness])) in points.iter().enumerate() {
        out.push((*x, *alpha as f32));
        let Some((next, [next_alpha, ..])) = points.get(i + 1) else { break };
        let knee = x + (next - x) * midpoint.clamp(0.0, 1.0);
        if *sharpness > 0.99 {
            out.extend([(knee, *alpha as f32), (knee, *next_alpha as f32)]);
        } else if *midpoint != 0.5 {
            out.push((knee, f64::midpoint(*alpha, *next_alpha) as f32));
        }
    }
    out
}

/// Control points that, mixed in RGB, follow the mix of `points` in `space`.
fn resampled(points: &[(f64, [f64; 3])], space: ParaViewColorSpace) -> Vec<(f64, [f32; 3])> {
    let plain = |rgb: [f64; 3]| rgb.map(|v| v as f32);
    let mut out = vec![(points[0].0, plain(points[0].1))];
    for pair in points.windows(2) {
        let [(from, a), (to, b)] = [pair[0], pair[1]];
        let mix = |t: f64| match space {
            ParaViewColorSpace::Hsv { wrap } => color::mix_hsv(a, b, t, wrap),
            ParaViewColorSpace::Lab => color::mix_lab(a, b, t),
            _ => color::mix_diverging(a, b, t),
        };
        match space {
            ParaViewColorSpace::Rgb => {}
            // An interval has the colour of its upper end.
            ParaViewColorSpace::Step => out.push((from, plain(b))),
            _ if to > from => {
                // by width, but enough in each interval, and an even number for the white in the middle
                let pieces = ((PIECES as f64 * (to - from)).ceil() as usize).max(PIECES.div_ceil(points.len() - 1));
                let pieces = pieces.next_multiple_of(2);
                let at = |i: usize| i as f64 / pieces as f64;
                let cut = |rgb: [f64; 3]| rgb.map(|v| v.clamp(0.0, 1.0) as f32);
                out.extend((1..pieces).map(|i| (from + (to - from) * at(i), cut(mix(at(i))))));
            }
            _ => {}
        }
        out.push((to, plain(b)));
    }
    out
}

#[cfg(test)]
#[path = "paraview_tests.rs"]
mod tests;
