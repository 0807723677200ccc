//! Volume files.

use crate::driver::{Scratch, Target, accepted, fuzz};
use base64::Engine;
use flate2::{Compression, write::GzEncoder, write::ZlibEncoder};
use std::io::Write;
use std::path::Path;
use volseggs::volume::formats;
use volseggs::volume::series::{Series, SeriesOptions};

/// Opens a volume, reads steps of it, and does what `inspect` does.
fn volume(path: &Path) -> bool {
    let Some(file) = accepted(formats::open(path)) else { return false };
    let header = file.header().clone();
    assert!(header.steps > 0 && !header.grid.is_empty());
    let mut values = Vec::new();
    for step in [0, header.steps - 1, header.steps] {
        if accepted(file.read(step, &mut values)).is_some() {
            assert!(step < header.steps && values.len() == header.grid.len(), "step {step} of {header:?}");
        }
    }
    drop(values);
    let options = SeriesOptions { nan_as: Some(0.0), ..SeriesOptions::default() };
    if let Some(series) = accepted(Series::open(&[path.to_string_lossy().into_owned()], &options)) {
        let _ = (series.name(0), series.time(series.len()), series.notes().len(), series.grid().size());
        if series.len() <= 4 {
            accepted(series.load_labels(0));
            if let Some(range) = accepted(series.range()) {
                accepted(series.histogram(0, 16, range));
            }
        }
    }
    true
}

fn at(scratch: &Scratch, name: &str, corpus: Vec<Vec<u8>>) -> Target {
    let path = scratch.path(name);
    let scratch = scratch.clone();
    let read = move |bytes: &[u8]| {
        scratch.overwrite(&path, bytes);
        volume(&path)
    };
    // gzip and zlib expand a thousandfold, and a byte becomes an f32; the names of a pattern of files may take 64 MiB,
    // and twice that while they are made
    Target::new(corpus, read).sizes(8 << 10, 160)
}

fn gzip(bytes: &[u8], level: u32) -> Vec<u8> {
    let mut out = GzEncoder::new(Vec::new(), Compression::new(level));
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

fn values() -> Vec<u8> {
    (0..24u16).flat_map(|v| (v * 7).to_le_bytes()).collect()
}

const TYPES: &[&str] = &["u8", "i8", "u16", "f32", "f64", "uint64", "int", "big", "little", "raw", "gzip", "ascii"];

#[test]
fn raw_with_toml() {
    fuzz("raw-toml", |scratch| {
        let path = scratch.write("a.raw", &values());
        let side = scratch.path("a.raw.toml");
        let scratch = scratch.clone();
        let seeds = [
            "dims = [2, 3, 4]\ntype = \"u16\"\nendian = \"little\"\nspacing = [1.0, 0.5, 2.0]\norigin = [0.0, -1.0, 3]\n",
            "dims = [1, 3, 4, 2]\ntype = \"i16\"\nendian = \"big\"\noffset = 0\n",
            "dims = [2, 2, 5]\ntype = \"u8\"\noffset = 8\nsteps = 2\n",
        ];
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&side, bytes);
            volume(&path)
        };
        Target::new(seeds.map(|s| s.as_bytes().to_vec()).to_vec(), read).tokens(TYPES)
    });
}

#[test]
fn raw_with_json() {
    fuzz("raw-json", |scratch| {
        let path = scratch.write("a.raw", &values());
        let side = scratch.path("a.json");
        let scratch = scratch.clone();
        let seeds = [
            r#"{"dims": [2, 3, 4], "type": "u16", "endian": "little", "spacing": [1, 0.5, 2], "origin": [0, -1, 3]}"#,
            r#"{"dims": [2, 3, 2, 2], "type": "short", "offset": 0, "steps": 2}"#,
        ];
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&side, bytes);
            volume(&path)
        };
        Target::new(seeds.map(|s| s.as_bytes().to_vec()).to_vec(), read).tokens(TYPES)
    });
}

fn npy_file(header: &str, version: u8) -> Vec<u8> {
    let mut bytes = b"\x93NUMPY".to_vec();
    bytes.extend([version, 0]);
    let length = header.len() as u32;
    bytes.extend(if version == 1 { (length as u16).to_le_bytes().to_vec() } else { length.to_le_bytes().to_vec() });
    bytes.extend(header.as_bytes());
    bytes.extend(values());
    bytes
}

#[test]
fn npy() {
    fuzz("npy", |scratch| {
        let seeds = vec![
            npy_file("{'descr': '<u2', 'fortran_order': False, 'shape': (2, 3, 4), }\n", 1),
            npy_file("{'descr': '>i2', 'fortran_order': True, 'shape': (2, 1, 3, 4), }\n", 2),
            npy_file("{'descr': '|u1', 'fortran_order': True, 'shape': (4, 4, 3), }", 3),
        ];
        let tokens = &["'descr'", "'shape'", "True", "False", "(", ")", "'<f4'", "'<f8'", "'|b1'", "L", ",", "{", "}"];
        at(scratch, "a.npy", seeds).tokens(tokens)
    });
}

