use super::*;
use crate::volume::grid::ScalarType;
use flate2::{Compression, write::ZlibEncoder};
use proptest::prelude::*;
use std::io::Write;

/// How a test file stores its array.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    Ascii,
    Inline,
    AppendedBase64,
    AppendedRaw,
}
use Form::{AppendedBase64, AppendedRaw, Ascii, Inline};

const FORMS: [Form; 4] = [Ascii, Inline, AppendedBase64, AppendedRaw];
const PACKERS: [&str; 3] = ["", "vtkZLibDataCompressor", "vtkLZ4DataCompressor"];

fn base64(bytes: &[u8]) -> Vec<u8> {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = Vec::new();
    for c in bytes.chunks(3) {
        let w = c.iter().enumerate().fold(0u32, |w, (i, b)| w | u32::from(*b) << (16 - 8 * i));
        for i in 0..4 {
            let letter = LETTERS[(w >> (18 - 6 * i)) as usize & 63];
            out.push(if i <= c.len() { letter } else { b'=' });
        }
    }
    out
}

/// Header and data of the block form of a compressor, or length and bytes without one.
fn packed(bytes: &[u8], packer: &str, block: usize) -> (Vec<u8>, Vec<u8>) {
    let pack = |b: &[u8]| {
        if packer.contains("LZ4") {
            return lz4_flex::block::compress(b);
        }
        let mut e = ZlibEncoder::new(Vec::new(), Compression::fast());
        e.write_all(b).unwrap();
        e.finish().unwrap()
    };
    let word = |n: usize| (n as u32).to_le_bytes();
    if packer.is_empty() {
        return (word(bytes.len()).to_vec(), bytes.to_vec());
    }
    let blocks: Vec<_> = bytes.chunks(block).map(pack).collect();
    let mut head: Vec<u8> = [blocks.len(), block, bytes.len() % block].iter().flat_map(|n| word(*n)).collect();
    head.extend(blocks.iter().flat_map(|b| word(b.len())));
    (head, blocks.concat())
}

/// The values 0, 1, ... 23 as `Int16` on a 2 x 3 x 4 grid whose extent starts at 1, 2, 3.
fn file(form: Form, packer: &str, block: usize) -> Vec<u8> {
    let values: Vec<u8> = (0..24i16).flat_map(i16::to_le_bytes).collect();
    let (head, data) = packed(&values, packer, block);
    let encoded = [base64(&head), base64(&data)].concat();
    let inline: Vec<u8> = match form {
        Ascii => (0..24).map(|v| format!("{v}\n ")).collect::<String>().into(),
        Inline => encoded.clone(),
        _ => Vec::new(),
    };
    let format = match form {
        Ascii => "ascii",
        Inline => "binary",
        _ => "appended",
    };
    let mut out = format!(
        r#"<?xml version="1.0"?>
<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt32" compressor="{packer}">
 <ImageData WholeExtent="1 2 2 4 3 6" Origin="10 20 30" Spacing="0.5 1 2">
  <FieldData><DataArray type="Float64" Name="TimeValue" NumberOfTuples="1" format="ascii">0</DataArray></FieldData>
  <Piece Extent="1 2 2 4 3 6">
   <PointData Scalars="rho">
    <DataArray type="Int16" Name="rho" format="{format}" RangeMin="0" offset="3">
     <InformationKey name="L2_NORM_RANGE"><Value index="0">7</Value></InformationKey>
     "#
    )
    .into_bytes();
    out.extend(inline);
    out.extend(b"\n</DataArray></PointData><CellData/></Piece></ImageData>\n");
    match form {
        AppendedBase64 => out.extend([&b"<AppendedData encoding=\"base64\">\n _xyz"[..], &encoded].concat()),
        AppendedRaw => out.extend([&b"<AppendedData encoding=\"raw\">\n _xyz"[..], &head, &data].concat()),
        _ => {}
    }
    if matches!(form, AppendedBase64 | AppendedRaw) {
        out.extend(b"\n</AppendedData>");
    }
    out.extend(b"</VTKFile>\n");
    out
}

/// An ascii file with the given content of `Piece`, on 2 x 2 x 1 points.
fn small(content: &str) -> Vec<u8> {
    format!(
        "<VTKFile type=\"ImageData\"><ImageData WholeExtent=\"0 1 0 1 0 0\"><Piece Extent=\"0 1 0 1 0 0\">{content}\
         </Piece></ImageData></VTKFile>"
    )
    .into_bytes()
}

