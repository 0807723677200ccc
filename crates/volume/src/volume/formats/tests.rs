//! Raw files, their sidecars and NumPy arrays: what is read, what is refused, and that nothing panics.

use super::decode::Endian;
use super::*;
use crate::volume::grid::ScalarType;
use proptest::prelude::*;
use std::fs::write;
use std::path::PathBuf;
use tempfile::TempDir;

pub fn dir() -> TempDir {
    tempfile::tempdir().unwrap()
}

/// The error message of opening the file or of reading its steps.
pub fn refused(path: &Path) -> String {
    let opened = match open(path) {
        Ok(file) => file,
        Err(e) => return e.to_string(),
    };
    let mut out = Vec::new();
    let failed = (0..opened.header().steps).find_map(|s| opened.read(s, &mut out).err());
    failed.expect("should be refused").to_string()
}

pub fn all(path: &Path) -> Vec<Vec<f32>> {
    let file = open(path).unwrap();
    let mut out = vec![f32::NAN; 3];
    (0..file.header().steps)
        .map(|s| {
            file.read(s, &mut out).unwrap();
            out.clone()
        })
        .collect()
}

pub fn stored(scalar: ScalarType, endian: Endian, values: &[u8]) -> Vec<u8> {
    let one = |&v: &u8| {
        let mut b = match scalar {
            ScalarType::U8 | ScalarType::I8 => vec![v],
            ScalarType::U16 | ScalarType::I16 => u16::from(v).to_le_bytes().to_vec(),
            ScalarType::U32 | ScalarType::I32 => u32::from(v).to_le_bytes().to_vec(),
            ScalarType::F32 => f32::from(v).to_le_bytes().to_vec(),
            ScalarType::F16 => half::f16::from_f32(f32::from(v)).to_le_bytes().to_vec(),
            ScalarType::U64 => (v as u64).to_le_bytes().to_vec(),
            ScalarType::I64 => (v as i64).to_le_bytes().to_vec(),
            ScalarType::F64 => f64::from(v).to_le_bytes().to_vec(),
        };
        if endian == Endian::Big {
            b.reverse();
        }
        b
    };
    values.iter().flat_map(one).collect()
}

pub fn scalars() -> impl Strategy<Value = ScalarType> {
    use ScalarType::{F16, F32, F64, I8, I16, I32, I64, U8, U16, U32, U64};
    prop::sample::select(vec![U8, I8, U16, I16, U32, I32, U64, I64, F16, F32, F64])
}

pub fn endians() -> impl Strategy<Value = Endian> {
    prop::sample::select(vec![Endian::Little, Endian::Big])
}

fn raw(folder: &TempDir, bytes: &[u8], toml: &str) -> PathBuf {
    let path = folder.path().join("a.raw");
    write(&path, bytes).unwrap();
    write(folder.path().join("a.raw.toml"), toml).unwrap();
    path
}

pub fn npy(descr: &str, fortran: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let text = format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': ({shape}), }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.bytes());
    bytes.extend(data);
    bytes
}

#[test]
fn unknown_extension_lists_supported_formats() {
    let d = dir();
    let path = d.path().join("a.tiff");
    assert!(refused(&path).contains("does not exist"));
    std::fs::write(&path, []).unwrap();
    let message = refused(&path);
    assert!(message.contains("save the stack as .npy"), "{message}");
    for (name, hint) in [
        ("a.xyz", ".nrrd, .nhdr, .npy"),
        ("a.npz", "numpy.save(\"rho.npy\", archive[\"rho\"])"),
        ("a.HDR", "a .hdr/.img pair: convert it to one .nii"),
        ("a.img", "convert it to one .nii"),
        ("a.IMG.gz", "convert it to one .nii"),
        ("a.mhd", "save it as .nrrd"),
        ("a.vtk", "save it from ParaView as .vti"),
        ("a.raw.gz", "unpack it first"),
    ] {
        let path = d.path().join(name);
        std::fs::write(&path, []).unwrap();
        let message = refused(&path);
        assert!(message.contains(hint) && message.contains(name), "{message}");
    }
    assert_eq!((not_read(Path::new("a.nii.gz")), not_read(Path::new("a.nrrd"))), (None, None));
    assert_eq!(format_of(Path::new("A.NII.GZ")), Some((VolumeFormat::Nifti, 7)));
    assert_eq!(format_of(Path::new(".raw")), None);
}

