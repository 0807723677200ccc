//! Differentiable Gaussian splatting: Gaussians and a camera in, colour and alpha out.
//!
//! The computation follows 3DGS (Kerbl et al. 2023; the paper's equations 1 to 4), with the constants of the reference
//! rasteriser:
//!
//! * covariance `R S S^T R^T` ([`splat`]) or as given ([`splat_covariances`]), projected with the Jacobian clamped at
//!   1.3 times the field of view, with [`Rendering::dilation`] added to its diagonal (pixels squared);
//! * colour `max(0, SH(direction) + 0.5)`, with the gradient flowing through the direction;
//! * `alpha = min(0.99, opacity * exp(power))`, skipped below 1/255; where it is clamped at 0.99 the
//!   gradient is zero (the reference rasteriser passes it through);
//! * front to back by depth, ties by index; a Gaussian that would bring the transmittance to 1e-4
//!   or less ends the pixel and is not blended; Gaussians at depth 0.2 or less are culled.
//!
//! With [`Rendering::path_opacity`] above 0 opacities depend on the direction of view too, see
//! [`crate::path_opacity`].
//!
//! A Gaussian whose projection is not finite (NaN, infinite scale), or whose covariance is invalid (not positive
//! semi-definite), is culled like one behind the camera: it adds nothing to the image and its gradients are zero. A
//! zero quaternion means no rotation.

mod autodiff;
pub mod contributors;
mod covariances;
pub(crate) mod cpu;
#[cfg(feature = "cube")]
mod cube;
pub mod reference;
mod rendering;
mod views;

use crate::path_opacity::path_opacity;
use crate::sh::Bands;
use crate::shading::{GaussianShading, shaded};
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::{Int, Tensor};
use std::any::Any;
use std::sync::Arc;

pub use covariances::{CovarianceInputs, splat_covariances};
pub use rendering::{Rendering, SplatSettings};
pub use views::{ViewSums, ViewSumsOps, ViewSumsOutput};

/// Alpha is clamped to this value.
pub const ALPHA_MAX: f32 = 0.99;
/// Contributions below this alpha are skipped.
pub const ALPHA_MIN: f32 = 1.0 / 255.0;
/// A pixel is finished when its transmittance would fall to this value.
pub const TRANSMITTANCE_MIN: f32 = 1e-4;
/// Gaussians at or nearer than this depth are culled.
pub const NEAR: f32 = 0.2;
/// [`Rendering::dilation`] in 3DGS, pixels squared.
pub const DILATION: f32 = 0.3;
/// Largest dilation allowed, pixels squared.
pub const MAX_DILATION: f32 = 100.0;
/// Maximum width and height of an image, pixels: rows and columns of tiles are numbered in 16 bits.
const MAX_SIDE: usize = (16 << 16) - 16;
/// A given covariance counts as positive semi-definite if no principal minor is negative by more than this, as a
/// fraction of the product of the minor's diagonal. Rounding of a product `M M^T` to f32 stays below it.
pub const MINOR_SLACK: f32 = 1e-5;

/// State that the forward pass keeps for the backward pass; opaque and specific to each backend.
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

/// The tensors of [`SplatInputs`] or [`CovarianceInputs`] on a backend, or the gradient with respect to each of them.
#[derive(Clone, Debug, ExtensionType)]
pub struct SplatTensors<B: Backend> {
    /// `[N, 3]`
    pub means: FloatTensor<B>,
    /// Parameters of the covariances.
    #[extension_type]
    pub covariances: CovarianceTensors<B>,
    /// `[N]`
    pub opacity_logits: FloatTensor<B>,
    /// `[N, K, 3]`
    pub sh: FloatTensor<B>,
    /// `[N, 2]`
    pub screen_offsets: FloatTensor<B>,
}

/// Parameters of the covariances: the part of [`SplatTensors`] in which the two kinds of input differ.
#[derive(Clone, Debug, ExtensionType)]
pub enum CovarianceTensors<B: Backend> {
    /// Rotations and scales, `R S S^T R^T`.
    Factored {
        /// `[N, 4]`
        rotations: FloatTensor<B>,
        /// `[N, 3]`
        log_scales: FloatTensor<B>,
    },
    /// Entries xx, xy, xz, yy, yz, zz `[N, 6]`.
    Entries(FloatTensor<B>),
}