fn load(bytes: &[u8]) -> Result<(VolumeHeader, Vec<f32>), VolumeError> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.vti");
    std::fs::write(&path, bytes).unwrap();
    let file = open(&path, None)?;
    let mut out = vec![9.0];
    file.read(0, &mut out)?;
    assert!(file.read(1, &mut Vec::new()).is_err());
    Ok((file.header().clone(), out))
}

fn message(bytes: &[u8]) -> String {
    load(bytes).unwrap_err().to_string()
}

/// The result for a file with one piece of text changed.
fn changed(bytes: &[u8], from: &str, to: &str) -> Result<(VolumeHeader, Vec<f32>), VolumeError> {
    let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
    load(&[&bytes[..at], to.as_bytes(), &bytes[at + from.len()..]].concat())
}

#[test]
fn reads_every_form_and_packing() {
    for form in FORMS {
        for packer in PACKERS {
            // one block of 48 bytes is the whole array, 16 divides it, 7 splits values across blocks
            for block in [48, 7, 16] {
                let (h, values) = load(&file(form, packer, block)).unwrap();
                assert_eq!((h.grid.dims, h.scalar, h.steps), ([2, 3, 4], ScalarType::I16, 1));
                assert_eq!((h.grid.origin, h.grid.spacing), ([10.5, 22.0, 36.0], [0.5, 1.0, 2.0]));
                assert!(h.notes.is_empty(), "{:?}", h.notes);
                assert!(values.iter().enumerate().all(|(i, v)| *v == i as f32) && values.len() == 24, "{form:?}");
            }
        }
    }
}

#[test]
fn reads_wide_big_endian_headers_and_joined_base64() {
    let bytes: Vec<u8> = 8u64.to_be_bytes().into_iter().chain([1u16, 2, 3, 4].map(u16::to_be_bytes).concat()).collect();
    let text = String::from_utf8(base64(&bytes)).unwrap();
    let content =
        format!("<PointData><DataArray Name=\"a\" type=\"UInt16\" format=\"binary\">{text}</DataArray></PointData>");
    let head = "type=\"ImageData\" byte_order=\"BigEndian\" header_type=\"UInt64\"";
    let (_, values) = changed(&small(&content), "type=\"ImageData\"", head).unwrap();
    assert_eq!(values, [1.0, 2.0, 3.0, 4.0]);
}

fn array(name: &str, components: usize, values: &str) -> String {
    format!("<DataArray Name=\"{name}\" type=\"Float32\" NumberOfComponents=\"{components}\">{values}</DataArray>")
}

#[test]
fn chooses_the_active_then_the_first_array() {
    let vector = array("v", 3, "0 0 0 0 0 0 0 0 0 0 0 0");
    let [a, b] = [array("a", 1, "1 nan -inf 4e-1"), array("b", 1, "5 6 7 8")];
    let read = |active: &str, arrays: &[&String]| {
        let arrays: String = arrays.iter().map(|s| s.as_str()).collect();
        load(&small(&format!("<PointData {active}>{arrays}</PointData>")))
    };
    let (h, values) = read("Scalars=\"b\" Vectors=\"v\"", &[&vector, &a, &b]).unwrap();
    assert_eq!((h.notes.len(), &values[..]), (0, &[5.0, 6.0, 7.0, 8.0][..]));
    let (h, values) = read("", &[&vector, &a, &b]).unwrap();
    assert!(
        h.notes[0].contains("\"a\"") && h.notes[0].contains("not read: b; choose with --variable"),
        "{:?}",
        h.notes
    );
    assert!(values[1].is_nan() && values[2] == f32::NEG_INFINITY && values[3] == 0.4);
    let (h, _) = read("Scalars=\"v\"", &[&vector, &a]).unwrap();
    assert!(h.notes[0].contains("skipped"), "{:?}", h.notes);
    let e = read("Scalars=\"v\"", &[&vector]).unwrap_err().to_string();
    assert!(e.contains("v (3 components)"), "{e}");
    assert!(message(&small("<PointData/>")).contains("no DataArray"));
}

#[test]
fn reads_cells_when_points_have_nothing() {
    let (h, values) = load(&small(&format!("<PointData/><CellData>{}</CellData>", array("c", 1, "7")))).unwrap();
    assert_eq!((h.grid.dims, h.grid.origin, &values[..]), ([1, 1, 1], [0.5, 0.5, 0.0], &[7.0][..]));
    assert!(h.notes[0].contains("cells"));
}

