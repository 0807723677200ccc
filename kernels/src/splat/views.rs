//! Statistics of views for densification, kept on a GPU until they are read: one launch a view. On the CPU the caller
//! adds them up.
// without a GPU backend the dispatch has no arm that uses the arguments
#![cfg_attr(not(feature = "cube"), allow(unused_variables))]

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::{Int, Tensor};

/// Result of adding a view, on a backend.
#[derive(ExtensionType)]
pub struct ViewSumsOutput<B: Backend> {
    /// See [`ViewSums::gradient`].
    pub gradient: FloatTensor<B>,
    /// See [`ViewSums::views`].
    pub views: FloatTensor<B>,
    /// See [`ViewSums::opacity`].
    pub opacity: FloatTensor<B>,
}

/// Statistics of views, each `[N]`, without gradients.
#[derive(Clone, Debug)]
pub struct ViewSums {
    /// Sum of the lengths of the gradients of the screen positions, in half images, of the views that drew the Gaussian.
    pub gradient: Tensor<1>,
    /// Number of views that drew it.
    pub views: Tensor<1>,
    /// Its largest opacity.
    pub opacity: Tensor<1>,
}

/// The backend side of [`ViewSums::add`].
#[backend_extension(Cube: cfg(feature = "cube"))]
pub trait ViewSumsOps: Backend {
    /// Adds a view whose gradients of screen positions `[N, 2]` are scaled by `scale`.
    fn add_view(
        gradient: FloatTensor<Self>,
        views: FloatTensor<Self>,
        opacity: FloatTensor<Self>,
        screen: FloatTensor<Self>,
        radii: IntTensor<Self>,
        logits: FloatTensor<Self>,
        scale: [f32; 2],
    ) -> ViewSumsOutput<Self>;
}

impl ViewSums {
    /// Adds a view of `size` (width, height) pixels: the gradient of its screen positions `[N, 2]`, its radii `[N]` (0
    /// if not drawn) and the opacity logits `[N]` as drawn.
    ///
    /// # Panics
    /// If the tensors are not on a GPU or the shapes differ.
    #[must_use]
    pub fn add(self, screen: Tensor<2>, radii: Tensor<1, Int>, logits: Tensor<1>, size: [usize; 2]) -> Self {
        let n = self.views.dims()[0];
        assert_eq!((screen.dims(), radii.dims(), logits.dims()), ([n, 2], [n], [n]), "ViewSums: one row per Gaussian");
        let out = Dispatch::add_view(
            self.gradient.into_dispatch(),
            self.views.into_dispatch(),
            self.opacity.into_dispatch(),
            screen.into_dispatch(),
            radii.into_dispatch(),
            logits.into_dispatch(),
            size.map(|s| 0.5 * s as f32),
        );
        Self {
            gradient: Tensor::from_dispatch(out.gradient),
            views: Tensor::from_dispatch(out.views),
            opacity: Tensor::from_dispatch(out.opacity),
        }
    }
}
