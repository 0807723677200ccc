//! The size of a model, computed from its configuration alone before anything is allocated. Nothing here overflows,
//! whatever the configuration says.

use super::encoder_definition::find_encoder;
use super::rendering::{check_dilation, check_path_opacity};
use crate::config::types::{Appearance, DecoderKind, EncoderKind, ModelConfig, ShBands};
use crate::memory::product;
use volseggs_kernels::changes::{COLUMNS, WIDTHS};

/// Octaves of the positional encoding beyond which single precision carries no information about a position.
pub(super) const MAX_OCTAVES: usize = 24;
/// Layers of the implicit encoder beyond which gradients hardly reach the first ones.
pub(super) const MAX_DEPTH: usize = 64;

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
    check_dilation(config.dilation as f32).map_err(|e| format!("model.{e}"))?;
    check_path_opacity(config.path_opacity as f32).map_err(|e| format!("model.{e}"))?;
    if config.encoder == EncoderKind::Implicit { check_implicit(config) } else { Ok(()) }
}

fn check_implicit(config: &ModelConfig) -> Result<(), String> {
    let (depth, skip) = (config.implicit_depth, config.implicit_skip);
    // (key, value, min, max)
    let ranges = [
        ("octaves", config.implicit_octaves, 0, MAX_OCTAVES),
        ("time_octaves", config.implicit_time_octaves, 0, MAX_OCTAVES),
        ("width", config.implicit_width, 1, usize::MAX),
        ("depth", depth, 1, MAX_DEPTH),
    ];
    for (name, value, min, max) in ranges {
        if value < min {
            return Err(format!("model.implicit_{name} = {value}: at least {min}"));
        }
        if value > max {
            return Err(format!("model.implicit_{name} = {value}: at most {max}"));
        }
    }
    if skip >= depth {
        return Err(format!(
            "model.implicit_skip = {skip}: below model.implicit_depth = {depth}, as a layer must follow it; 0 for none"
        ));
    }
    Ok(())
}

/// Number of spherical-harmonics coefficients K per Gaussian and channel.
#[must_use]
pub fn coefficients(config: &ModelConfig) -> u128 {
    let degree = config.sh_degree as u128;
    match config.sh_bands {
        ShBands::All => degree.saturating_add(1).saturating_pow(2),
        // one function in band 0, five in band 2, nine in band 4
        ShBands::Even => (degree / 2).saturating_add(1).saturating_mul(degree.saturating_add(1)),
    }
}

/// Number of values per Gaussian: spherical harmonics, embedding and the other attributes.
#[must_use]
pub fn attributes(config: &ModelConfig) -> u128 {
    let coefficients = coefficients(config);
    let normal = if config.appearance == Appearance::Headlight { 3 } else { 0 };
    let others = (config.embedding as u128).saturating_add(3 + 4 + 3 + 1 + normal);
    coefficients.saturating_mul(3).saturating_add(others)
}

/// Number of features that the encoder outputs per Gaussian.
#[must_use]
pub fn features(config: &ModelConfig) -> u128 {
    match config.encoder {
        EncoderKind::Extra => find_encoder(&config.extra_encoder).map_or(0, |encoder| encoder.features(config) as u128),
        EncoderKind::Factorised | EncoderKind::HexPlane | EncoderKind::Implicit => {
            product(&[config.levels, config.channels])
        }
    }
}

/// Number of inputs of the decoder per Gaussian: the features and the embedding.
#[must_use]
pub fn inputs(config: &ModelConfig) -> u128 {
    features(config).saturating_add(config.embedding as u128)
}

/// Number of hidden values of the decoder per Gaussian, of the trunk and of each head.
#[must_use]
pub fn hidden(config: &ModelConfig) -> u128 {
    product(&[1 + heads(config), config.width])
}

fn heads(config: &ModelConfig) -> usize {
    match config.decoder {
        DecoderKind::Heads => WIDTHS.len(),
        DecoderKind::Shared => 1,
    }
}

/// Number of values that encode a point and a time in the implicit encoder.
fn encoded(config: &ModelConfig) -> u128 {
    let waves = |octaves: usize| (octaves as u128).saturating_mul(2).saturating_add(1);
    waves(config.implicit_octaves).saturating_mul(3).saturating_add(waves(config.implicit_time_octaves))
}