impl<B: Backend> SplatTensors<B> {
    /// Returns the tensors in the order of the fields: six, or five with [`CovarianceTensors::Entries`].
    pub(crate) fn into_vec(self) -> Vec<FloatTensor<B>> {
        let Self { means, covariances, opacity_logits, sh, screen_offsets } = self;
        match covariances {
            CovarianceTensors::Factored { rotations, log_scales } => {
                vec![means, rotations, log_scales, opacity_logits, sh, screen_offsets]
            }
            CovarianceTensors::Entries(entries) => vec![means, entries, opacity_logits, sh, screen_offsets],
        }
    }
}

/// The backend side of [`splat`] and [`splat_covariances`].
#[backend_extension(Autodiff, NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait SplatOps: Backend {
    /// Renders; shapes as in [`SplatTensors`]. `save` says that a backward pass will follow.
    fn splat_forward(
        #[extension_type] inputs: SplatTensors<Self>,
        settings: SplatSettings,
        save: bool,
    ) -> SplatForward<Self>;
}

/// The backward side of [`SplatOps`], for backends that compute. The autodiff backend does not implement it, so a
/// second derivative does not compile. Dispatched too, so that benchmarks can time it alone.
#[backend_extension(NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait SplatBackwardOps: Backend {
    /// Returns the gradients of a loss whose gradient with respect to the image is `grad_image` `[H, W, 4]`.
    fn splat_backward(
        #[extension_type] inputs: SplatTensors<Self>,
        grad_image: FloatTensor<Self>,
        settings: SplatSettings,
        saved: SplatSaved,
    ) -> SplatTensors<Self>;
}

/// A rendered view.
#[derive(Clone, Debug)]
pub struct SplatOutput {
    /// Colour over the background and alpha, `[H, W, 4]`, differentiable.
    pub image: Tensor<3>,
    /// Radius on screen in pixels, 0 for Gaussians that were not drawn, `[N]`.
    pub radii: Tensor<1, Int>,
}

/// N Gaussians on a device, canonical or at one time, in the parameters that are optimised, as drawn by [`splat`].
#[derive(Clone, Debug)]
pub struct SplatInputs {
    /// World positions `[N, 3]`.
    pub means: Tensor<2>,
    /// Quaternions w, x, y, z `[N, 4]`; normalised inside.
    pub rotations: Tensor<2>,
    /// Natural logarithm of the standard deviations `[N, 3]`, scene units.
    pub log_scales: Tensor<2>,
    /// Opacity before the sigmoid `[N]`.
    pub opacity_logits: Tensor<1>,
    /// Spherical-harmonics coefficients `[N, K, 3]`: of all bands, K in 1, 4, 9, 16, or of even ones, K in 6, 15.
    pub sh: Tensor<3>,
    /// Pixel offsets added to the projected means `[N, 2]`; pass zeros. Their gradient is the screen-space gradient
    /// that densification needs. `None` if it is not needed.
    pub screen_offsets: Option<Tensor<2>>,
    /// Shading of the first coefficients, which are then base colours; `None` if they are the final colours.
    pub shading: Option<GaussianShading>,
}

impl SplatInputs {
    /// Gaussians with these attributes alone, in the shapes of the fields.
    pub fn new(
        means: Tensor<2>,
        rotations: Tensor<2>,
        log_scales: Tensor<2>,
        opacity_logits: Tensor<1>,
        sh: Tensor<3>,
    ) -> Self {
        Self { means, rotations, log_scales, opacity_logits, sh, screen_offsets: None, shading: None }
    }

    /// Replaces the shading and the opacities by the colours and opacities that the camera sees.
    fn seen(self, settings: &SplatSettings) -> Self {
        let mut seen = self.with_seen_opacities(settings);
        if let Some(shading) = seen.shading.take() {
            let eye = settings.camera.position();
            seen.sh = shaded(seen.means.clone(), seen.rotations.clone(), seen.sh, &shading, eye);
        }
        seen
    }

    /// Replaces the opacities by those that the camera sees.
    fn with_seen_opacities(mut self, settings: &SplatSettings) -> Self {
        let exponent = settings.rendering.path_opacity;
        if exponent != 0.0 {
            self.opacity_logits = path_opacity(
                self.means.clone(),
                self.rotations.clone(),
                self.log_scales.clone(),
                self.opacity_logits,
                settings.camera.position(),
                exponent,
            );
        }
        self
    }

    /// The same tensors without gradients, and without shading.
    pub(crate) fn without_gradients(self) -> Self {
        fn plain<const D: usize>(tensor: Tensor<D>) -> Tensor<D> {
            if tensor.device().is_autodiff() { tensor.inner() } else { tensor }
        }
        Self {
            means: plain(self.means),
            rotations: plain(self.rotations),
            log_scales: plain(self.log_scales),
            opacity_logits: plain(self.opacity_logits),
            sh: plain(self.sh),
            screen_offsets: self.screen_offsets.map(plain),
            shading: None,
        }
    }

