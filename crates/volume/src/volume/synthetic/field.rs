//! The smooth building blocks that the scenes share: steps, blends, the window that empties the box's faces.
//! Nothing here knows a scene.

/// A point or a vector of the box.
pub(super) type P3 = [f64; 3];

/// Width of the margin over which every field falls to 0 at the faces of the box.
const MARGIN: f64 = 0.05;

/// Quintic step: 0 for `x <= 0`, 1 for `x >= 1`, twice differentiable.
pub(super) fn step(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (x * (x * 6.0 - 15.0) + 10.0)
}

/// Smooth maximum: equals `max` where the two differ by more than `k`, never more than `k / 4` above it.
pub(super) fn smooth_max(a: f64, b: f64, k: f64) -> f64 {
    let k = k.max(1e-12);
    let h = (k - (a - b).abs()).max(0.0) / k;
    a.max(b) + h * h * k * 0.25
}

/// Smooth minimum, the mirror of [`smooth_max`].
pub(super) fn smooth_min(a: f64, b: f64, k: f64) -> f64 {
    -smooth_max(-a, -b, k)
}

/// Factor that is 1 inside the box and falls smoothly to 0 on the two faces of one axis; a point's factor is the
/// product over its coordinates.
pub(super) fn window(coordinate: f64) -> f64 {
    step((1.0 - coordinate.abs()) / MARGIN)
}

/// Linear interpolation.
pub(super) fn lerp(a: f64, b: f64, s: f64) -> f64 {
    a + (b - a) * s
}

/// Difference of two points.
pub(super) fn sub(a: P3, b: P3) -> P3 {
    std::array::from_fn(|i| a[i] - b[i])
}

/// Scalar product.
pub(super) fn dot(a: P3, b: P3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Euclidean length.
pub(super) fn norm(a: P3) -> f64 {
    dot(a, a).sqrt()
}

/// Approximate signed distance to an axis-aligned ellipsoid with these semi-axes, negative inside. Exact for
/// a sphere; near the surface correct to first order.
pub(super) fn ellipsoid(q: P3, axes: P3) -> f64 {
    let scaled: P3 = std::array::from_fn(|i| q[i] / axes[i]);
    let slope: P3 = std::array::from_fn(|i| scaled[i] / axes[i]);
    let level = norm(scaled);
    // At the very centre the ratio is 0/0; its limit is bounded, so a floor keeps it finite.
    level * (level - 1.0) / norm(slope).max(1e-9)
}