#[test]
fn raw_with_every_field_given() {
    let d = dir();
    let toml = "dims = [2, 1, 2, 2]\ntype = \"uint16\"\nendian = \"big\"\nspacing = [1, 2.5, 3]\norigin = [-1, 0, 4]\noffset = 3";
    let p = raw(&d, &[9, 9, 9, 0, 1, 0, 2, 0, 3, 0, 4, 1, 0, 0, 6, 0, 7, 0, 8], toml);
    let header = open(&p).unwrap().header().clone();
    assert_eq!((header.grid.dims, header.steps, header.scalar), ([2, 1, 2], 2, ScalarType::U16));
    assert_eq!((header.grid.spacing, header.grid.origin), ([1.0, 2.5, 3.0], [-1.0, 0.0, 4.0]));
    assert_eq!(all(&p), [[1.0, 2.0, 3.0, 4.0], [256.0, 6.0, 7.0, 8.0]]);
    assert!(open(&p).unwrap().read(2, &mut Vec::new()).is_err());
}

#[test]
fn raw_sidecar_names() {
    for name in ["v.dat.toml", "v.toml", "v.dat.json", "v.json", "volume.toml", "volume.json"] {
        let d = dir();
        let p = d.path().join("v.dat");
        write(&p, [1, 2]).unwrap();
        let text =
            if name.ends_with("json") { r#"{"dims":[2,1,1],"type":"uchar"}"# } else { "dims=[2,1,1]\ntype='u8'" };
        write(d.path().join(name), text).unwrap();
        assert_eq!(all(&p), [[1.0, 2.0]], "{name}");
        if !name.starts_with("volume") {
            // the file's own sidecar takes precedence over the folder's, whatever that says
            write(d.path().join("volume.toml"), "poison").unwrap();
            assert_eq!(all(&p), [[1.0, 2.0]], "{name}");
        }
        write(d.path().join(if name == "v.toml" { "v.json" } else { "v.toml" }), "dims=[2,1,1]\ntype='u8'").unwrap();
        if !name.starts_with("volume") {
            assert!(refused(&p).contains("both"), "{name}");
        }
    }
}

#[test]
fn raw_errors() {
    let d = dir();
    let p = d.path().join("b.bin");
    write(&p, [0; 8]).unwrap();
    assert!(refused(&p).contains("type = \"u8\""), "shows an example: {}", refused(&p));
    for (toml, want) in [
        (
            "dims=[2,2,2]\ntype='u16'",
            "expected 16 bytes (offset 0 + 2 x 2 x 2 voxels x 1 steps x 2 bytes of u16), found 8",
        ),
        ("dims=[2,2,1]\ntype='u8'", "expected 4 bytes"),
        ("dims=[2,2]\ntype='u8'", "2 entries"),
        ("dims=[2,2,2]\ntype='u128'", "\"u128\" is not a scalar type"),
        ("dims=[2,2,2]\ntype='u8'\nendian='middle'", "endian"),
        ("dims=[2,2,2]\ntype='u8'\nspacing=[0,1,1]", "spacing"),
        ("dims=[2,2,2]\ntype='u8'\norigin=[nan,1,1]", "origin"),
        ("dims=[2,2,2]\ntype='u8'\nflip=true", "flip"),
        ("dims=[2,2,2,1]\ntype='u8'\nsteps=2", "steps"),
        ("dims=[0,2,2]\ntype='u8'", "hold no values"),
        ("dims=[4294967296,4294967296,4294967296]\ntype='u8'", "more than can be addressed"),
        ("dims=[100000,100000,100000]\ntype='u8'", "expected 1000000000000000 bytes"),
        ("dims=[2,2,2]\ntype='u8'\noffset=9223372036854775807", "offset"),
        ("dims=[2,2,-2]\ntype='u8'", "line 1"),
        ("dims", "sidecar"),
    ] {
        write(d.path().join("b.toml"), toml).unwrap();
        assert!(refused(&p).contains(want), "{toml}: {}", refused(&p));
    }
    assert!(refused(&d.path().join("absent.raw")).contains("cannot open"));
    std::fs::create_dir(d.path().join("c.raw")).unwrap();
    assert!(refused(&d.path().join("c.raw")).contains("regular file"));
}

#[test]
fn a_file_cut_short_after_opening_is_an_error() {
    let d = dir();
    let p = raw(&d, &[1; 8], "dims=[2,2,2]\ntype='u8'");
    let file = open(&p).unwrap();
    write(&p, [1; 4]).unwrap();
    assert!(file.read(0, &mut Vec::new()).unwrap_err().to_string().contains("truncated"));
}

#[test]
fn npy_orders_and_place() {
    let d = dir();
    let p = d.path().join("a.npy");
    // [t, z, y, x] = [2, 1, 2, 3].
    let c: Vec<u8> = (0..12).collect();
    write(&p, npy("|u1", "False", "2, 1, 2, 3", &c)).unwrap();
    let steps = [[0.0, 1.0, 2.0, 3.0, 4.0, 5.0], [6.0, 7.0, 8.0, 9.0, 10.0, 11.0]];
    assert_eq!(all(&p), steps);
    assert_eq!(open(&p).unwrap().header().grid.dims, [3, 2, 1]);
    // The same array with the first axis fastest.
    let mut f = vec![0; 12];
    for (t, y, x) in (0..12).map(|i| (i / 6, i / 3 % 2, i % 3)) {
        f[t + 2 * (y + 2 * x)] = c[t * 6 + y * 3 + x];
    }
    write(&p, npy("|b1", "True", "2L, 1, 2, 3", &f)).unwrap();
    assert_eq!(all(&p), steps);
    write(d.path().join("a.npy.json"), r#"{"spacing":[1,2,3]}"#).unwrap();
    assert_eq!(open(&p).unwrap().header().grid.spacing, [1.0, 2.0, 3.0]);
    write(d.path().join("a.npy.json"), r#"{"dims":[1,2,3]}"#).unwrap();
    assert!(refused(&p).contains("dims"));
}

#[test]
fn npy_errors() {
    let d = dir();
    let p = d.path().join("a.npy");
    let mut deep = npy("<f4", "False", "1,1,1", &[0; 4]);
    deep[8..10].copy_from_slice(&60000u16.to_le_bytes());
    deep.resize(10, 0);
    deep.extend(vec![b'['; 60000]);
    let mut long = b"\x93NUMPY\x02\x00".to_vec();
    long.extend(u32::MAX.to_le_bytes());
    let structured = npy("x", "False", "1,1,1", &[]);
    let structured = String::from_utf8_lossy(&structured[10..]).replace("'x'", "[('rho', '<f4'), ('u', '<f4')]");
    let structured =
        [b"\x93NUMPY\x01\x00", &(structured.len() as u16).to_le_bytes()[..], structured.as_bytes()].concat();
    for (bytes, want) in [
        (b"not an array".to_vec(), "magic"),
        (b"\x93NUMPY\x09\x00aaaa".to_vec(), "version"),
        (b"\x93NUMPY\x01\x00\xff".to_vec(), "header"),
        (long, "claims 4294967295 bytes"),
        (deep, "not a dictionary"),
        (npy("<c8", "False", "1,1,1", &[0; 8]), "'<c8', complex numbers, is not supported; save a real part"),
        (npy("<f16", "False", "1,1,1", &[0; 16]), "long double, is not supported; save it with a.astype(\"float64\")"),
        (npy("|O", "False", "1,1,1", &[0; 8]), "Python objects"),
        (npy("<U4", "False", "1,1,1", &[0; 16]), "text"),
        (npy("<M8[s]", "False", "1,1,1", &[0; 8]), "as with a.astype(\"int64\")"),
        (structured, "of the fields rho, u; save one of them, as in a[\"rho\"]"),
        (npy("", "False", "1,1,1", &[0; 8]), "is not supported"),
        (npy("|u1", "False", "4, 4", &[0; 16]), "2 axes"),
        (npy("|u1", "Maybe", "1,1,1", &[0; 1]), "fortran_order"),
        (npy("|u1", "False", "1,1,-1", &[0; 1]), "shape"),
        (npy("<f4", "False", "1,1,2", &[0; 7]), "expected 8 bytes of values"),
        (npy("<f4", "False", "1,1,2", &[0; 9]), "found 9"),
        (npy("<f4", "True", "100000,100000,100000", &[0; 9]), "expected 4000000000000000 bytes"),
        (npy("<f4", "False", "4294967296,4294967296,4294967296", &[]), "more than can be addressed"),
        (npy("|u1', 'x': '1", "False", "1,1,1", &[0; 1]), "unknown key x"),
    ] {
        write(&p, bytes).unwrap();
        assert!(refused(&p).contains(want), "{want}: {}", refused(&p));
    }
}

#[test]
fn byte_order_marks_are_no_part_of_sidecars_and_headers() {
    let d = dir();
    let json = r#"{"dims": [2, 1, 1], "type": "u8"}"#;
    for (name, text) in [("a.raw.json", json), ("a.raw.toml", "dims = [2, 1, 1]\r\ntype = 'u8'\r\n")] {
        let path = raw(&d, &[7, 9], "");
        std::fs::remove_file(d.path().join("a.raw.toml")).unwrap();
        for bytes in [
            [b"\xef\xbb\xbf", text.as_bytes()].concat(),
            std::iter::once(0xfeff).chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect(),
        ] {
            write(d.path().join(name), bytes).unwrap();
            assert_eq!(all(&path), [[7.0, 9.0]], "{name}");
        }
        write(d.path().join(name), text.replace("[2, 1, 1]", "{}")).unwrap();
        let message = refused(&path);
        assert!(!message.contains("u64") && !message.contains("sequence"), "{message}");
        std::fs::remove_file(d.path().join(name)).unwrap();
    }
    let head = "\u{feff}NRRD0004\ntype: uchar\ndimension: 3\nsizes: 2 1 1\nencoding: raw\ndata file: a.raw\n";
    write(d.path().join("b.nhdr"), head).unwrap();
    assert_eq!(all(&d.path().join("b.nhdr")), [[7.0, 9.0]]);
}

/// Opens and reads arbitrary content; it only has to return.
pub fn survive(path: &Path) {
    if let Ok(file) = open(path) {
        let mut out = Vec::new();
        for step in 0..file.header().steps.min(3) {
            let _ = file.read(step, &mut out);
            assert!(out.len() <= 1 << 22, "a small file became {} voxels", out.len());
        }
    }
}

/// `bytes` with some overwritten, some inserted, some removed.
pub fn mutated(bytes: Vec<u8>) -> impl Strategy<Value = Vec<u8>> {
    let edits = prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..4u8), 1..6);
    edits.prop_map(move |edits| {
        let mut b = bytes.clone();
        for (at, value, kind) in edits {
            if b.is_empty() {
                b.push(value);
            }
            let at = at.index(b.len());
            match kind {
                0 => b.truncate(at),
                1 => b.insert(at, value),
                2 => b.insert(at, b'0' + value % 10),
                _ => b[at] = value,
            }
        }
        b
    })
}

proptest! {
    #[test]
    fn raw_and_npy_round_trip(
        scalar in scalars(), endian in endians(), fortran: bool,
        (t, z, y, x) in (1..3usize, 1..4usize, 1..4usize, 1..4usize), seed: u8,
    ) {
        let n = t * z * y * x;
        let values: Vec<u8> = (0..n).map(|i| (i as u8).wrapping_mul(31).wrapping_add(seed) % 128).collect();
        let expected: Vec<Vec<f32>> = values.chunks(n / t).map(|c| c.iter().map(|&v| f32::from(v)).collect()).collect();
        let d = dir();
        let order = if endian == Endian::Big { "big" } else { "little" };
        let toml = format!("dims=[{x},{y},{z},{t}]\ntype='{}'\nendian='{order}'", scalar.name());
        prop_assert_eq!(all(&raw(&d, &stored(scalar, endian, &values), &toml)), expected.clone());

        let mut laid = values.clone();
        if fortran {
            for (i, &v) in values.iter().enumerate() {
                let (it, iz, iy, ix) = (i / (z * y * x), i / (y * x) % z, i / x % y, i % x);
                laid[it + t * (iz + z * (iy + y * ix))] = v;
            }
        }
        let kind = format!("{}{}{}", if order == "big" { '>' } else { '<' }, &scalar.name()[..1], scalar.bytes());
        let p = d.path().join("a.npy");
        let flag = if fortran { "True" } else { "False" };
        write(&p, npy(&kind, flag, &format!("{t}, {z}, {y}, {x}"), &stored(scalar, endian, &laid))).unwrap();
        prop_assert_eq!(all(&p), expected);
    }

    #[test]
    fn mutated_npy_never_panics(bytes in mutated(npy("<f4", "True", "2, 2, 1, 3", &[7; 48]))) {
        let d = dir();
        let p = d.path().join("a.npy");
        write(&p, bytes).unwrap();
        survive(&p);
    }

    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let d = dir();
        for name in ["a.npy", "a.nrrd", "a.raw"] {
            let p = d.path().join(name);
            let magic: &[u8] = if name == "a.npy" { b"\x93NUMPY\x01\x00" } else { b"NRRD0004\n" };
            write(d.path().join("volume.toml"), &bytes).unwrap();
            write(&p, &bytes).unwrap();
            survive(&p);
            write(&p, [magic, &bytes].concat()).unwrap();
            survive(&p);
        }
    }

    #[test]
    fn mutated_sidecars_never_panic(
        toml in mutated(b"dims = [2, 2, 2]\ntype = 'u8'\noffset = 0\nspacing = [1.0, 1, 1]".to_vec()),
        json in mutated(br#"{"dims": [2, 2, 2], "type": "u8", "endian": "big", "steps": 1}"#.to_vec()),
    ) {
        for (name, text) in [("a.toml", toml), ("a.json", json)] {
            let d = dir();
            let p = d.path().join("a.raw");
            write(&p, [3; 8]).unwrap();
            write(d.path().join(name), text).unwrap();
            survive(&p);
        }
    }
}
