//! Shading as a differentiable op of the backends in host memory.

use super::cpu::{self, Gradients, Lit};
use super::{Light, Shading};
use crate::backend::{CpuBackend, for_cpu_backends};
use crate::tensors::{op_tensors, register};
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients as Grads;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
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
    shading: &Shading,
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
fn lent<B: CpuBackend, R>(inputs: &ShadeTensors<B>, light: Light, eye: [f32; 3], f: impl FnOnce(&Lit<'_>) -> R) -> R {
    let [means, rotations, sh, normals, material] = inputs.as_array().map(B::values);
    let lit = Lit {
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

fn cpu_forward<B: CpuBackend>(inputs: &ShadeTensors<B>, light: Light, eye: [f32; 3]) -> FloatTensor<B> {
    let (shape, device) = (inputs.sh.shape(), inputs.sh.device());
    B::tensor(lent(inputs, light, eye, cpu::forward), shape, &device)
}

fn cpu_backward<B: CpuBackend>(
    inputs: &ShadeTensors<B>,
    grad: &FloatTensor<B>,
    light: Light,
    eye: [f32; 3],
) -> ShadeTensors<B> {
    let grad = B::values(grad);
    let Gradients { means, rotations, sh, normals, material } =
        lent(inputs, light, eye, |lit| cpu::backward(lit, &grad));
    let device = inputs.sh.device();
    let like = |values: Vec<f32>, of: &FloatTensor<B>| B::tensor(values, of.shape(), &device);
    ShadeTensors {
        means: like(means, &inputs.means),
        rotations: like(rotations, &inputs.rotations),
        sh: like(sh, &inputs.sh),
        normals: like(normals, &inputs.normals),
        material: like(material, &inputs.material),
    }
}

macro_rules! bind {
    ($backend:ty) => {
        impl ShadeOps for $backend {
            fn shade(inputs: ShadeTensors<Self>, light: Light, eye: [f32; 3]) -> FloatTensor<Self> {
                cpu_forward::<Self>(&inputs, light, eye)
            }
        }

        impl ShadeBackwardOps for $backend {
            fn shade_backward(
                inputs: ShadeTensors<Self>,
                grad: FloatTensor<Self>,
                light: Light,
                eye: [f32; 3],
            ) -> ShadeTensors<Self> {
                cpu_backward::<Self>(&inputs, &grad, light, eye)
            }
        }
    };
}

for_cpu_backends!(bind);

#[derive(Clone, Debug)]
struct State<B: ShadeBackwardOps> {
    inputs: ShadeTensors<B>,
    light: Light,
    eye: [f32; 3],
}

#[derive(Debug)]
struct ShadeBackward;

impl<B: ShadeBackwardOps> Backward<B, 5> for ShadeBackward {
    type State = State<B>;

    fn backward(self, ops: Ops<Self::State, 5>, grads: &mut Grads, _checkpointer: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let State { inputs, light, eye } = ops.state;
        let out = B::shade_backward(inputs, grad, light, eye);
        register::<B, 5>(grads, ops.parents.map(|p| p.map(|node| node.id)), out.into_array());
    }
}

impl<B: ShadeOps + ShadeBackwardOps, C: CheckpointStrategy> ShadeOps for Autodiff<B, C> {
    fn shade(inputs: ShadeTensors<Self>, light: Light, eye: [f32; 3]) -> FloatTensor<Self> {
        let (inputs, nodes) = inputs.into_parts();
        match ShadeBackward.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let out = B::shade(inputs.clone(), light, eye);
                prep.finish(State::<B> { inputs, light, eye }, out)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::shade(inputs, light, eye)),
        }
    }
}