    /// Checks shapes and settings.
    ///
    /// # Panics
    /// As [`splat`].
    pub(crate) fn check(&self, settings: &SplatSettings) {
        let n = self.means.dims()[0];
        assert_eq!(self.rotations.dims(), [n, 4], "splat: rotations are [N, 4] with N = {n}");
        assert_eq!(self.log_scales.dims(), [n, 3], "splat: log_scales are [N, 3] with N = {n}");
        check_common(&self.means, &self.opacity_logits, &self.sh, self.screen_offsets.as_ref(), settings);
    }

    /// Converts the inputs to the tensors that the backends take, which carry no shading.
    pub fn into_tensors(self) -> SplatTensors<Dispatch> {
        SplatTensors {
            screen_offsets: offsets_or_zeros(self.screen_offsets, &self.means).into_dispatch(),
            means: self.means.into_dispatch(),
            covariances: CovarianceTensors::Factored {
                rotations: self.rotations.into_dispatch(),
                log_scales: self.log_scales.into_dispatch(),
            },
            opacity_logits: self.opacity_logits.into_dispatch(),
            sh: self.sh.into_dispatch(),
        }
    }
}

/// Returns the screen offsets, or zeros if there are none.
fn offsets_or_zeros(offsets: Option<Tensor<2>>, means: &Tensor<2>) -> Tensor<2> {
    offsets.unwrap_or_else(|| Tensor::zeros([means.dims()[0], 2], &means.device()))
}

/// Renders Gaussians through a camera, with their [`GaussianShading`] applied if they have one, and with the opacities
/// that the camera sees.
///
/// # Panics
/// If the shapes disagree, `sh` holds fewer coefficients than the degree in use needs, or the settings are out of
/// range: all are errors of the calling program, never of the data.
pub fn splat(inputs: SplatInputs, settings: SplatSettings) -> SplatOutput {
    inputs.check(&settings);
    render(inputs.seen(&settings).into_tensors(), settings)
}

/// Checks the inputs that both kinds have in common.
fn check_common(
    means: &Tensor<2>,
    opacity_logits: &Tensor<1>,
    sh: &Tensor<3>,
    screen_offsets: Option<&Tensor<2>>,
    settings: &SplatSettings,
) {
    let [n, three] = means.dims();
    assert_eq!(three, 3, "splat: means are [N, 3], got [{n}, {three}]");
    assert_eq!(opacity_logits.dims(), [n], "splat: opacity_logits are [N] with N = {n}");
    let [n_sh, k, channels] = sh.dims();
    assert_eq!((n_sh, channels), (n, 3), "splat: sh are [N, K, 3] with N = {n}");
    let degree = settings.rendering.sh_degree;
    match Bands::from_count(k) {
        Some((_, most)) => assert!(degree <= most, "splat: degree {degree} is in use, {k} coefficients allow {most}"),
        None => panic!("splat: sh has {k} coefficients, expected 1, 4, 9 or 16 of all bands, or 6 or 15 of even ones"),
    }
    if let Err(problem) = settings.rendering.check() {
        panic!("splat: {problem}");
    }
    let camera = settings.camera;
    assert!(
        camera.width > 0 && camera.height > 0,
        "splat: the image is {}x{}, expected at least 1x1",
        camera.width,
        camera.height
    );
    assert!(
        camera.width.max(camera.height) <= MAX_SIDE,
        "splat: the image is {}x{}, expected at most {MAX_SIDE} pixels a side",
        camera.width,
        camera.height
    );
    assert!(
        camera.fx > 0.0 && camera.fy > 0.0 && camera.fx.is_finite() && camera.fy.is_finite(),
        "splat: focal lengths are {} and {} pixels, expected finite ones above 0",
        camera.fx,
        camera.fy
    );
    if let Some(offsets) = screen_offsets {
        assert_eq!(offsets.dims(), [n, 2], "splat: screen_offsets are [N, 2] with N = {n}");
    }
}

fn render(tensors: SplatTensors<Dispatch>, settings: SplatSettings) -> SplatOutput {
    let out = Dispatch::splat_forward(tensors, settings, false);
    SplatOutput { image: Tensor::from_dispatch(out.image), radii: Tensor::from_dispatch(out.radii) }
}
