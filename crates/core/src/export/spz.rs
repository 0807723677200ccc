//! Gaussians as an SPZ file (Niantic's compressed splats, version 3), which viewers on the web and on phones open.
//!
//! The file is one gzip stream: a header of 16 bytes, then, for all Gaussians, the means (24-bit fixed point),
//! opacities, base colours, log scales (one byte per number), rotations (the three smallest components in ten bits
//! each) and the other coefficients of the harmonics (one byte each). Coordinates are the scene's own, as in the PLY
//! files.

use super::exporters::{Content, Exporter};
use super::splat_file::{self, SplatFileError, SplatFileOptions};
use crate::files::MARK;
use crate::model::HostGaussians;
use flate2::{Compression, GzBuilder};
use std::io::{self, Write};
use std::path::Path;

/// "NGSP", little-endian.
const MAGIC: u32 = 0x5053_474e;
const VERSION: u32 = 3;
/// Bits of a coordinate, including its sign.
const COORDINATE_BITS: i32 = 24;
/// Maximum number of fractional bits: more are below the precision of an f32 near 1.
const MAX_FRACTION_BITS: i32 = 20;
/// Base colours are `0.5 + COLOUR * coefficient`.
const COLOUR: f32 = 0.15;

/// Niantic's format.
pub(super) const EXPORTER: Exporter = Exporter {
    extension: "spz",
    endings: &[],
    description: "Niantic's compressed splats, about a fifth of a PLY",
    content: Content::Gaussians { write, log_scales: -10.0..=5.9375, has_sh_degree: false },
};

/// Writes the Gaussians atomically, replacing only a file of this program. Shaded ones are written as
/// [`HostGaussians::baked`], since readers support only harmonics.
///
/// Comments are part of the comment of the gzip stream, as the format has no place for them. One byte
/// per number is coarse: log scales are clamped to [-10, 5.9], and coefficients beyond the first to [-1, 1).
///
/// # Errors
/// [`SplatFileError::Shape`] if the fields differ in length or a mean is not finite or too far out,
/// [`SplatFileError::Replace`] if something else is there or the folder is missing, [`SplatFileError::Io`] from the
/// file system.
pub fn write(gaussians: &HostGaussians, path: &Path, options: &SplatFileOptions) -> Result<(), SplatFileError> {
    let gaussians = splat_file::plain(gaussians)?;
    let fraction = fraction_bits(&gaussians.means)?;
    splat_file::write(path, |file| compress(&body(&gaussians, fraction), &options.comments, file))
}

fn compress(bytes: &[u8], comments: &[String], out: &mut impl Write) -> io::Result<()> {
    // the comment in its header identifies a file of this program
    let mut comment = MARK.to_owned();
    for line in comments {
        // what ends a comment cannot be in it
        comment += &format!("\n{}", line.replace('\0', " "));
    }
    let mut gzip = GzBuilder::new().comment(comment).write(out, Compression::best());
    gzip.write_all(bytes)?;
    gzip.finish().map(drop)
}

/// Returns the number of fractional bits: as many as leave room for the mean that is farthest out.
fn fraction_bits(means: &[f32]) -> Result<i32, SplatFileError> {
    let farthest = means.iter().fold(0.0f32, |most, v| if v.is_finite() { most.max(v.abs()) } else { f32::INFINITY });
    let whole = (0..COORDINATE_BITS).find(|bits| farthest < 2f32.powi(*bits) - 1.0);
    match whole {
        Some(bits) => Ok((COORDINATE_BITS - 1 - bits).min(MAX_FRACTION_BITS)),
        None => Err(SplatFileError::Shape(format!("a coordinate of {farthest} is beyond what SPZ can hold"))),
    }
}

