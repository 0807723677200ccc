//! The dimensions of the networks. No tensors here.

use super::SamError;

/// Dimensions of a Segment Anything network with a TinyViT image encoder; the default is MobileSAM's `vit_t`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SamConfig {
    /// Width and height of the encoder's square input, pixels; a multiple of 16.
    pub image_size: usize,
    /// Channels of the encoder's four stages.
    pub embed_dims: [usize; 4],
    /// Blocks of each stage.
    pub depths: [usize; 4],
    /// Attention heads of each stage; the first stage has no attention.
    pub heads: [usize; 4],
    /// Side of each stage's attention windows, cells; the first stage has none.
    pub windows: [usize; 4],
    /// Ratio of hidden to input channels of the encoder's MLPs.
    pub mlp_ratio: usize,
    /// Ratio of hidden to input channels of the first stage's convolution blocks.
    pub expand_ratio: usize,
    /// Channels of the image embedding, the prompts and the mask decoder; a multiple of 8.
    pub prompt_dim: usize,
    /// Two-way blocks of the mask decoder.
    pub decoder_depth: usize,
    /// Attention heads of the mask decoder.
    pub decoder_heads: usize,
    /// Hidden channels of the mask decoder's MLPs.
    pub decoder_mlp: usize,
    /// Ratio of input to inner channels of the decoder's attention between tokens and image.
    pub decoder_downsample: usize,
    /// Candidate masks per prompt.
    pub candidates: usize,
    /// Layers of the head that predicts mask quality.
    pub iou_depth: usize,
    /// Hidden channels of that head.
    pub iou_hidden: usize,
}

impl Default for SamConfig {
    fn default() -> Self {
        Self {
            image_size: 1024,
            embed_dims: [64, 128, 160, 320],
            depths: [2, 2, 6, 2],
            heads: [2, 4, 5, 10],
            windows: [7, 7, 14, 7],
            mlp_ratio: 4,
            expand_ratio: 4,
            prompt_dim: 256,
            decoder_depth: 2,
            decoder_heads: 8,
            decoder_mlp: 2048,
            decoder_downsample: 2,
            candidates: 3,
            iou_depth: 3,
            iou_hidden: 256,
        }
    }
}

impl SamConfig {
    /// Width and height of the image embedding, cells.
    pub fn embedding_side(&self) -> usize {
        self.image_size / 16
    }

    /// Checks that the dimensions fit each other.
    ///
    /// # Errors
    /// [`SamError::Config`] naming the field.
    pub fn validate(&self) -> Result<(), SamError> {
        let check = |sound: bool, field: &'static str, rule: String| {
            if sound { Ok(()) } else { Err(SamError::Config { field, rule }) }
        };
        let multiple = |value: usize, of: usize| value > 0 && of > 0 && value.is_multiple_of(of);
        check(
            multiple(self.image_size, 16),
            "image_size",
            format!("{} is not a positive multiple of 16", self.image_size),
        )?;
        check(multiple(self.embed_dims[0], 2), "embed_dims", "the first is not a positive even number".to_owned())?;
        for stage in 1..4 {
            let (dim, heads) = (self.embed_dims[stage], self.heads[stage]);
            check(
                multiple(dim, heads),
                "embed_dims",
                format!("{dim} of stage {stage} does not split into {heads} heads"),
            )?;
            check(self.windows[stage] > 0, "windows", format!("0 in stage {stage}"))?;
        }
        let prompt = self.prompt_dim;
        check(multiple(prompt, 8), "prompt_dim", format!("{prompt} is not a positive multiple of 8"))?;
        let (down, heads) = (self.decoder_downsample, self.decoder_heads);
        check(multiple(prompt, down), "decoder_downsample", format!("{down} does not divide prompt_dim {prompt}"))?;
        let inner = prompt / down;
        check(multiple(inner, heads), "decoder_heads", format!("{heads} does not divide {inner} channels"))?;
        check(multiple(prompt, heads), "decoder_heads", format!("{heads} does not divide {prompt} channels"))?;
        for (field, value) in [
            ("mlp_ratio", self.mlp_ratio),
            ("expand_ratio", self.expand_ratio),
            ("decoder_mlp", self.decoder_mlp),
            ("candidates", self.candidates),
            ("iou_depth", self.iou_depth),
            ("iou_hidden", self.iou_hidden),
        ] {
            check(value > 0, field, "must be above 0".to_owned())?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_published_dimensions_are_sound() {
        let config = SamConfig::default();
        config.validate().unwrap();
        assert_eq!(config.embedding_side(), 64);
    }

    #[test]
    fn dimensions_that_do_not_fit_are_named() {
        let good = SamConfig::default();
        let bad = [
            (SamConfig { image_size: 1000, ..good.clone() }, "image_size"),
            (SamConfig { image_size: 0, ..good.clone() }, "image_size"),
            (SamConfig { heads: [2, 4, 7, 10], ..good.clone() }, "embed_dims"),
            (SamConfig { heads: [2, 0, 5, 10], ..good.clone() }, "embed_dims"),
            (SamConfig { windows: [7, 7, 0, 7], ..good.clone() }, "windows"),
            (SamConfig { prompt_dim: 60, ..good.clone() }, "prompt_dim"),
            (SamConfig { decoder_downsample: 0, ..good.clone() }, "decoder_downsample"),
            (SamConfig { decoder_heads: 3, ..good.clone() }, "decoder_heads"),
            (SamConfig { iou_depth: 0, ..good }, "iou_depth"),
        ];
        for (config, name) in bad {
            let error = config.validate().unwrap_err();
            assert!(matches!(&error, SamError::Config { field, .. } if *field == name), "{error}");
        }
    }
}