#[test]
fn reads_sixty_four_bit_integers() {
    let content = "<PointData><DataArray Name=\"a\" type=\"Int64\">1 -2 3 9007199254740993</DataArray></PointData>";
    let (h, values) = load(&small(content)).unwrap();
    assert_eq!((h.scalar, values[1], values[3]), (ScalarType::I64, -2.0, 9007199254740993i64 as f32));
}

#[test]
fn says_what_is_wrong() {
    let ascii = file(Ascii, "", 48);
    let says = |from: &str, to: &str, words: &str| {
        let e = changed(&ascii, from, to).unwrap_err().to_string();
        assert!(e.contains(words), "{to}: {e}");
    };
    says("type=\"ImageData\"", "type=\"PImageData\"", "pieces");
    says("type=\"ImageData\"", "type=\"PolyData\"", "regular grid");
    says("LittleEndian", "Middle", "byte_order");
    says("UInt32", "Int8", "header_type");
    says("1 2 2 4 3 6\" Origin", "1 2 2 4 3\" Origin", "6 numbers");
    says("WholeExtent=", "Other=", "lacks WholeExtent");
    says("<Piece Extent=\"1 2 2 4 3 6\"", "<Piece Extent=\"3 2 2 4 3 6\"", "no voxel");
    says("<Piece Extent=\"1 2 2 4 3 6\"", "<Piece Extent=\"0 9999 0 9999 0 9999\"", "more than the file");
    says("<Piece Extent=\"1 2 2 4 3 6\"", "<Piece Extent=\"1 2 2 4 3 7\"", "truncated");
    says("<Piece Extent=\"1 2 2 4 3 6\"", "<Piece Extent=\"1 2 2 4 3 5\"", "more values");
    says("<Piece ", "<Piece Extent=\"0 0 0 0 0 0\"></Piece><Piece ", "more than one piece");
    says("Spacing=\"0.5", "Spacing=\"-1", "Spacing");
    says("Origin=\"10", "Origin=\"nan", "finite");
    says("Origin=\"10", "Origin=\"1e300", "not a valid position");
    says("Spacing=\"0.5", "Spacing=\"1e308", "not a valid spacing");
    says("type=\"Int16\"", "type=\"Bit\"", "unknown type");
    says("format=\"ascii\" RangeMin", "format=\"hex\" RangeMin", "unknown format");
    says("format=\"ascii\" RangeMin", "format=\"appended\" RangeMin", "AppendedData");
    says("14\n", "1x4\n", "\"1x4\"");
    says("14\n", "99999\n", "\"99999\"");
    says("</PointData>", "</PointDat>", "not XML");
    says("</VTKFile>", "", "ends before");
    assert!(message(b"").contains("no VTKFile"));
    assert!(message(b"\x89PNG\r\n").contains("VTKFile") || message(b"\x89PNG\r\n").contains("XML"));
    assert!(message(b"<html/>").contains("<html>"));
    assert!(message(&file(Inline, "vtkLZMADataCompressor", 48)).contains("vtkLZMADataCompressor"));
    assert!(open(Path::new("no/such.vti"), None).unwrap_err().to_string().contains("open the file"));
}

#[test]
fn says_what_is_wrong_with_blocks() {
    for (packer, words) in PACKERS.into_iter().zip(["the array holds", "do not make", "do not make"]) {
        for form in [Inline, AppendedBase64, AppendedRaw] {
            let bytes = file(form, packer, 48);
            let e = changed(&bytes, "<Piece Extent=\"1 2", "<Piece Extent=\"2 2").unwrap_err().to_string();
            assert!(e.contains(words), "{e}");
            let end = bytes.len() - b"\n</AppendedData></VTKFile>\n".len();
            if form != Inline {
                assert!(message(&bytes[..end - 9]).contains("the file"), "{form:?} {packer}");
                assert!(load(&bytes[..end]).is_ok(), "only the closing tags are lost");
            }
        }
    }
    let raw = file(AppendedRaw, "vtkZLibDataCompressor", 16);
    let start = raw.windows(4).position(|w| w == b"_xyz").unwrap() + 4;
    let mut huge = raw.clone();
    huge[start..start + 4].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(message(&huge).contains("do not make"));
    let mut broken = raw;
    broken[start + 24] ^= 0xff;
    assert!(message(&broken).contains("block 0"));
    let inline = file(Inline, "", 48);
    let letters = String::from_utf8(base64(&[0, 0, 1, 0, 2, 0])).unwrap();
    let e = changed(&inline, &letters, &format!("{}!", &letters[1..])).unwrap_err().to_string();
    assert!(e.contains("not base64"), "{e}");
}

