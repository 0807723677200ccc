//! The compositing rule on vectors of pixels, shared by drawing, its replay in the backward pass and the lists of
//! contributors, so that the weights of all three are bit-identical.

use super::lanes::exp2;
use crate::splat::{ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN};
use pulp::Simd;

/// The rule's constants, in every lane.
#[derive(Clone, Copy)]
pub(crate) struct Rule<S: Simd> {
    threshold: S::f32s,
    alpha_max: S::f32s,
    t_min: S::f32s,
    zero: S::f32s,
}

/// The effect of a Gaussian on a vector of pixels.
pub(crate) struct Effect<S: Simd> {
    /// Alpha before it was clamped.
    pub unclamped: S::f32s,
    /// Alpha, also where it was not blended.
    pub alpha: S::f32s,
    /// Alpha times transmittance where it was blended, 0 elsewhere.
    pub weight: S::f32s,
    /// The transmittance behind the Gaussian, where it was blended.
    pub after: S::f32s,
    /// Where it was blended: touched, and not finishing the pixel.
    pub blended: S::m32s,
}

impl<S: Simd> Rule<S> {
    #[inline(always)]
    pub(crate) fn new(simd: S) -> Self {
        Self {
            threshold: simd.splat_f32s(ALPHA_MIN.log2()),
            alpha_max: simd.splat_f32s(ALPHA_MAX),
            t_min: simd.splat_f32s(TRANSMITTANCE_MIN),
            zero: simd.splat_f32s(0.0),
        }
    }

    /// Returns `log2` of alpha before it is clamped: `(qa dx + qb) dx + constant`, where `qb` includes the factor dy
    /// and `constant` holds `qc dy^2` and the opacity.
    #[inline(always)]
    pub(crate) fn power(self, simd: S, dx: S::f32s, [qa, qb, constant]: [S::f32s; 3]) -> S::f32s {
        simd.mul_add_e_f32s(simd.mul_add_e_f32s(qa, dx, qb), dx, constant)
    }

    /// Returns where alpha is not too small and the pixel, given its transmittance `t`, is unfinished.
    #[inline(always)]
    pub(crate) fn touched(self, simd: S, power: S::f32s, t: S::f32s) -> S::m32s {
        simd.and_m32s(simd.greater_than_or_equal_f32s(power, self.threshold), simd.greater_than_f32s(t, self.zero))
    }

    /// Evaluates the Gaussian where it is `touched`.
    #[inline(always)]
    pub(crate) fn evaluate(self, simd: S, power: S::f32s, t: S::f32s, touched: S::m32s) -> Effect<S> {
        let unclamped = exp2(simd, power);
        let alpha = simd.min_f32s(unclamped, self.alpha_max);
        let weight = simd.mul_f32s(t, alpha);
        let after = simd.sub_f32s(t, weight);
        let blended = simd.and_m32s(touched, simd.greater_than_f32s(after, self.t_min));
        Effect { unclamped, alpha, weight: simd.select_f32s(blended, weight, self.zero), after, blended }
    }

    /// Returns the transmittance `t` after the Gaussian: unchanged where it did not touch a pixel, negated where it
    /// finished it.
    #[inline(always)]
    pub(crate) fn left(self, simd: S, t: S::f32s, effect: &Effect<S>, touched: S::m32s) -> S::f32s {
        simd.select_f32s(effect.blended, effect.after, simd.select_f32s(touched, simd.neg_f32s(t), t))
    }
}
