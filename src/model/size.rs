//! How large a model is, from its configuration alone: asked before anything of it is allocated. Nothing here overflows,
//! whatever the configuration says.

use crate::config::types::{DecoderKind, EncoderKind, ModelConfig};
use crate::extend::find_encoder;
use crate::memory::product;

use super::decoder::{OUTPUT_COLUMNS, OUTPUTS};

/// Octaves of the positional encoding beyond which single precision says nothing about a position.
const MAX_OCTAVES: usize = 24;

/// Refuses sizes that no model can have, by key.
///
/// # Errors
/// The first such key with its value, and what it may be.
pub fn check_model(config: &ModelConfig) -> Result<(), String> {
    if config.sh_degree > 3 {
        return Err(format!("model.sh_degree = {}: at most 3", config.sh_degree));
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
    if config.encoder == EncoderKind::Implicit && config.implicit_octaves > MAX_OCTAVES {
        return Err(format!("model.implicit_octaves = {}: at most {MAX_OCTAVES}", config.implicit_octaves));
    }
    Ok(())
}

/// Values of the spherical harmonics and the other attributes of one Gaussian.
#[must_use]
pub fn attributes(config: &ModelConfig) -> u128 {
    let coefficients = (config.sh_degree as u128).saturating_add(1).saturating_pow(2);
    coefficients.saturating_mul(3).saturating_add(3 + 4 + 3 + 1)
}

/// Features that the encoder gives for each Gaussian.
#[must_use]
pub fn features(config: &ModelConfig) -> u128 {
    match config.encoder {
        EncoderKind::Extra => find_encoder(&config.extra_encoder).map_or(0, |encoder| encoder.features(config) as u128),
        EncoderKind::Factorised | EncoderKind::Implicit => product(&[config.levels, config.channels]),
    }
}

/// Hidden values of the decoder for each Gaussian: of the trunk and of each head.
#[must_use]
pub fn hidden(config: &ModelConfig) -> u128 {
    product(&[1 + heads(config), config.width])
}

fn heads(config: &ModelConfig) -> usize {
    match config.decoder {
        DecoderKind::Heads => OUTPUTS.len(),
        DecoderKind::Shared => 1,
    }
}

/// Parameters of the deformation field. Of a registered encoder they are not known, and count as none.
#[must_use]
pub fn field_parameters(config: &ModelConfig) -> u128 {
    let width = config.width as u128;
    let layer = |inputs: u128, outputs: u128| inputs.saturating_add(1).saturating_mul(outputs);
    let encoder = match config.encoder {
        EncoderKind::Factorised => {
            let (levels, nodes) = (config.levels as u128, config.resolution as u128);
            // level m has m * resolution nodes an axis: sums of m and of m * m over the levels
            let next = levels.saturating_add(1);
            let sum = levels.saturating_mul(next) / 2;
            let squares = levels.saturating_mul(next).saturating_mul(levels.saturating_mul(2).saturating_add(1)) / 6;
            let planes = squares.saturating_mul(nodes).saturating_mul(nodes).saturating_mul(3);
            let lines = sum.saturating_mul(nodes).saturating_mul(3);
            let times = product(&[config.levels, config.time_knots]);
            planes.saturating_add(lines).saturating_add(times).saturating_mul(config.channels as u128)
        }
        EncoderKind::Implicit => {
            let inputs = (config.implicit_octaves as u128).saturating_mul(6).saturating_add(1);
            let hidden = layer(inputs, width).saturating_add(layer(width, width));
            hidden.saturating_add(layer(width, features(config)))
        }
        EncoderKind::Extra => 0,
    };
    let trunk = layer(features(config), width);
    let hidden = layer(width, width).saturating_mul(heads(config) as u128);
    encoder.saturating_add(trunk).saturating_add(hidden).saturating_add(layer(width, OUTPUT_COLUMNS as u128))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::types::Config;
    use crate::device::DeviceName;
    use crate::model::{DeformationField, params};

    #[test]
    fn the_count_is_that_of_the_module() {
        let device = DeviceName::all()[0].open().unwrap();
        for encoder in [EncoderKind::Factorised, EncoderKind::Implicit] {
            for decoder in [DecoderKind::Heads, DecoderKind::Shared] {
                let mut config = Config::default().model;
                (config.levels, config.resolution, config.time_knots) = (3, 5, 7);
                (config.channels, config.width, config.encoder, config.decoder) = (4, 6, encoder, decoder);
                let field = DeformationField::new(&config, [0.0; 3], [1.0; 3], 0, &device);
                let values: usize = params::collect(&field).values().map(|t| t.values.len()).sum();
                assert_eq!(field_parameters(&config), values as u128, "{encoder:?} {decoder:?}");
            }
        }
    }

    #[test]
    fn no_size_overflows() {
        let mut config = Config::default().model;
        (config.levels, config.resolution, config.time_knots) = (usize::MAX, usize::MAX, usize::MAX);
        (config.channels, config.width, config.implicit_octaves) = (usize::MAX, usize::MAX, usize::MAX);
        config.sh_degree = usize::MAX;
        for encoder in [EncoderKind::Factorised, EncoderKind::Implicit, EncoderKind::Extra] {
            config.encoder = encoder;
            assert!(field_parameters(&config) > 1 << 64 && attributes(&config) > 1 << 64);
        }
        assert!(check_model(&config).unwrap_err().contains("model.sh_degree"));
    }
}
