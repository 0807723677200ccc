//! NRRD headers and data: what is read, what is refused and how fast, and that nothing panics.

use super::super::open;
use super::super::tests::{all, dir, endians, mutated, refused, scalars, stored, survive};
use super::*;
use crate::data::calibration::AxisConvention;
use crate::volume::directions::Directions;
use crate::volume::source::{PhysicalMetadata, TimeAxis};
use flate2::{Compression, write::GzEncoder};
use proptest::prelude::*;
use std::fs::write;
use std::io::Write;

fn gz(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// A file of the given header lines (after the magic) and data.
fn file(lines: &str, data: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let d = dir();
    let p = d.path().join("a.nrrd");
    write(&p, [format!("NRRD0005\n{lines}\n\n").as_bytes(), data].concat()).unwrap();
    (d, p)
}

const U8: &str = "type: uchar\ndimension: 3\nsizes: 2 2 1\nencoding: raw";

#[test]
fn attached_raw_with_notes() {
    let (_d, p) = file(
        "# comment\ncontent: a:b\nkey:=value: x\nType: unsigned  short\ndimension: 3\nsizes: 2 1 2\nendian: big\n\
         encoding: RAW\nspace: left-posterior-superior\nspace directions: (0,2,0) (3, 0, 0) (0,0,0.5)\n\
         space origin: (1,2,-3)\nwarp: 9",
        &[0, 1, 0, 2, 1, 0, 0, 4],
    );
    let header = open(&p).unwrap().header().clone();
    let directions = Directions::of_steps([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).unwrap().0;
    assert_eq!(header.grid, Grid { dims: [2, 1, 2], spacing: [2.0, 3.0, 0.5], origin: [1.0, 2.0, -3.0], directions });
    assert_eq!(header.physical.axes, Some(AxisConvention::LeftPosteriorSuperior));
    assert_eq!(all(&p), [[1.0, 2.0, 256.0, 4.0]]);
    assert!(header.notes.iter().any(|n| n.contains("\"warp\" ignored")), "{:?}", header.notes);
    assert_eq!(header.notes.len(), 1, "{:?}", header.notes);
}

#[test]
fn space_units_and_times_are_kept() {
    let read = |more: &str| {
        let (_d, p) = file(&format!("{U8}\n{more}"), b"abcd");
        open(&p).unwrap().header().clone()
    };
    let flipped = "space directions: (-2,0,0) (0,0,3) (0,-0.5,0)\nspace origin: (30,40,-7)";
    let steps = |h: &VolumeHeader| h.grid.steps().to_cols_array_2d();
    let ras = read(&format!("space: RAS\n{flipped}\nspace units: \"mm\" \"mm\" \"mm\""));
    assert_eq!(steps(&ras), [[-2.0, 0.0, 0.0], [0.0, 0.0, 3.0], [0.0, -0.5, 0.0]]);
    let PhysicalMetadata { length_unit, axes, time } = &ras.physical;
    let known = (length_unit.as_deref(), *axes, time);
    assert_eq!(known, (Some("mm"), Some(AxisConvention::RightAnteriorSuperior), &None));
    assert!(ras.notes.is_empty(), "{:?}", ras.notes);
    // a left-handed space is converted
    let las = read(&format!("space: left-anterior-superior\n{flipped}"));
    assert_eq!((steps(&las)[0], las.grid.origin), ([2.0, 0.0, 0.0], [-30.0, 40.0, -7.0]));
    assert_eq!((las.physical.axes, las.physical.length_unit.clone()), (ras.physical.axes, None));
    assert!(las.notes[0].contains("x changes its sign"), "{:?}", las.notes);
    let left = read(&format!("space: 3D-left-handed\n{flipped}"));
    assert_eq!((steps(&left)[1], left.grid.origin, left.physical.axes), ([0.0, 0.0, -3.0], [30.0, 40.0, 7.0], None));
    // without directions
    let plain = read("spacings: 1 -2 3\nunits: \"um\" \"um\" \"um\"");
    assert_eq!((plain.grid.spacing, steps(&plain)[1]), ([1.0, 2.0, 3.0], [0.0, -2.0, 0.0]));
    assert_eq!(plain.physical.length_unit.as_deref(), Some("um"));
    assert_eq!(read("content: none").physical.length_unit.as_deref(), Some("voxels"));
    let mixed = read("spacings: 1 2 3\nunits: \"mm\" \"mm\" \"cm\"");
    assert!(mixed.physical.length_unit.is_none() && mixed.notes[0].contains("mm, mm, cm"), "{:?}", mixed.notes);
    let odd = read(&format!("space: sideways\n{flipped}"));
    assert!(odd.physical.axes.is_none() && odd.notes[0].contains("sideways"));
    for (more, want) in [
        ("space directions: (1,0,0) (0.1,1,0) (0,0,1)", "perpendicular"),
        ("space directions: (1,0,0) (0,1,0) none", "no vector for axis 2"),
        ("space directions: (1,0) (0,1) (1,1)", "three components"),
        ("space directions: (1,0,0) (0,nan,0) (0,0,1)", "not a valid spacing"),
    ] {
        let (_d, p) = file(&format!("{U8}\n{more}"), b"abcd");
        assert!(refused(&p).contains(want), "{more}: {}", refused(&p));
    }
    let time = |more: &str| {
        let lines = format!("type: uchar\ndimension: 4\nsizes: 2 1 1 2\nencoding: raw\n{more}");
        open(&file(&lines, b"abcd").1).unwrap().header().physical.time.clone()
    };
    let axis = |start, step, unit: Option<&str>| Some(TimeAxis { start, step, unit: unit.map(str::to_owned) });
    assert_eq!(time("spacings: 1 1 1 0.5\naxis mins: 0 0 0 3\nunits: mm mm mm s"), axis(3.0, 0.5, Some("s")));
    assert_eq!(time("spacings: 1 1 1 2"), axis(0.0, 2.0, None));
    assert_eq!(time("spacings: 1 1 1 nan"), None);
    let four = "space: LPST\nspace directions: (1,0,0,0) (0,1,0,0) (0,0,1,0) (0,0,0,4)\nspace origin: (1,2,3,10)";
    assert_eq!(time(&format!("{four}\nspace units: mm mm mm ms")), axis(10.0, 4.0, Some("ms")));
}

#[test]
fn skips_and_line_ends() {
    let (_d, p) = file(&format!("{U8}\nline skip: 1\nbyte skip: 2"), b"junk\n!!abcd");
    assert_eq!(all(&p), [[97.0, 98.0, 99.0, 100.0]]);
    let (_d, p) = file(&format!("{U8}\nbyteskip: -1"), b"whatever it isabcd");
    assert_eq!(all(&p), [[97.0, 98.0, 99.0, 100.0]]);
    let d = dir();
    let p = d.path().join("a.nrrd");
    write(&p, format!("NRRD0001\n{U8}\n\nabcd").replace('\n', "\r\n")).unwrap();
    assert_eq!(all(&p), [[97.0, 98.0, 99.0, 100.0]]);
    let lines = U8.replace("raw", "gz");
    let data = [b"skipped\n".as_slice(), &gz(b"!abcd")].concat();
    let (_d, p) = file(&format!("{lines}\nline skip: 1\nbyte skip: 1"), &data);
    assert_eq!(all(&p), [[97.0, 98.0, 99.0, 100.0]]);
}

#[test]
fn ascii_numbers() {
    let lines = "type: float\ndimension: 3\nsizes: 3 1 1\nencoding: ascii";
    let (_d, p) = file(lines, b" 1.5\n-2e3\tnan\n");
    let v = all(&p);
    assert_eq!(v[0][..2], [1.5, -2000.0]);
    assert!(v[0][2].is_nan());
    assert!(refused(&file(lines, b"1     2").1).contains("found 2"));
    assert!(refused(&file(lines, b"1 2 3 4").1).contains("found 4"));
    assert!(refused(&file(lines, b"1 2 x").1).contains("\"x\" is not a valid f32"));
    assert!(refused(&file(&lines.replace("float", "uchar"), b"1 2 256").1).contains("256"));
    assert!(refused(&file(&lines.replace("3 1 1", "100000 100000 100000"), b"1 2 3").1).contains("cannot fit"));
}

#[test]
fn detached_one_list_and_pattern() {
    let d = dir();
    let folder = d.path().join("data");
    std::fs::create_dir(&folder).unwrap();
    for (name, bytes) in [("0", [1u8, 2]), ("1", [3, 4]), ("2", [5, 6])] {
        write(folder.join(format!("s0{name}.raw")), bytes).unwrap();
        write(folder.join(format!("s0{name}.gz")), gz(&bytes)).unwrap();
    }
    write(d.path().join("one.raw"), [1, 2, 3, 4, 5, 6]).unwrap();
    let p = d.path().join("a.nhdr");
    let head = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 1 3\n";
    for rest in [
        "encoding: raw\ndata file: one.raw",
        "encoding: raw\ndata file: data/../one.raw\n\nignored",
        "encoding: raw\ndatafile: data/s%02d.raw 0 2 1\n",
        "encoding: gzip\ndata file: data/s%02d.gz 0 2 1 2\n",
        "encoding: raw\ndata file: LIST\ndata/s00.raw\ndata/s01.raw\ndata/s02.raw",
    ] {
        write(&p, format!("{head}{rest}")).unwrap();
        assert_eq!(all(&p), [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]], "{rest}");
    }
    for (rest, want) in [
        ("encoding: raw\ndata file: two.raw", "two.raw does not exist"),
        ("encoding: raw\ndata file: data/s%02d.raw 0 3 1", "evenly"),
        ("encoding: raw\ndata file: LIST", "no file names"),
        ("encoding: raw\ndata file: LIST\ndata/s00.raw\ndata/s01.raw\ndata/s00.raw", "names \"data/s00.raw\" twice"),
        ("encoding: raw\ndata file: ", "is empty"),
        ("encoding: raw\ndata file: a\ndata file: b", "twice"),
        ("encoding: raw", "neither data nor a data file"),
    ] {
        write(&p, format!("{head}{rest}")).unwrap();
        assert!(refused(&p).contains(want), "{rest}: {}", refused(&p));
    }
    // a file elsewhere is read, with a note
    let notes = |rest: &str| {
        write(&p, format!("{head}encoding: raw\ndata file: {rest}")).unwrap();
        open(&p).unwrap().header().notes.join("; ")
    };
    let whole = p.with_file_name("one.raw");
    assert!(notes(&whole.display().to_string()).contains("is not in the folder of its header"));
    assert!(!notes("data/../one.raw").contains("folder"));
    // Four dimensions over files of one step, time last.
    write(&p, "NRRD0004\ntype: uint8\ndimension: 4\nsizes: 2 1 1 3\nencoding: raw\ndata file: data/s%02d.raw 2 0 -1")
        .unwrap();
    assert_eq!(all(&p), [[5.0, 6.0], [3.0, 4.0], [1.0, 2.0]]);
}

#[test]
fn where_time_is() {
    let data = [1, 2, 3, 4, 5, 6, 7, 8];
    let (last, first) = (
        vec![vec![1.0, 2.0, 3.0, 4.0], vec![5.0, 6.0, 7.0, 8.0]],
        vec![vec![1.0, 3.0, 5.0, 7.0], vec![2.0, 4.0, 6.0, 8.0]],
    );
    let one = vec![vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]];
    for (sizes, extra, want, spacing) in [
        ("2 2 1 2", "spacings: 1 2 3 nan", &last, [1.0, 2.0, 3.0]),
        ("2 2 1 2", "kinds: space space space time", &last, [1.0; 3]),
        ("2 2 1 2", "kinds: list domain domain domain\nspacings: nan 1 2 3", &first, [1.0, 2.0, 3.0]),
        (
            "2 2 1 2",
            "kinds: time domain domain domain\nspace directions: none (2,0,0) (0,2,0) (0,0,2)",
            &first,
            [2.0; 3],
        ),
        ("1 2 2 2", "kinds: vector domain domain domain\nspacings: 9 1 2 3", &one, [1.0, 2.0, 3.0]),
        ("1 2 2 2", "", &one, [1.0; 3]),
        ("1 2 2 2", "space directions: none (1,0,0) (0,-1,0) (0,0,1)", &one, [1.0; 3]),
        ("2 2 1 2", "space directions: (1,0,0) (0,1,0) (0,0,1) none", &last, [1.0; 3]),
    ] {
        for encoding in ["raw", "gz", "ascii"] {
            let ascii = data.map(|v: u8| v.to_string()).join(" ").into_bytes();
            let bytes = match encoding {
                "raw" => data.to_vec(),
                "gz" => gz(&data),
                _ => ascii,
            };
            let lines = format!("type: uchar\ndimension: 4\nsizes: {sizes}\nencoding: {encoding}\n{extra}");
            let (_d, p) = file(lines.trim_end(), &bytes);
            assert_eq!(all(&p), *want, "{lines}");
            assert_eq!(open(&p).unwrap().header().grid.spacing, spacing, "{lines}");
        }
    }
}

