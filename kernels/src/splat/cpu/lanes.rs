//! The few vector operations that blending needs, over any SIMD width that `pulp` finds at run time.

use pulp::bytemuck;
use pulp::{Simd, WithSimd};

/// `log2(e)`.
pub(crate) const LOG2_E: f32 = std::f32::consts::LOG2_E;

/// Returns the lanes of a mask as bits, the first lane lowest.
#[inline(always)]
pub(crate) fn bits<S: Simd>(_: S, mask: S::m32s) -> u32 {
    #[cfg(target_arch = "x86_64")]
    if const { size_of::<S::m32s>() == size_of::<std::arch::x86_64::__m256>() } {
        // SAFETY: masks of this size exist only where pulp has found AVX; the sizes are equal and any bits are valid.
        return unsafe { std::arch::x86_64::_mm256_movemask_ps(std::mem::transmute_copy(&mask)) } as u32;
    }
    let bytes = bytemuck::bytes_of(&mask);
    if const { size_of::<S::m32s>() == size_of::<S::u32s>() } {
        // a word for each lane, of ones or zeros
        bytes.chunks_exact(4).enumerate().fold(0, |acc, (lane, word)| acc | u32::from(word[0] & 1) << lane)
    } else {
        // a bit for each lane
        bytes.iter().enumerate().fold(0, |acc, (i, &byte)| acc | u32::from(byte) << (8 * i))
    }
}

/// Returns true if any lane of the mask is set.
#[inline(always)]
pub(crate) fn any<S: Simd>(simd: S, mask: S::m32s) -> bool {
    bits(simd, mask) != 0
}

/// `2^p` for `p` in `[-30, 1]`, with a relative error below 2e-7. Other arguments give arbitrary values, including NaN.
///
/// The integer part is found by adding 1.5 * 2^23, which leaves it in the low bits of the mantissa.
#[inline(always)]
pub(crate) fn exp2<S: Simd>(simd: S, p: S::f32s) -> S::f32s {
    let magic = simd.splat_f32s(12_582_912.0);
    let rounded = simd.add_f32s(p, magic);
    let f = simd.sub_f32s(p, simd.sub_f32s(rounded, magic));
    // minimum relative error on [-0.5, 0.5] at this degree, 7.5e-8
    let mut q = simd.splat_f32s(1.327_647_2e-3);
    for c in [9.675_541e-3, 5.550_713e-2, 0.240_221_2, 0.693_146_94, 1.000_000_1] {
        q = simd.mul_add_e_f32s(q, f, simd.splat_f32s(c));
    }
    let exponent = simd.wrapping_dyn_shl_u32s(simd.transmute_u32s_f32s(rounded), simd.splat_u32s(23));
    simd.transmute_f32s_u32s(simd.add_u32s(simd.transmute_u32s_f32s(q), exponent))
}

struct Wide<F>(F);

impl<R, F: FnOnce() -> R> WithSimd for Wide<F> {
    type Output = R;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> R {
        (self.0)()
    }
}

/// Runs a closure compiled for the machine's widest instruction set; see [`wide`].
#[inline(always)]
pub(crate) fn run_wide<R>(f: impl FnOnce() -> R) -> R {
    crate::arch().dispatch(Wide(f))
}

/// Evaluates an expression, without `return` or `?`, compiled for the machine's widest instruction set. Only a closure
/// marked `#[inline(always)]` is certain to be compiled so, and a function cannot mark its argument.
macro_rules! wide {
    ($body:expr) => {
        $crate::splat::cpu::lanes::run_wide(
            #[inline(always)]
            || $body,
        )
    };
}
pub(crate) use wide;
