//! Exponential and logarithm without branches or calls, so that loops over lanes of numbers become vector instructions;
//! those of the standard library are one call for each number. Both keep NaN.

/// ln 2 in two parts, of which the first has few bits, so that its products with small integers are exact.
const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];

/// `e^x` with a relative error below 3e-7, for `x` bounded to [-87, 88], so that the result is neither subnormal nor
/// infinite.
#[inline(always)]
pub(crate) fn exp(x: f32) -> f32 {
    // adding 1.5 * 2^23 leaves the rounded number in the low bits of the mantissa
    const MAGIC: f32 = 12_582_912.0;
    let x = x.clamp(-87.0, 88.0);
    let rounded = x * std::f32::consts::LOG2_E + MAGIC;
    let n = rounded - MAGIC;
    let r = (x - n * LN_2[0]) - n * LN_2[1];
    let mut q = 1.987_569_1e-4;
    for c in [1.398_199_9e-3, 8.333_452e-3, 4.166_579_6e-2, 0.166_666_65, 0.5] {
        q = q * r + c;
    }
    let power = q * r * r + r + 1.0;
    f32::from_bits(power.to_bits().wrapping_add(rounded.to_bits() << 23))
}

/// The natural logarithm of a positive number that is not subnormal, with a relative error below 1.5e-7, also near 1; of
/// infinity infinity, of other numbers any value.
#[inline(always)]
pub(crate) fn ln(x: f32) -> f32 {
    /// The bits of the square root of one half.
    const ROOT: u32 = 0x3f35_04f3;
    let exponent = (x.to_bits().wrapping_sub(ROOT) as i32) >> 23;
    let f = f32::from_bits(x.to_bits().wrapping_sub((exponent << 23) as u32)) - 1.0;
    let n = exponent as f32;
    let mut q = 7.037_683_6e-2;
    for c in [
        -0.115_146_1,
        0.116_769_99,
        -0.124_201_41,
        0.142_493_23,
        -0.166_680_57,
        0.200_007_14,
        -0.249_999_94,
        0.333_333_3,
    ] {
        q = q * f + c;
    }
    let square = f * f;
    let value = n * LN_2[0] + (f + (q * f * square + (n * LN_2[1] - 0.5 * square)));
    if x < f32::INFINITY { value } else { x }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponentials_are_those_of_double_precision() {
        for i in -870_000..=880_000 {
            let x = i as f32 * 1e-4;
            let (found, exact) = (f64::from(exp(x)), f64::from(x).exp());
            assert!((found / exact - 1.0).abs() < 3e-7, "{x}: {found} against {exact}");
        }
        assert!(exp(f32::NEG_INFINITY) < 2e-38 && exp(f32::INFINITY) > 1e38 && exp(f32::NAN).is_nan());
        assert_eq!(exp(0.0), 1.0);
    }

    #[test]
    fn logarithms_are_those_of_double_precision() {
        // steps of 1 in 1000, and all numbers around 1
        let wide = (-87_000..=88_000).map(|i| (f64::from(i) * 1e-3).exp() as f32);
        let near = (-100_000i32..100_000).map(|i| f32::from_bits((1f32.to_bits() as i32 + i) as u32));
        for x in wide.chain(near) {
            let (found, exact) = (f64::from(ln(x)), f64::from(x).ln());
            let scale = exact.abs();
            assert!((found - exact).abs() <= 1.5e-7 * scale, "{x}: {found} against {exact}");
        }
        assert_eq!((ln(1.0), ln(f32::INFINITY)), (0.0, f32::INFINITY));
        assert!(ln(f32::NAN).is_nan());
    }
}
