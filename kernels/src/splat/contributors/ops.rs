//! The lists as an op of the backend: on the host from host memory, on a GPU by two walks along the tiles' lists.

use super::cpu;
use super::{Contributors, ContributorsError};
use crate::backend::CpuBackend;
use crate::splat::SplatSettings;
use crate::splat::cpu::{Attributes, bin::Order, blend, project};
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, ExtensionType, TensorMetadata, backend_extension};

/// What a backend finds.
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
    /// The lists of `pixels`.
    fn contributors(
        means: FloatTensor<Self>,
        rotations: FloatTensor<Self>,
        log_scales: FloatTensor<Self>,
        opacity_logits: FloatTensor<Self>,
        sh: FloatTensor<Self>,
        screen_offsets: FloatTensor<Self>,
        settings: SplatSettings,
        pixels: Vec<u32>,
    ) -> ContributorsOutput<Self>;
}

fn on_host<B: CpuBackend>(
    tensors: [FloatTensor<B>; 5],
    offsets: &FloatTensor<B>,
    settings: &SplatSettings,
    pixels: &[u32],
) -> ContributorsOutput<B> {
    let device = tensors[0].device();
    let sh_stride = tensors[4].shape()[1];
    let values = tensors.each_ref().map(B::values);
    let splats = project::project(Attributes::new(&values, sh_stride), &B::values(offsets), settings);
    let order = Order::new(&splats, settings.camera.height);
    // blending finds where each tile ends, and so which Gaussians matter
    let (_, bins) = blend::blend(&order, settings);
    let lists = cpu::contributors(&order, &bins, settings, pixels);
    let radii: Vec<i32> = splats.iter().map(|s| s.radius).collect();
    let n = radii.len();
    ContributorsOutput { lists, radii: B::int_tensor(radii, [n], &device) }
}

macro_rules! bind {
    ($backend:ty) => {
        impl ContributorsOps for $backend {
            fn contributors(
                means: FloatTensor<Self>,
                rotations: FloatTensor<Self>,
                log_scales: FloatTensor<Self>,
                opacity_logits: FloatTensor<Self>,
                sh: FloatTensor<Self>,
                screen_offsets: FloatTensor<Self>,
                settings: SplatSettings,
                pixels: Vec<u32>,
            ) -> ContributorsOutput<Self> {
                on_host::<Self>([means, rotations, log_scales, opacity_logits, sh], &screen_offsets, &settings, &pixels)
            }
        }
    };
}

#[cfg(feature = "ndarray")]
bind!(burn_ndarray::NdArray);
#[cfg(feature = "flex")]
bind!(burn_flex::Flex);
#[cfg(feature = "tch")]
bind!(burn_tch::LibTorch);
