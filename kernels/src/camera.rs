//! The pinhole camera of the splatting kernels: plain numbers, no file access and a single convention.

/// A pinhole camera in OpenCV axes (+x right, +y down, +z forward).
///
/// Pixel `(column i, row j)` is sampled at `(i + 0.5, j + 0.5)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PinholeCamera {
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

impl PinholeCamera {
    /// Camera centre in world coordinates, `-R^T t`.
    pub fn position(&self) -> [f32; 3] {
        let (r, t) = (&self.rotation, &self.translation);
        std::array::from_fn(|j| -(r[0][j] * t[0] + r[1][j] * t[1] + r[2][j] * t[2]))
    }

    /// Smallest and largest `x/z`, and the same of `y/z`, at which the Jacobian of the projection is evaluated: those of the
    /// picture, 1.3 times as wide, as in 3DGS, about the middle of the picture.
    pub(crate) fn jacobian_limits(&self) -> [[f32; 2]; 2] {
        let along = |size: usize, focal: f32, principal: f32| {
            let (half, middle) = (1.3 * size as f32 / (2.0 * focal), (0.5 * size as f32 - principal) / focal);
            [middle - half, middle + half]
        };
        [along(self.width, self.fx, self.cx), along(self.height, self.fy, self.cy)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_jacobian_is_limited_about_the_middle_of_the_picture() {
        let rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let camera = PinholeCamera {
            width: 100,
            height: 50,
            fx: 50.0,
            fy: 50.0,
            cx: 50.0,
            cy: 25.0,
            rotation,
            translation: [0.0; 3],
        };
        assert_eq!(camera.jacobian_limits(), [[-1.3, 1.3], [-0.65, 0.65]]);
        // cropped so that the axis is at the right border: the picture reaches from -2 to 0
        let cropped = PinholeCamera { cx: 100.0, ..camera };
        assert_eq!(cropped.jacobian_limits()[0].map(|x| (10.0 * x).round()), [-23.0, 3.0]);
    }
}
