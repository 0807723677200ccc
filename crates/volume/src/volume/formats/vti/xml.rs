//! The markup of a `.vti` file: geometry, arrays and where their text lies. Reads no values, and stops where raw
//! appended data (which is not XML) begins.

use crate::volume::error::VolumeError;
use crate::volume::formats::common::scalar_from_name;
use crate::volume::formats::decode::Endian;
use crate::volume::grid::ScalarType;
use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};
use std::io::BufRead;
use std::path::Path;

/// The content of the markup.
#[derive(Debug)]
pub(super) struct VtiDocument {
    pub endian: Endian,
    /// Block headers are 64-bit words.
    pub wide: bool,
    /// Name of the compressor; empty for none.
    pub compressor: String,
    pub image: Image,
    pub piece_extent: [i32; 6],
    pub point: ArraySection,
    pub cell: ArraySection,
    /// First byte of the appended data (after `_`), and whether it is raw (else base64).
    pub appended: Option<(u64, bool)>,
}

/// The attributes of `ImageData`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Image {
    /// The `WholeExtent`.
    pub extent: [i32; 6],
    pub spacing: [f64; 3],
    pub origin: [f64; 3],
    /// Unit vectors of the image's axes as columns, row by row.
    pub direction: [f64; 9],
}

/// The arrays of `PointData` or `CellData`.
#[derive(Debug, Default)]
pub(super) struct ArraySection {
    /// Value of the attribute `Scalars`.
    pub active: Option<String>,
    pub arrays: Vec<Array>,
}

/// One `DataArray`, as the markup describes it.
#[derive(Debug)]
pub(super) struct Array {
    pub name: String,
    pub kind: String,
    pub format: String,
    pub components: u64,
    pub offset: u64,
    /// First byte and length of the inline text.
    pub text: Option<(u64, u64)>,
}

/// The number type of a name: `Int8`, `Float32`, ...
pub(super) fn kind(name: &str) -> Option<ScalarType> {
    let kinds = ["Int8", "Int16", "Int32", "Int64", "UInt8", "UInt16", "UInt32", "UInt64", "Float32", "Float64"];
    kinds.contains(&name).then(|| scalar_from_name(name))?
}

const REWRITE: &str = "the file is damaged or truncated: copy or write it again";

/// Reads the markup up to the appended data or the end.
pub(super) fn parse(path: &Path, mut src: impl BufRead) -> Result<VtiDocument, VolumeError> {
    let refused = |e| VolumeError::io(path, "read the file", e, "check the file system");
    // The XML reader skips a byte order mark without counting it.
    let mark = if src.fill_buf().map_err(refused)?.starts_with(b"\xef\xbb\xbf") { 3 } else { 0 };
    src.consume(mark);
    let mark = mark as u64;
    let mut reader = Reader::from_reader(src);
    reader.config_mut().expand_empty_elements = true;
    let mut state = XmlState::default();
    let mut buf = Vec::new();
    loop {
        let before = mark + reader.buffer_position();
        buf.clear();
        let event = reader.read_event_into(&mut buf).map_err(|e| {
            VolumeError::invalid(
                path,
                format!("byte {}", mark + reader.error_position()),
                format!("not XML: {e}"),
                REWRITE,
            )
        })?;
        match event {
            Event::Start(tag) => {
                let name = tag.local_name().as_ref().to_owned();
                if name == "AppendedData" {
                    let raw = XmlAttributes::of(path, &name, &tag)?.get("encoding").is_some_and(|e| e == "raw");
                    let start = mark + reader.buffer_position();
                    state.appended = Some((underscore(path, reader.into_inner(), start)?, raw));
                    break;
                }
                state.start(path, &name, &tag)?;
            }
            Event::End(tag) => {
                let name = tag.local_name().as_ref().to_owned();
                if state.end(&name) {
                    break;
                }
            }
            Event::Text(text) => state.text(before, text.as_ref()),
            Event::Eof => {
                let problem = if state.kind_seen { "ends before </VTKFile>" } else { "has no VTKFile element" };
                return Err(VolumeError::invalid(path, "VTKFile", problem, REWRITE));
            }
            _ => {}
        }
    }
    state.finish(path)
}

