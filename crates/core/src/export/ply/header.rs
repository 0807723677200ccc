//! The text header of a PLY file: where each property lies in a row.

use std::io::{BufRead, Read};

use super::{MAX_SH_DEGREE, ReadError};
use crate::files::MARK;

/// Maximum length of a header; a file without `end_header` must not fill the memory.
const MAX_HEADER: u64 = 1 << 16;

/// Returns the header for `count` Gaussians with `k` coefficients per channel; its first comment identifies the program,
/// then follow `comments`.
pub(super) fn text(count: usize, k: usize, comments: &[String]) -> String {
    let fixed = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
    let mut names = fixed(&["x", "y", "z", "nx", "ny", "nz"]);
    names.extend(numbered("f_dc_", 3));
    names.extend(numbered("f_rest_", 3 * (k - 1)));
    names.push("opacity".to_owned());
    names.extend(numbered("scale_", 3));
    names.extend(numbered("rot_", 4));
    let mut text = format!("ply\nformat binary_little_endian 1.0\ncomment {MARK}\n");
    for comment in comments {
        text += &format!("comment {comment}\n");
    }
    text += &format!("element vertex {count}\n");
    for name in names {
        text += &format!("property float {name}\n");
    }
    text + "end_header\n"
}

fn numbered(prefix: &str, count: usize) -> Vec<String> {
    (0..count).map(|i| format!("{prefix}{i}")).collect()
}

/// Position of a floating-point property in a row.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PropertySlot {
    offset: usize,
    double: bool,
}

impl PropertySlot {
    /// Returns the value in `row`, which is as long as the header's stride.
    pub(super) fn value(&self, row: &[u8]) -> f32 {
        let mut wide = [0; 8];
        if self.double {
            wide.copy_from_slice(&row[self.offset..][..8]);
            return f64::from_le_bytes(wide) as f32;
        }
        let mut narrow = [0; 4];
        narrow.copy_from_slice(&row[self.offset..][..4]);
        f32::from_le_bytes(narrow)
    }
}

/// What a header says about the rows.
#[derive(Debug)]
pub(super) struct PlyHeader {
    pub(super) count: usize,
    pub(super) stride: usize,
    pub(super) mean: [PropertySlot; 3],
    pub(super) dc: [PropertySlot; 3],
    /// All of red, then all of green, then all of blue.
    pub(super) rest: Vec<PropertySlot>,
    pub(super) opacity: PropertySlot,
    pub(super) scale: [PropertySlot; 3],
    pub(super) rotation: [PropertySlot; 4],
}

fn wrong<T>(reason: impl Into<String>) -> Result<T, ReadError> {
    Err(ReadError::Format(reason.into()))
}

impl PlyHeader {
    pub(super) fn coefficients(&self) -> usize {
        self.rest.len() / 3 + 1
    }

    pub(super) fn read(input: &mut impl BufRead) -> Result<Self, ReadError> {
        let mut limited = input.take(MAX_HEADER);
        let mut line = String::new();
        let mut next = |what: &str| -> Result<String, ReadError> {
            let mut bytes = Vec::new();
            limited.read_until(b'\n', &mut bytes)?;
            if bytes.pop() != Some(b'\n') {
                return wrong(format!("the file ends in the header, before {what}"));
            }
            line.clear();
            line.push_str(&String::from_utf8_lossy(&bytes));
            Ok(line.trim_end().to_owned())
        };
        if next("the first line")? != "ply" {
            return wrong("this is not a PLY file: the first line is not `ply`");
        }
        let mut count: Option<usize> = None;
        let mut formatted = false;
        let mut stride = 0;
        let mut slots: Vec<(String, PropertySlot)> = Vec::new();
        loop {
            let line = next("end_header")?;
            let words: Vec<&str> = line.split_whitespace().collect();
            match words.as_slice() {
                ["end_header"] => break,
                [] | ["comment" | "obj_info", ..] => {}
                ["format", "binary_little_endian", "1.0"] => formatted = true,
                ["format", other, ..] => {
                    return wrong(format!("format {other} is not supported; save the file as binary_little_endian"));
                }
                ["element", "vertex", number] if count.is_none() => match number.parse() {
                    Ok(number) => count = Some(number),
                    Err(_) => return wrong(format!("`{line}`: {number:?} is not a count")),
                },
                // Elements after the vertices follow them in the file and are not read.
                ["element", ..] if count.is_some() => {
                    while next("end_header")? != "end_header" {}
                    break;
                }
                ["element", other, ..] => {
                    return wrong(format!("the first element is `{other}`, expected `vertex`"));
                }
                ["property", kind, name] if count.is_some() => {
                    let Some(size) = size_of(kind) else {
                        return wrong(format!("property {name} has the unknown type {kind}"));
                    };
                    if matches!(*kind, "float" | "float32" | "double" | "float64") {
                        let slot = PropertySlot { offset: stride, double: size == 8 };
                        slots.push(((*name).to_owned(), slot));
                    }
                    stride += size;
                }
                _ => return wrong(format!("header line `{line}` is not understood")),
            }
        }
        if !formatted {
            return wrong("the header has no `format` line");
        }
        let Some(count) = count else {
            return wrong("the header has no `element vertex` line");
        };
        Self::from_slots(count, stride, &slots)
    }

    fn from_slots(count: usize, stride: usize, slots: &[(String, PropertySlot)]) -> Result<Self, ReadError> {
        let find = |name: &str| match slots.iter().find(|(known, _)| known == name) {
            Some((_, slot)) => Ok(*slot),
            None => wrong(format!("float property `{name}` is missing; is this a file of Gaussians?")),
        };
        let rest = slots.iter().filter(|(n, _)| n.starts_with("f_rest_")).count();
        if !(0..=MAX_SH_DEGREE).any(|d| rest == 3 * ((d + 1) * (d + 1) - 1)) {
            return wrong(format!("{rest} f_rest properties do not match a degree; expected 0, 9, 24 or 45"));
        }
        let names = numbered("f_rest_", rest);
        Ok(Self {
            count,
            stride,
            mean: [find("x")?, find("y")?, find("z")?],
            dc: [find("f_dc_0")?, find("f_dc_1")?, find("f_dc_2")?],
            rest: names.iter().map(|name| find(name)).collect::<Result<_, _>>()?,
            opacity: find("opacity")?,
            scale: [find("scale_0")?, find("scale_1")?, find("scale_2")?],
            rotation: [find("rot_0")?, find("rot_1")?, find("rot_2")?, find("rot_3")?],
        })
    }
}

fn size_of(kind: &str) -> Option<usize> {
    Some(match kind {
        "char" | "uchar" | "int8" | "uint8" => 1,
        "short" | "ushort" | "int16" | "uint16" => 2,
        "int" | "uint" | "float" | "int32" | "uint32" | "float32" => 4,
        "double" | "float64" => 8,
        _ => return None,
    })
}
