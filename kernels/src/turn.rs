//! Vectors turned by quaternions, for the CPU kernels, and the products that they need.

pub(crate) type Float3 = [f32; 3];

/// Squared lengths of quaternions up to this one mean no rotation.
pub(crate) const NO_ROTATION: f32 = 1e-24;

/// Turns `v` by the quaternion `w`, `u`, and scales it by the squared length of the quaternion.
#[inline(always)]
pub(crate) fn turn(w: f32, u: Float3, v: Float3) -> Float3 {
    let (straight, along, across) = (w * w - dot(u, u), 2.0 * dot(u, v), cross(u, v));
    std::array::from_fn(|c| straight * v[c] + along * u[c] + 2.0 * w * across[c])
}

/// Returns the gradients with respect to `w` and `u` of a loss whose gradient with respect to [`turn`] of `v` is `by`.
#[inline(always)]
pub(crate) fn turn_backward(w: f32, u: Float3, v: Float3, by: Float3) -> (f32, Float3) {
    let (uv, ub, vb, across) = (dot(u, v), dot(u, by), dot(v, by), cross(v, by));
    let by_u = std::array::from_fn(|c| 2.0 * (v[c] * ub + by[c] * uv + w * across[c] - u[c] * vb));
    (2.0 * (w * vb + dot(u, across)), by_u)
}

#[inline(always)]
pub(crate) fn dot(a: Float3, b: Float3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(crate) fn cross(a: Float3, b: Float3) -> Float3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
