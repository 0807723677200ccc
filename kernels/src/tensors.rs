//! The tensors of an op as one struct: its inputs, or one gradient for each of them; and how ops take part in autodiff.
//!
//! [`op_tensors`] names the fields once; arrays, autodiff's parts and the registration of gradients follow from them,
//! so that another input of an op takes one more line.

use crate::backend::CpuBackend;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, NodeGuard, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, TensorMetadata};
use std::fmt::Debug;

/// Defines a struct of `count` tensors of a backend.
macro_rules! op_tensors {
    ($(#[$doc:meta])* $name:ident[$count:literal] { $($(#[$field_doc:meta])* $field:ident,)* }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, burn::backend::ExtensionType)]
        pub struct $name<B: Backend> {
            $($(#[$field_doc])* pub $field: FloatTensor<B>,)*
        }

        impl<B: Backend> $name<B> {
            /// Returns the tensors in the order of the fields.
            pub(crate) fn into_array(self) -> [FloatTensor<B>; $count] {
                [$(self.$field),*]
            }

            /// As [`Self::into_array`], borrowed.
            pub(crate) fn as_array(&self) -> [&FloatTensor<B>; $count] {
                [$(&self.$field),*]
            }
        }

        /// Builds the struct from the tensors in the order of the fields.
        impl<B: Backend> From<[FloatTensor<B>; $count]> for $name<B> {
            fn from([$($field),*]: [FloatTensor<B>; $count]) -> Self {
                Self { $($field),* }
            }
        }

        impl<B: Backend, C: burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy>
            $name<burn::backend::Autodiff<B, C>>
        {
            /// Returns the inner tensors, and the graph's nodes in the order of the fields.
            pub(crate) fn into_parts(self) -> ($name<B>, [burn::backend::autodiff::ops::NodeGuard; $count]) {
                $(let $field = self.$field.into_parts();)*
                ($name { $($field: $field.0),* }, [$($field.1),*])
            }
        }
    };
}
pub(crate) use op_tensors;

/// Wraps arrays as tensors, each of the shape and on the device of the tensor in its place.
pub(crate) fn like<B: CpuBackend, const N: usize>(
    tensors: [&FloatTensor<B>; N],
    arrays: [Vec<f32>; N],
) -> [FloatTensor<B>; N] {
    let mut arrays = arrays.into_iter();
    tensors.map(|tensor| B::tensor(arrays.next().unwrap_or_default(), tensor.shape(), &tensor.device()))
}

/// The backward pass of an op: from what its forward pass kept and the gradient with respect to its result to the
/// gradients with respect to its N inputs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pullback<B: Backend, S, const N: usize>(pub(crate) fn(S, FloatTensor<B>) -> [FloatTensor<B>; N]);

/// Registers the gradient of each input that takes part in the graph.
impl<B: Backend, S: Clone + Debug + Send + 'static, const N: usize> Backward<B, N> for Pullback<B, S, N> {
    type State = S;

    fn backward(self, ops: Ops<S, N>, grads: &mut Gradients, _checkpointer: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        for (parent, grad) in ops.parents.into_iter().zip((self.0)(ops.state, grad)) {
            if let Some(node) = parent {
                grads.register::<B>(node.id, grad);
            }
        }
    }
}

/// Computes a differentiable op by `forward`, which gets `kept`, and records that its gradients follow from `kept` by
/// `backward`; `nodes` are those of its inputs in the graph.
pub(crate) fn recorded<B: Backend, C: CheckpointStrategy, S: Clone + Debug + Send + 'static, const N: usize>(
    nodes: [NodeGuard; N],
    kept: S,
    forward: impl FnOnce(S) -> FloatTensor<B>,
    backward: fn(S, FloatTensor<B>) -> [FloatTensor<B>; N],
) -> FloatTensor<Autodiff<B, C>> {
    match Pullback::<B, S, N>(backward).prepare::<C>(nodes).compute_bound().stateful() {
        OpsKind::Tracked(prep) => prep.finish(kept.clone(), forward(kept)),
        OpsKind::UnTracked(prep) => prep.finish(forward(kept)),
    }
}
