use proptest::prelude::*;

use super::*;
use crate::data::Camera;
use crate::device::DeviceName;
use crate::model::params::to_vec;
use crate::model::{Rendering, ToKernel};
use glam::DVec3;
use volseggs_kernels::splat::splat;

fn sample(n: usize, sh_degree: usize) -> HostGaussians {
    let k = (sh_degree + 1) * (sh_degree + 1);
    let value = |i: usize| i as f32 * 0.25 - 3.0;
    HostGaussians {
        means: (0..n).flat_map(|i| [value(i), 1.5, -2.0]).collect(),
        log_scales: (0..n).flat_map(|i| [-value(i), 0.5, 0.25]).collect(),
        rotations: (0..n).flat_map(|i| [1.0, value(i), 0.0, 0.5]).collect(),
        opacity_logits: (0..n).map(value).collect(),
        sh: (0..n * k * 3).map(value).collect(),
        sh_stride: k,
        ..HostGaussians::default()
    }
}

/// The file without added coefficients.
fn bytes(gaussians: &HostGaussians) -> Vec<u8> {
    let mut out = Vec::new();
    write_to(gaussians, &options(gaussians), &mut out).unwrap();
    out
}

fn options(gaussians: &HostGaussians) -> SplatFileOptions {
    SplatFileOptions { sh_degree: gaussians.sh_degree(), ..SplatFileOptions::default() }
}

fn read(mut bytes: &[u8]) -> Result<HostGaussians, String> {
    read_from(&mut bytes).map_err(|error| match error {
        ReadError::Format(reason) => reason,
        ReadError::Io(error) => panic!("{error}"),
    })
}

#[test]
fn the_header_is_byte_exact_and_colours_lie_channel_by_channel() {
    let gaussians = sample(1, 1);
    let mut expected = String::from("ply\nformat binary_little_endian 1.0\ncomment volseggs\nelement vertex 1\n");
    for name in [
        "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "f_rest_0", "f_rest_1", "f_rest_2", "f_rest_3",
        "f_rest_4", "f_rest_5", "f_rest_6", "f_rest_7", "f_rest_8", "opacity", "scale_0", "scale_1", "scale_2",
        "rot_0", "rot_1", "rot_2", "rot_3",
    ] {
        expected += &format!("property float {name}\n");
    }
    expected += "end_header\n";
    let written = bytes(&gaussians);
    assert_eq!(&written[..expected.len()], expected.as_bytes());
    let row: Vec<f32> =
        written[expected.len()..].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    assert_eq!(row.len(), 26);
    assert_eq!(row[3..6], [0.0; 3]);
    let sh = |k: usize, c: usize| gaussians.sh[k * 3 + c];
    assert_eq!(row[6..9], [sh(0, 0), sh(0, 1), sh(0, 2)]);
    assert_eq!(row[9..12], [sh(1, 0), sh(2, 0), sh(3, 0)]);
    assert_eq!(row[15..18], [sh(1, 2), sh(2, 2), sh(3, 2)]);
}

#[test]
fn a_file_round_trips_at_every_degree() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.ply");
    for degree in 0..=3 {
        for n in [0, 5] {
            let gaussians = sample(n, degree);
            write(&gaussians, &path, &options(&gaussians)).unwrap();
            assert_eq!(super::read(&path).unwrap(), gaussians);
        }
    }
    assert!(super::read(&dir.path().join("none.ply")).is_err());
    std::fs::write(&path, "a thesis").unwrap();
    assert!(matches!(write(&sample(1, 0), &path, &SplatFileOptions::default()), Err(SplatFileError::Replace(_))));
    assert_eq!(std::fs::read(&path).unwrap(), b"a thesis");
}

#[test]
fn by_default_a_file_has_the_degree_that_the_reference_loader_accepts_and_looks_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.ply");
    let camera = Camera::look_at(DVec3::new(0.3, -5.0, 0.4), DVec3::ZERO, DVec3::Z, 1.2, 24, 20).to_kernel();
    let device = DeviceName::all()[0].open().unwrap();
    let image = |gaussians: &HostGaussians| {
        let sh_degree = gaussians.sh_degree();
        let rendering = Rendering { background: [0.1; 3], sh_degree, ..Rendering::default() };
        to_vec(splat(gaussians.to_splat(&device), rendering.seen_by(camera)).image)
    };
    for degree in 0..=3 {
        let mut gaussians = sample(12, degree).with_unit_rotations();
        for (i, v) in gaussians.means.iter_mut().chain(&mut gaussians.sh).enumerate() {
            *v = 0.7 * (1.9 * i as f32).sin();
        }
        let options = SplatFileOptions { comments: vec!["scale 2".into()], ..SplatFileOptions::default() };
        write(&gaussians, &path, &options).unwrap();
        let text = String::from_utf8_lossy(&std::fs::read(&path).unwrap()).into_owned();
        assert_eq!(text.matches("property float f_rest_").count(), 45);
        assert!(text.contains("comment volseggs\ncomment scale 2\nelement"), "{text}");
        let read = super::read(&path).unwrap();
        // the coefficients of each channel stay in their places
        let k = gaussians.sh_stride;
        for (padded, sh) in read.sh.chunks_exact(48).zip(gaussians.sh.chunks_exact(3 * k)) {
            assert_eq!(&padded[..3 * k], sh);
            assert!(padded[3 * k..].iter().all(|v| *v == 0.0));
        }
        assert_eq!(image(&read), image(&gaussians));
        for too_low in 0..degree {
            let options = SplatFileOptions { sh_degree: too_low, ..SplatFileOptions::default() };
            let error = write(&gaussians, &path, &options).unwrap_err().to_string();
            assert!(error.contains(&format!("from {degree} to 3")), "{error}");
        }
    }
}

