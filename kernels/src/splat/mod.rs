//! Differentiable Gaussian splatting: Gaussians and a camera in, colour and alpha out.
//!
//! What is computed (3DGS, Kerbl et al. 2023; the paper's equations 1 to 4), with the constants of the
//! reference rasteriser:
//!
//! * covariance `R S S^T R^T`, projected with the Jacobian clamped at 1.3 times the field of view,
//!   0.3 added to its diagonal (pixels squared);
//! * colour `max(0, SH(direction) + 0.5)`, the gradient flowing through the direction;
//! * `alpha = min(0.99, opacity * exp(power))`, skipped below 1/255; where it is clamped at 0.99 the
//!   gradient is zero (the reference rasteriser passes it through);
//! * front to back by depth, ties by index; a Gaussian that would bring the transmittance to 1e-4
//!   or less ends the pixel and is not blended; Gaussians at depth 0.2 or less are culled.
//!
//! A Gaussian whose projection is not finite (NaN, infinite scale) is culled like one behind the
//! camera: it adds nothing to the image and its gradients are zero. A zero quaternion stands for no rotation.

mod autodiff;
pub mod contributors;
pub(crate) mod cpu;
#[cfg(feature = "cube")]
mod cube;
pub mod reference;

use crate::Camera;
use crate::shading::{Shading, shaded};
use crate::tensors::op_tensors;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::{Int, Tensor};
use std::any::Any;
use std::sync::Arc;

/// Alpha is clamped to this value.
pub const ALPHA_MAX: f32 = 0.99;
/// Contributions below this alpha are skipped.
pub const ALPHA_MIN: f32 = 1.0 / 255.0;
/// A pixel is finished when its transmittance would fall to this value.
pub const TRANSMITTANCE_MIN: f32 = 1e-4;
/// Gaussians at or nearer than this depth are culled.
pub const NEAR: f32 = 0.2;
/// Added to the diagonal of the projected covariance, pixels squared.
pub const DILATION: f32 = 0.3;

/// Everything about a rendering that is not a tensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplatSettings {
    /// The camera, with the image size.
    pub camera: Camera,
    /// Background colour, RGB.
    pub background: [f32; 3],
    /// Spherical-harmonics degree in use, 0 to 3; coefficients beyond it are ignored and get no gradient.
    pub sh_degree: usize,
}

/// What the forward pass keeps for the backward pass; opaque, and each backend's own.
#[derive(Clone)]
pub struct SplatSaved(Arc<dyn Any + Send + Sync>);

impl std::fmt::Debug for SplatSaved {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("SplatSaved")
    }
}

/// Result of the forward pass on a backend.
#[derive(ExtensionType)]
pub struct SplatForward<B: Backend> {
    /// Colour and alpha `[H, W, 4]`, differentiable.
    pub image: FloatTensor<B>,
    /// Radius of each Gaussian on screen in pixels (three standard deviations, rounded up); 0 if not drawn. `[N]`.
    pub radii: IntTensor<B>,
    /// Kept for the backward pass.
    pub saved: SplatSaved,
}

op_tensors! {
    /// The tensors of [`SplatInputs`] on a backend, or the gradient with respect to each of them.
    SplatTensors[6] {
        /// `[N, 3]`
        means,
        /// `[N, 4]`
        rotations,
        /// `[N, 3]`
        log_scales,
        /// `[N]`
        opacity_logits,
        /// `[N, K, 3]`
        sh,
        /// `[N, 2]`
        screen_offsets,
    }
}

/// The backend side of [`splat`].
#[backend_extension(Autodiff, NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait SplatOps: Backend {
    /// Renders; shapes as in [`splat`]. With `save` a backward pass will follow.
    fn splat_forward(
        #[extension_type] inputs: SplatTensors<Self>,
        settings: SplatSettings,
        save: bool,
    ) -> SplatForward<Self>;
}

/// The backward side of [`splat`], of backends that compute. One that records gradients has none of its own: a second
/// derivative does not compile. Dispatched too, so that benches can time it alone.
#[backend_extension(NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait SplatBackwardOps: Backend {
    /// Gradients of a loss whose gradient with respect to the image is `grad_image` `[H, W, 4]`.
    fn splat_backward(
        #[extension_type] inputs: SplatTensors<Self>,
        grad_image: FloatTensor<Self>,
        settings: SplatSettings,
        saved: SplatSaved,
    ) -> SplatTensors<Self>;
}

