//! Converts stored values to `f32`: either byte order, every [`ScalarType`]. No files here.

use crate::volume::grid::ScalarType;
use half::f16;
use rayon::prelude::*;

/// Values converted by one task; fixed, though values are independent and no result depends on it.
const CHUNK: usize = 1 << 16;

/// Order of the bytes of one value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Endian {
    /// Lowest byte first.
    Little,
    /// Highest byte first.
    Big,
}

impl Endian {
    /// The bytes of a value, lowest first.
    fn to_little<const N: usize>(self, mut bytes: [u8; N]) -> [u8; N] {
        if self == Self::Big {
            bytes.reverse();
        }
        bytes
    }
}

/// Decodes the values numbered `first + i * stride` of `bytes` into `out[i]`. Where `bytes` holds fewer values, the
/// rest of `out` is unchanged. Integers beyond 2^24 round to the nearest `f32`; an `f64` beyond the range of `f32`
/// becomes infinite.
pub fn decode_into(bytes: &[u8], scalar: ScalarType, endian: Endian, first: usize, stride: usize, out: &mut [f32]) {
    decode_scaled(bytes, scalar, endian, None, first, stride, out);
}

/// Like [`decode_into`], but decodes a value `x` as `slope * x + inter` where `scale` holds `(slope, inter)`.
pub fn decode_scaled(
    bytes: &[u8],
    scalar: ScalarType,
    endian: Endian,
    scale: Option<(f64, f64)>,
    first: usize,
    stride: usize,
    out: &mut [f32],
) {
    macro_rules! as_f32 {
        ($number:expr) => {
            match scale {
                None => convert(bytes, first, stride, out, |b| $number(endian.to_little(b)) as f32),
                Some((slope, inter)) => {
                    convert(bytes, first, stride, out, |b| ($number(endian.to_little(b)) as f64 * slope + inter) as f32)
                }
            }
        };
    }
    match scalar {
        ScalarType::U8 => as_f32!(u8::from_le_bytes),
        ScalarType::I8 => as_f32!(i8::from_le_bytes),
        ScalarType::U16 => as_f32!(u16::from_le_bytes),
        ScalarType::I16 => as_f32!(i16::from_le_bytes),
        ScalarType::U32 => as_f32!(u32::from_le_bytes),
        ScalarType::I32 => as_f32!(i32::from_le_bytes),
        ScalarType::F16 => as_f32!(|b| f16::from_le_bytes(b).to_f32()),
        ScalarType::F32 => as_f32!(f32::from_le_bytes),
        ScalarType::U64 => as_f32!(u64::from_le_bytes),
        ScalarType::I64 => as_f32!(i64::from_le_bytes),
        ScalarType::F64 => as_f32!(f64::from_le_bytes),
    }
}

/// Reads a value of this type from text; `None` if it is none, or out of range.
pub fn parse(text: &str, scalar: ScalarType) -> Option<f32> {
    let whole = |low: i64, high: i64| text.parse().ok().filter(|v| (low..=high).contains(v)).map(|v: i64| v as f32);
    match scalar {
        ScalarType::U8 => whole(0, i64::from(u8::MAX)),
        ScalarType::I8 => whole(i64::from(i8::MIN), i64::from(i8::MAX)),
        ScalarType::U16 => whole(0, i64::from(u16::MAX)),
        ScalarType::I16 => whole(i64::from(i16::MIN), i64::from(i16::MAX)),
        ScalarType::U32 => whole(0, i64::from(u32::MAX)),
        ScalarType::I32 => whole(i64::from(i32::MIN), i64::from(i32::MAX)),
        ScalarType::I64 => whole(i64::MIN, i64::MAX),
        ScalarType::U64 => text.parse::<u64>().ok().map(|v| v as f32),
        ScalarType::F16 | ScalarType::F32 => text.parse().ok(),
        ScalarType::F64 => text.parse::<f64>().ok().map(|v| v as f32),
    }
}