#[test]
fn header_errors() {
    let d4 = "type: uchar\ndimension: 4\nsizes: 2 2 1 1\nencoding: raw";
    for (lines, want) in [
        (U8.replace("uchar", "long"), "\"long\" is not supported"),
        (U8.replace("uchar", "block"), "block"),
        (U8.replace("uchar", "ushort"), "endian"),
        (format!("{U8}\nendian: middle"), "middle"),
        (U8.replace("raw", "bzip2"), "bzip2"),
        (U8.replace("raw", "hex"), "hex"),
        (U8.replace("2 2 1", "2 2"), "3 whole numbers"),
        (U8.replace("2 2 1", "2 -2 1"), "3 whole numbers"),
        (U8.replace("2 2 1", "2 0 1"), "hold no values"),
        (U8.replace("2 2 1", "2 2 2"), "expected 8 bytes (8 values of u8) after 0 skipped, found 4"),
        (U8.replace("2 2 1", "1 1 1"), "found 4"),
        (U8.replace("2 2 1", "4294967296 4294967296 4294967296"), "more than can be addressed"),
        (U8.replace("dimension: 3", "dimension: 2"), "neither 3 nor 4"),
        (U8.replace("encoding: raw", "# none"), "encoding"),
        (format!("{U8}\ntype: char"), "twice"),
        (format!("{U8}\nno field"), "line 6"),
        (format!("{U8}\nspacings: 1 1"), "3 numbers"),
        (format!("{U8}\nspacings: 1 0 1"), "spacing"),
        (format!("{U8}\nspace directions: (1,0,0) none"), "3 vectors"),
        (format!("{U8}\nspace origin: (1,2"), "position"),
        (format!("{U8}\nkinds: vector domain domain"), "one component per voxel is needed"),
        (format!("{U8}\nkinds: domain domain time"), "fewer than three"),
        (format!("{U8}\nkinds: domain"), "1 are given"),
        (format!("{U8}\nline skip: 5"), "line skip"),
        (format!("{U8}\nline skip: many"), "line skip"),
        (format!("{U8}\nbyte skip: -2"), "byte skip"),
        (format!("{d4}\nkinds: RGB-color domain domain domain"), "one component per voxel is needed"),
        (format!("{d4}\nkinds: domain time domain domain"), "first or last"),
        (format!("{d4}\nspace directions: none (1,0,0) (0,1,0) (0,0,1)"), "may be time or components"),
    ] {
        let (_d, p) = file(&lines, b"abcd");
        assert!(refused(&p).contains(want), "{lines}: {}", refused(&p));
    }
    let (_d, p) = file("", b"");
    write(&p, "NRRD0009\n\n").unwrap();
    assert!(refused(&p).contains("magic"));
}

