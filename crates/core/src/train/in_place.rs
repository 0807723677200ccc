//! A module that an optimiser updates in place.

use std::ops::{Deref, DerefMut};

/// A module that can be updated behind a reference without a copy of its tensors.
///
/// Modules are mapped by value, and an operation writes into the memory of a tensor only if nothing else holds it. The
/// module is therefore moved out for an update, which is then its only owner, and moved back.
#[derive(Clone, Debug)]
pub struct InPlace<M>(Option<M>);

/// Returns the content, which only a panic during an update loses.
fn present<T>(content: Option<T>) -> T {
    content.unwrap_or_else(|| unreachable!("every update returns the module"))
}

impl<M> InPlace<M> {
    /// Holds a module.
    pub fn new(module: M) -> Self {
        Self(Some(module))
    }

    /// Replaces the module by the first result of `update`, which owns it meanwhile, and returns the second.
    pub fn map<R>(&mut self, update: impl FnOnce(M) -> (M, R)) -> R {
        let (module, result) = update(present(self.0.take()));
        self.0 = Some(module);
        result
    }
}

impl<M> Deref for InPlace<M> {
    type Target = M;

    fn deref(&self) -> &M {
        present(self.0.as_ref())
    }
}

impl<M> DerefMut for InPlace<M> {
    fn deref_mut(&mut self) -> &mut M {
        present(self.0.as_mut())
    }
}