fn convert<const N: usize>(
    bytes: &[u8],
    first: usize,
    stride: usize,
    out: &mut [f32],
    value: impl Fn([u8; N]) -> f32 + Sync,
) {
    let (values, _) = bytes.as_chunks::<N>();
    let values = values.get(first..).unwrap_or_default();
    let stride = stride.max(1);
    let fill = |from: usize, part: &mut [f32]| {
        let values = values.get(from * stride..).unwrap_or_default();
        if stride == 1 {
            part.iter_mut().zip(values).for_each(|(o, b)| *o = value(*b));
        } else {
            part.iter_mut().zip(values.iter().step_by(stride)).for_each(|(o, b)| *o = value(*b));
        }
    };
    if out.len() <= CHUNK {
        fill(0, out);
    } else {
        out.par_chunks_mut(CHUNK).enumerate().for_each(|(i, part)| fill(i * CHUNK, part));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Decodes all of `bytes` into `out`, which is cleared first.
    fn decode(bytes: &[u8], scalar: ScalarType, endian: Endian, out: &mut Vec<f32>) {
        out.clear();
        out.resize(bytes.len() / scalar.bytes(), 0.0);
        decode_into(bytes, scalar, endian, 0, 1, out);
    }

    macro_rules! round_trip {
        ($name:ident, $number:ty, $scalar:expr) => {
            proptest! {
                #[test]
                fn $name(values in proptest::collection::vec(any::<$number>(), 0..40)) {
                    let expected: Vec<u32> = values.iter().map(|&v| (v as f32).to_bits()).collect();
                    let le: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
                    let be: Vec<u8> = values.iter().flat_map(|v| v.to_be_bytes()).collect();
                    // poison: previous content must not show
                    let mut out = vec![f32::NAN; 7];
                    decode(&le, $scalar, Endian::Little, &mut out);
                    prop_assert_eq!(out.iter().map(|v| v.to_bits()).collect::<Vec<_>>(), expected.clone());
                    decode(&be, $scalar, Endian::Big, &mut out);
                    prop_assert_eq!(out.iter().map(|v| v.to_bits()).collect::<Vec<_>>(), expected);
                }
            }
        };
    }
    round_trip!(u8_round_trip, u8, ScalarType::U8);
    round_trip!(i8_round_trip, i8, ScalarType::I8);
    round_trip!(u16_round_trip, u16, ScalarType::U16);
    round_trip!(i16_round_trip, i16, ScalarType::I16);
    round_trip!(u32_round_trip, u32, ScalarType::U32);
    round_trip!(i32_round_trip, i32, ScalarType::I32);
    round_trip!(f32_round_trip, f32, ScalarType::F32);
    round_trip!(f64_round_trip, f64, ScalarType::F64);
    round_trip!(u64_round_trip, u64, ScalarType::U64);
    round_trip!(i64_round_trip, i64, ScalarType::I64);

    #[test]
    fn every_half_float_is_exact() {
        let all: Vec<f16> = (0..=u16::MAX).map(f16::from_bits).collect();
        for (endian, bytes) in [
            (Endian::Little, all.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>()),
            (Endian::Big, all.iter().flat_map(|v| v.to_be_bytes()).collect()),
        ] {
            let mut out = Vec::new();
            decode(&bytes, ScalarType::F16, endian, &mut out);
            assert!(out.iter().zip(&all).all(|(o, v)| o.to_bits() == v.to_f32().to_bits() || v.is_nan() && o.is_nan()));
        }
    }

    #[test]
    fn large_input_equals_the_values_one_by_one() {
        let n = 3 * CHUNK + 17;
        let bytes: Vec<u8> = (0..n).flat_map(|i| ((i * 7919) as u16).to_be_bytes()).collect();
        let mut out = Vec::new();
        decode(&bytes, ScalarType::U16, Endian::Big, &mut out);
        assert_eq!(out.len(), n);
        assert!(out.iter().enumerate().all(|(i, &v)| v == f32::from((i * 7919) as u16)));
        let mut strided = vec![f32::NAN; n / 2];
        decode_into(&bytes, ScalarType::U16, Endian::Big, 1, 2, &mut strided);
        assert!(strided.iter().enumerate().all(|(i, &v)| v == out[1 + 2 * i]));
    }

    #[test]
    fn short_input_leaves_the_rest_and_does_not_panic() {
        let mut out = [-5.0; 4];
        decode_into(&[1, 2, 3], ScalarType::U8, Endian::Little, 1, 1, &mut out);
        assert_eq!(out, [2.0, 3.0, -5.0, -5.0]);
        decode_into(&[1, 2, 3], ScalarType::U8, Endian::Little, 9, 3, &mut out);
        assert_eq!(out, [2.0, 3.0, -5.0, -5.0]);
    }
}
