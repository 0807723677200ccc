//! Exchange of memory between the CPU backends and the kernels.
//!
//! The kernels work on `&[f32]`; this file is the only one that knows how NdArray, Flex and LibTorch
//! store a tensor. Results are handed over without a copy. Ops are implemented for every [`CpuBackend`] at once.

use burn::backend::Backend;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::tensor::{Shape, TensorData};
use rayon::prelude::*;
use std::borrow::Cow;

/// A backend whose tensors live in host memory.
pub(crate) trait CpuBackend: Backend {
    /// The tensor's values in row-major order; borrowed when it is contiguous.
    fn values(tensor: &FloatTensor<Self>) -> Cow<'_, [f32]>;

    /// Takes the tensor's values for overwriting: the same memory where the backend allows it, otherwise a copy.
    fn into_values(tensor: FloatTensor<Self>) -> Vec<f32>;

    /// Wraps `values` as a tensor of `shape`, reusing the vector's memory.
    fn tensor(values: Vec<f32>, shape: impl Into<Shape>, device: &Self::Device) -> FloatTensor<Self> {
        Self::float_from_data(TensorData::new(values, shape), device)
    }

    /// Wraps integers as a tensor of `shape`, reusing the vector's memory.
    fn int_tensor(values: Vec<i32>, shape: impl Into<Shape>, device: &Self::Device) -> IntTensor<Self> {
        Self::int_from_data(TensorData::new(values, shape), device)
    }
}

/// Length from which buffers are written by all threads.
const LARGE: usize = 1 << 16;

/// Returns `len` zeros for a kernel to write to. One thread takes 4 ms for the features of 150,000 Gaussians, as long as
/// two take to compute them.
pub(crate) fn zeros(len: usize) -> Vec<f32> {
    filled(0.0, len)
}

/// Returns `len` copies of `value`, as [`zeros`].
pub(crate) fn filled<T: Copy + Send + Sync>(value: T, len: usize) -> Vec<T> {
    if len < LARGE {
        return vec![value; len];
    }
    let mut values = Vec::new();
    values.par_extend(rayon::iter::repeat_n(value, len).with_min_len(LARGE / 4));
    values
}

#[cfg(feature = "ndarray")]
mod ndarray {
    use super::*;
    use burn_ndarray::{NdArray, NdArrayTensor};

    impl CpuBackend for NdArray {
        fn values(tensor: &FloatTensor<Self>) -> Cow<'_, [f32]> {
            match tensor {
                NdArrayTensor::F32(storage) => {
                    let view = storage.view();
                    match view.to_slice() {
                        Some(slice) => Cow::Borrowed(slice),
                        None => Cow::Owned(view.iter().copied().collect()),
                    }
                }
                other => panic!("the kernels take f32 tensors, got {:?}", burn::backend::TensorMetadata::dtype(other)),
            }
        }

        fn into_values(tensor: FloatTensor<Self>) -> Vec<f32> {
            Self::values(&tensor).into_owned()
        }
    }
}

#[cfg(feature = "flex")]
mod flex {
    use super::*;
    use burn_flex::Flex;

    impl CpuBackend for Flex {
        fn values(tensor: &FloatTensor<Self>) -> Cow<'_, [f32]> {
            match tensor.as_slice::<f32>() {
                Some(slice) => Cow::Borrowed(slice),
                None => Cow::Owned(tensor.to_contiguous().storage::<f32>().to_vec()),
            }
        }

        fn into_values(tensor: FloatTensor<Self>) -> Vec<f32> {
            if tensor.is_unique() && tensor.is_contiguous() {
                let data = tensor.into_data();
                return data.try_into_vec::<f32>().expect("a contiguous f32 tensor gives its vector");
            }
            Self::values(&tensor).into_owned()
        }
    }
}

#[cfg(feature = "tch")]
mod tch {
    use super::*;
    use burn_tch::{LibTorch, TchTensor};

    impl CpuBackend for LibTorch {
        fn values(tensor: &FloatTensor<Self>) -> Cow<'_, [f32]> {
            assert_eq!(tensor.tensor.device(), ::tch::Device::Cpu, "the kernels take LibTorch tensors on the CPU");
            assert_eq!(tensor.tensor.kind(), ::tch::Kind::Float, "the kernels take f32 tensors");
            if tensor.tensor.is_contiguous() && tensor.tensor.numel() > 0 {
                let start = tensor.tensor.data_ptr().cast::<f32>();
                // SAFETY: a contiguous f32 CPU tensor holds `numel` values from that address on and outlives the
                // borrow; LibTorch writes in place only if the storage is not shared.
                return Cow::Borrowed(unsafe { std::slice::from_raw_parts(start, tensor.tensor.numel()) });
            }
            let flat = tensor.tensor.contiguous().reshape(-1);
            Cow::Owned(Vec::<f32>::try_from(&flat).expect("a flat f32 tensor gives its values"))
        }

        fn into_values(tensor: TchTensor) -> Vec<f32> {
            Self::values(&tensor).into_owned()
        }
    }
}
