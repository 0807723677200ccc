//! A gradient that a loss computed in its forward pass, times the gradient of the loss itself.

use crate::backend::CpuBackend;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata};
use rayon::prelude::*;

/// Values per task.
const TASK: usize = 1 << 16;

/// Multiplication by a number that is a tensor `[1]`, for backends that compute.
pub trait ScaleOps: Backend {
    /// Returns `values` times `by` `[1]`, in place if nobody else holds them.
    fn scaled(values: FloatTensor<Self>, by: FloatTensor<Self>) -> FloatTensor<Self>;
}

/// The backward pass of a loss that computed its gradients in the forward pass: each of them times that of the loss, `by`
/// `[1]`.
pub(crate) fn scaled<B: ScaleOps, const N: usize>(
    grads: [FloatTensor<B>; N],
    by: FloatTensor<B>,
) -> [FloatTensor<B>; N] {
    grads.map(|grad| B::scaled(grad, by.clone()))
}

impl<B: CpuBackend> ScaleOps for B {
    fn scaled(values: FloatTensor<Self>, by: FloatTensor<Self>) -> FloatTensor<Self> {
        let by = B::values(&by)[0];
        if by == 1.0 {
            return values;
        }
        let (shape, device) = (values.shape(), values.device());
        let mut values = B::into_values(values);
        values.par_chunks_mut(TASK).for_each(|values| values.iter_mut().for_each(|value| *value *= by));
        B::tensor(values, shape, &device)
    }
}

#[cfg(feature = "cube")]
impl ScaleOps for burn_cubecl::CubeBackend {
    fn scaled(values: FloatTensor<Self>, by: FloatTensor<Self>) -> FloatTensor<Self> {
        use burn::backend::ops::FloatTensorOps;
        let ones: Vec<usize> = values.shape().iter().map(|_| 1).collect();
        Self::float_mul(values, Self::float_reshape(by, ones.into()))
    }
}
