//! Cameras of datasets as the kernels take them.

use crate::data::Camera;

/// Conversion to the camera of the splatting kernels.
pub trait ToKernel {
    /// The same camera in single precision.
    fn to_kernel(&self) -> volseggs_kernels::PinholeCamera;
}

impl ToKernel for Camera {
    fn to_kernel(&self) -> volseggs_kernels::PinholeCamera {
        let (rotation, translation) = self.world_to_camera_opencv();
        volseggs_kernels::PinholeCamera {
            width: self.width as usize,
            height: self.height as usize,
            fx: self.fx as f32,
            fy: self.fy as f32,
            cx: self.cx as f32,
            cy: self.cy as f32,
            rotation: std::array::from_fn(|r| std::array::from_fn(|c| rotation.col(c)[r] as f32)),
            translation: translation.as_vec3().to_array(),
        }
    }
}