#[test]
fn keeps_directions_and_notes_a_partial_piece() {
    let bytes = file(Ascii, "", 48);
    // row by row: the image's x leads along z, its y backwards along x; the first value is at 1, 2, 3
    let turn = |d: &str| changed(&bytes, "Spacing=", &format!("Direction=\"{d}\" Spacing="));
    let (h, _) = turn("0 -1 0 0 0 1 1 0 0").unwrap();
    assert_eq!(h.grid.steps().to_cols_array_2d(), [[0.0, 0.0, 0.5], [-1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]);
    assert_eq!((h.grid.origin, h.notes.len()), ([10.0 - 2.0, 20.0 + 6.0, 30.0 + 0.5], 0));
    let sheared = turn("1 0.2 0 0 1 0 0 0 1").unwrap_err().to_string();
    assert!(sheared.contains("Direction") && sheared.contains("perpendicular"), "{sheared}");
    assert!(turn("1 0 0 0 0 0 0 0 1").unwrap_err().to_string().contains("Direction"));
    assert_eq!(load(&[b"\xef\xbb\xbf", &bytes[..]].concat()).unwrap().1[23], 23.0, "byte order mark");
    let (h, _) = changed(&bytes, "WholeExtent=\"1 2", "WholeExtent=\"0 9").unwrap();
    assert!(h.notes[0].contains("WholeExtent"));
}

proptest! {
    #[test]
    fn damage_never_panics(
        form in 0usize..4,
        packer in 0usize..3,
        edits in prop::collection::vec((any::<usize>(), any::<u8>(), 0usize..4), 1..6),
        cut in prop::option::of(any::<usize>()),
    ) {
        let mut f = file(FORMS[form], PACKERS[packer], 16);
        for (at, b, way) in edits {
            let at = at % f.len();
            match way {
                0 => { f.remove(at); }
                1 => f.insert(at, b),
                2 => f[at] = b'0' + b % 10,
                _ => f[at] = b,
            }
        }
        if let Some(cut) = cut {
            f.truncate(cut % f.len());
        }
        if let Ok((h, values)) = load(&f) {
            prop_assert_eq!(values.len(), h.grid.len());
        }
    }

    #[test]
    fn damaged_blocks_never_panic(
        packer in 0usize..3,
        edits in prop::collection::vec((any::<usize>(), any::<u8>()), 1..6),
    ) {
        let mut f = file(AppendedRaw, PACKERS[packer], 16);
        let start = f.windows(4).position(|w| w == b"_xyz").unwrap() + 4;
        for (at, b) in edits {
            let n = f.len() - start;
            f[start + at % n] = b;
        }
        if let Ok((h, values)) = load(&f) {
            prop_assert_eq!(values.len(), h.grid.len());
        }
    }
}

#[test]
fn an_array_is_chosen_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.vti");
    let array = |name: &str, components: usize, values: &str| {
        format!(
            "<DataArray type=\"Float32\" Name=\"{name}\" NumberOfComponents=\"{components}\" format=\"ascii\">{values}</DataArray>"
        )
    };
    let point = array("a", 1, "1 2 3 4") + &array("u", 3, "0 0 0 0 0 0 0 0 0 0 0 0") + &array("b", 1, "5 6 7 8");
    let content = format!("<PointData Scalars=\"b\">{point}</PointData><CellData>{}</CellData>", array("c", 1, "9"));
    std::fs::write(&path, small(&content)).unwrap();
    for (wanted, read, first) in [(None, "b", 5.0), (Some("a"), "a", 1.0), (Some("b"), "b", 5.0), (Some("c"), "c", 9.0)]
    {
        let file = open(&path, wanted).unwrap();
        let mut out = Vec::new();
        file.read(0, &mut out).unwrap();
        assert_eq!((file.variable(), out[0]), (Some(read), first));
        let names: Vec<(&str, u64)> = file.variables().iter().map(|v| (v.name.as_str(), v.components)).collect();
        assert_eq!(names, [("a", 1), ("u", 3), ("b", 1), ("c", 1)]);
    }
    let refused = |name: &str| open(&path, Some(name)).unwrap_err().to_string();
    assert!(refused("rho").contains("no array \"rho\" among a, u (3 components), b, c"), "{}", refused("rho"));
    assert!(refused("u").contains("\"u\": has 3 components") && refused("u").contains("magnitude"), "{}", refused("u"));
}