const NRRD: &[&str] = &[
    "type: ",
    "dimension: ",
    "sizes: ",
    "encoding: ",
    "endian: ",
    "spacings: ",
    "space directions: ",
    "space origin: ",
    "kinds: ",
    "line skip: ",
    "byte skip: ",
    "data file: ",
    "data file: LIST\n",
    "a.raw",
    "%03d.raw 0 9 1",
    "data file: %d.raw 0 1000000 1\n",
    "(1,0,0)",
    "none",
    "domain",
    "time",
    "vector",
    "raw",
    "gzip",
    "ascii",
    "double",
    "uchar",
    "NRRD0005\n",
    "\n\n",
    "-1",
];

fn nrrd_header(more: &str) -> String {
    format!("NRRD0004\n# made by hand\ntype: ushort\n{more}endian: little\nspace origin: (0,0.5,-1)\ncontent: x\n")
}

#[test]
fn nrrd() {
    fuzz("nrrd", |scratch| {
        let axes = "dimension: 3\nsizes: 2 3 4\nspacings: 1 2 0.5\n";
        let with = |header: String, data: &[u8]| [header.as_bytes(), b"\n", data].concat();
        let four = "dimension: 4\nsizes: 2 2 3 2\nkinds: time domain domain domain\nspace directions: none (1,0,0) (0,1,0) (0,0,2)\n";
        let text: String = (0..24).map(|v| format!("{v} ")).collect();
        let skip = nrrd_header(&format!("{axes}encoding: raw\nline skip: 1\nbyte skip: -1\n"));
        let seeds = vec![
            with(nrrd_header(&format!("{axes}encoding: raw\n")), &values()),
            with(nrrd_header(&format!("{axes}encoding: gzip\n")), &gzip(&values(), 6)),
            with(nrrd_header(&format!("{four}encoding: gzip\n")), &gzip(&values(), 0)),
            with(nrrd_header(&format!("{four}encoding: raw\n")), &values()),
            with(nrrd_header(&format!("{axes}encoding: ascii\n")), text.as_bytes()),
            with(skip, &[b"a line\n", &values()[..]].concat()),
            // zeros, which gzip reduces to a thousandth
            with(
                nrrd_header("dimension: 3\nsizes: 100 100 100\nencoding: gzip\n").replace("ushort", "uchar"),
                &gzip(&vec![0; 1_000_000], 9),
            ),
        ];
        at(scratch, "a.nrrd", seeds).tokens(NRRD)
    });
}

#[test]
fn nhdr() {
    fuzz("nhdr", |scratch| {
        scratch.write("a.raw", &values());
        scratch.write("a.raw.gz", &gzip(&values(), 6));
        scratch.write("a.txt", b"1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24");
        for i in 0..4 {
            scratch.write(&format!("s{i:02}.raw"), &values()[..12]);
        }
        let axes = "dimension: 3\nsizes: 2 3 4\n";
        let seeds = [
            format!("{axes}encoding: raw\ndata file: a.raw\n"),
            format!("{axes}encoding: gz\nbyte skip: 0\ndata file: a.raw.gz\n"),
            format!("{axes}encoding: txt\ndatafile: a.txt\n"),
            format!("{axes}encoding: raw\ndata file: s%02d.raw 0 3 1 2\n"),
        ];
        let mut seeds: Vec<Vec<u8>> = seeds.iter().map(|s| nrrd_header(s).into_bytes()).collect();
        let list = "encoding: raw\ndata file: LIST\ns00.raw\ns01.raw\ns02.raw\ns03.raw\n";
        seeds.push(format!("{}{list}", nrrd_header(axes)).into_bytes());
        at(scratch, "a.nhdr", seeds).tokens(NRRD)
    });
}

