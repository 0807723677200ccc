//! Gradient registration for [`super::splat`].

use super::{SplatBackwardOps, SplatForward, SplatOps, SplatSaved, SplatSettings, SplatTensors};
use crate::tensors::register;
use burn::backend::Autodiff;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};

#[derive(Clone, Debug)]
struct State<B: SplatBackwardOps> {
    inputs: SplatTensors<B>,
    settings: SplatSettings,
    saved: SplatSaved,
}

#[derive(Debug)]
struct SplatBackward;

impl<B: SplatBackwardOps> Backward<B, 6> for SplatBackward {
    type State = State<B>;

    fn backward(self, ops: Ops<Self::State, 6>, grads: &mut Gradients, _checkpointer: &mut Checkpointer) {
        let grad_image = grads.consume::<B>(&ops.node);
        let State { inputs, settings, saved } = ops.state;
        let out = B::splat_backward(inputs, grad_image, settings, saved);
        register::<B, 6>(grads, ops.parents.map(|p| p.map(|node| node.id)), out.into_array());
    }
}

impl<B: SplatOps + SplatBackwardOps, C: CheckpointStrategy> SplatOps for Autodiff<B, C> {
    fn splat_forward(inputs: SplatTensors<Self>, settings: SplatSettings, _: bool) -> SplatForward<Self> {
        let (inputs, nodes) = inputs.into_parts();
        match SplatBackward.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let out = B::splat_forward(inputs.clone(), settings, true);
                let state = State::<B> { inputs, settings, saved: out.saved.clone() };
                SplatForward { image: prep.finish(state, out.image), radii: out.radii, saved: out.saved }
            }
            OpsKind::UnTracked(prep) => {
                let out = B::splat_forward(inputs, settings, false);
                SplatForward { image: prep.finish(out.image), radii: out.radii, saved: out.saved }
            }
        }
    }
}
