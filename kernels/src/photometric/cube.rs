//! The distance between two images on a GPU: one pass, sums in a fixed order.

use super::Distance;
use super::ops::{PhotometricForward, PhotometricOps};
use crate::cube::reduce::{over_cube, total};
use crate::cube::{UNITS, Words, arg, cubes, empty_f32, rows};
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl;
use burn_cubecl::cubecl::prelude::*;

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
