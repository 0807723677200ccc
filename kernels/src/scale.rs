//! A gradient that a loss computed in its forward pass, times the gradient of the loss itself.

use crate::backend::{CpuBackend, for_cpu_backends};
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

fn cpu<B: CpuBackend>(values: FloatTensor<B>, by: &FloatTensor<B>) -> FloatTensor<B> {
    let by = B::values(by)[0];
    if by == 1.0 {
        return values;
    }
    let (shape, device) = (values.shape(), values.device());
    let mut values = B::into_values(values);
    values.par_chunks_mut(TASK).for_each(|values| values.iter_mut().for_each(|value| *value *= by));
    B::tensor(values, shape, &device)
}

macro_rules! bind {
    ($backend:ty) => {
        impl ScaleOps for $backend {
            fn scaled(values: FloatTensor<Self>, by: FloatTensor<Self>) -> FloatTensor<Self> {
                cpu::<Self>(values, &by)
            }
        }
    };
}

for_cpu_backends!(bind);

#[cfg(feature = "cube")]
impl ScaleOps for burn_cubecl::CubeBackend {
    fn scaled(values: FloatTensor<Self>, by: FloatTensor<Self>) -> FloatTensor<Self> {
        use burn::backend::ops::FloatTensorOps;
        let ones: Vec<usize> = values.shape().iter().map(|_| 1).collect();
        Self::float_mul(values, Self::float_reshape(by, ones.into()))
    }
}
