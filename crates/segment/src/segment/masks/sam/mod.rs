//! Segment Anything with MobileSAM's image encoder: masks of an image from point and box prompts, or of everything.
//!
//! Inference only. [`Sam`] holds the networks and ties the steps together; `tiny_vit` encodes images, `prompt` points
//! and boxes, `decoder` and `transformer` make masks of both, `image` converts pixels and logits on the host, and
//! [`automatic`] prompts with a grid. Weights are never downloaded: [`checkpoint`] finds a local file, `weights` reads
//! it under the names of the published PyTorch model.

pub mod automatic;
pub mod checkpoint;
mod config;
mod decoder;
mod error;
pub mod image;
mod layers;
mod prompt;
#[cfg(test)]
pub(super) mod tests;
mod tiny_vit;
mod tiny_vit_block;
mod transformer;
mod weights;

pub use automatic::{AutomaticOptions, KeptCandidates, SamMask, generate};
pub use config::SamConfig;
pub use error::SamError;
pub use image::ImageFit;
pub use prompt::{PointLabel, SamPrompt};

use super::{Mask, MaskError};
use burn::tensor::{DType, Device, Tensor, TensorData};
use decoder::MaskDecoder;
use prompt::PromptEncoder;
use std::path::Path;
use tiny_vit::TinyVit;
use weights::SamWeights;

/// A Segment Anything network with its weights on a device. Nothing here is differentiable.
#[derive(Debug, Clone)]
pub struct Sam {
    config: SamConfig,
    device: Device,
    encoder: TinyVit,
    prompt: PromptEncoder,
    decoder: MaskDecoder,
    /// Positional encoding of the embedding's cells, `[1, S * S, C]`.
    cells: Tensor<3>,
}

/// An encoded image: the costly step, shared by all prompts on it.
#[derive(Debug, Clone)]
pub struct Embedding {
    /// `[1, C, S, S]` with `S = image_size / 16`.
    pub(crate) features: Tensor<4>,
    frame: ImageFit,
}

/// Low-resolution candidate masks of a batch of prompts.
#[derive(Debug, Clone, PartialEq)]
pub struct MaskPrediction {
    /// Prompts `B`.
    pub prompts: usize,
    /// Candidates per prompt `M`.
    pub candidates: usize,
    /// Width and height `L` of each candidate, a quarter of the network's input.
    pub side: usize,
    /// Mask logits `[B, M, L, L]`; a pixel is set where the logit is above 0.
    pub logits: Vec<f32>,
    /// The network's estimate of each candidate's intersection over union with the true mask, `[B, M]`.
    pub iou: Vec<f32>,
}

impl MaskPrediction {
    /// The logits `[L, L]` of one candidate.
    ///
    /// # Panics
    /// If `prompt` or `candidate` is out of range.
    pub fn candidate(&self, prompt: usize, candidate: usize) -> &[f32] {
        let pixels = self.side * self.side;
        let start = (prompt * self.candidates + candidate) * pixels;
        &self.logits[start..start + pixels]
    }
}

impl Embedding {
    /// The sizes that map between the image and the network.
    pub fn frame(&self) -> &ImageFit {
        &self.frame
    }
}

impl Sam {
    /// Loads weights, F32 or F16, onto `device`.
    ///
    /// The safetensors file holds the published PyTorch model's tensors under their own names. Batch norms are folded
    /// into the convolutions before them. Other tensors are ignored.
    ///
    /// # Errors
    /// [`SamError::Config`], or any [`SamError`] about the file: unreadable, truncated, a tensor missing, of a wrong
    /// shape or type, or not finite.
    pub fn load(path: impl AsRef<Path>, config: &SamConfig, device: &Device) -> Result<Self, SamError> {
        config.validate()?;
        let device = if device.is_autodiff() { device.clone().inner() } else { device.clone() };
        let path = path.as_ref();
        let bytes =
            crate::files::read_regular(path).map_err(|source| SamError::Read { path: path.to_path_buf(), source })?;
        let weights = SamWeights::parse(path, &bytes, &device)?;
        let root = weights.root();
        let prompt = PromptEncoder::load(&root.at("prompt_encoder"), config)?;
        Ok(Self {
            encoder: TinyVit::load(&root.at("image_encoder"), config)?,
            decoder: MaskDecoder::load(&root.at("mask_decoder"), config)?,
            cells: prompt.cells(config.embedding_side()),
            prompt,
            device,
            config: config.clone(),
        })
    }

    /// The dimensions of the networks.
    pub fn config(&self) -> &SamConfig {
        &self.config
    }

    /// Encodes an RGB image `[height, width, 3]`, row-major from the top.
    ///
    /// # Errors
    /// [`SamError::ImageSize`] if `rgb` does not hold `width * height * 3` bytes, [`SamError::ImageShape`] if the image
    /// is empty or too thin to be resized.
    pub fn encode(&self, rgb: &[u8], width: usize, height: usize) -> Result<Embedding, SamError> {
        let frame = ImageFit::new(width, height, self.config.image_size)?;
        let values = image::network_input(rgb, &frame)?;
        let side = self.config.image_size;
        let data = TensorData::new(values, [1, 3, side, side]);
        let features = self.encoder.forward(Tensor::from_data(data, (&self.device, DType::F32)));
        Ok(Embedding { features, frame })
    }

    /// Predicts candidate masks for each prompt: three at different scales or, without `multimask`, the single one that
    /// is meant for prompts of several points.
    ///
    /// # Errors
    /// [`SamError::Prompt`] if a prompt is empty, not finite, or differs from the first in its number of points or in
    /// having a box.
    pub fn predict(
        &self,
        image: &Embedding,
        prompts: &[SamPrompt],
        multimask: bool,
    ) -> Result<MaskPrediction, SamError> {
        let side = 4 * self.config.embedding_side();
        let candidates = if multimask { self.config.candidates } else { 1 };
        let empty = MaskPrediction { prompts: 0, candidates, side, logits: Vec::new(), iou: Vec::new() };
        if prompts.is_empty() {
            return Ok(empty);
        }
        let sparse = self.prompt.sparse(prompts, &image.frame)?;
        let features = self.prompt.with_no_mask(image.features.clone());
        let (masks, iou) = self.decoder.forward(features, self.cells.clone(), sparse, multimask);
        Ok(MaskPrediction { prompts: prompts.len(), logits: host(masks)?, iou: host(iou)?, ..empty })
    }
}

/// Copies a tensor's values to the host, row-major.
fn host<const D: usize>(tensor: Tensor<D>) -> Result<Vec<f32>, SamError> {
    let data = tensor.try_into_data().map_err(|e| SamError::Device(e.to_string()))?;
    data.try_into_vec::<f32>().map_err(|e| SamError::Device(format!("{e:?}")))
}
