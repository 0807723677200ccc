//! The size of a model, computed from its configuration alone before anything is allocated. Nothing here overflows,
//! whatever the configuration says.

use super::d3dgs;
use super::encoder::find_encoder;
use super::rendering::Rendering;
use crate::config::types::{Appearance, D3dgsConfig, DecoderKind, ModelConfig, ShBands};
use crate::memory::product;
use volseggs_kernels::changes::{COLUMNS, WIDTHS};

/// Octaves of the positional encoding beyond which single precision carries no information about a position.
pub(super) const MAX_OCTAVES: usize = 24;
/// Layers of the implicit encoder beyond which gradients hardly reach the first ones.
pub(super) const MAX_DEPTH: usize = 64;

/// What determines the memory of a model of Gaussians, in values.
#[derive(Clone, Copy, Debug)]
pub struct ModelSizes {
    /// Values per Gaussian.
    pub attributes: u128,
    /// Those of them that are its colours.
    pub colours: u128,
    /// Parameters besides the Gaussians.
    pub parameters: u128,
    /// Values that a step keeps per Gaussian until the gradients are computed, besides its attributes.
    pub kept: u128,
    /// Inputs of the decoder per Gaussian; 0 without a decoder.
    pub inputs: u128,
    /// Width of the decoder's hidden layers; 0 without a decoder.
    pub width: usize,
    /// Values per Gaussian in the widest tensor of a network that encodes places; 0 without one.
    pub widest: u128,
}

impl ModelSizes {
    /// Returns the sizes of a scene with the field that `model` describes, or with the network of D3DGS in its place.
    pub fn of_scene(model: &ModelConfig, network: Option<&D3dgsConfig>) -> Self {
        let (attributes, colours) = (attributes(model), coefficients(model).saturating_mul(3));
        let Some(network) = network else {
            // an embedding is concatenated with the features, and so are the gradients
            let joined = if model.embedding > 0 { inputs(model) } else { 0 };
            let features = features(model).saturating_add(joined).saturating_mul(2);
            let kept = features.saturating_add(hidden(model)).saturating_add(encoder_values(model));
            let (parameters, inputs, widest) = (field_parameters(model), inputs(model), widest_layer(model));
            return Self { attributes, colours, parameters, kept, inputs, width: model.width, widest };
        };
        let (parameters, kept, widest) =
            (d3dgs::parameters(network), d3dgs::kept_values(network), d3dgs::widest(network));
        Self { attributes, colours, parameters, kept, inputs: 0, width: 0, widest }
    }
}

/// Rejects sizes that no model can have, naming the key.
///
/// # Errors
/// The first such key with its value and the allowed range.
pub fn check_model(config: &ModelConfig) -> Result<(), String> {
    match (config.sh_bands, config.sh_degree) {
        (ShBands::All, 0..=3) | (ShBands::Even, 0 | 2 | 4) => {}
        (ShBands::All, degree) => {
            return Err(format!("model.sh_degree = {degree}: at most 3 with model.sh_bands = \"all\""));
        }
        (ShBands::Even, degree) => {
            return Err(format!(
                "model.sh_degree = {degree}: 0, 2 or 4 with model.sh_bands = \"even\", 0 to 3 with \"all\""
            ));
        }
    }
    for (name, value) in [
        ("levels", config.levels),
        ("channels", config.channels),
        ("time_knots", config.time_knots),
        ("width", config.width),
        ("resolution", config.resolution),
    ] {
        if value == 0 {
            return Err(format!("model.{name} = 0: at least 1"));
        }
    }
    Rendering::from(config).check().map_err(|e| format!("model.{e}"))?;
    find_encoder(&config.encoder).map_err(|e| format!("model.encoder: {e}"))?.check(config)
}

/// Number of spherical-harmonics coefficients K per Gaussian and channel.
pub fn coefficients(config: &ModelConfig) -> u128 {
    let degree = config.sh_degree as u128;
    match config.sh_bands {
        ShBands::All => degree.saturating_add(1).saturating_pow(2),
        // one function in band 0, five in band 2, nine in band 4
        ShBands::Even => (degree / 2).saturating_add(1).saturating_mul(degree.saturating_add(1)),
    }
}

/// Number of values per Gaussian: spherical harmonics, embedding and the other attributes.
pub fn attributes(config: &ModelConfig) -> u128 {
    let coefficients = coefficients(config);
    let normal = if config.appearance == Appearance::Headlight { 3 } else { 0 };
    let others = (config.embedding as u128).saturating_add(3 + 4 + 3 + 1 + normal);
    coefficients.saturating_mul(3).saturating_add(others)
}

/// Number of features that the encoder outputs per Gaussian.
pub fn features(config: &ModelConfig) -> u128 {
    find_encoder(&config.encoder).map_or(0, |encoder| encoder.features(config))
}

/// Number of inputs of the decoder per Gaussian: the features and the embedding.
pub fn inputs(config: &ModelConfig) -> u128 {
    features(config).saturating_add(config.embedding as u128)
}

/// Number of hidden values of the decoder per Gaussian, of the trunk and of each head.
pub fn hidden(config: &ModelConfig) -> u128 {
    product(&[1 + heads(config), config.width])
}

fn heads(config: &ModelConfig) -> usize {
    match config.decoder {
        DecoderKind::Heads => WIDTHS.len(),
        DecoderKind::Shared => 1,
    }
}

