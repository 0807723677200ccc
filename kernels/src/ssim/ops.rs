//! SSIM as a differentiable op on tensors. The forward pass computes the gradient too, in the same sweep.

use super::{ssim, ssim_grad};
use crate::backend::{CpuBackend, zeros};
use crate::scale::{ScaleOps, scaled};
use crate::tensors::Pullback;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::ops::{Backward, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, AutodiffBackend, Backend, Dispatch, ExtensionType, TensorMetadata, backend_extension};
use burn::tensor::Tensor;
use rayon::prelude::*;
use std::borrow::Cow;

/// SSIM and its gradient on a backend.
#[derive(ExtensionType)]
pub struct SsimForward<B: Backend> {
    /// Mean SSIM `[1]`.
    pub value: FloatTensor<B>,
    /// dSSIM/da, of a's shape; a placeholder of one element if it was not requested.
    pub grad: FloatTensor<B>,
}

/// The backend side of [`mean_ssim`].
#[backend_extension(Autodiff, NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait SsimOps: Backend {
    /// Computes SSIM of two images `[H, W, 3]` or `[H, W, 4]`, with the gradient with respect to the first if
    /// requested.
    fn ssim_forward(a: FloatTensor<Self>, b: FloatTensor<Self>, with_grad: bool) -> SsimForward<Self>;
}

/// Returns the mean SSIM `[1]` of the colours of two images with values in [0, 1], `[H, W, 3]` or `[H, W, 4]` with
/// alpha ignored; differentiable with respect to `a`, while `b` is treated as a constant. Window: 11 taps, Gaussian,
/// sigma 1.5, zero padding.
///
/// # Panics
/// If the shapes differ or do not have three or four channels.
pub fn mean_ssim(a: Tensor<3>, b: Tensor<3>) -> Tensor<1> {
    assert_eq!(a.dims(), b.dims(), "mean_ssim: both images have one shape");
    assert!(matches!(a.dims()[2], 3 | 4), "mean_ssim: images are [H, W, 3] or [H, W, 4]");
    Tensor::from_dispatch(Dispatch::ssim_forward(a.into_dispatch(), b.into_dispatch(), false).value)
}

impl<B: CpuBackend> SsimOps for B {
    fn ssim_forward(a: FloatTensor<Self>, b: FloatTensor<Self>, with_grad: bool) -> SsimForward<Self> {
        let device = a.device();
        let shape = a.shape();
        let (h, w) = (shape[0], shape[1]);
        let channels = shape[2];
        let (va, vb) = (colours(B::values(&a), channels), colours(B::values(&b), channels));
        let (value, grad) = if with_grad {
            let mut grad = zeros(va.len());
            let value = ssim_grad(&va, &vb, h, w, 1.0, &mut grad);
            let grad = if channels == 4 { with_alpha(&grad) } else { grad };
            (value, B::tensor(grad, shape, &device))
        } else {
            (ssim(&va, &vb, h, w), B::tensor(vec![0.0], [1], &device))
        };
        SsimForward { value: B::tensor(vec![value as f32], [1], &device), grad }
    }
}

/// Pixels per task.
const PIECE: usize = 16_384;

/// Returns the colours alone, `[H * W * 3]`.
fn colours(values: Cow<'_, [f32]>, channels: usize) -> Cow<'_, [f32]> {
    if channels == 3 {
        return values;
    }
    let mut out = zeros(values.len() / 4 * 3);
    out.par_chunks_mut(3 * PIECE).zip(values.par_chunks(4 * PIECE)).for_each(|(out, values)| {
        for (out, pixel) in out.chunks_exact_mut(3).zip(values.chunks_exact(4)) {
            out.copy_from_slice(&pixel[..3]);
        }
    });
    Cow::Owned(out)
}

/// Returns the gradient of the colours with a zero for alpha, `[H * W * 4]`.
fn with_alpha(grad: &[f32]) -> Vec<f32> {
    let mut out = zeros(grad.len() / 3 * 4);
    out.par_chunks_mut(4 * PIECE).zip(grad.par_chunks(3 * PIECE)).for_each(|(out, grad)| {
        for (out, pixel) in out.chunks_exact_mut(4).zip(grad.chunks_exact(3)) {
            out[..3].copy_from_slice(pixel);
        }
    });
    out
}

impl<B: SsimOps + ScaleOps, C: CheckpointStrategy> SsimOps for Autodiff<B, C> {
    fn ssim_forward(a: FloatTensor<Self>, b: FloatTensor<Self>, _: bool) -> SsimForward<Self> {
        let (a, node) = a.into_parts();
        let (b, _) = b.into_parts();
        let plain = <Self as AutodiffBackend>::from_inner;
        match Pullback::<B, _, 1>(scaled::<B, _>).prepare::<C>([node]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let SsimForward { value, grad } = B::ssim_forward(a, b, true);
                SsimForward { value: prep.finish([grad.clone()], value), grad: plain(grad) }
            }
            OpsKind::UnTracked(prep) => {
                let SsimForward { value, grad } = B::ssim_forward(a, b, false);
                SsimForward { value: prep.finish(value), grad: plain(grad) }
            }
        }
    }
}