#[test]
fn other_orders_types_and_properties_are_accepted() {
    let mut data = String::from(
        "ply\r\nformat binary_little_endian 1.0\r\ncomment by hand\nelement vertex 1\n\
         property uchar red\nproperty double opacity\n",
    );
    let names = [
        "rot_3", "rot_2", "rot_1", "rot_0", "z", "y", "x", "f_dc_2", "f_dc_1", "f_dc_0", "scale_2", "scale_1",
        "scale_0",
    ];
    for name in names {
        data += &format!("property float32 {name}\n");
    }
    data += "element face 7\nproperty list uchar int vertex_indices\nend_header\n";
    let mut data = data.into_bytes();
    data.push(9);
    data.extend(0.5f64.to_le_bytes());
    data.extend((0..names.len()).flat_map(|i| (i as f32).to_le_bytes()));
    let read = read(&data).unwrap();
    assert_eq!(read.opacity_logits, [0.5]);
    assert_eq!(read.rotations, [3.0, 2.0, 1.0, 0.0]);
    assert_eq!(read.means, [6.0, 5.0, 4.0]);
    assert_eq!(read.sh, [9.0, 8.0, 7.0]);
    assert_eq!(read.log_scales, [12.0, 11.0, 10.0]);
}

#[test]
fn wrong_files_are_named() {
    let good = bytes(&sample(2, 0));
    let text = String::from_utf8_lossy(&good).into_owned();
    let with = |from: &str, to: &str| read(text.replace(from, to).as_bytes()).unwrap_err();
    assert!(with("binary_little_endian", "ascii").contains("ascii is not supported"));
    assert!(with("element vertex 2", "element point 2").contains("`point`"));
    assert!(with("vertex 2", "vertex -2").contains("is not a count"));
    assert!(with("float opacity", "float o").contains("`opacity` is missing"));
    assert!(with("float nx", "float f_rest_0").contains("do not match a degree"));
    assert!(with("float nx", "quad nx").contains("unknown type quad"));
    assert!(with("ply\n", "plx\n").contains("not a PLY file"));
    let cut = read(&good[..good.len() - 1]).unwrap_err();
    assert!(cut.contains("Gaussian 1 of 2"), "{cut}");
    // A number of rows that could never fit into memory fails at the first missing row.
    assert!(with("vertex 2", "vertex 18446744073709551615").contains("cut short"));
}

#[test]
fn fields_of_different_lengths_are_not_written() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.ply");
    let mut gaussians = sample(2, 1);
    gaussians.sh.pop();
    let error = write(&gaussians, &path, &SplatFileOptions::default()).unwrap_err().to_string();
    assert!(error.contains("sh holds 23 entries"), "{error}");
    assert!(!path.exists());
    gaussians.sh_stride = 25;
    assert!(write(&gaussians, &path, &SplatFileOptions::default()).is_err());
}

#[test]
fn every_truncation_is_an_error_and_none_panics() {
    let good = bytes(&sample(2, 1));
    for length in 0..good.len() {
        assert!(read(&good[..length]).is_err(), "{length}");
    }
}

proptest! {
    #[test]
    fn any_bits_round_trip(degree in 0usize..=3, seed in any::<[u32; 16]>(), n in 0usize..4) {
        let k = (degree + 1) * (degree + 1);
        let value = |i: usize| f32::from_bits(seed[i % 16].rotate_left(i as u32 / 16));
        let gaussians = HostGaussians {
            means: (0..n).flat_map(|i| [value(i), value(i + 1), value(i + 2)]).collect(),
            log_scales: (0..n).flat_map(|i| [value(i + 3), value(i + 4), value(i + 5)]).collect(),
            rotations: (0..n).flat_map(|i| [value(i), value(i + 6), value(i + 7), value(i)]).collect(),
            opacity_logits: (0..n).map(value).collect(),
            sh: (0..n * k * 3).map(value).collect(),
            sh_stride: k,
            ..HostGaussians::default()
        };
        let written = bytes(&gaussians);
        // Compared as bytes, for NaN.
        prop_assert_eq!(bytes(&read(&written).unwrap()), written);
    }

    #[test]
    fn changed_bytes_never_panic(at in 0usize..900, byte in any::<u8>()) {
        let mut data = bytes(&sample(2, 1));
        let at = at % data.len();
        data[at] = byte;
        let _ = read(&data);
    }
}
