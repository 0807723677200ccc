//! Transfer functions as TOML text: reading, checking and writing. The format is described at [`TransferFile`].

use super::{DEFAULT_UNIT_LENGTH, SegmentRange, Shading, TransferFunction, color, colormap, paraview, slug};
use crate::volume::error::VolumeError;
use serde::Deserialize;
use std::collections::HashSet;
use std::fmt::Write as _;
use std::path::Path;
use toml::Value;

/// Control points of the colours and of the opacity.
type ControlPoints<T> = Vec<(f64, T)>;

const COLOR_HINT: &str = "\"#rrggbb\" or [r, g, b] in [0, 1]";

/// The file as written. Positions are in `units`: fractions of `range`, or data values, where `range` defaults to the
/// span of the control points.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TransferFile {
    name: Option<String>,
    #[serde(default)]
    units: PositionUnits,
    range: Option<[f64; 2]>,
    /// `[position, "#rrggbb"]` or `[position, [r, g, b]]` each; this or `colormap`.
    colors: Option<Vec<Value>>,
    /// A name of [`colormap::NAMES`] or a ParaView file next to this one.
    colormap: Option<String>,
    /// `[position, opacity]` each.
    opacity: Vec<Value>,
    unit_length: Option<f64>,
    #[serde(default)]
    shading: Shading,
    #[serde(default)]
    segments: Vec<SegmentTable>,
}

#[derive(Deserialize, Default, Clone, Copy, PartialEq)]
#[serde(rename_all = "lowercase")]
enum PositionUnits {
    #[default]
    Fraction,
    Data,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SegmentTable {
    name: String,
    range: [f64; 2],
    color: Option<Value>,
}

pub(super) fn read(path: &Path) -> Result<TransferFunction, VolumeError> {
    let text = crate::files::read_settings(path).map_err(|e| {
        VolumeError::io(path, "read the transfer function", e, "check that the file is there and is text")
    })?;
    parse(&text, path)
}

pub(super) fn parse(text: &str, path: &Path) -> Result<TransferFunction, VolumeError> {
    let wrong = |field: &str, problem: String, hint: &str| VolumeError::invalid(path, field, problem, hint);
    crate::nesting::check_toml(text).map_err(|e| wrong("TOML", e, "see the transfer functions in configs/"))?;
    let document: TransferFile = toml::from_str(text).map_err(|e| {
        let before = e.span().and_then(|s| text.get(..s.start)).unwrap_or("");
        let line = before.bytes().filter(|b| *b == b'\n').count() + 1;
        wrong(&format!("line {line}"), e.message().replace('\n', " "), "correct the TOML there")
    })?;
    let opacity = points(path, "opacity", &document.opacity, "a number in [0, 1]", |v| number(v).map(|v| v as f32))?;
    let colors = match (&document.colors, &document.colormap) {
        (Some(list), None) => Some(points(path, "colors", list, COLOR_HINT, color_of)?),
        (None, Some(_)) => None,
        (Some(_), Some(_)) => {
            return Err(wrong("colormap", "colors are given too".to_owned(), "keep either colors or colormap"));
        }
        (None, None) => {
            return Err(wrong(
                "colors",
                "there is no color".to_owned(),
                "add colors = [[0.0, \"#000000\"]] or a colormap",
            ));
        }
    };
    let mut segments = Vec::new();
    for (i, segment) in document.segments.iter().enumerate() {
        let color = segment.color.as_ref().map(|value| {
            let field = format!("segments[{i}].color");
            color_of(value)
                .ok_or_else(|| wrong(&field, format!("{value} is not a color"), &format!("write {COLOR_HINT}")))
        });
        segments.push(SegmentRange { name: segment.name.clone(), range: segment.range, color: color.transpose()? });
    }
    let stem = path.file_stem().map(|s| s.to_string_lossy()).unwrap_or_default();
    let mut function = TransferFunction {
        name: document.name.clone().unwrap_or_else(|| slug(&stem)),
        range: document.range,
        colors: colors.unwrap_or_default(),
        opacity,
        unit_length: document.unit_length.unwrap_or(DEFAULT_UNIT_LENGTH),
        shading: document.shading,
        segments,
    };
    if document.units == PositionUnits::Data && !function.opacity.is_empty() {
        to_fractions(&mut function, path)?;
    }
    // after the change of units: a colour map is always in fractions
    if let Some(name) = &document.colormap {
        function.colors = named_colors(name, path)?;
    }
    check(&function, path)?;
    Ok(function)
}

/// Positions and values of a list of pairs; `hint` describes what `value_of` accepts.
fn points<T>(
    path: &Path,
    field: &str,
    list: &[Value],
    hint: &str,
    value_of: impl Fn(&Value) -> Option<T>,
) -> Result<ControlPoints<T>, VolumeError> {
    let pair = |(i, entry): (usize, &Value)| {
        let wrong = |problem: String| {
            let hint = format!("write [position, value] with a number and {hint}");
            VolumeError::invalid(path, format!("{field}[{i}]"), problem, hint)
        };
        let list = entry.as_array().map(Vec::as_slice);
        let Some([position, value]) = list else { return Err(wrong(format!("{entry} is not a pair"))) };
        let position = number(position).ok_or_else(|| wrong(format!("{position} is not a position")))?;
        Ok((position, value_of(value).ok_or_else(|| wrong(format!("{value} is not a valid value")))?))
    };
    list.iter().enumerate().map(pair).collect()
}

fn number(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|v| v as f64))
}

