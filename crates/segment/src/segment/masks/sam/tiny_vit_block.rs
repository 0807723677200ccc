//! TinyViT's attention block: attention within square windows, a convolution per channel, an MLP.

use super::SamError;
use super::config::SamConfig;
use super::layers::{ConvShape, LayerNorm, Linear, NORM_EPSILON, SamConv};
use super::weights::Scope;
use burn::module::{Module, Param};
use burn::tensor::Tensor;
use burn::tensor::activation::gelu;
use burn::tensor::module::attention;
use burn::tensor::ops::AttentionModuleOptions;

/// A block on `[B, H, W, C]`.
#[derive(Module, Debug)]
pub(super) struct TinyVitBlock {
    attention: WindowAttention,
    local: SamConv,
    norm: LayerNorm,
    widen: Linear,
    narrow: Linear,
}

impl TinyVitBlock {
    pub(super) fn load(scope: &Scope<'_>, config: &SamConfig, stage: usize) -> Result<Self, SamError> {
        let dim = config.embed_dims[stage];
        let hidden = dim * config.mlp_ratio;
        let mlp = scope.at("mlp");
        Ok(Self {
            attention: WindowAttention::load(&scope.at("attn"), dim, config.heads[stage], config.windows[stage])?,
            local: SamConv::load_folded(&scope.at("local_conv"), ConvShape::depthwise(dim, 3, 1))?,
            norm: LayerNorm::load(&mlp.at("norm"), dim, NORM_EPSILON)?,
            widen: Linear::load(&mlp.at("fc1"), dim, hidden)?,
            narrow: Linear::load(&mlp.at("fc2"), hidden, dim)?,
        })
    }

    pub(super) fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let x = x.clone() + self.attention.forward(x);
        let x = self.local.forward(x.permute([0, 3, 1, 2])).permute([0, 2, 3, 1]);
        x.clone() + self.narrow.forward(gelu(self.widen.forward(self.norm.forward(x))))
    }
}

/// Attention within windows, with a learned bias for each distance between two cells.
#[derive(Module, Debug)]
struct WindowAttention {
    norm: LayerNorm,
    /// Queries, keys and values concatenated within each head, head by head.
    qkv: Linear,
    out: Linear,
    /// `[1, heads, window^2, window^2]`
    bias: Param<Tensor<4>>,
    heads: usize,
    window: usize,
}

impl WindowAttention {
    fn load(scope: &Scope<'_>, dim: usize, heads: usize, window: usize) -> Result<Self, SamError> {
        let cells = window * window;
        // one learned value per pair of row and column distance
        let learned = scope.values("attention_biases", &[heads, cells])?;
        let mut bias = Vec::with_capacity(heads * cells * cells);
        for of_head in learned.chunks_exact(cells) {
            for a in 0..cells {
                let distance =
                    |b: usize| (a / window).abs_diff(b / window) * window + (a % window).abs_diff(b % window);
                bias.extend((0..cells).map(|b| of_head[distance(b)]));
            }
        }
        Ok(Self {
            norm: LayerNorm::load(&scope.at("norm"), dim, NORM_EPSILON)?,
            qkv: Linear::load(&scope.at("qkv"), dim, 3 * dim)?,
            out: Linear::load(&scope.at("proj"), dim, dim)?,
            bias: scope.place(bias, [1, heads, cells, cells]),
            heads,
            window,
        })
    }

    /// `[B, H, W, C]`, without the residual.
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let [batch, height, width, dim] = x.dims();
        let window = self.window;
        let (rows, columns) = (height.div_ceil(window), width.div_ceil(window));
        // the cells that pad the last windows are zeros before the norm and are attended to, as in training
        let x = fill(fill(x, 1, rows * window), 2, columns * window);
        let x = x.reshape([batch, rows, window, columns, window, dim]).swap_dims(2, 3);
        let x = self.attend(x.reshape([batch * rows * columns, window * window, dim]));
        let x = x.reshape([batch, rows, columns, window, window, dim]).swap_dims(2, 3);
        let x = x.reshape([batch, rows * window, columns * window, dim]);
        x.slice([0..batch, 0..height, 0..width, 0..dim])
    }

    /// Windows `[N, window^2, C]`.
    fn attend(&self, x: Tensor<3>) -> Tensor<3> {
        let [windows, cells, dim] = x.dims();
        let size = dim / self.heads;
        let qkv =
            self.qkv.forward(self.norm.forward(x)).reshape([windows, cells, self.heads, 3 * size]).swap_dims(1, 2);
        let [q, k, v] = [0, 1, 2].map(|part| qkv.clone().narrow(3, part * size, size));
        let bias = Some(self.bias.val());
        let mixed = attention(q, k, v, None, bias, AttentionModuleOptions::default());
        self.out.forward(mixed.swap_dims(1, 2).reshape([windows, cells, dim]))
    }
}

/// Appends zeros along `axis` up to `size`.
fn fill(x: Tensor<4>, axis: usize, size: usize) -> Tensor<4> {
    let mut dims = x.dims();
    if dims[axis] == size {
        return x;
    }
    dims[axis] = size - dims[axis];
    let zeros = Tensor::zeros(dims, &x.device());
    Tensor::cat(vec![x, zeros], axis)
}
