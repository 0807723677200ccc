use super::*;
use crate::data::calibration::AxisConvention;
use crate::volume::source::TimeAxis;
use flate2::{Compression, write::GzEncoder};
use glam::{DMat3, DVec3};
use proptest::prelude::*;
use std::io::Write;

/// A header of 352 bytes: `dim` after `dim[0]`, NIfTI type code, bits.
fn header(dim: &[i16], code: i16, bits: i16, big: bool) -> Vec<u8> {
    let mut h = vec![0u8; 352];
    let mut put = |at: usize, le: &[u8]| {
        let mut b = le.to_vec();
        if big {
            b.reverse();
        }
        h[at..at + b.len()].copy_from_slice(&b);
    };
    put(0, &348i32.to_le_bytes());
    put(40, &(dim.len() as i16).to_le_bytes());
    for a in 0..7 {
        put(42 + 2 * a, &dim.get(a).copied().unwrap_or(1).to_le_bytes());
    }
    put(70, &code.to_le_bytes());
    put(72, &bits.to_le_bytes());
    for (a, v) in [1.0f32, 0.5, 2.0, 3.0].iter().enumerate() {
        put(76 + 4 * a, &v.to_le_bytes());
    }
    put(108, &352f32.to_le_bytes());
    h[344..348].copy_from_slice(b"n+1\0");
    h
}

fn set_f32(bytes: &mut [u8], at: usize, v: f32) {
    bytes[at..at + 4].copy_from_slice(&v.to_le_bytes());
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut e = GzEncoder::new(Vec::new(), Compression::fast());
    e.write_all(bytes).unwrap();
    e.finish().unwrap()
}

fn with<T>(name: &str, bytes: &[u8], f: impl FnOnce(&Path) -> T) -> T {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    f(&path)
}

/// Opens and reads every step.
fn load(name: &str, bytes: &[u8]) -> Result<(VolumeHeader, Vec<Vec<f32>>), VolumeError> {
    with(name, bytes, |path| {
        let file = open(path)?;
        let mut steps = Vec::new();
        for k in 0..file.header().steps {
            let mut out = vec![9.0];
            file.read(k, &mut out)?;
            steps.push(out);
        }
        Ok((file.header().clone(), steps))
    })
}

fn message(bytes: &[u8]) -> String {
    load("a.nii", bytes).unwrap_err().to_string()
}

/// Two steps of 2 x 1 x 2 `i16` values.
fn four_d() -> Vec<u8> {
    let mut f = header(&[2, 1, 2, 2], 4, 16, false);
    f.extend((0..8i16).flat_map(|v| (v - 3).to_le_bytes()));
    f
}

#[test]
fn reads_steps_plain_and_packed() {
    for bytes in [four_d(), gzip(&four_d())] {
        let (h, steps) = load("a.nii.gz", &bytes).unwrap();
        assert_eq!((h.grid.dims, h.steps, h.scalar), ([2, 1, 2], 2, crate::volume::grid::ScalarType::I16));
        assert_eq!(h.grid.spacing, [0.5, 2.0, 3.0]);
        assert!(h.notes.is_empty(), "{:?}", h.notes);
        assert_eq!(steps, [[-3.0, -2.0, -1.0, 0.0], [1.0, 2.0, 3.0, 4.0]]);
    }
}

#[test]
fn steps_are_read_together_as_they_are_one_by_one() {
    for bytes in [four_d(), gzip(&four_d())] {
        with("a.nii.gz", &bytes, |path| {
            let (file, mut out) = (open(path).unwrap(), vec![9.0]);
            file.read_range(0..2, &mut out).unwrap();
            assert_eq!(out, [-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0]);
            file.read_range(1..1, &mut out).unwrap();
            assert!(out.is_empty());
            assert!(file.read_range(1..3, &mut out).unwrap_err().to_string().contains("no step 2"));
            assert!(file.read(usize::MAX, &mut out).is_err());
        });
    }
}

#[test]
fn packed_in_several_members() {
    let bytes = four_d();
    let mut packed = gzip(&bytes[..355]);
    packed.extend(gzip(&bytes[355..]));
    assert_eq!(load("a.nii.gz", &packed).unwrap().1[1], [1.0, 2.0, 3.0, 4.0]);
}

#[test]
fn reads_big_endian_and_every_type() {
    let mut f = header(&[2, 1, 1], 16, 32, true);
    f.extend([1.5f32, -2.0].iter().flat_map(|v| v.to_be_bytes()));
    assert_eq!(load("a.nii", &f).unwrap().1, [[1.5, -2.0]]);
    for (code, bits) in
        [(2, 8), (4, 16), (8, 32), (16, 32), (64, 64), (256, 8), (512, 16), (768, 32), (1024, 64), (1280, 64)]
    {
        let mut f = header(&[2, 1, 1], code, bits, false);
        f.extend(vec![0u8; 2 * bits as usize / 8]);
        let (h, steps) = load("a.nii", &f).unwrap();
        assert_eq!(steps, [[0.0, 0.0]]);
        assert_eq!(h.scalar.bytes(), bits as usize / 8);
    }
}