fn color_of(value: &Value) -> Option<[f32; 3]> {
    match value {
        Value::String(text) => color::parse_hex(text),
        Value::Array(list) => {
            let channels: Option<Vec<f32>> = list.iter().map(|v| number(v).map(|v| v as f32)).collect();
            channels?.try_into().ok()
        }
        _ => None,
    }
}

fn named_colors(name: &str, path: &Path) -> Result<ControlPoints<[f32; 3]>, VolumeError> {
    if let Some((file, map)) = paraview::split_spec(name) {
        let beside = path.parent().unwrap_or(Path::new("")).join(file);
        return Ok(paraview::read(&beside, map)?.colors);
    }
    colormap::named(name).ok_or_else(|| {
        let hint = format!("use one of {} or a ParaView .json file", colormap::NAMES.join(", "));
        VolumeError::invalid(path, "colormap", format!("there is no map named {name:?}"), hint)
    })
}

/// Replaces data values by fractions of the range, which is derived first if the file has none.
fn to_fractions(function: &mut TransferFunction, path: &Path) -> Result<(), VolumeError> {
    let positions = function.colors.iter().map(|p| p.0).chain(function.opacity.iter().map(|p| p.0));
    let (low, high) = positions.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
    let [low, high] = function.range.unwrap_or([low, high]);
    check_range("range", [low, high], path)?;
    let fraction = |field: String, value: f64| {
        if (low..=high).contains(&value) {
            return Ok((value - low) / (high - low));
        }
        let problem = format!("{value} is outside the range {low} to {high}");
        Err(VolumeError::invalid(path, field, problem, "move it or write a wider range = [low, high]"))
    };
    for (i, point) in function.colors.iter_mut().enumerate() {
        point.0 = fraction(format!("colors[{i}]"), point.0)?;
    }
    for (i, point) in function.opacity.iter_mut().enumerate() {
        point.0 = fraction(format!("opacity[{i}]"), point.0)?;
    }
    for (i, segment) in function.segments.iter_mut().enumerate() {
        for end in &mut segment.range {
            *end = fraction(format!("segments[{i}].range"), *end)?;
        }
    }
    function.range = Some([low, high]);
    Ok(())
}

fn check_range(field: &str, [low, high]: [f64; 2], path: &Path) -> Result<(), VolumeError> {
    // A width that overflows would make every fraction zero.
    if low < high && (high - low).is_finite() {
        return Ok(());
    }
    let problem = format!("{low} to {high} is not a valid range");
    Err(VolumeError::invalid(path, field, problem, "write [low, high] with low below high, both finite"))
}

pub(super) fn check(function: &TransferFunction, path: &Path) -> Result<(), VolumeError> {
    let wrong = |field: String, problem: String, hint: &str| Err(VolumeError::invalid(path, field, problem, hint));
    check_name("name", &function.name, path)?;
    if let Some(range) = function.range {
        check_range("range", range, path)?;
    }
    check_positions("colors", function.colors.iter().map(|p| p.0), path)?;
    check_positions("opacity", function.opacity.iter().map(|p| p.0), path)?;
    let colors = function.colors.iter().enumerate().map(|(i, p)| (format!("colors[{i}]"), p.1));
    let own = function.segments.iter().enumerate();
    let own = own.filter_map(|(i, s)| s.color.map(|c| (format!("segments[{i}].color"), c)));
    for (field, value) in colors.chain(own) {
        if !value.iter().all(|v| (0.0..=1.0).contains(v)) {
            return wrong(field, format!("{value:?} is not a color"), "keep each channel in [0, 1]");
        }
    }
    for (i, (_, value)) in function.opacity.iter().enumerate() {
        if !(0.0..=1.0).contains(value) {
            return wrong(format!("opacity[{i}]"), format!("{value} is not an opacity"), "keep it in [0, 1]");
        }
    }
    if !(function.unit_length > 0.0 && function.unit_length.is_finite()) {
        let problem = format!("{} is not a valid length", function.unit_length);
        return wrong("unit_length".to_owned(), problem, "write a fraction of the longest side above 0, such as 0.01");
    }
    let Shading { ambient, diffuse, specular, power, .. } = function.shading;
    for (field, value, min) in [
        ("ambient", ambient, 0.0),
        ("diffuse", diffuse, 0.0),
        ("specular", specular, 0.0),
        ("power", power, f32::MIN_POSITIVE),
    ] {
        if !(value >= min && value.is_finite()) {
            let hint =
                if min > 0.0 { "write a number above 0, at most 3.4e38" } else { "write a number from 0 to 3.4e38" };
            return wrong(format!("shading.{field}"), format!("{value} cannot be used"), hint);
        }
    }
    check_segments(&function.segments, path)
}

