//! Vectors of three numbers in GPU kernels.

use crate::cube::prelude::*;

/// Three numbers.
#[derive(CubeType)]
pub(crate) struct Vec3 {
    pub x: f32,
    pub y: f32,
    pub z: f32,
}

/// Reads three numbers from the index `at` on.
#[cube]
pub(crate) fn vec3_at(values: &[f32], at: usize) -> Vec3 {
    Vec3 { x: values[at], y: values[at + 1], z: values[at + 2] }
}

/// Writes three numbers from the index `at` on.
#[cube]
pub(crate) fn store_vec3(out: &mut [f32], at: usize, v: &Vec3) {
    out[at] = v.x;
    out[at + 1] = v.y;
    out[at + 2] = v.z;
}

#[cube]
pub(crate) fn dot(a: &Vec3, b: &Vec3) -> f32 {
    a.x * b.x + a.y * b.y + a.z * b.z
}

#[cube]
pub(crate) fn cross(a: &Vec3, b: &Vec3) -> Vec3 {
    Vec3 { x: a.y * b.z - a.z * b.y, y: a.z * b.x - a.x * b.z, z: a.x * b.y - a.y * b.x }
}

/// `factor v`
#[cube]
pub(crate) fn scaled(v: &Vec3, factor: f32) -> Vec3 {
    Vec3 { x: factor * v.x, y: factor * v.y, z: factor * v.z }
}

/// The products of the components.
#[cube]
pub(crate) fn products(a: &Vec3, b: &Vec3) -> Vec3 {
    Vec3 { x: a.x * b.x, y: a.y * b.y, z: a.z * b.z }
}

/// `a v + b w`
#[cube]
pub(crate) fn sum_of_two(a: f32, v: &Vec3, b: f32, w: &Vec3) -> Vec3 {
    Vec3 { x: a * v.x + b * w.x, y: a * v.y + b * w.y, z: a * v.z + b * w.z }
}

/// `f.x u + f.y v + f.z w`: the product of a vector with the matrix of these columns.
#[cube]
pub(crate) fn sum_of_three(f: &Vec3, u: &Vec3, v: &Vec3, w: &Vec3) -> Vec3 {
    Vec3 {
        x: f.x * u.x + f.y * v.x + f.z * w.x,
        y: f.x * u.y + f.y * v.y + f.z * w.y,
        z: f.x * u.z + f.y * v.z + f.z * w.z,
    }
}