#[test]
fn scales_and_takes_odd_slopes_as_none() {
    let mut f = four_d();
    set_f32(&mut f, 112, 2.0);
    set_f32(&mut f, 116, 10.0);
    assert_eq!(load("a.nii", &f).unwrap().1[0], [4.0, 6.0, 8.0, 10.0]);
    for slope in [0.0, f32::NAN] {
        set_f32(&mut f, 112, slope);
        assert_eq!(load("a.nii", &f).unwrap().1[0], [-3.0, -2.0, -1.0, 0.0]);
    }
}

/// A header with an sform of these columns and this offset.
fn with_sform(columns: [[f32; 3]; 3], offset: [f32; 3]) -> Vec<u8> {
    let mut f = four_d();
    f[254] = 1; // sform_code
    for row in 0..3 {
        for (c, column) in columns.iter().enumerate() {
            set_f32(&mut f, 280 + 16 * row + 4 * c, column[row]);
        }
        set_f32(&mut f, 292 + 16 * row, offset[row]);
    }
    f
}

#[test]
fn the_sform_places_the_voxels_and_turns_the_axes() {
    let ras = Some(AxisConvention::RightAnteriorSuperior);
    let mut f = with_sform([[0.5, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]], [7.0, 8.0, 9.0]);
    f[123] = 10; // mm, s
    let (h, _) = load("a.nii", &f).unwrap();
    assert_eq!((h.grid.origin, h.grid.directions.is_aligned(), h.notes.len()), ([7.0, 8.0, 9.0], true, 0));
    assert_eq!((h.physical.axes, h.physical.length_unit.as_deref()), (ras, Some("mm")));
    // the sform alone was changed
    f = with_sform([[0.5, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 6.0]], [7.0, 8.0, 9.0]);
    let (h, _) = load("a.nii", &f).unwrap();
    assert_eq!(h.grid.spacing, [0.5, 2.0, 6.0]);
    assert!(h.notes.iter().any(|n| n.contains("spacing 3 along axis 2 replaced by 6")), "{:?}", h.notes);
    // permuted and mirrored
    f = with_sform([[0.0, 0.0, -0.5], [-2.0, 0.0, 0.0], [0.0, 3.0, 0.0]], [7.0, 8.0, 9.0]);
    let (h, _) = load("a.nii", &f).unwrap();
    assert_eq!(h.grid.steps().to_cols_array_2d(), [[0.0, 0.0, -0.5], [-2.0, 0.0, 0.0], [0.0, 3.0, 0.0]]);
    assert_eq!((h.grid.directions.code(ras), h.notes.len(), h.physical.length_unit), ("ILA".into(), 0, None));
    // sheared, and without direction
    f = with_sform([[0.5, 0.0, 0.0], [0.2, 2.0, 0.0], [0.0, 0.0, 3.0]], [0.0; 3]);
    assert!(message(&f).contains("sform: the axes x and y are 84.29 degrees apart"), "{}", message(&f));
    f = with_sform([[0.5, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 3.0]], [0.0; 3]);
    assert!(message(&f).contains("sform"), "{}", message(&f));
    f = with_sform([[0.5, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]], [f32::NAN; 3]);
    assert!(message(&f).contains("not a valid position"), "{}", message(&f));
}

#[test]
fn the_qform_turns_the_axes_by_its_quaternion() {
    let mut f = four_d();
    f[252] = 1; // qform_code
    set_f32(&mut f, 268, 4.0);
    let (h, _) = load("a.nii", &f).unwrap();
    assert_eq!((h.grid.origin[0], h.grid.directions.is_aligned()), (4.0, true));
    assert_eq!(h.physical.axes, Some(AxisConvention::RightAnteriorSuperior));
    // a quarter turn about x, left-handed: y leads to z, z backwards along -y
    set_f32(&mut f, 256, std::f32::consts::FRAC_1_SQRT_2);
    set_f32(&mut f, 76, -1.0);
    let steps = load("a.nii", &f).unwrap().0.grid.steps();
    let want = DMat3::from_cols(DVec3::X * 0.5, DVec3::Z * 2.0, DVec3::Y * 3.0);
    assert!(steps.abs_diff_eq(want, 1e-6), "{steps}");
    set_f32(&mut f, 80, 0.0);
    assert_eq!(load("a.nii", &f).unwrap().0.grid.spacing[0], 1.0);
    set_f32(&mut f, 260, 0.9);
    assert!(message(&f).contains("unit quaternion"), "{}", message(&f));
}