/// Number of values that a step keeps per Gaussian until the gradients of the encoder are computed, besides the features.
pub fn encoder_values(config: &ModelConfig) -> u128 {
    find_encoder(&config.encoder).map_or(0, |encoder| encoder.kept_values(config))
}

/// Number of values per Gaussian in the encoder's widest tensor, if that is not the features.
pub fn widest_layer(config: &ModelConfig) -> u128 {
    find_encoder(&config.encoder).map_or(0, |encoder| encoder.widest_layer(config))
}

/// Number of parameters of a layer.
pub(super) fn layer(inputs: u128, outputs: u128) -> u128 {
    inputs.saturating_add(1).saturating_mul(outputs)
}

/// Number of parameters of the encoder; 0 if it is not known.
pub fn encoder_parameters(config: &ModelConfig) -> u128 {
    find_encoder(&config.encoder).map_or(0, |encoder| encoder.parameters(config))
}

/// Number of parameters of the deformation field: the encoder's, by [`encoder_parameters`], and the decoder's.
pub fn field_parameters(config: &ModelConfig) -> u128 {
    let width = config.width as u128;
    let trunk = layer(inputs(config), width);
    let hidden = layer(width, width).saturating_mul(heads(config) as u128);
    let decoder = trunk.saturating_add(hidden).saturating_add(layer(width, COLUMNS as u128));
    encoder_parameters(config).saturating_add(decoder)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::preset;
    use crate::device::DeviceName;
    use crate::model::{DeformationField, params};

    #[test]
    fn the_count_is_that_of_the_module() {
        let device = DeviceName::all()[0].open().unwrap();
        let implicit = [(1, 0), (2, 0), (2, 1), (5, 0), (5, 2), (5, 4)].map(|shape| ("implicit", shape));
        let grids = ["factorised", "hexplane"].map(|grid| (grid, (0, 0)));
        for (encoder, (depth, skip)) in grids.into_iter().chain(implicit) {
            for decoder in [DecoderKind::Heads, DecoderKind::Shared] {
                let mut config = preset("best").unwrap().model;
                (config.levels, config.resolution, config.time_knots) = (3, 5, 7);
                (config.channels, config.width, config.encoder, config.decoder) = (4, 6, encoder.into(), decoder);
                (config.implicit_width, config.implicit_depth, config.implicit_skip) = (9, depth, skip);
                config.embedding = depth;
                check_model(&config).unwrap();
                let field = DeformationField::new(&config, [0.0; 3], [1.0; 3], 0, &device);
                let values = |part: &str| -> usize {
                    let parameters = params::collect(&field);
                    parameters.iter().filter(|(name, _)| name.starts_with(part)).map(|(_, t)| t.values.len()).sum()
                };
                let what = format!("{encoder:?} {depth} {skip} {decoder:?}");
                assert_eq!(field_parameters(&config), values("") as u128, "{what}");
                assert_eq!(encoder_parameters(&config), values("encoder") as u128, "{what}");
            }
        }
    }

    #[test]
    fn shapes_that_the_implicit_encoder_cannot_have_are_refused_by_key() {
        type Edit = fn(&mut ModelConfig);
        let cases: [(Edit, &str); 7] = [
            (|m| m.implicit_octaves = 25, "model.implicit_octaves = 25: at most 24"),
            (|m| m.implicit_time_octaves = 25, "model.implicit_time_octaves = 25: at most 24"),
            (|m| m.implicit_width = 0, "model.implicit_width = 0: at least 1"),
            (|m| m.implicit_depth = 0, "model.implicit_depth = 0: at least 1"),
            (|m| m.implicit_depth = 65, "model.implicit_depth = 65: at most 64"),
            (|m| m.implicit_depth = 5, "model.implicit_skip = 5: below model.implicit_depth = 5"),
            (|m| m.implicit_skip = usize::MAX, "model.implicit_skip"),
        ];
        for (edit, words) in cases {
            let mut config = preset("best").unwrap().model;
            edit(&mut config);
            assert_eq!(check_model(&config), Ok(()), "another encoder does not read these keys");
            config.encoder = "implicit".into();
            let error = check_model(&config).unwrap_err();
            assert!(error.contains(words), "{error}");
        }
    }

    #[test]
    fn what_a_step_keeps_of_the_implicit_encoder_is_counted() {
        let mut config = preset("best").unwrap().model;
        assert_eq!(encoder_values(&config), 0);
        config.encoder = "implicit".into();
        assert_eq!(encoder_values(&config), 76 + (76 + 256) + 2 * 7 * 256);
        config.implicit_skip = 0;
        assert_eq!(encoder_values(&config), 76 + 2 * 7 * 256);
    }

    #[test]
    fn no_size_overflows() {
        let mut config = preset("best").unwrap().model;
        (config.levels, config.resolution, config.time_knots) = (usize::MAX, usize::MAX, usize::MAX);
        (config.channels, config.width, config.implicit_octaves) = (usize::MAX, usize::MAX, usize::MAX);
        (config.implicit_width, config.implicit_depth) = (usize::MAX, usize::MAX);
        (config.implicit_time_octaves, config.implicit_skip) = (usize::MAX, usize::MAX);
        (config.sh_degree, config.embedding) = (usize::MAX, usize::MAX);
        let all = ["factorised", "hexplane", "implicit"];
        for encoder in all {
            config.encoder = encoder.into();
            assert!(field_parameters(&config) > 1 << 64 && attributes(&config) > 1 << 64);
        }
        assert!(check_model(&config).unwrap_err().contains("model.sh_degree"));
    }
}
