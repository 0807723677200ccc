//! The target image of a training step on a GPU: from a view's four bytes per pixel, which are a quarter of the data to
//! send, in one launch. On the CPU the caller composites while it reads the bytes.
// without a GPU backend the dispatch has no arm that uses the arguments
#![cfg_attr(not(feature = "cube"), allow(unused_variables))]

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::{Device, Int, Tensor, TensorData};

/// The backend side of [`target`].
#[backend_extension(Cube: cfg(feature = "cube"))]
pub trait TargetOps: Backend {
    /// Composites pixels `[H * W]`, one word each, over `background`: `[H, W, 4]`.
    fn composite_bytes(words: IntTensor<Self>, size: [usize; 2], background: [f32; 3]) -> FloatTensor<Self>;
}

/// Returns an image of `[height, width]` pixels, RGBA bytes with straight alpha, over `background`, with its alpha:
/// `[H, W, 4]`, without gradients.
///
/// # Panics
/// If the device is not a GPU, or `rgba` does not hold four bytes per pixel.
pub fn target(rgba: &[u8], size: [usize; 2], background: [f32; 3], device: &Device) -> Tensor<3> {
    let (pixels, rest) = rgba.as_chunks::<4>();
    assert!(rest.is_empty() && pixels.len() == size[0] * size[1], "target: four bytes per pixel");
    let words: Vec<i32> = pixels.iter().map(|&p| i32::from_le_bytes(p)).collect();
    let words = Tensor::<1, Int>::from_data(TensorData::new(words, [pixels.len()]), &device.clone().inner());
    Tensor::from_dispatch(Dispatch::composite_bytes(words.into_dispatch(), size, background))
}
