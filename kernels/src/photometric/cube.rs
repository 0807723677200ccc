//! The distance between two images on a GPU: one pass, sums in a fixed order; and the target image from its bytes.

use super::Distance;
use super::ops::{PhotometricForward, PhotometricOps};
use super::target::TargetOps;
use crate::cube::prelude::*;
use crate::cube::reduce::{over_cube, total};
use crate::cube::{UNITS, Words, arg, cubes, empty_f32, rows};
use burn::backend::tensor::IntTensor;
use burn_cubecl::kernel::into_contiguous;

/// Values per unit.
const VALUES_PER_UNIT: u32 = 16;

/// Computes the gradient of every value, and the sums of the distances and of the squared colour differences of each
/// cube.
#[cube(launch)]
fn compare(
    image: &[f32],
    target: &[f32],
    grad: &mut [f32],
    values: &mut [f32],
    squares: &mut [f32],
    len: u32,
    colour_weight: f32,
    alpha_weight: f32,
    #[comptime] squared: bool,
) {
    let mut value = 0.0f32;
    let mut square = 0.0f32;
    for k in 0..comptime!(VALUES_PER_UNIT) {
        let at = (CUBE_POS as u32 * comptime!(VALUES_PER_UNIT) + k) * 256u32 + UNIT_POS;
        if at < len {
            let is_alpha = at % 4u32 == 3u32;
            let weight = select(is_alpha, alpha_weight, colour_weight);
            let difference = image[at as usize] - target[at as usize];
            if comptime!(squared) {
                value += weight * (difference * difference);
                grad[at as usize] = 2.0f32 * weight * difference;
            } else {
                value += weight * f32::abs(difference);
                let mut slope = select(difference > 0.0f32, weight, -weight);
                if difference == 0.0f32 {
                    slope = 0.0f32;
                }
                grad[at as usize] = slope;
            }
            if !is_alpha {
                square += difference * difference;
            }
        }
    }
    let value = over_cube(value);
    let square = over_cube(square);
    if UNIT_POS == 0u32 {
        values[CUBE_POS] = value;
        squares[CUBE_POS] = square;
    }
}

impl PhotometricOps for CubeBackend {
    fn photometric_forward(
        image: FloatTensor<Self>,
        target: FloatTensor<Self>,
        kind: Distance,
        alpha: f32,
    ) -> PhotometricForward<Self> {
        let (image, target) = (rows(image), rows(target));
        let client = image.client.clone();
        let len = image.meta.shape().num_elements();
        let pixels = (len / 4) as f32;
        let count = cubes(len, UNITS * VALUES_PER_UNIT);
        let launched = crate::cube::launched(&count);
        let (values, squares) = (Words::empty(&client, launched), Words::empty(&client, launched));
        let out = PhotometricForward {
            value: empty_f32(&image, [1]),
            squared: empty_f32(&image, [1]),
            grad: empty_f32(&image, image.meta.shape().clone()),
        };
        compare::launch(
            &client,
            count,
            CubeDim::new_1d(UNITS),
            arg(&image),
            arg(&target),
            arg(&out.grad),
            values.arg(),
            squares.arg(),
            len as u32,
            1.0 / (3.0 * pixels),
            alpha / pixels,
            kind == Distance::Squared,
        );
        total(&client, &values, &out.value, 1.0);
        total(&client, &squares, &out.squared, 1.0 / (3.0 * pixels));
        out
    }
}

#[cube(launch)]
fn composite(words: &[u32], image: &mut [f32], pixels: u32, red: f32, green: f32, blue: f32) {
    if ABSOLUTE_POS < pixels as usize {
        let word = words[ABSOLUTE_POS];
        let alpha = f32::cast_from(word >> 24u32) / 255.0f32;
        let rest = 1.0f32 - alpha;
        let at = 4 * ABSOLUTE_POS;
        image[at] = f32::cast_from(word & 255u32) / 255.0f32 * alpha + rest * red;
        image[at + 1] = f32::cast_from((word >> 8u32) & 255u32) / 255.0f32 * alpha + rest * green;
        image[at + 2] = f32::cast_from((word >> 16u32) & 255u32) / 255.0f32 * alpha + rest * blue;
        image[at + 3] = alpha;
    }
}

impl TargetOps for CubeBackend {
    fn composite_bytes(words: IntTensor<Self>, size: [usize; 2], background: [f32; 3]) -> FloatTensor<Self> {
        assert_eq!(words.dtype, burn::tensor::DType::I32, "a word per pixel");
        let words = into_contiguous(words);
        let pixels = size[0] * size[1];
        let image = empty_f32(&words, [size[0], size[1], 4]);
        let [red, green, blue] = background;
        composite::launch(
            &words.client.clone(),
            cubes(pixels, UNITS),
            CubeDim::new_1d(UNITS),
            arg(&words),
            arg(&image),
            pixels as u32,
            red,
            green,
            blue,
        );
        image
    }
}
