//! The target image of a step: a view over the background, with its alpha, `[H, W, 4]`.

use crate::data::Split;
use burn::tensor::{Device, Int, Tensor, TensorData};

/// Returns view `view` over `background`, composited on the host, or, with `on_device`, from its four bytes per pixel
/// on the device, which sends a quarter of the data to a GPU.
pub(crate) fn target(split: &Split, view: usize, background: [f32; 3], device: &Device, on_device: bool) -> Tensor<3> {
    let (h, w) = (split.images.height as usize, split.images.width as usize);
    if !on_device {
        let values = split.images.composite_with_alpha(view, background);
        return Tensor::from_data(TensorData::new(values, [h, w, 4]), device);
    }
    let pixels = split.images.frame(view).chunks_exact(4).map(|p| i32::from_le_bytes([p[0], p[1], p[2], p[3]]));
    let device = device.clone().inner();
    let words = Tensor::<1, Int>::from_data(TensorData::new(pixels.collect::<Vec<_>>(), [h * w]), &device);
    let byte = |k: i32| {
        let low = if k == 0 { words.clone() } else { words.clone().bitwise_right_shift_scalar(8 * k) };
        low.bitwise_and_scalar(255).float().div_scalar(255.0)
    };
    let alpha = byte(3);
    let rest = alpha.clone().neg().add_scalar(1.0);
    let channel = |k: i32| byte(k) * alpha.clone() + rest.clone().mul_scalar(background[k as usize]);
    let channels = [channel(0), channel(1), channel(2), alpha.clone()];
    Tensor::from_inner(Tensor::stack::<2>(channels.to_vec(), 1).reshape([h, w, 4]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{ImageSet, SplitName};
    use crate::device::DeviceName;
    use crate::model::params::to_vec;

    #[test]
    fn both_ways_give_the_same_image() {
        let device = DeviceName::all()[0].open().unwrap().autodiff();
        let pixels: Vec<u8> = (0..2 * 5 * 7 * 4).map(|i| (i * 37 % 256) as u8).collect();
        let images = ImageSet { width: 7, height: 5, pixels };
        let split = Split { name: SplitName::Train, frames: Vec::new(), images };
        let [a, b] = [false, true].map(|on| to_vec(target(&split, 1, [0.2, 1.0, 0.5], &device, on).inner()));
        assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-6), "{a:?} {b:?}");
    }
}
