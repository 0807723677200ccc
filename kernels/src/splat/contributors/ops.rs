//! The lists as an op of the backend: computed on the host for backends in host memory, on a GPU by two walks along the
//! tiles' lists.

use super::cpu;
use super::{Contributors, ContributorsError};
use crate::backend::CpuBackend;
use crate::splat::cpu::{Values, bin::DepthOrder, project};
use crate::splat::{SplatSettings, SplatTensors};
use burn::backend::tensor::IntTensor;
use burn::backend::{Backend, ExtensionType, TensorMetadata, backend_extension};

/// Result of [`ContributorsOps::contributors`].
#[derive(ExtensionType)]
pub struct ContributorsOutput<B: Backend> {
    /// The lists, on the host.
    pub lists: Result<Contributors, ContributorsError>,
    /// Radius of each Gaussian on screen in pixels, 0 if not drawn, `[N]`.
    pub radii: IntTensor<B>,
}

/// The backend side of [`super::contributors`].
#[backend_extension(NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait ContributorsOps: Backend {
    /// Finds the lists of `pixels`.
    fn contributors(
        #[extension_type] inputs: SplatTensors<Self>,
        settings: SplatSettings,
        pixels: Vec<u32>,
    ) -> ContributorsOutput<Self>;
}

impl<B: CpuBackend> ContributorsOps for B {
    fn contributors(inputs: SplatTensors<Self>, settings: SplatSettings, pixels: Vec<u32>) -> ContributorsOutput<Self> {
        let values = Values::of::<B>(&inputs);
        let (attributes, offsets) = values.borrow();
        let splats = project::project(attributes, offsets, &settings);
        let order = DepthOrder::new(&splats, &settings.camera);
        let lists = cpu::of_pixels(&order, &settings, &pixels);
        let radii: Vec<i32> = splats.iter().map(|s| s.radius).collect();
        let n = radii.len();
        ContributorsOutput { lists, radii: B::int_tensor(radii, [n], &inputs.means.device()) }
    }
}
