//! Adam as a plain f64 loop: the oracle of the fast kernel.

use super::cpu::AdamStep;

/// Runs one step on every element; the bias corrections are computed from `t`, the step counted from 1, not taken from
/// `step`.
pub fn adam_step(param: &mut [f64], grad: &[f64], m: &mut [f64], v: &mut [f64], step: AdamStep, t: i32) {
    let (beta1, beta2) = (f64::from(step.beta1), f64::from(step.beta2));
    for i in 0..param.len() {
        m[i] = beta1 * m[i] + (1.0 - beta1) * grad[i];
        v[i] = beta2 * v[i] + (1.0 - beta2) * grad[i] * grad[i];
        let mean = m[i] / (1.0 - beta1.powi(t));
        let square = v[i] / (1.0 - beta2.powi(t));
        let factor = match step.lr_pattern {
            Some(p) if i % p.row_len >= p.head_len => f64::from(p.tail_factor),
            _ => 1.0,
        };
        param[i] -= f64::from(step.lr) * factor * mean / (square.sqrt() + f64::from(step.eps));
    }
}
