//! The target image of a step: a view over the background, with its alpha, `[H, W, 4]`.

use crate::data::Split;
use burn::tensor::{Device, Tensor, TensorData};

/// Returns view `view` over `background`, composited on the host, or, with `on_device`, from its four bytes per pixel
/// on the device, which sends a quarter of the data to a GPU.
pub fn target(split: &Split, view: usize, background: [f32; 3], device: &Device, on_device: bool) -> Tensor<3> {
    let (h, w) = (split.images.height as usize, split.images.width as usize);
    if !on_device {
        let values = split.images.composite_with_alpha(view, background);
        return Tensor::from_data(TensorData::new(values, [h, w, 4]), device);
    }
    Tensor::from_inner(volseggs_kernels::photometric::target(split.images.frame(view), [h, w], background, device))
}

#[cfg(test)]
#[cfg(any(feature = "wgpu", feature = "cuda"))]
mod tests {
    use super::*;
    use crate::data::{ImageSet, SplitName};
    use crate::device::DeviceName;
    use crate::model::params::to_vec;

    fn both_ways_give_the_same_image(gpu: Device) {
        let cpu = DeviceName::all()[0].open().unwrap().autodiff();
        let pixels: Vec<u8> = (0..2 * 5 * 7 * 4).map(|i| (i * 37 % 256) as u8).collect();
        let images = ImageSet { width: 7, height: 5, pixels };
        let split = Split { name: SplitName::Train, frames: Vec::new(), images };
        let image = |device: &Device, on| to_vec(target(&split, 1, [0.2, 1.0, 0.5], device, on).inner());
        let (a, b) = (image(&cpu, false), image(&gpu.autodiff(), true));
        assert_eq!(a.len(), b.len());
        assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-6), "{a:?} {b:?}");
    }

    volseggs_testing::on_every_gpu!(crate::device::open_to_test => both_ways_give_the_same_image);
}
