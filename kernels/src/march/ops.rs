//! Ray compositing as a differentiable op on tensors, for every backend.

use super::cpu::{backward, forward};
use super::rays::RaySamples;
use crate::backend::CpuBackend;
use crate::tensors::{like, op_tensors, recorded};
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
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

impl<B: CpuBackend> MarchOps for B {
    fn march_forward(inputs: MarchTensors<Self>, rays: RaySamples, background: [f32; 3]) -> FloatTensor<Self> {
        let [depths, colours] = inputs.as_array().map(B::values);
        let mut out = vec![0.0; 4 * rays.rays()];
        forward(&rays, &depths, &colours, background, &mut out);
        B::tensor(out, [rays.rays(), 4], &inputs.depths.device())
    }
}

impl<B: CpuBackend> MarchBackwardOps for B {
    fn march_backward(
        inputs: MarchTensors<Self>,
        grad: FloatTensor<Self>,
        rays: RaySamples,
        background: [f32; 3],
    ) -> MarchTensors<Self> {
        let [depths, colours] = inputs.as_array().map(B::values);
        let (mut of_depths, mut of_colours) = (vec![0.0; depths.len()], vec![0.0; colours.len()]);
        backward(&rays, &depths, &colours, background, &B::values(&grad), &mut of_depths, &mut of_colours);
        like::<B, _>(inputs.as_array(), [of_depths, of_colours]).into()
    }
}

impl<B: MarchOps + MarchBackwardOps, C: CheckpointStrategy> MarchOps for Autodiff<B, C> {
    fn march_forward(inputs: MarchTensors<Self>, rays: RaySamples, background: [f32; 3]) -> FloatTensor<Self> {
        let (inputs, nodes) = inputs.into_parts();
        recorded::<B, C, _, _>(
            nodes,
            (inputs, rays, background),
            |(inputs, rays, background)| B::march_forward(inputs, rays, background),
            |(inputs, rays, background), grad| B::march_backward(inputs, grad, rays, background).into_array(),
        )
    }
}