/// A `.vti` file of 2 x 3 x 4 values.
fn vti_file(format: &str, packer: &str, cells: bool) -> Vec<u8> {
    let pack = |bytes: &[u8]| match packer {
        "vtkLZ4DataCompressor" => lz4_flex::block::compress(bytes),
        _ => {
            let mut out = ZlibEncoder::new(Vec::new(), Compression::fast());
            out.write_all(bytes).unwrap();
            out.finish().unwrap()
        }
    };
    let words = |list: &[usize]| list.iter().flat_map(|n| (*n as u32).to_le_bytes()).collect::<Vec<u8>>();
    let values = values();
    let (head, data) = if packer.is_empty() {
        (words(&[values.len()]), values)
    } else {
        let blocks: Vec<Vec<u8>> = values.chunks(20).map(pack).collect();
        let sizes: Vec<usize> = blocks.iter().map(Vec::len).collect();
        (words(&[&[blocks.len(), 20, values.len() % 20], &sizes[..]].concat()), blocks.concat())
    };
    let base64 = |bytes: &[u8]| base64::engine::general_purpose::STANDARD.encode(bytes).into_bytes();
    let encoded = [base64(&head), base64(&data)].concat();
    let (kind, inline, appended) = match format {
        "ascii" => ("ascii", (0..24).map(|v| format!("{v} ")).collect::<String>().into_bytes(), None),
        "inline" => ("binary", encoded, None),
        "base64" => ("appended", Vec::new(), Some(encoded)),
        _ => ("appended", Vec::new(), Some([head, data].concat())),
    };
    let section = if cells { "CellData" } else { "PointData" };
    let high = if cells { [3, 5, 7] } else { [2, 4, 6] };
    let extent = format!("1 {} 2 {} 3 {}", high[0], high[1], high[2]);
    let mut out = format!(
        "<?xml version=\"1.0\"?>\n<!-- made by hand -->\n<VTKFile type=\"ImageData\" version=\"1.0\" byte_order=\"LittleEndian\" \
         header_type=\"UInt32\" compressor=\"{packer}\">\n<ImageData WholeExtent=\"{extent}\" Origin=\"0 0.5 -1\" Spacing=\"1 2 0.5\" \
         Direction=\"1 0 0 0 1 0 0 0 1\">\n<Piece Extent=\"{extent}\">\n<{section} Scalars=\"f\">\n<DataArray type=\"UInt16\" \
         Name=\"f\" NumberOfComponents=\"1\" format=\"{kind}\" offset=\"0\">\n"
    )
    .into_bytes();
    out.extend(inline);
    out.extend(format!("\n</DataArray>\n</{section}>\n</Piece>\n</ImageData>\n").bytes());
    if let Some(bytes) = appended {
        let encoding = if format == "base64" { "base64" } else { "raw" };
        out.extend(format!("<AppendedData encoding=\"{encoding}\">\n_").bytes());
        out.extend(bytes);
        out.extend(b"\n</AppendedData>\n");
    }
    out.extend(b"</VTKFile>\n");
    out
}

#[test]
fn vti() {
    fuzz("vti", |scratch| {
        let forms = ["ascii", "inline", "base64", "raw"];
        let packers = ["", "vtkZLibDataCompressor", "vtkLZ4DataCompressor"];
        let mut seeds: Vec<Vec<u8>> =
            packers.iter().flat_map(|p| forms.iter().map(|f| vti_file(f, p, false)).collect::<Vec<_>>()).collect();
        seeds.push(vti_file("raw", "", true));
        let tokens = &[
            "ascii",
            "binary",
            "appended",
            "raw",
            "base64",
            "UInt64",
            "Float64",
            "Int8",
            "BigEndian",
            "vtkZLibDataCompressor",
            "vtkLZ4DataCompressor",
            "<Piece Extent=\"0 1 0 1 0 1\">",
            "</Piece>",
            "<DataArray/>",
            "<CellData>",
            "&lt;",
            "&#0;",
            "&x;",
            "<![CDATA[",
            "]]>",
            "<!DOCTYPE a [<!ENTITY b \"c\">]>",
            "<?",
            "=\"\"",
            "NumberOfComponents=\"3\"",
        ];
        at(scratch, "a.vti", seeds).tokens(tokens)
    });
}

/// Returns a NIfTI-1 file, with the header's fields at their offsets.
fn nifti_file(dims: &[i16], swap: bool) -> Vec<u8> {
    let mut bytes = vec![0u8; 352];
    let mut put = |at: usize, value: &[u8]| {
        let mut value = value.to_vec();
        if swap {
            value.reverse();
        }
        bytes[at..at + value.len()].copy_from_slice(&value);
    };
    put(0, &348i32.to_le_bytes());
    for (i, d) in dims.iter().enumerate() {
        put(40 + 2 * i, &d.to_le_bytes());
    }
    put(70, &512i16.to_le_bytes()); // uint16
    put(72, &16i16.to_le_bytes());
    for i in 0..4 {
        put(76 + 4 * i, &1f32.to_le_bytes());
    }
    put(108, &352f32.to_le_bytes());
    put(112, &2f32.to_le_bytes());
    put(254, &1i16.to_le_bytes()); // sform
    for (row, at) in [280, 296, 312].into_iter().enumerate() {
        put(at + 4 * row, &1.5f32.to_le_bytes());
    }
    bytes[344..348].copy_from_slice(b"n+1\0");
    bytes.extend(values());
    bytes
}

#[test]
fn nifti() {
    fuzz("nifti", |scratch| {
        let seeds = vec![nifti_file(&[3, 2, 3, 4, 1, 1, 1, 1], false), nifti_file(&[4, 2, 3, 2, 2, 1, 1, 1], true)];
        at(scratch, "a.nii", seeds)
    });
}

#[test]
fn nifti_gz() {
    fuzz("nifti-gz", |scratch| {
        let plain = nifti_file(&[3, 2, 3, 4, 1, 1, 1, 1], false);
        let seeds = vec![gzip(&plain, 6), gzip(&plain, 0), [gzip(&plain[..360], 0), gzip(&plain[360..], 6)].concat()];
        at(scratch, "a.nii.gz", seeds)
    });
}

/// A compressed file that is damaged before it is compressed.
#[test]
fn nifti_packed() {
    fuzz("nifti-packed", |scratch| {
        let seeds = vec![nifti_file(&[3, 2, 3, 4, 1, 1, 1, 1], false), nifti_file(&[4, 2, 3, 2, 2, 1, 1, 1], false)];
        at(scratch, "a.nii.gz", seeds).assemble(|bytes| gzip(&bytes, 1))
    });
}
