//! Resizing of images by two matrix products: linear interpolation between pixel centres along each axis.

use burn::tensor::{Device, Tensor, TensorData};

/// A matrix `[to, from]` that resizes `from` pixels to `to`: it interpolates at each new pixel's centre between the two
/// nearest old ones, as PyTorch's `interpolate(mode="bilinear", align_corners=False)` does. There is no averaging when
/// reducing.
pub fn weights(from: usize, to: usize) -> Vec<f32> {
    let mut out = vec![0.0; from * to];
    for (i, row) in out.chunks_exact_mut(from.max(1)).enumerate() {
        let place = ((i as f64 + 0.5) * from as f64 / to as f64 - 0.5).max(0.0);
        let low = (place as usize).min(from - 1);
        let fraction = (place - low as f64).min(1.0) as f32;
        row[low] += 1.0 - fraction;
        row[(low + 1).min(from - 1)] += fraction;
    }
    out
}

/// Resizes images `[N, C, H, W]` to `[N, C, height, width]`.
pub fn resized(x: Tensor<4>, [height, width]: [usize; 2]) -> Tensor<4> {
    let [_, _, h, w] = x.dims();
    if [h, w] == [height, width] {
        return x;
    }
    let device = x.device();
    let across = matrix(weights(w, width), [width, w], &device).swap_dims(2, 3);
    matrix(weights(h, height), [height, h], &device).matmul(x).matmul(across)
}

fn matrix(values: Vec<f32>, [rows, columns]: [usize; 2], device: &Device) -> Tensor<4> {
    Tensor::from_data(TensorData::new(values, [1, 1, rows, columns]), device)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::device;
    use volseggs_core::model::params::to_vec;

    #[test]
    fn it_is_pytorchs_bilinear_interpolation() {
        // the example of torch.nn.Upsample(scale_factor=2, mode='bilinear') in PyTorch's documentation
        let x = Tensor::<4>::from_data(TensorData::new(vec![1.0f32, 2.0, 3.0, 4.0], [1, 1, 2, 2]), &device());
        let expected = [1.0, 1.25, 1.75, 2.0, 1.5, 1.75, 2.25, 2.5, 2.5, 2.75, 3.25, 3.5, 3.0, 3.25, 3.75, 4.0];
        assert_eq!(to_vec(resized(x.clone(), [4, 4])), expected);
        assert_eq!(to_vec(resized(x.clone(), [2, 2])), [1.0, 2.0, 3.0, 4.0]);
        assert_eq!(to_vec(resized(x, [1, 1])), [2.5]);
        // four to three: centres at 1/6, 1.5 and 2 + 5/6
        let found = weights(4, 3);
        let expected = [5.0 / 6.0, 1.0 / 6.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.0, 0.0, 0.0, 1.0 / 6.0, 5.0 / 6.0];
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?}");
    }
}
