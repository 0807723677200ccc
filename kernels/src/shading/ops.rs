//! Shading as a differentiable op of the backends in host memory.

use super::cpu::{self, ShadingArrays};
use super::{GaussianShading, Light};
use crate::backend::CpuBackend;
use crate::tensors::{like, op_tensors, recorded};
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, TensorMetadata, backend_extension};
use burn::tensor::Tensor;

op_tensors! {
    /// The tensors of [`super::shaded`] on a backend, or the gradient with respect to each of them.
    ShadeTensors[5] {
        /// `[N, 3]`
        means,
        /// `[N, 4]`
        rotations,
        /// `[N, K, 3]`
        sh,
        /// `[N, 3]`
        normals,
        /// `[3]`
        material,
    }
}

/// The backend side of [`super::shaded`].
#[backend_extension(Autodiff, NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), LibTorch: cfg(feature = "tch"))]
pub trait ShadeOps: Backend {
    /// Returns the shaded coefficients `[N, K, 3]`.
    fn shade(#[extension_type] inputs: ShadeTensors<Self>, light: Light, eye: [f32; 3]) -> FloatTensor<Self>;
}

/// The backward side of [`super::shaded`], for backends that compute.
#[backend_extension(NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), LibTorch: cfg(feature = "tch"))]
pub trait ShadeBackwardOps: Backend {
    /// Returns the gradients of a loss whose gradient with respect to the result is `grad` `[N, K, 3]`.
    fn shade_backward(
        #[extension_type] inputs: ShadeTensors<Self>,
        grad: FloatTensor<Self>,
        light: Light,
        eye: [f32; 3],
    ) -> ShadeTensors<Self>;
}

/// Computes [`super::shaded`] by one kernel, on a device in host memory.
pub(super) fn fused(
    means: Tensor<2>,
    rotations: Tensor<2>,
    sh: Tensor<3>,
    shading: &GaussianShading,
    eye: [f32; 3],
) -> Tensor<3> {
    let inputs = ShadeTensors {
        means: means.into_dispatch(),
        rotations: rotations.into_dispatch(),
        sh: sh.into_dispatch(),
        normals: shading.normals.clone().into_dispatch(),
        material: shading.material.clone().into_dispatch(),
    };
    Tensor::from_dispatch(Dispatch::shade(inputs, shading.light, eye))
}

/// Passes the arrays, borrowed where possible, to `f`.
fn lent<B: CpuBackend, R>(
    inputs: &ShadeTensors<B>,
    light: Light,
    eye: [f32; 3],
    f: impl FnOnce(&ShadingArrays<'_>) -> R,
) -> R {
    let [means, rotations, sh, normals, material] = inputs.as_array().map(B::values);
    let lit = ShadingArrays {
        means: &means,
        rotations: &rotations,
        sh: &sh,
        normals: &normals,
        material: std::array::from_fn(|i| material[i]),
        light,
        eye,
    };
    f(&lit)
}

impl<B: CpuBackend> ShadeOps for B {
    fn shade(inputs: ShadeTensors<Self>, light: Light, eye: [f32; 3]) -> FloatTensor<Self> {
        B::tensor(lent(&inputs, light, eye, cpu::forward), inputs.sh.shape(), &inputs.sh.device())
    }
}

impl<B: CpuBackend> ShadeBackwardOps for B {
    fn shade_backward(
        inputs: ShadeTensors<Self>,
        grad: FloatTensor<Self>,
        light: Light,
        eye: [f32; 3],
    ) -> ShadeTensors<Self> {
        let grads = lent(&inputs, light, eye, |lit| cpu::backward(lit, &B::values(&grad)));
        like::<B, _>(inputs.as_array(), grads).into()
    }
}

impl<B: ShadeOps + ShadeBackwardOps, C: CheckpointStrategy> ShadeOps for Autodiff<B, C> {
    fn shade(inputs: ShadeTensors<Self>, light: Light, eye: [f32; 3]) -> FloatTensor<Self> {
        let (inputs, nodes) = inputs.into_parts();
        recorded::<B, C, _, _>(
            nodes,
            (inputs, light, eye),
            |(inputs, light, eye)| B::shade(inputs, light, eye),
            |(inputs, light, eye), grad| B::shade_backward(inputs, grad, light, eye).into_array(),
        )
    }
}