/// Number of values that a step keeps per Gaussian until the gradients of the implicit encoder are computed: its input,
/// the concatenated input of the skip layer, and each layer but the last before and after its ReLU. 0 for other
/// encoders.
#[must_use]
pub fn encoder_values(config: &ModelConfig) -> u128 {
    if config.encoder != EncoderKind::Implicit {
        return 0;
    }
    let (width, inputs) = (config.implicit_width as u128, encoded(config));
    let joined = if config.implicit_skip > 0 { inputs.saturating_add(width) } else { 0 };
    let layers = (config.implicit_depth as u128).saturating_sub(1).saturating_mul(width);
    inputs.saturating_add(joined).saturating_add(layers.saturating_mul(2))
}

/// Number of values per Gaussian in the widest tensor of the implicit encoder. 0 for other encoders.
#[must_use]
pub fn widest_layer(config: &ModelConfig) -> u128 {
    if config.encoder != EncoderKind::Implicit {
        return 0;
    }
    let (inputs, width) = (encoded(config), config.implicit_width as u128);
    if config.implicit_skip > 0 { inputs.saturating_add(width) } else { inputs.max(width) }
}

/// Number of parameters of a layer.
pub(super) fn layer(inputs: u128, outputs: u128) -> u128 {
    inputs.saturating_add(1).saturating_mul(outputs)
}

/// Number of parameters of the encoder. Those of a registered one are not known and count as 0.
#[must_use]
pub fn encoder_parameters(config: &ModelConfig) -> u128 {
    match config.encoder {
        EncoderKind::Factorised | EncoderKind::HexPlane => {
            let (levels, nodes) = (config.levels as u128, config.resolution as u128);
            // level m has m * resolution nodes per axis: sums of m and of m * m over the levels
            let next = levels.saturating_add(1);
            let sum = levels.saturating_mul(next) / 2;
            let squares = levels.saturating_mul(next).saturating_mul(levels.saturating_mul(2).saturating_add(1)) / 6;
            let planes = squares.saturating_mul(nodes).saturating_mul(nodes).saturating_mul(3);
            let lines = sum.saturating_mul(nodes).saturating_mul(3);
            let over_time = if config.encoder == EncoderKind::HexPlane {
                lines.saturating_mul(config.time_knots as u128)
            } else {
                lines.saturating_add(product(&[config.levels, config.time_knots]))
            };
            planes.saturating_add(over_time).saturating_mul(config.channels as u128)
        }
        EncoderKind::Implicit => {
            let (depth, skip) = (config.implicit_depth as u128, config.implicit_skip as u128);
            let (width, inputs, outputs) = (config.implicit_width as u128, encoded(config), features(config));
            if depth < 2 {
                return layer(inputs, outputs);
            }
            let within = (depth - 2).saturating_mul(layer(width, width));
            let whole = layer(inputs, width).saturating_add(within).saturating_add(layer(width, outputs));
            let joins = if skip == depth - 1 { outputs } else { width };
            whole.saturating_add(if skip > 0 { inputs.saturating_mul(joins) } else { 0 })
        }
        EncoderKind::Extra => 0,
    }
}

/// Number of parameters of the deformation field: the encoder's, by [`encoder_parameters`], and the decoder's.
#[must_use]
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
        let implicit = [(1, 0), (2, 0), (2, 1), (5, 0), (5, 2), (5, 4)].map(|shape| (EncoderKind::Implicit, shape));
        let grids = [EncoderKind::Factorised, EncoderKind::HexPlane].map(|grid| (grid, (0, 0)));
        for (encoder, (depth, skip)) in grids.into_iter().chain(implicit) {
            for decoder in [DecoderKind::Heads, DecoderKind::Shared] {
                let mut config = preset("best").unwrap().model;
                (config.levels, config.resolution, config.time_knots) = (3, 5, 7);
                (config.channels, config.width, config.encoder, config.decoder) = (4, 6, encoder, decoder);
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
            config.encoder = EncoderKind::Implicit;
            let error = check_model(&config).unwrap_err();
            assert!(error.contains(words), "{error}");
        }
    }

    #[test]
    fn what_a_step_keeps_of_the_implicit_encoder_is_counted() {
        let mut config = preset("best").unwrap().model;
        assert_eq!(encoder_values(&config), 0);
        config.encoder = EncoderKind::Implicit;
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
        let all = [EncoderKind::Factorised, EncoderKind::HexPlane, EncoderKind::Implicit, EncoderKind::Extra];
        for encoder in all {
            config.encoder = encoder;
            assert!(field_parameters(&config) > 1 << 64 && attributes(&config) > 1 << 64);
        }
        assert!(check_model(&config).unwrap_err().contains("model.sh_degree"));
    }
}
