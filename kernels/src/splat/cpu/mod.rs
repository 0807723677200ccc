//! The splat op in host memory: the stages in order, and their binding to the backends.
//!
//! project (per Gaussian) -> order (depth) -> list and blend (one task per row of tiles, slab by slab of depth);
//! backward: blend again front to back with gradients, merge per Gaussian in a fixed order, then back through the
//! projection. No result depends on the number of threads.

pub(crate) mod bin;
pub(crate) mod blend;
mod blend_backward;
pub(crate) mod covariance;
pub(crate) mod lanes;
pub(crate) mod project;
mod project_backward;
mod reach;
mod rows;
pub(crate) mod rule;
#[cfg(test)]
mod tests;

use super::{CovarianceTensors, SplatBackwardOps, SplatForward, SplatOps, SplatSaved, SplatSettings, SplatTensors};
use crate::backend::CpuBackend;
use bin::{DepthOrder, TileBins};
use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use covariance::Covariances;
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::Arc;

/// Tile side in pixels.
pub(crate) const TILE: usize = 16;

/// The values of a backend's tensors: attributes, and offsets on the screen.
pub(crate) struct Values<'a> {
    means: Cow<'a, [f32]>,
    covariances: Covariances<Cow<'a, [f32]>>,
    opacity_logits: Cow<'a, [f32]>,
    sh: Cow<'a, [f32]>,
    sh_stride: usize,
    screen_offsets: Cow<'a, [f32]>,
}

impl<'a> Values<'a> {
    /// Reads the values, borrowed where the tensors are contiguous.
    pub(crate) fn of<B: CpuBackend>(inputs: &'a SplatTensors<B>) -> Self {
        Self {
            means: B::values(&inputs.means),
            covariances: match &inputs.covariances {
                CovarianceTensors::Factored { rotations, log_scales } => {
                    Covariances::Factored { rotations: B::values(rotations), log_scales: B::values(log_scales) }
                }
                CovarianceTensors::Entries(entries) => Covariances::Entries(B::values(entries)),
            },
            opacity_logits: B::values(&inputs.opacity_logits),
            sh: B::values(&inputs.sh),
            sh_stride: inputs.sh.shape()[1],
            screen_offsets: B::values(&inputs.screen_offsets),
        }
    }

    /// Returns the attributes and the offsets `[N, 2]`.
    pub(crate) fn borrow(&self) -> (Attributes<'_>, &[f32]) {
        let attributes = Attributes {
            means: &self.means,
            covariances: self.covariances.map(|rows| &**rows),
            opacity_logits: &self.opacity_logits,
            sh: &self.sh,
            sh_stride: self.sh_stride,
        };
        (attributes, &self.screen_offsets)
    }
}

/// The attribute arrays, row-major.
#[derive(Clone, Copy)]
pub(crate) struct Attributes<'a> {
    /// `[N, 3]`
    pub means: &'a [f32],
    /// Parameters of the covariances.
    pub covariances: Covariances<&'a [f32]>,
    /// `[N]`
    pub opacity_logits: &'a [f32],
    /// `[N, K, 3]`
    pub sh: &'a [f32],
    /// Coefficients per Gaussian, K.
    pub sh_stride: usize,
}

impl Attributes<'_> {
    fn len(&self) -> usize {
        self.opacity_logits.len()
    }
}

/// State that the forward pass keeps for the backward pass.
struct ForwardState {
    order: DepthOrder,
    /// The Gaussians that each tile was drawn with.
    bins: TileBins,
    /// The rendered image `[H, W, 4]`.
    image: Vec<f32>,
}

fn forward(
    attributes: Attributes<'_>,
    offsets: &[f32],
    settings: &SplatSettings,
) -> (Vec<f32>, Vec<i32>, ForwardState) {
    let splats = project::project(attributes, offsets, settings);
    let order = DepthOrder::new(&splats, &settings.camera);
    let (image, bins) = blend::blend(&order, settings);
    let radii = splats.par_iter().map(|s| s.radius).collect();
    // a clone would be made by one thread while the others wait
    let kept = image.par_iter().copied().collect();
    (image, radii, ForwardState { order, bins, image: kept })
}

impl<B: CpuBackend> SplatOps for B {
    fn splat_forward(inputs: SplatTensors<Self>, settings: SplatSettings, _: bool) -> SplatForward<Self> {
        let device = inputs.means.device();
        let values = Values::of::<B>(&inputs);
        let (attributes, offsets) = values.borrow();
        let (image, radii, saved) = forward(attributes, offsets, &settings);
        SplatForward {
            image: B::tensor(image, [settings.camera.height, settings.camera.width, 4], &device),
            radii: B::int_tensor(radii, [attributes.len()], &device),
            saved: SplatSaved(Arc::new(saved)),
        }
    }
}

impl<B: CpuBackend> SplatBackwardOps for B {
    fn splat_backward(
        inputs: SplatTensors<Self>,
        grad_image: FloatTensor<Self>,
        settings: SplatSettings,
        saved: SplatSaved,
    ) -> SplatTensors<Self> {
        let values = Values::of::<B>(&inputs);
        let (attributes, _) = values.borrow();
        let saved = saved.0.downcast_ref::<ForwardState>().expect("the forward pass ran on the same backend");
        let screen = blend_backward::blend_backward(saved, &B::values(&grad_image), &settings);
        let g = project_backward::project_backward(attributes, &saved.order, &screen, &settings);
        let device = inputs.means.device();
        let (n, sh_stride) = (attributes.len(), attributes.sh_stride);
        SplatTensors {
            means: B::tensor(g.means, [n, 3], &device),
            covariances: match g.covariances {
                Covariances::Factored { rotations, log_scales } => CovarianceTensors::Factored {
                    rotations: B::tensor(rotations, [n, 4], &device),
                    log_scales: B::tensor(log_scales, [n, 3], &device),
                },
                Covariances::Entries(entries) => CovarianceTensors::Entries(B::tensor(entries, [n, 6], &device)),
            },
            opacity_logits: B::tensor(g.opacity_logits, [n], &device),
            sh: B::tensor(g.sh, [n, sh_stride, 3], &device),
            screen_offsets: B::tensor(g.screen_offsets, [n, 2], &device),
        }
    }
}