#[test]
fn gzip_must_be_exact_and_whole() {
    let lines = U8.replace("raw", "gzip");
    assert_eq!(all(&file(&lines, &gz(b"abcd")).1), [[97.0, 98.0, 99.0, 100.0]]);
    assert_eq!(all(&file(&lines, &[gz(b"ab"), gz(b"cd")].concat()).1), [[97.0, 98.0, 99.0, 100.0]]);
    assert!(refused(&file(&lines, &gz(b"abc")).1).contains("found 3"));
    assert!(refused(&file(&lines, &gz(b"abcde")).1).contains("found more"));
    let whole = gz(b"abcd");
    assert!(refused(&file(&lines, &whole[..whole.len() - 4]).1).contains("end early"));
    let mut broken = whole.clone();
    let crc = broken.len() - 6;
    broken[crc] ^= 1;
    assert!(refused(&file(&lines, &broken).1).contains("damaged"));
    assert!(refused(&file(&lines, b"plain text").1).contains("damaged"));
    assert!(refused(&file(&format!("{lines}\nbyte skip: 9"), &whole).1).contains("bytes to skip"));
}

#[test]
fn huge_claims_are_refused_at_once() {
    let start = std::time::Instant::now();
    let lines = "type: uchar\ndimension: 3\nsizes: 100000 100000 100000\nencoding: gzip";
    let (_d, p) = file(lines, &gz(&[0; 100_000]));
    // Refused on opening, before a step could be allocated.
    let message = open(&p).unwrap_err().to_string();
    assert!(message.contains("cannot fit in the gzip data"), "{message}");
    assert!(start.elapsed().as_secs() < 2);
}