/// The byte after the underscore that starts appended data.
fn underscore(path: &Path, src: impl BufRead, start: u64) -> Result<u64, VolumeError> {
    for (i, byte) in src.bytes().enumerate() {
        match byte.map_err(|e| VolumeError::io(path, "read the file", e, "check the file system"))? {
            b'_' => return Ok(start + i as u64 + 1),
            b if b.is_ascii_whitespace() => {}
            _ => break,
        }
    }
    Err(VolumeError::invalid(path, "AppendedData", "does not start with an underscore", REWRITE))
}

/// The parser's state.
#[derive(Debug, Default)]
struct XmlState {
    kind_seen: bool,
    big_endian: bool,
    wide: bool,
    compressor: String,
    image: Option<Image>,
    piece: Option<[i32; 6]>,
    point: ArraySection,
    cell: ArraySection,
    /// Inside `PointData` (false) or `CellData` (true).
    section: Option<bool>,
    array: Option<Array>,
    /// Depth of elements inside the array, which are not its text.
    inside: usize,
    appended: Option<(u64, bool)>,
}

impl XmlState {
    fn start(&mut self, path: &Path, name: &str, tag: &BytesStart<'_>) -> Result<(), VolumeError> {
        if self.array.is_some() {
            self.inside += 1;
            return Ok(());
        }
        let bad = |field: &str, problem: String, hint: &str| Err(VolumeError::invalid(path, field, problem, hint));
        if !self.kind_seen && name != "VTKFile" {
            return bad("VTKFile", format!("the file starts with <{name}>"), "give a .vti file (VTK XML image data)");
        }
        match name {
            "VTKFile" => self.file(path, &XmlAttributes::of(path, name, tag)?)?,
            "ImageData" => {
                let at = XmlAttributes::of(path, name, tag)?;
                let extent = at.numbers("WholeExtent")?.ok_or_else(|| at.missing("WholeExtent"))?;
                let spacing = at.numbers("Spacing")?.unwrap_or([1.0; 3]);
                let origin = at.numbers("Origin")?.unwrap_or([0.0; 3]);
                let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
                let direction = at.numbers("Direction")?.unwrap_or(identity);
                self.image = Some(Image { extent, spacing, origin, direction });
            }
            "Piece" => {
                if self.piece.is_some() {
                    return bad("Piece", "more than one piece".to_owned(), "write the image as one piece");
                }
                let at = XmlAttributes::of(path, name, tag)?;
                let whole = self.image.map(|image| image.extent);
                self.piece = Some(at.numbers("Extent")?.or(whole).ok_or_else(|| at.missing("Extent"))?);
            }
            "PointData" | "CellData" if self.piece.is_some() => {
                let active = XmlAttributes::of(path, name, tag)?.get("Scalars").map(str::to_owned);
                self.section = Some(name == "CellData");
                self.current().active = active;
            }
            "DataArray" if self.section.is_some() => {
                let at = XmlAttributes::of(path, name, tag)?;
                let text = |key: &str, default: &str| at.get(key).unwrap_or(default).to_owned();
                self.array = Some(Array {
                    name: text("Name", ""),
                    kind: text("type", ""),
                    format: text("format", "ascii").to_ascii_lowercase(),
                    components: at.numbers("NumberOfComponents")?.map_or(1, |[n]: [u64; 1]| n),
                    offset: at.numbers("offset")?.map_or(0, |[n]: [u64; 1]| n),
                    text: None,
                });
                self.inside = 0;
            }
            _ => {}
        }
        Ok(())
    }

