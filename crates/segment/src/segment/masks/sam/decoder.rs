//! The mask decoder: from an image embedding and prompts to candidate masks and their predicted quality.

use super::SamError;
use super::config::SamConfig;
use super::layers::{CHANNEL_NORM_EPSILON, Doubling, LayerNorm, SamMlp};
use super::transformer::TwoWayTransformer;
use super::weights::Scope;
use burn::module::{Module, Param};
use burn::tensor::Tensor;
use burn::tensor::activation::gelu;

/// The mask decoder.
#[derive(Module, Debug)]
pub(super) struct MaskDecoder {
    transformer: TwoWayTransformer,
    /// The tokens of the quality, of the single mask and of the candidates, `[2 + candidates, C]`.
    tokens: Param<Tensor<2>>,
    first_doubling: Doubling,
    norm: LayerNorm,
    second_doubling: Doubling,
    /// From a mask's token to the weights of the image's channels, for the single mask and the candidates.
    filters: Vec<SamMlp>,
    quality: SamMlp,
}

/// Layers of the networks that make filters.
const FILTER_DEPTH: usize = 3;

impl MaskDecoder {
    pub(super) fn load(scope: &Scope<'_>, config: &SamConfig) -> Result<Self, SamError> {
        let (dim, masks) = (config.prompt_dim, config.candidates + 1);
        let mut tokens = scope.at("iou_token").values("weight", &[1, dim])?;
        tokens.extend(scope.at("mask_tokens").values("weight", &[masks, dim])?);
        let filter = |i: usize| {
            let scope = scope.at("output_hypernetworks_mlps").at(i);
            SamMlp::load(&scope, dim, dim, dim / 8, FILTER_DEPTH)
        };
        let upscaling = scope.at("output_upscaling");
        let quality = scope.at("iou_prediction_head");
        Ok(Self {
            transformer: TwoWayTransformer::load(&scope.at("transformer"), config)?,
            tokens: scope.place(tokens, [1 + masks, dim]),
            first_doubling: Doubling::load(&upscaling.at(0), dim, dim / 4)?,
            norm: LayerNorm::load(&upscaling.at(1), dim / 4, CHANNEL_NORM_EPSILON)?,
            second_doubling: Doubling::load(&upscaling.at(3), dim / 4, dim / 8)?,
            filters: (0..masks).map(filter).collect::<Result<_, _>>()?,
            quality: SamMlp::load(&quality, dim, config.iou_hidden, masks, config.iou_depth)?,
        })
    }

    /// Maps an image `[1, C, S, S]` with the mask prompt added, positional encoding `[1, S * S, C]` and prompts
    /// `[B, N, C]` to logits `[B, M, 4 S, 4 S]` and qualities `[B, M]`: the candidates, or the single mask.
    pub(super) fn forward(
        &self,
        image: Tensor<4>,
        cells: Tensor<3>,
        prompts: Tensor<3>,
        multimask: bool,
    ) -> (Tensor<4>, Tensor<2>) {
        let [_, dim, side, _] = image.dims();
        let batch = prompts.dims()[0];
        let own = self.tokens.val().unsqueeze::<3>().repeat_dim(0, batch);
        let image = image.reshape([1, dim, side * side]).swap_dims(1, 2);
        let (tokens, image) = self.transformer.forward(image, cells, Tensor::cat(vec![own, prompts], 1));

        // a decoder without blocks leaves one image for all prompts
        let images = image.dims()[0];
        let image = image.swap_dims(1, 2).reshape([images, dim, side, side]);
        let image = gelu(self.norm.forward_channels(self.first_doubling.forward(image)));
        let image = gelu(self.second_doubling.forward(image));
        let side = 4 * side;
        let image = image.reshape([images, dim / 8, side * side]);

        let wanted = if multimask { 1..self.filters.len() } else { 0..1 };
        let token = |i: usize| tokens.clone().narrow(1, i, 1);
        let filters = wanted.clone().map(|i| self.filters[i].forward(token(1 + i))).collect();
        let masks = Tensor::cat(filters, 1).matmul(image).reshape([batch, wanted.len(), side, side]);
        let quality = self.quality.forward(token(0)).squeeze_dim::<2>(1);
        (masks, quality.narrow(1, wanted.start, wanted.len()))
    }
}