fn body(gaussians: &HostGaussians, fraction: i32) -> Vec<u8> {
    let [means, rotations, log_scales, _, sh] = gaussians.common_columns();
    let n = gaussians.len();
    let mut out = Vec::with_capacity(16 + n * (9 + 1 + 3 + 3 + 4 + sh.width));
    for word in [MAGIC, VERSION, n as u32] {
        out.extend(word.to_le_bytes());
    }
    out.extend([gaussians.sh_degree() as u8, fraction as u8, 0, 0]);
    let scale = 2f32.powi(fraction);
    out.extend(means.values.iter().flat_map(|v| {
        let [low, middle, high, _] = ((v * scale).round() as i32).to_le_bytes();
        [low, middle, high]
    }));
    out.extend(gaussians.opacity().iter().map(|o| byte(255.0 * o)));
    out.extend((0..n).flat_map(|i| &sh.row(i)[..3]).map(|v| byte(255.0 * (COLOUR * v + 0.5))));
    out.extend(log_scales.values.iter().map(|v| byte(16.0 * (v + 10.0))));
    out.extend((0..n).flat_map(|i| smallest_three(rotations.row(i)).to_le_bytes()));
    out.extend((0..n).flat_map(|i| &sh.row(i)[3..]).map(|v| byte(128.0 * v + 128.0)));
    out
}

/// Rounds a value to a byte; the cast saturates.
fn byte(value: f32) -> u8 {
    value.round() as u8
}

