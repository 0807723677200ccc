//! The pinhole camera of the splatting kernels: plain numbers, no file access and a single convention.

/// A pinhole camera in OpenCV axes (+x right, +y down, +z forward).
///
/// Pixel `(column i, row j)` is sampled at `(i + 0.5, j + 0.5)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// Focal length along x, pixels.
    pub fx: f32,
    /// Focal length along y, pixels.
    pub fy: f32,
    /// Principal point x, pixels.
    pub cx: f32,
    /// Principal point y, pixels.
    pub cy: f32,
    /// World-to-camera rotation, row-major `[3, 3]`.
    pub rotation: [[f32; 3]; 3],
    /// World-to-camera translation `[3]`.
    pub translation: [f32; 3],
}

impl Camera {
    /// Camera centre in world coordinates, `-R^T t`.
    pub fn position(&self) -> [f32; 3] {
        let (r, t) = (&self.rotation, &self.translation);
        std::array::from_fn(|j| -(r[0][j] * t[0] + r[1][j] * t[1] + r[2][j] * t[2]))
    }

    /// Largest `|x/z|` and `|y/z|` at which the Jacobian of the projection is evaluated: 1.3 times the tangent of half
    /// the field of view, as in 3DGS.
    pub(crate) fn jacobian_limits(&self) -> [f32; 2] {
        [1.3 * self.width as f32 / (2.0 * self.fx), 1.3 * self.height as f32 / (2.0 * self.fy)]
    }
}