#[test]
fn the_times_of_steps_are_known_where_the_header_says() {
    let time = |units: u8, step: f32, start: f32| {
        let mut f = four_d();
        f[123] = units;
        set_f32(&mut f, 92, step);
        set_f32(&mut f, 136, start);
        load("a.nii", &f).unwrap().0.physical.time
    };
    let axis = |start, step, unit: Option<&str>| Some(TimeAxis { start, step, unit: unit.map(str::to_owned) });
    assert_eq!(time(8 + 2, 2.5, 10.0), axis(10.0, 2.5, Some("s")));
    assert_eq!(time(16, 1.0, 0.0), axis(0.0, 1.0, Some("ms")));
    assert_eq!(time(0, 2.0, f32::NAN), axis(0.0, 2.0, None));
    for (units, step) in [(0, 1.0), (8, 0.0), (8, f32::INFINITY), (32, 2.0)] {
        assert_eq!(time(units, step, 0.0), None, "{units} {step}");
    }
}

#[test]
fn says_what_is_wrong() {
    assert!(message(&four_d()[..100]).contains("truncated"));
    assert!(message(&four_d()[..360]).contains("more than the file"));
    assert!(message(&[0u8; 400]).contains("NIfTI-1"));
    let change = |at: usize, bytes: &[u8]| {
        let mut f = four_d();
        f[at..at + bytes.len()].copy_from_slice(bytes);
        message(&f)
    };
    assert!(change(0, &540i32.to_le_bytes()).contains("NIfTI-2"));
    assert!(change(0, &0i32.to_le_bytes()).contains("sizeof_hdr"));
    assert!(change(344, b"ni1\0").contains(".hdr/.img pair"));
    assert!(change(70, &32i16.to_le_bytes()).contains("Complex64"));
    assert!(change(70, &128i16.to_le_bytes()).contains("Rgb24"));
    assert!(change(70, &3i16.to_le_bytes()).contains("unknown code 3"));
    assert!(change(72, &32i16.to_le_bytes()).contains("bitpix"));
    assert!(change(42, &(-2i16).to_le_bytes()).contains("-2"));
    assert!(change(42, &0i16.to_le_bytes()).contains("dim"));
    assert!(change(40, &[5, 0, 2, 0, 1, 0, 2, 0, 1, 0, 2]).contains("more axes"));
    assert!(change(108, &12f32.to_le_bytes()).contains("vox_offset"));
    assert!(change(108, &f32::NAN.to_le_bytes()).contains("vox_offset"));
    assert!(change(80, &f32::INFINITY.to_le_bytes()).contains("pixdim"));
    assert!(open(Path::new("no/such.nii")).unwrap_err().to_string().contains("open the file"));
    with("a.nii", &four_d(), |p| assert!(open(p).unwrap().read(2, &mut Vec::new()).is_err()));
}

#[test]
fn refuses_what_gzip_cannot_hold_and_reports_short_streams() {
    let mut huge = header(&[32767, 32767, 32767], 64, 64, false);
    huge.extend([0; 8]);
    assert!(load("a.nii.gz", &gzip(&huge)).unwrap_err().to_string().contains("more than the file"));
    let short = load("a.nii.gz", &gzip(&four_d()[..364])).unwrap_err().to_string();
    assert!(short.contains("step 1") && short.contains("truncated"), "{short}");
    let packed = gzip(&four_d());
    assert!(load("a.nii.gz", &packed[..packed.len() - 12]).is_err());
}

proptest! {
    #[test]
    fn damage_never_panics(
        packed: bool,
        edits in prop::collection::vec((0usize..370, any::<u8>()), 1..6),
        cut in prop::option::of(0usize..370),
    ) {
        let mut f = four_d();
        for (at, b) in edits {
            let n = f.len();
            f[at % n] = b;
        }
        if let Some(cut) = cut {
            f.truncate(cut);
        }
        if let Ok((h, steps)) = load("a.nii", &if packed { gzip(&f) } else { f }) {
            prop_assert_eq!(h.steps, steps.len());
            prop_assert!(steps.iter().all(|s| s.len() == h.grid.len()));
        }
    }

    #[test]
    fn damaged_gzip_never_panics(edits in prop::collection::vec((2usize..200, any::<u8>()), 1..4)) {
        let mut f = gzip(&four_d());
        for (at, b) in edits {
            let n = f.len();
            f[at % n] = b;
        }
        let _ = load("a.nii.gz", &f);
    }
}