/// Packs a quaternion w, x, y, z without its largest component, which follows from the length of 1: two bits for which
/// of x, y, z, w that is, and for each of the others, in that order, its sign and nine bits of its magnitude, at most
/// the root of 1/2.
fn smallest_three(rotation: &[f32]) -> u32 {
    let [w, x, y, z] = std::array::from_fn(|k| rotation[k]);
    let norm = (w * w + x * x + y * y + z * z).sqrt();
    let unit = if norm > 1e-12 { [x, y, z, w].map(|v| v / norm) } else { [0.0, 0.0, 0.0, 1.0] };
    let largest = (1..4).fold(0, |best, k| if unit[k].abs() > unit[best].abs() { k } else { best });
    let mut packed = largest as u32;
    for (_, value) in unit.iter().enumerate().filter(|(k, _)| *k != largest) {
        // the largest is made positive: -q is the same rotation as q
        let is_negative = (*value < 0.0) != (unit[largest] < 0.0);
        let size = (511.0 * value.abs() / std::f32::consts::FRAC_1_SQRT_2 + 0.5) as u32;
        packed = packed << 10 | u32::from(is_negative) << 9 | size.min(511);
    }
    packed
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::read::GzDecoder;
    use std::io::Read;
    use volseggs_kernels::activation::sigmoid;

    fn some(n: usize, sh_stride: usize) -> HostGaussians {
        let wave = |width: usize, size: f32, from: f32| -> Vec<f32> {
            (0..n * width).map(|i| from + size * (1.7 * i as f32).sin()).collect()
        };
        HostGaussians {
            means: wave(3, 2.5, 0.1),
            rotations: wave(4, 1.0, 0.0),
            log_scales: wave(3, 2.0, -5.0),
            opacity_logits: wave(1, 4.0, 0.0),
            sh: wave(3 * sh_stride, 0.9, 0.0),
            sh_stride,
            ..HostGaussians::default()
        }
    }

    fn written(gaussians: &HostGaussians) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.spz");
        write(gaussians, &path, &SplatFileOptions::default()).unwrap();
        let options = SplatFileOptions { comments: vec!["scale 2".into()], ..SplatFileOptions::default() };
        write(gaussians, &path, &options).unwrap(); // replaces its own file
        let mut bytes = Vec::new();
        let mut file = GzDecoder::new(std::fs::File::open(&path).unwrap());
        file.read_to_end(&mut bytes).unwrap();
        assert_eq!(file.header().unwrap().comment(), Some(&b"volseggs\nscale 2"[..]));
        bytes
    }

    /// Reads according to the format, in plain steps; holds the bytes that are left.
    struct Reader<'a>(&'a [u8]);

    impl Reader<'_> {
        fn take(&mut self, n: usize) -> Vec<f32> {
            let (now, rest) = self.0.split_at(n);
            self.0 = rest;
            now.iter().map(|b| f32::from(*b)).collect()
        }
    }

    #[test]
    fn everything_comes_back_as_exactly_as_the_format_allows() {
        for stride in [1, 4, 16] {
            let (n, all) = (200, some(200, stride));
            let bytes = written(&all);
            assert_eq!(bytes.len(), 16 + n * (20 + 3 * (stride - 1)));
            assert_eq!(bytes[..12], [b"NGSP".as_slice(), &[3, 0, 0, 0], &[200, 0, 0, 0]].concat()[..]);
            assert_eq!(bytes[12..16], [stride.isqrt() as u8 - 1, 20, 0, 0]);
            let mut reader = Reader(&bytes[16..]);
            let means = reader.take(9 * n);
            for (v, b) in all.means.iter().zip(means.chunks_exact(3)) {
                let fixed = b[0] + 256.0 * b[1] + 65_536.0 * b[2];
                let fixed = if b[2] > 127.0 { fixed - 16_777_216.0 } else { fixed };
                assert!((fixed / 1_048_576.0 - v).abs() < 1e-6, "{v}");
            }
            let close = |a: &[f32], b: Vec<f32>, off: f32| {
                assert_eq!(a.len(), b.len());
                assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() <= off), "{a:?} {b:?}");
            };
            let opacity: Vec<f32> = all.opacity_logits.iter().map(|l| sigmoid(*l)).collect();
            close(&opacity, reader.take(n).iter().map(|b| b / 255.0).collect(), 0.002);
            let rows = || all.sh.chunks_exact(3 * stride);
            let base: Vec<f32> = rows().flat_map(|row| &row[..3]).copied().collect();
            close(&base, reader.take(3 * n).iter().map(|b| (b / 255.0 - 0.5) / COLOUR).collect(), 0.0132);
            close(&all.log_scales, reader.take(3 * n).iter().map(|b| b / 16.0 - 10.0).collect(), 0.0313);
            for (q, b) in all.rotations.chunks_exact(4).zip(reader.take(4 * n).chunks_exact(4)) {
                let word = b.iter().rev().fold(0u32, |word, b| word << 8 | *b as u32);
                let largest = (word >> 30) as usize;
                let mut found = [0.0f32; 4];
                for (place, k) in (0..4).filter(|k| *k != largest).enumerate() {
                    let ten = word >> (10 * (2 - place)) & 1023;
                    let size = (ten & 511) as f32 / 511.0 * std::f32::consts::FRAC_1_SQRT_2;
                    found[k] = if ten & 512 > 0 { -size } else { size };
                }
                found[largest] = (1.0 - found.iter().map(|v| v * v).sum::<f32>()).max(0.0).sqrt();
                let norm = q.iter().map(|v| v * v).sum::<f32>().sqrt();
                // x, y, z, w in the file; w, x, y, z here; either sign
                let dot = q[0] * found[3] + q[1] * found[0] + q[2] * found[1] + q[3] * found[2];
                assert!((dot / norm).abs() > 0.99999, "{q:?} {found:?}");
            }
            let rest: Vec<f32> = rows().flat_map(|row| &row[3..]).copied().collect();
            let left = reader.0.len();
            close(&rest, reader.take(left).iter().map(|b| b / 128.0 - 1.0).collect(), 0.004);
        }
    }

    #[test]
    fn distant_means_have_fewer_fractional_bits_and_too_distant_ones_are_refused() {
        assert_eq!(fraction_bits(&[0.5, -0.2]).unwrap(), MAX_FRACTION_BITS);
        assert_eq!(fraction_bits(&[100.0, -3000.0]).unwrap(), 11);
        assert!(3000.0 * 2f32.powi(11) < 8_388_608.0);
        for far in [1e8, f32::NAN, f32::NEG_INFINITY] {
            let error = fraction_bits(&[0.0, far]).unwrap_err().to_string();
            assert!(error.contains("beyond what SPZ can hold"), "{error}");
        }
        let wild = HostGaussians { log_scales: vec![90.0, -90.0, f32::NAN], ..HostGaussians::zeros(1, 1) };
        assert_eq!(written(&wild)[16 + 13..16 + 16], [255, 0, 0]);
    }
}
