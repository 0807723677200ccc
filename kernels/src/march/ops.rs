//! Ray compositing as a differentiable op on tensors, for every backend.

use super::cpu::{backward, forward};
use super::rays::RaySamples;
use crate::backend::{CpuBackend, for_cpu_backends};
use crate::tensors::{op_tensors, register};
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, TensorMetadata, backend_extension};
use burn::tensor::Tensor;

op_tensors! {
    /// The inputs of [`composite`] on a backend, or the gradient with respect to each of them.
    MarchTensors[2] {
        /// `[S]`
        depths,
        /// `[C, 3]`
        colours,
    }
}

/// The backend side of [`composite`].
#[backend_extension(Autodiff, NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait MarchOps: Backend {
    /// Returns colour and alpha `[R, 4]`.
    fn march_forward(
        #[extension_type] inputs: MarchTensors<Self>,
        rays: RaySamples,
        background: [f32; 3],
    ) -> FloatTensor<Self>;
}

/// The backward side of [`composite`], for backends that compute. The autodiff backend does not implement it, so a
/// second derivative does not compile.
pub trait MarchBackwardOps: Backend {
    /// Returns the gradients for `grad` `[R, 4]`.
    fn march_backward(
        inputs: MarchTensors<Self>,
        grad: FloatTensor<Self>,
        rays: RaySamples,
        background: [f32; 3],
    ) -> MarchTensors<Self>;
}

/// Composites the samples of rays into `[R, 4]`: colour over `background`, and alpha. `depths` `[S]` are the optical
/// depths of all samples, each at least 0, `colours` `[C, 3]` the colours of those samples that have one.
/// Differentiable with respect to both.
///
/// # Panics
/// If a tensor does not fit `rays`, or if there is no sample or no colour, as not every backend can hold an empty
/// tensor.
pub fn composite(depths: Tensor<1>, colours: Tensor<2>, rays: &RaySamples, background: [f32; 3]) -> Tensor<2> {
    assert_eq!(depths.dims(), [rays.samples()], "composite: depths are [S]");
    assert_eq!(colours.dims(), [rays.coloured(), 3], "composite: colours are [C, 3]");
    assert!(rays.coloured() > 0, "composite: at least one sample with a colour");
    let inputs = MarchTensors { depths: depths.into_dispatch(), colours: colours.into_dispatch() };
    Tensor::from_dispatch(Dispatch::march_forward(inputs, rays.clone(), background))
}

fn cpu_forward<B: CpuBackend>(inputs: &MarchTensors<B>, rays: &RaySamples, background: [f32; 3]) -> FloatTensor<B> {
    let [depths, colours] = inputs.as_array().map(B::values);
    let mut out = vec![0.0; 4 * rays.rays()];
    forward(rays, &depths, &colours, background, &mut out);
    B::tensor(out, [rays.rays(), 4], &inputs.depths.device())
}

fn cpu_backward<B: CpuBackend>(
    inputs: &MarchTensors<B>,
    grad: &FloatTensor<B>,
    rays: &RaySamples,
    background: [f32; 3],
) -> MarchTensors<B> {
    let device = inputs.depths.device();
    let [depths, colours] = inputs.as_array().map(B::values);
    let (mut of_depths, mut of_colours) = (vec![0.0; depths.len()], vec![0.0; colours.len()]);
    backward(rays, &depths, &colours, background, &B::values(grad), &mut of_depths, &mut of_colours);
    MarchTensors {
        depths: B::tensor(of_depths, inputs.depths.shape(), &device),
        colours: B::tensor(of_colours, inputs.colours.shape(), &device),
    }
}

macro_rules! bind {
    ($backend:ty) => {
        impl MarchOps for $backend {
            fn march_forward(inputs: MarchTensors<Self>, rays: RaySamples, background: [f32; 3]) -> FloatTensor<Self> {
                cpu_forward::<Self>(&inputs, &rays, background)
            }
        }

        impl MarchBackwardOps for $backend {
            fn march_backward(
                inputs: MarchTensors<Self>,
                grad: FloatTensor<Self>,
                rays: RaySamples,
                background: [f32; 3],
            ) -> MarchTensors<Self> {
                cpu_backward::<Self>(&inputs, &grad, &rays, background)
            }
        }
    };
}

for_cpu_backends!(bind);

#[derive(Clone, Debug)]
struct State<B: MarchBackwardOps> {
    inputs: MarchTensors<B>,
    rays: RaySamples,
    background: [f32; 3],
}

#[derive(Debug)]
struct MarchBackward;

impl<B: MarchBackwardOps> Backward<B, 2> for MarchBackward {
    type State = State<B>;

    fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _checkpointer: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let State { inputs, rays, background } = ops.state;
        let out = B::march_backward(inputs, grad, rays, background);
        register::<B, 2>(grads, ops.parents.map(|p| p.map(|node| node.id)), out.into_array());
    }
}

impl<B: MarchOps + MarchBackwardOps, C: CheckpointStrategy> MarchOps for Autodiff<B, C> {
    fn march_forward(inputs: MarchTensors<Self>, rays: RaySamples, background: [f32; 3]) -> FloatTensor<Self> {
        let (inputs, nodes) = inputs.into_parts();
        let out = B::march_forward(inputs.clone(), rays.clone(), background);
        match MarchBackward.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(State { inputs, rays, background }, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }
}
