//! Adam on a GPU: one unit per element, in place if the memory is not shared.
//!
//! Non-finite elements are not detected, as reporting them to the host would stall every step: they make the parameter
//! NaN. The caller notices that at the latest when it saves the parameters; the loss need not show it, as a Gaussian
//! with a NaN is not drawn.

use super::ops::{AdamOps, AdamOutput};
use super::{AdamStep, LrPattern};
use crate::cube::prelude::*;
use crate::cube::{UNITS, arg, cubes, rows};

#[cube(launch)]
fn update(
    param: &mut [f32],
    grad: &[f32],
    first: &mut [f32],
    second: &mut [f32],
    len: u32,
    rate: f32,
    keep1: f32,
    keep2: f32,
    root: f32,
    epsilon: f32,
    row_len: u32,
    head_len: u32,
    tail_factor: f32,
) {
    if ABSOLUTE_POS < len as usize {
        let i = ABSOLUTE_POS;
        let g = grad[i];
        let m = keep1 * first[i] + (1.0f32 - keep1) * g;
        let v = keep2 * second[i] + (1.0f32 - keep2) * (g * g);
        first[i] = m;
        second[i] = v;
        let in_tail = (i as u32) % row_len >= head_len;
        let rate = select(in_tail, rate * tail_factor, rate);
        param[i] -= rate * m / (f32::sqrt(v) * root + epsilon);
    }
}

/// Returns the tensor itself if it may be overwritten, otherwise a copy.
fn own(tensor: CubeTensor) -> CubeTensor {
    let tensor = rows(tensor);
    if tensor.can_mut() { tensor } else { tensor.copy() }
}

impl AdamOps for CubeBackend {
    fn adam(
        param: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        moment_1: FloatTensor<Self>,
        moment_2: FloatTensor<Self>,
        step: AdamStep,
    ) -> AdamOutput<Self> {
        let [param, moment_1, moment_2] = [param, moment_1, moment_2].map(own);
        let client = param.client.clone();
        let len = param.meta.shape().num_elements();
        let same = LrPattern { row_len: 1, head_len: 1, tail_factor: 1.0 };
        let pattern = step.lr_pattern.unwrap_or(same);
        assert!(pattern.row_len > 0 && len.is_multiple_of(pattern.row_len), "param must be whole rows");
        update::launch(
            &client,
            cubes(len, UNITS),
            CubeDim::new_1d(UNITS),
            arg(&param),
            arg(&rows(grad)),
            arg(&moment_1),
            arg(&moment_2),
            len as u32,
            step.lr / step.bias_correction1,
            step.beta1,
            step.beta2,
            1.0 / step.bias_correction2.sqrt(),
            step.eps,
            pattern.row_len as u32,
            pattern.head_len as u32,
            pattern.tail_factor,
        );
        AdamOutput { param, moment_1, moment_2, non_finite: None }
    }
}
