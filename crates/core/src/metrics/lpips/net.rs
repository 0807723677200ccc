//! The two backbones as tables: which layers run, and where LPIPS reads its features. No tensors here.

use super::LpipsNet;

/// A convolution followed by a ReLU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ConvSpec {
    pub input: usize,
    pub output: usize,
    pub kernel: usize,
    pub stride: usize,
    pub padding: usize,
}

impl ConvSpec {
    /// The shape of its weights.
    pub(super) fn weight_shape(&self) -> [usize; 4] {
        [self.output, self.input, self.kernel, self.kernel]
    }
}

/// Convolutions up to a feature map that LPIPS reads, after an optional max pool of stride 2.
#[derive(Debug, Clone, Copy)]
pub(super) struct ConvStage {
    /// Side length of the pooling window.
    pub pool: Option<usize>,
    pub convs: &'static [ConvSpec],
}

/// Stride of every max pool of both nets.
pub(super) const POOL_STRIDE: usize = 2;

const fn conv(input: usize, output: usize, kernel: usize, stride: usize, padding: usize) -> ConvSpec {
    ConvSpec { input, output, kernel, stride, padding }
}

const fn same3(input: usize, output: usize) -> ConvSpec {
    conv(input, output, 3, 1, 1)
}

const ALEX: [ConvStage; 5] = [
    ConvStage { pool: None, convs: &[conv(3, 64, 11, 4, 2)] },
    ConvStage { pool: Some(3), convs: &[conv(64, 192, 5, 1, 2)] },
    ConvStage { pool: Some(3), convs: &[same3(192, 384)] },
    ConvStage { pool: None, convs: &[same3(384, 256)] },
    ConvStage { pool: None, convs: &[same3(256, 256)] },
];

const VGG: [ConvStage; 5] = [
    ConvStage { pool: None, convs: &[same3(3, 64), same3(64, 64)] },
    ConvStage { pool: Some(2), convs: &[same3(64, 128), same3(128, 128)] },
    ConvStage { pool: Some(2), convs: &[same3(128, 256), same3(256, 256), same3(256, 256)] },
    ConvStage { pool: Some(2), convs: &[same3(256, 512), same3(512, 512), same3(512, 512)] },
    ConvStage { pool: Some(2), convs: &[same3(512, 512), same3(512, 512), same3(512, 512)] },
];

impl LpipsNet {
    /// Both nets.
    pub const ALL: [Self; 2] = [Self::Alex, Self::Vgg];

    /// The net whose first convolution has weights of this shape, which distinguishes the two.
    pub fn with_first_weights(shape: &[usize]) -> Option<Self> {
        Self::ALL.into_iter().find(|net| net.stages()[0].convs[0].weight_shape() == shape)
    }

    /// The shapes of the convolutions' weights in order, `[output, input, k, k]`; a bias has `[output]`.
    pub fn convolution_shapes(self) -> impl Iterator<Item = [usize; 4]> + Clone {
        self.stages().iter().flat_map(|stage| stage.convs).map(ConvSpec::weight_shape)
    }

    /// The shapes of the heads' weights, one for each stage: `[1, C, 1, 1]`.
    pub fn head_shapes(self) -> [[usize; 4]; 5] {
        self.stages().each_ref().map(|stage| [1, stage.convs.last().map_or(0, |c| c.output), 1, 1])
    }

    pub(super) fn stages(self) -> &'static [ConvStage; 5] {
        match self {
            LpipsNet::Alex => &ALEX,
            LpipsNet::Vgg => &VGG,
        }
    }

    /// The minimum height and width for which every feature map has at least one position.
    pub fn min_side(self) -> usize {
        // backwards from one position in the last map: a window needs (n - 1) stride + kernel inputs
        let mut side = 1;
        for stage in self.stages().iter().rev() {
            for conv in stage.convs.iter().rev() {
                let padded = (side - 1) * conv.stride + conv.kernel;
                side = padded.saturating_sub(2 * conv.padding).max(1);
            }
            if let Some(kernel) = stage.pool {
                side = (side - 1) * POOL_STRIDE + kernel;
            }
        }
        side
    }
}
