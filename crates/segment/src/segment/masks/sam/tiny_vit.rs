//! The TinyViT image encoder: stem, a stage of convolution blocks, three stages of attention blocks, neck.

use super::SamError;
use super::config::SamConfig;
use super::layers::{CHANNEL_NORM_EPSILON, ConvShape, LayerNorm, SamConv};
use super::tiny_vit_block::TinyVitBlock;
use super::weights::Scope;
use burn::module::Module;
use burn::tensor::Tensor;
use burn::tensor::activation::gelu;

/// Expands the channels, filters each, and projects them: an inverted residual block without its residual.
#[derive(Module, Debug)]
struct ConvBlock {
    expand: SamConv,
    filter: SamConv,
    project: SamConv,
}

impl ConvBlock {
    /// Loads a block from `inputs` through `hidden` to `outputs` channels, whose filters move by `stride`.
    fn load(scope: &Scope<'_>, [inputs, hidden, outputs]: [usize; 3], stride: usize) -> Result<Self, SamError> {
        Ok(Self {
            expand: SamConv::load_folded(&scope.at("conv1"), ConvShape::dense(inputs, hidden, 1, 1))?,
            filter: SamConv::load_folded(&scope.at("conv2"), ConvShape::depthwise(hidden, 3, stride))?,
            project: SamConv::load_folded(&scope.at("conv3"), ConvShape::dense(hidden, outputs, 1, 1))?,
        })
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        self.project.forward(gelu(self.filter.forward(gelu(self.expand.forward(x)))))
    }
}

/// The image encoder.
#[derive(Module, Debug)]
pub(super) struct TinyVit {
    stem: Vec<SamConv>,
    convs: Vec<ConvBlock>,
    /// Between a stage and the next: they change the channels and, by their stride, the resolution.
    merges: Vec<ConvBlock>,
    /// Of stages 1 to 3.
    stages: Vec<Vec<TinyVitBlock>>,
    neck: Vec<SamConv>,
    neck_norms: Vec<LayerNorm>,
}

/// Strides after stages 0, 1 and 2. The published TinyViT halves three times; SAM's omits the last one, which keeps the
/// embedding at a sixteenth of the input.
const MERGE_STRIDES: [usize; 3] = [2, 2, 1];

impl TinyVit {
    pub(super) fn load(scope: &Scope<'_>, config: &SamConfig) -> Result<Self, SamError> {
        let dims = config.embed_dims;
        let stem = scope.at("patch_embed.seq");
        let half = dims[0] / 2;
        let stem = vec![
            SamConv::load_folded(&stem.at(0), ConvShape::dense(3, half, 3, 2))?,
            SamConv::load_folded(&stem.at(2), ConvShape::dense(half, dims[0], 3, 2))?,
        ];
        let layer = |stage: usize| scope.at("layers").at(stage);
        let hidden = dims[0] * config.expand_ratio;
        let conv = |i: usize| ConvBlock::load(&layer(0).at("blocks").at(i), [dims[0], hidden, dims[0]], 1);
        let merge = |(stage, stride): (usize, usize)| {
            let (from, to) = (dims[stage], dims[stage + 1]);
            ConvBlock::load(&layer(stage).at("downsample"), [from, to, to], stride)
        };
        let stage = |stage: usize| {
            let block = |i: usize| TinyVitBlock::load(&layer(stage).at("blocks").at(i), config, stage);
            (0..config.depths[stage]).map(block).collect::<Result<Vec<_>, _>>()
        };
        let (neck, to) = (scope.at("neck"), config.prompt_dim);
        Ok(Self {
            stem,
            convs: (0..config.depths[0]).map(conv).collect::<Result<_, _>>()?,
            merges: MERGE_STRIDES.into_iter().enumerate().map(merge).collect::<Result<_, _>>()?,
            stages: (1..4).map(stage).collect::<Result<_, _>>()?,
            neck: vec![
                SamConv::load(&neck.at(0), ConvShape::dense(dims[3], to, 1, 1))?,
                SamConv::load(&neck.at(2), ConvShape::dense(to, to, 3, 1))?,
            ],
            neck_norms: vec![
                LayerNorm::load(&neck.at(1), to, CHANNEL_NORM_EPSILON)?,
                LayerNorm::load(&neck.at(3), to, CHANNEL_NORM_EPSILON)?,
            ],
        })
    }

    /// Maps normalised pixels `[B, 3, I, I]` to the embedding `[B, C, I / 16, I / 16]`.
    pub(super) fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let mut x = x;
        for (i, conv) in self.stem.iter().enumerate() {
            x = conv.forward(if i == 0 { x } else { gelu(x) });
        }
        for block in &self.convs {
            x = gelu(block.forward(x.clone()) + x);
        }
        for (merge, blocks) in self.merges.iter().zip(&self.stages) {
            // attention works on rows of channels
            x = merge.forward(x).permute([0, 2, 3, 1]);
            for block in blocks {
                x = block.forward(x);
            }
            x = x.permute([0, 3, 1, 2]);
        }
        for (conv, norm) in self.neck.iter().zip(&self.neck_norms) {
            x = norm.forward_channels(conv.forward(x));
        }
        x
    }
}
