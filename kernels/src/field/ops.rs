//! The field as a differentiable op on tensors for every backend, with its implementation for those in host memory.

use super::cpu::{backward, forward};
use super::params::{FieldGrads, FieldParams};
use super::shape::FieldShape;
use crate::backend::{CpuBackend, zeros};
use crate::tensors::{like, op_tensors, recorded};
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, TensorMetadata, backend_extension};
use burn::tensor::Tensor;
use rayon::prelude::*;

op_tensors! {
    /// The inputs of [`field`] on a backend, or the gradient with respect to each of them.
    FieldTensors[4] {
        /// `[planes_len]`
        planes,
        /// `[lines_len]`
        lines,
        /// `[times_len]`
        times,
        /// `[N, 3]`
        points,
    }
}

/// The backend side of [`field`].
#[backend_extension(Autodiff, NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait FieldOps: Backend {
    /// Returns the features `[N, levels * R]`.
    fn field_forward(#[extension_type] inputs: FieldTensors<Self>, shape: FieldShape, time: f32) -> FloatTensor<Self>;
}

/// The backward side of [`field`], for backends that compute. The autodiff backend does not implement it, so a second
/// derivative does not compile.
pub trait FieldBackwardOps: Backend {
    /// Returns the gradients for `grad` `[N, levels * R]`.
    fn field_backward(
        inputs: FieldTensors<Self>,
        grad: FloatTensor<Self>,
        shape: FieldShape,
        time: f32,
    ) -> FieldTensors<Self>;
}

/// Samples the factorised space-time field (the paper's T4, before the decoder).
///
/// `planes`, `lines` and `times` are the flat parameter buffers that [`FieldShape`] describes, `points`
/// `[N, 3]` lie in [-1, 1] and `time` in [0, 1] spans all the time knots. Returns `[N, levels * R]`.
///
/// # Panics
/// If `shape` is invalid, or a buffer does not fit it.
pub fn field(
    planes: Tensor<1>,
    lines: Tensor<1>,
    times: Tensor<1>,
    points: Tensor<2>,
    shape: &FieldShape,
    time: f32,
) -> Tensor<2> {
    shape.check([&planes, &lines, &times].map(|buffer| buffer.dims()[0]));
    let [n, three] = points.dims();
    assert_eq!(three, 3, "field: points are [N, 3], got [{n}, {three}]");
    let inputs = FieldTensors {
        planes: planes.into_dispatch(),
        lines: lines.into_dispatch(),
        times: times.into_dispatch(),
        points: points.into_dispatch(),
    };
    Tensor::from_dispatch(Dispatch::field_forward(inputs, shape.clone(), time))
}

impl<B: CpuBackend> FieldOps for B {
    fn field_forward(inputs: FieldTensors<Self>, shape: FieldShape, time: f32) -> FloatTensor<Self> {
        let n = inputs.points.shape()[0];
        let mut features = zeros(n * shape.features_len());
        let [planes, lines, times, points] = inputs.as_array().map(B::values);
        forward(&shape, FieldParams { planes: &planes, lines: &lines, times: &times }, &points, time, &mut features);
        B::tensor(features, [n, shape.features_len()], &inputs.points.device())
    }
}

impl<B: CpuBackend> FieldBackwardOps for B {
    fn field_backward(
        inputs: FieldTensors<Self>,
        grad: FloatTensor<Self>,
        shape: FieldShape,
        time: f32,
    ) -> FieldTensors<Self> {
        let [planes, lines, times, points] = inputs.as_array().map(B::values);
        let params = FieldParams { planes: &planes, lines: &lines, times: &times };
        let mut grads = [&planes, &lines, &times, &points].map(|values| zeros(values.len()));
        let [of_planes, of_lines, of_times, of_points] = &mut grads;
        let out = FieldGrads { planes: of_planes, lines: of_lines, times: of_times, points: of_points };
        let grad = B::values(&grad);
        // Gaussians seen by no pixel have a gradient of zero: about half of them in a translucent scene
        let rows = grad.par_chunks_exact(shape.features_len()).with_min_len(1024);
        let active: Vec<bool> = rows.map(|row| row.iter().any(|&g| g != 0.0)).collect();
        backward(&shape, params, &points, time, &grad, Some(&active), out);
        like::<B, _>(inputs.as_array(), grads).into()
    }
}

impl<B: FieldOps + FieldBackwardOps, C: CheckpointStrategy> FieldOps for Autodiff<B, C> {
    fn field_forward(inputs: FieldTensors<Self>, shape: FieldShape, time: f32) -> FloatTensor<Self> {
        let (inputs, nodes) = inputs.into_parts();
        recorded::<B, C, _, _>(
            nodes,
            (inputs, shape, time),
            |(inputs, shape, time)| B::field_forward(inputs, shape, time),
            |(inputs, shape, time), grad| B::field_backward(inputs, grad, shape, time).into_array(),
        )
    }
}