/// A rendered view.
#[derive(Clone, Debug)]
pub struct Splatted {
    /// Colour over the background and alpha, `[H, W, 4]`, differentiable.
    pub image: Tensor<3>,
    /// Radius on screen in pixels, 0 for Gaussians that were not drawn, `[N]`.
    pub radii: Tensor<1, Int>,
}

/// N Gaussians on a device, canonical or at one time, as they are optimised: what [`splat`] draws.
#[derive(Clone, Debug)]
pub struct SplatInputs {
    /// World positions `[N, 3]`.
    pub means: Tensor<2>,
    /// Quaternions w, x, y, z `[N, 4]`; normalised inside.
    pub rotations: Tensor<2>,
    /// Natural logarithm of the standard deviations `[N, 3]`, world units.
    pub log_scales: Tensor<2>,
    /// Opacity before the sigmoid `[N]`.
    pub opacity_logits: Tensor<1>,
    /// Spherical-harmonics coefficients `[N, K, 3]`, K in 1, 4, 9, 16.
    pub sh: Tensor<3>,
    /// Pixel offsets added to the projected means `[N, 2]`; pass zeros. Their gradient is the
    /// screen-space gradient that densification needs. `None` if no one asks for it.
    pub screen_offsets: Option<Tensor<2>>,
    /// What shades the first coefficients, which are then base colours; `None` if they are colours as they are.
    pub shading: Option<Shading>,
}

impl SplatInputs {
    /// The same with the colours that `camera` sees, of no shading any more.
    #[must_use]
    pub fn shaded(mut self, camera: &Camera) -> Self {
        if let Some(shading) = self.shading.take() {
            self.sh = shaded(self.means.clone(), self.rotations.clone(), self.sh, &shading, camera.position());
        }
        self
    }

    /// The tensors as the backends take them, which know nothing of shading.
    pub fn into_tensors(self) -> SplatTensors<Dispatch> {
        let zeros = || Tensor::zeros([self.opacity_logits.dims()[0], 2], &self.means.device());
        SplatTensors {
            screen_offsets: self.screen_offsets.unwrap_or_else(zeros).into_dispatch(),
            means: self.means.into_dispatch(),
            rotations: self.rotations.into_dispatch(),
            log_scales: self.log_scales.into_dispatch(),
            opacity_logits: self.opacity_logits.into_dispatch(),
            sh: self.sh.into_dispatch(),
        }
    }
}

/// Renders Gaussians through a camera, those with a [`Shading`] in the colours that it gives them.
///
/// # Panics
/// If the shapes disagree, or `sh` holds fewer coefficients than `settings.sh_degree` needs: both are
/// errors of the calling program, never of the data.
pub fn splat(inputs: SplatInputs, settings: SplatSettings) -> Splatted {
    let [n, three] = inputs.means.dims();
    assert_eq!(three, 3, "splat: means are [N, 3], got [{n}, {three}]");
    assert_eq!(inputs.rotations.dims(), [n, 4], "splat: rotations are [N, 4] with N = {n}");
    assert_eq!(inputs.log_scales.dims(), [n, 3], "splat: log_scales are [N, 3] with N = {n}");
    assert_eq!(inputs.opacity_logits.dims(), [n], "splat: opacity_logits are [N] with N = {n}");
    let [n_sh, k, channels] = inputs.sh.dims();
    assert_eq!((n_sh, channels), (n, 3), "splat: sh are [N, K, 3] with N = {n}");
    let degree = settings.sh_degree;
    assert!(
        degree <= 3 && (degree + 1).pow(2) <= k,
        "splat: degree {degree} needs {} coefficients, sh has {k}",
        (degree + 1).pow(2)
    );
    let camera = settings.camera;
    assert!(camera.width > 0 && camera.height > 0, "splat: the image is {}x{}", camera.width, camera.height);

    if let Some(offsets) = &inputs.screen_offsets {
        assert_eq!(offsets.dims(), [n, 2], "splat: screen_offsets are [N, 2] with N = {n}");
    }
    let out = Dispatch::splat_forward(inputs.shaded(&camera).into_tensors(), settings, false);
    Splatted { image: Tensor::from_dispatch(out.image), radii: Tensor::from_dispatch(out.radii) }
}