#[test]
fn zeros_that_compress_best_are_read() {
    let n = 3 << 20;
    let (_d, p) = file(&format!("type: uchar\ndimension: 3\nsizes: {n} 1 1\nencoding: gzip"), &gz(&vec![0; n]));
    assert_eq!(all(&p)[0].len(), n);
}

fn name(scalar: crate::volume::grid::ScalarType) -> &'static str {
    scalar.name()
}

proptest! {
    #[test]
    fn round_trip(
        scalar in scalars(), endian in endians(), encoding in prop::sample::select(vec!["raw", "gzip", "ascii"]),
        (x, y, z, t) in (1..4usize, 1..4usize, 1..4usize, 1..4usize), first: bool, seed: u8,
    ) {
        let n = x * y * z;
        let values: Vec<u8> = (0..n * t).map(|i| (i as u8).wrapping_mul(37).wrapping_add(seed) % 128).collect();
        let at = |s: usize, v: usize| if first { v * t + s } else { s * n + v };
        let expected: Vec<Vec<f32>> =
            (0..t).map(|s| (0..n).map(|v| f32::from(values[at(s, v)])).collect()).collect();
        let data = match encoding {
            "raw" => stored(scalar, endian, &values),
            "gzip" => gz(&stored(scalar, endian, &values)),
            _ => values.iter().map(u8::to_string).collect::<Vec<_>>().join(" ").into_bytes(),
        };
        let order = if endian == Endian::Big { "big" } else { "little" };
        let (sizes, kinds) = if first {
            (format!("{t} {x} {y} {z}"), "time domain domain domain")
        } else {
            (format!("{x} {y} {z} {t}"), "domain domain domain time")
        };
        let lines = format!(
            "type: {}\ndimension: 4\nsizes: {sizes}\nkinds: {kinds}\nendian: {order}\nencoding: {encoding}", name(scalar)
        );
        prop_assert_eq!(all(&file(&lines, &data).1), expected);
    }

    #[test]
    fn mutated_files_never_panic(
        raw in mutated(b"NRRD0005\ntype: short\ndimension: 4\nsizes: 2 2 1 3\nkinds: list domain domain domain\nendian: big\n\
            encoding: raw\nspace directions: none (1,0,0) (0,1,0) (0,0,1)\nbyte skip: -1\n\nabcdefghijklmnopqrstuvwx".to_vec()),
        ascii in mutated(b"NRRD0001\ntype: float\ndimension: 3\nsizes: 2 2 1\nencoding: txt\nline skip: 1\n\n#\n1 2 3 4".to_vec()),
        zipped in mutated([
            b"NRRD0004\ntype: uchar\ndimension: 3\nsizes: 10 10 10\nspacings: 1 1 1\nencoding: gzip\n\n".as_slice(),
            &gz(&[5; 1000]),
        ].concat()),
        many in mutated(b"NRRD0004\ntype: uchar\ndimension: 3\nsizes: 10 1 3\nencoding: raw\ndata file: %03d.raw 0 9 1\n".to_vec()),
    ) {
        let d = dir();
        for bytes in [raw, ascii, zipped, many] {
            let p = d.path().join("a.nrrd");
            write(&p, bytes).unwrap();
            survive(&p);
        }
    }
}
