//! The distance as a differentiable op on tensors. The forward pass computes the gradient too, in the same sweep.

use super::{Distance, photometric};
use crate::backend::{CpuBackend, zeros};
use crate::scale::{ScaleOps, scaled};
use crate::tensors::recorded;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, AutodiffBackend, Backend, Dispatch, ExtensionType, TensorMetadata, backend_extension};
use burn::tensor::Tensor;

/// The distance and its gradient on a backend.
#[derive(ExtensionType)]
pub struct PhotometricForward<B: Backend> {
    /// The weighted distance `[1]`.
    pub value: FloatTensor<B>,
    /// Mean squared difference of the colours `[1]`, without gradient.
    pub squared: FloatTensor<B>,
    /// Gradient of `value` with respect to the image `[H, W, 4]`.
    pub grad: FloatTensor<B>,
}

/// The backend side of [`photometric_loss`].
#[backend_extension(Autodiff, NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait PhotometricOps: Backend {
    /// Computes the distance between two images `[H, W, 4]` with its gradient.
    fn photometric_forward(
        image: FloatTensor<Self>,
        target: FloatTensor<Self>,
        kind: Distance,
        alpha: f32,
    ) -> PhotometricForward<Self>;
}

/// Result of [`photometric_loss`].
#[derive(Clone, Debug)]
pub struct Photometric {
    /// The weighted distance `[1]`, differentiable with respect to the image.
    pub loss: Tensor<1>,
    /// Mean squared difference of the colours `[1]`, whatever the distance: the quantity PSNR is computed from. No
    /// gradient.
    pub squared: Tensor<1>,
}

/// Returns the mean over pixels and colours of the distance between `image` and `target` `[H, W, 4]`, plus `alpha`
/// times that of the fourth channel (the paper's equation 5, and a term for alpha). `target` is treated as a constant.
///
/// # Panics
/// If the shapes differ or do not have four channels.
pub fn photometric_loss(image: Tensor<3>, target: Tensor<3>, kind: Distance, alpha: f32) -> Photometric {
    let [_, _, channels] = image.dims();
    assert_eq!(channels, 4, "photometric_loss: images are [H, W, 4]");
    assert_eq!(image.dims(), target.dims(), "photometric_loss: both images have one shape");
    let out = Dispatch::photometric_forward(image.into_dispatch(), target.into_dispatch(), kind, alpha);
    Photometric { loss: Tensor::from_dispatch(out.value), squared: Tensor::from_dispatch(out.squared) }
}

impl<B: CpuBackend> PhotometricOps for B {
    fn photometric_forward(
        image: FloatTensor<Self>,
        target: FloatTensor<Self>,
        kind: Distance,
        alpha: f32,
    ) -> PhotometricForward<Self> {
        let device = image.device();
        let values = B::values(&image);
        let mut grad = zeros(values.len());
        let (value, squared) = photometric(&values, &B::values(&target), kind, alpha, &mut grad);
        let scalar = |v: f64| B::tensor(vec![v as f32], [1], &device);
        let grad = B::tensor(grad, image.shape(), &device);
        PhotometricForward { value: scalar(value), squared: scalar(squared), grad }
    }
}

impl<B: PhotometricOps + ScaleOps, C: CheckpointStrategy> PhotometricOps for Autodiff<B, C> {
    fn photometric_forward(
        image: FloatTensor<Self>,
        target: FloatTensor<Self>,
        kind: Distance,
        alpha: f32,
    ) -> PhotometricForward<Self> {
        let (image, node) = image.into_parts();
        let (target, _) = target.into_parts();
        let out = B::photometric_forward(image, target, kind, alpha);
        let plain = <Self as AutodiffBackend>::from_inner;
        let (squared, grad) = (plain(out.squared), plain(out.grad.clone()));
        let value = recorded::<B, C, _, _>([node], [out.grad], |_| out.value, scaled::<B, _>);
        PhotometricForward { value, squared, grad }
    }
}
