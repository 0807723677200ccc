//! The tensors of an op as one struct: its inputs, or one gradient for each of them.
//!
//! [`op_tensors`] names the fields once; arrays, autodiff's parts and the registration of gradients follow from them,
//! so that another input of an op takes one more line.

use burn::backend::Backend;
use burn::backend::autodiff::NodeId;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::tensor::FloatTensor;

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

/// Registers the gradient of each parent that takes part in the graph.
pub(crate) fn register<B: Backend, const N: usize>(
    grads: &mut Gradients,
    parents: [Option<NodeId>; N],
    of: impl IntoIterator<Item = FloatTensor<B>>,
) {
    for (parent, grad) in parents.into_iter().zip(of) {
        if let Some(node) = parent {
            grads.register::<B>(node, grad);
        }
    }
}