    fn file(&mut self, path: &Path, at: &XmlAttributes<'_>) -> Result<(), VolumeError> {
        let bad = |field: &str, value: &str, hint: &str| {
            Err(VolumeError::invalid(path, field, format!("cannot read \"{value}\""), hint))
        };
        match at.get("type").unwrap_or("") {
            "ImageData" => {}
            "PImageData" => return bad("type", "PImageData", "give the pieces (.vti) or write one serial file"),
            other => return bad("type", other, "only ImageData has a regular grid: resample in VTK or ParaView"),
        }
        self.big_endian = match at.get("byte_order").unwrap_or("LittleEndian") {
            "LittleEndian" => false,
            "BigEndian" => true,
            other => return bad("byte_order", other, "use LittleEndian or BigEndian"),
        };
        self.wide = match at.get("header_type").unwrap_or("UInt32") {
            "UInt32" => false,
            "UInt64" => true,
            other => return bad("header_type", other, "use UInt32 or UInt64"),
        };
        self.compressor = at.get("compressor").unwrap_or("").to_owned();
        self.kind_seen = true;
        Ok(())
    }

    fn current(&mut self) -> &mut ArraySection {
        if self.section == Some(true) { &mut self.cell } else { &mut self.point }
    }

    /// Closes an element; true at the end of the file's root.
    fn end(&mut self, name: &str) -> bool {
        if self.array.is_some() {
            if self.inside > 0 {
                self.inside -= 1;
            } else if let Some(array) = self.array.take() {
                self.current().arrays.push(array);
            }
            return false;
        }
        if name == "PointData" || name == "CellData" {
            self.section = None;
        }
        name == "VTKFile"
    }

    fn text(&mut self, start: u64, text: &str) {
        if let Some(array) = &mut self.array
            && self.inside == 0
            && array.text.is_none()
            && !text.bytes().all(|b| b.is_ascii_whitespace())
        {
            array.text = Some((start, text.len() as u64));
        }
    }

    fn finish(self, path: &Path) -> Result<VtiDocument, VolumeError> {
        let missing = |field: &str| {
            VolumeError::invalid(path, field, "the file has none", "write the image again as a serial .vti file")
        };
        let image = self.image.ok_or_else(|| missing("ImageData"))?;
        let piece_extent = self.piece.ok_or_else(|| missing("Piece"))?;
        let endian = if self.big_endian { Endian::Big } else { Endian::Little };
        let Self { wide, compressor, point, cell, appended, .. } = self;
        Ok(VtiDocument { endian, wide, compressor, image, piece_extent, point, cell, appended })
    }
}

/// The attributes of one element.
struct XmlAttributes<'a> {
    path: &'a Path,
    element: String,
    list: Vec<(String, String)>,
}

impl<'a> XmlAttributes<'a> {
    fn of(path: &'a Path, element: &str, tag: &BytesStart<'_>) -> Result<Self, VolumeError> {
        let bad = |e: String| VolumeError::invalid(path, element, format!("bad attribute: {e}"), REWRITE);
        let mut list = Vec::new();
        // the check for repeated names takes quadratic time, which a hostile file could exploit
        for attribute in tag.attributes().with_checks(false) {
            let attribute = attribute.map_err(|e| bad(e.to_string()))?;
            let value = quick_xml::escape::unescape(&attribute.value).map_err(|e| bad(e.to_string()))?;
            list.push((attribute.key.as_ref().to_owned(), value.into_owned()));
        }
        Ok(Self { path, element: element.to_owned(), list })
    }

    fn get(&self, key: &str) -> Option<&str> {
        self.list.iter().find(|(k, _)| k == key).map(|(_, v)| v.trim())
    }

    /// Exactly `N` numbers, or none if the attribute is absent.
    fn numbers<T: std::str::FromStr, const N: usize>(&self, key: &str) -> Result<Option<[T; N]>, VolumeError> {
        let Some(text) = self.get(key) else { return Ok(None) };
        let values: Option<Vec<T>> = text.split_ascii_whitespace().map(|t| t.parse().ok()).collect();
        match values.and_then(|v| v.try_into().ok()) {
            Some(values) => Ok(Some(values)),
            None => Err(VolumeError::invalid(
                self.path,
                format!("{} {key}", self.element),
                format!("\"{text}\" is not {N} numbers of the expected type"),
                "write them as plain numbers separated by spaces",
            )),
        }
    }

    fn missing(&self, key: &str) -> VolumeError {
        VolumeError::invalid(self.path, &self.element[..], format!("lacks {key}"), REWRITE)
    }
}