fn check_segments(segments: &[SegmentRange], path: &Path) -> Result<(), VolumeError> {
    let wrong = |field: String, problem: String, hint: &str| Err(VolumeError::invalid(path, field, problem, hint));
    let mut names = HashSet::new();
    for (i, segment) in segments.iter().enumerate() {
        check_name(&format!("segments[{i}].name"), &segment.name, path)?;
        if !names.insert(&segment.name) {
            return wrong(format!("segments[{i}].name"), format!("{:?} is used twice", segment.name), "rename one");
        }
        let [low, high] = segment.range;
        if !(low >= 0.0 && low < high && high <= 1.0) {
            let problem = format!("{low} to {high} is not a range within 0 to 1");
            return wrong(format!("segments[{i}].range"), problem, "write [low, high] with low below high in [0, 1]");
        }
        let clash = segments[..i].iter().find(|other| low < other.range[1] && other.range[0] < high);
        if let Some(other) = clash {
            let problem = format!("overlaps the segment {:?}", other.name);
            return wrong(format!("segments[{i}].range"), problem, "let one end where the other starts");
        }
    }
    Ok(())
}

fn check_name(field: &str, name: &str, path: &Path) -> Result<(), VolumeError> {
    let allowed = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-' || b == b'_';
    if !name.is_empty() && name.bytes().all(allowed) {
        return Ok(());
    }
    let hint = format!("use a-z, 0-9, - and _, such as {:?}", slug(name));
    Err(VolumeError::invalid(path, field, format!("{name:?} is not a valid name"), hint))
}

fn check_positions(field: &str, positions: impl Iterator<Item = f64>, path: &Path) -> Result<(), VolumeError> {
    let mut last = None;
    for (i, position) in positions.enumerate() {
        let wrong =
            |problem: String, hint: &str| Err(VolumeError::invalid(path, format!("{field}[{i}]"), problem, hint));
        if !(0.0..=1.0).contains(&position) {
            return wrong(format!("position {position} is outside [0, 1]"), "use fractions, or units = \"data\"");
        }
        if let Some(before) = last.filter(|l| *l > position) {
            return wrong(format!("position {position} comes after {before}"), "sort the points by position");
        }
        last = Some(position);
    }
    match last {
        Some(_) => Ok(()),
        None => Err(VolumeError::invalid(path, field, "there is no control point", "add at least one")),
    }
}

pub(super) fn write(function: &TransferFunction) -> String {
    let quoted = |text: &str| Value::String(text.to_owned()).to_string();
    let mut out = format!("name = {}\nunits = \"fraction\"\n", quoted(&function.name));
    // Writing to a String cannot fail.
    if let Some([low, high]) = function.range {
        let _ = writeln!(out, "range = [{low:?}, {high:?}]");
    }
    let _ = writeln!(out, "unit_length = {:?}", function.unit_length);
    out += "colors = [\n";
    for (position, value) in &function.colors {
        let _ = writeln!(out, "  [{position:?}, {}],", color_text(*value));
    }
    out += "]\nopacity = [\n";
    for (position, value) in &function.opacity {
        let _ = writeln!(out, "  [{position:?}, {}],", short(*value));
    }
    let s = function.shading;
    let _ = writeln!(out, "]\n\n[shading]\nenabled = {}", s.enabled);
    for (key, value) in [("ambient", s.ambient), ("diffuse", s.diffuse), ("specular", s.specular), ("power", s.power)] {
        let _ = writeln!(out, "{key} = {}", short(value));
    }
    for segment in &function.segments {
        let [low, high] = segment.range;
        let _ = writeln!(out, "\n[[segments]]\nname = {}\nrange = [{low:?}, {high:?}]", quoted(&segment.name));
        if let Some(value) = segment.color {
            let _ = writeln!(out, "color = {}", color_text(value));
        }
    }
    out
}

fn color_text(value: [f32; 3]) -> String {
    color::exact_hex(value).map_or_else(|| format!("[{}]", value.map(short).join(", ")), |hex| format!("\"{hex}\""))
}

/// Shortest decimal that reads back as the same number, also via a double.
fn short(value: f32) -> String {
    let text = format!("{value:?}");
    let back = text.parse::<f64>().map(|v| v as f32);
    if back == Ok(value) { text } else { format!("{:?}", f64::from(value)) }
}
