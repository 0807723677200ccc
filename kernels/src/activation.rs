//! The sigmoid and its inverse, the form in which opacities are stored, defined once for all host code. GPU kernels and
//! the f64 oracles write them out themselves: the former because their language requires it, the latter to stay
//! independent.

/// `1 / (1 + exp(-x))`, in (0, 1): the opacity of a logit.
#[inline(always)]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// [`sigmoid`] in double precision.
#[inline]
pub fn sigmoid_f64(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// The inverse of [`sigmoid`] for `p` in (0, 1): the logit of an opacity.
#[inline]
pub fn logit(p: f32) -> f32 {
    (p / (1.0 - p)).ln()
}

/// The inverse of [`sigmoid_f64`] for `p` in (0, 1), accurate for tiny `p` too.
#[inline]
pub fn logit_f64(p: f64) -> f64 {
    p.ln() - (-p).ln_1p()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sigmoid_and_logit_are_inverses() {
        for x in [-20.0, -3.0, -0.5, 0.0, 0.1, 2.0, 7.0] {
            assert!((logit_f64(sigmoid_f64(x)) - x).abs() < 1e-9, "{x}");
        }
        for p in [1e-6f32, 0.004, 0.1, 0.5, 0.9, 0.99] {
            assert!((sigmoid(logit(p)) / p - 1.0).abs() < 1e-5, "{p}");
            assert!((f64::from(logit(p)) - logit_f64(p.into())).abs() < 1e-5, "{p}");
        }
    }

    #[test]
    fn extremes_are_finite_or_nan() {
        assert_eq!((sigmoid(-1e4), sigmoid(1e4)), (0.0, 1.0));
        assert_eq!((sigmoid_f64(-1e4), sigmoid_f64(1e4)), (0.0, 1.0));
        assert!(sigmoid(f32::NAN).is_nan() && logit_f64(f64::NAN).is_nan());
        assert_eq!((logit(0.0), logit(1.0)), (f32::NEG_INFINITY, f32::INFINITY));
    }
}
