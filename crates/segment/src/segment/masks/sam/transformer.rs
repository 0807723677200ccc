//! The two-way transformer: tokens attend to the image and the image to the tokens.
//!
//! Image tensors may have batch 1 where the tokens have batch `B`: as long as the image is the same for all prompts,
//! its projections are computed once.

use super::SamError;
use super::config::SamConfig;
use super::layers::{LayerNorm, Linear, NORM_EPSILON};
use super::weights::Scope;
use burn::module::Module;
use burn::tensor::Tensor;
use burn::tensor::activation::relu;
use burn::tensor::module::attention;
use burn::tensor::ops::AttentionModuleOptions;

/// Attention with projections into fewer channels.
#[derive(Module, Debug)]
struct Attention {
    q: Linear,
    k: Linear,
    v: Linear,
    out: Linear,
    heads: usize,
}

impl Attention {
    fn load(scope: &Scope<'_>, config: &SamConfig, downsample: usize) -> Result<Self, SamError> {
        let (dim, inner) = (config.prompt_dim, config.prompt_dim / downsample);
        Ok(Self {
            q: Linear::load(&scope.at("q_proj"), dim, inner)?,
            k: Linear::load(&scope.at("k_proj"), dim, inner)?,
            v: Linear::load(&scope.at("v_proj"), dim, inner)?,
            out: Linear::load(&scope.at("out_proj"), inner, dim)?,
            heads: config.decoder_heads,
        })
    }

    /// `[1 or B, N, C]` to `[batch, heads, N, size]`.
    fn split(&self, x: Tensor<3>, batch: usize) -> Tensor<4> {
        let [own, count, inner] = x.dims();
        let x = x.reshape([own, count, self.heads, inner / self.heads]).swap_dims(1, 2);
        if own == batch { x } else { x.repeat_dim(0, batch) }
    }

    /// Queries `[1 or B, N, C]`, keys and values `[1 or B, M, C]` to `[B, N, C]`.
    fn forward(&self, q: Tensor<3>, k: Tensor<3>, v: Tensor<3>) -> Tensor<3> {
        let batch = q.dims()[0].max(k.dims()[0]);
        let count = q.dims()[1];
        let [q, k, v] = [self.q.forward(q), self.k.forward(k), self.v.forward(v)].map(|x| self.split(x, batch));
        let mixed = attention(q, k, v, None, None, AttentionModuleOptions::default()).swap_dims(1, 2);
        let inner = mixed.dims()[2] * mixed.dims()[3];
        self.out.forward(mixed.reshape([batch, count, inner]))
    }
}

/// Tokens to tokens, tokens to image, an MLP on the tokens, image to tokens.
#[derive(Module, Debug)]
struct TwoWayBlock {
    own: Attention,
    to_image: Attention,
    from_image: Attention,
    widen: Linear,
    narrow: Linear,
    norms: Vec<LayerNorm>,
    first: bool,
}

impl TwoWayBlock {
    fn load(scope: &Scope<'_>, config: &SamConfig, first: bool) -> Result<Self, SamError> {
        let (dim, down) = (config.prompt_dim, config.decoder_downsample);
        let norm = |i: usize| LayerNorm::load(&scope.at(format!("norm{i}")), dim, NORM_EPSILON);
        Ok(Self {
            own: Attention::load(&scope.at("self_attn"), config, 1)?,
            to_image: Attention::load(&scope.at("cross_attn_token_to_image"), config, down)?,
            from_image: Attention::load(&scope.at("cross_attn_image_to_token"), config, down)?,
            widen: Linear::load(&scope.at("mlp.lin1"), dim, config.decoder_mlp)?,
            narrow: Linear::load(&scope.at("mlp.lin2"), config.decoder_mlp, dim)?,
            norms: (1..=4).map(norm).collect::<Result<_, _>>()?,
            first,
        })
    }

    fn forward(
        &self,
        tokens: Tensor<3>,
        image: Tensor<3>,
        prompts: &Tensor<3>,
        cells: &Tensor<3>,
    ) -> (Tensor<3>, Tensor<3>) {
        // the first block's tokens are the prompts themselves: there is nothing to add or keep
        let tokens = if self.first {
            self.own.forward(tokens.clone(), tokens.clone(), tokens)
        } else {
            let q = tokens.clone() + prompts.clone();
            tokens.clone() + self.own.forward(q.clone(), q, tokens)
        };
        let tokens = self.norms[0].forward(tokens);

        let placed = image.clone() + cells.clone();
        let seen = self.to_image.forward(tokens.clone() + prompts.clone(), placed.clone(), image.clone());
        let tokens = self.norms[1].forward(tokens + seen);

        let wide = relu(self.widen.forward(tokens.clone()));
        let tokens = self.norms[2].forward(tokens + self.narrow.forward(wide));

        let update = self.from_image.forward(placed, tokens.clone() + prompts.clone(), tokens.clone());
        (tokens, self.norms[3].forward(image + update))
    }
}

/// The transformer of the mask decoder.
#[derive(Module, Debug)]
pub(super) struct TwoWayTransformer {
    blocks: Vec<TwoWayBlock>,
    last: Attention,
    norm: LayerNorm,
}

impl TwoWayTransformer {
    pub(super) fn load(scope: &Scope<'_>, config: &SamConfig) -> Result<Self, SamError> {
        let block = |i: usize| TwoWayBlock::load(&scope.at("layers").at(i), config, i == 0);
        Ok(Self {
            blocks: (0..config.decoder_depth).map(block).collect::<Result<_, _>>()?,
            last: Attention::load(&scope.at("final_attn_token_to_image"), config, config.decoder_downsample)?,
            norm: LayerNorm::load(&scope.at("norm_final_attn"), config.prompt_dim, NORM_EPSILON)?,
        })
    }

    /// Maps an image `[1, M, C]`, its positional encoding `[1, M, C]` and prompts `[B, N, C]` to tokens `[B, N, C]` and
    /// an image for each prompt `[B, M, C]`.
    pub(super) fn forward(&self, image: Tensor<3>, cells: Tensor<3>, prompts: Tensor<3>) -> (Tensor<3>, Tensor<3>) {
        let (mut tokens, mut image) = (prompts.clone(), image);
        for block in &self.blocks {
            (tokens, image) = block.forward(tokens, image, &prompts, &cells);
        }
        let seen = self.last.forward(tokens.clone() + prompts, image.clone() + cells, image.clone());
        (self.norm.forward(tokens + seen), image)
    }
}
