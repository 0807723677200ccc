//! Requirements on a configuration before training may start, beyond its types.

use super::budget::max_gaussians;
use super::{TrainError, densify, ema, losses, rate_schedule};
use crate::config::types::{Config, DataConfig, DensifyConfig};
use crate::memory::product;
use crate::model::encoder::find_encoder;
use crate::model::size::{ModelSizes, check_model};
use crate::rng::{Purpose, Rng};
use crate::volume::transfer::color::parse_hex;
use burn::tensor::Device;

/// The background behind the Gaussians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Background {
    /// Always this colour.
    Fixed([f32; 3]),
    /// A new colour each step.
    Random,
}

impl Background {
    /// Returns the colour for a step.
    pub fn colour(self, seed: u64, step: usize) -> [f32; 3] {
        match self {
            Self::Fixed(colour) => colour,
            Self::Random => {
                let mut rng = Rng::new(seed, step as u64, Purpose::Background);
                std::array::from_fn(|_| rng.uniform())
            }
        }
    }
}

/// Returns the background colour that `data.background` names; white in evaluation if it is `random`.
///
/// # Errors
/// If it has none of the known forms.
pub fn evaluation_background(text: &str) -> Result<[f32; 3], TrainError> {
    match parse_background(text)? {
        Background::Fixed(colour) => Ok(colour),
        Background::Random => Ok([1.0; 3]),
    }
}

/// Reads `data.background`: `white`, `black`, `random` or `#rrggbb`.
///
/// # Errors
/// If it has none of these forms.
pub fn parse_background(text: &str) -> Result<Background, TrainError> {
    match text {
        "white" => Ok(Background::Fixed([1.0; 3])),
        "black" => Ok(Background::Fixed([0.0; 3])),
        "random" => Ok(Background::Random),
        other => parse_hex(other).map(Background::Fixed).ok_or_else(|| {
            TrainError::Config(format!("data.background = \"{other}\": use white, black, random or #rrggbb"))
        }),
    }
}

/// Refuses a run whose largest buffers the device cannot bind; accepts any on devices in host memory.
pub fn check_device(
    config: &Config,
    sizes: &ModelSizes,
    start: usize,
    images: [usize; 2],
    device: &Device,
) -> Result<(), TrainError> {
    let Some(limit) = crate::device::largest_buffer(device) else { return Ok(()) };
    let n = usize::try_from(max_gaussians(config)).unwrap_or(usize::MAX).max(start);
    let ModelSizes { colours, inputs, width, widest, .. } = *sizes;
    let needs = [
        (format!("spherical harmonics of {n} Gaussians"), colours.saturating_mul(4 * n as u128)),
        (format!("hidden layers of the decoder for {n} Gaussians"), product(&[n, 4 * 4, width])),
        (format!("features and embeddings of {n} Gaussians"), inputs.saturating_mul(4 * n as u128)),
        (format!("widest layer of the implicit network for {n} Gaussians"), widest.saturating_mul(4 * n as u128)),
        ("statistics of DSSIM at this image size".to_owned(), product(&[images[0], images[1], 4 * 15])),
    ];
    let (what, bytes) = needs.into_iter().max_by_key(|(_, bytes)| *bytes).unwrap_or_default();
    if bytes > u128::from(limit) {
        return Err(TrainError::Config(format!(
            "the {what} take {} MB in one buffer, but this GPU binds at most {} MB: use fewer Gaussians, a \
             smaller model or smaller images, or --device flex",
            bytes / 1_000_000,
            limit / 1_000_000
        )));
    }
    Ok(())
}

/// Refuses values that no training can start with.
///
/// # Errors
/// The first such value, named by its key.
pub fn check(config: &Config) -> Result<(), TrainError> {
    let bad = |text: String| Err(TrainError::Config(text));
    check_model(&config.model).map_err(TrainError::Config)?;
    let whole = serde_json::to_value(config).map_err(|e| TrainError::Config(e.to_string()))?;
    if let Some(text) = bad_number(&whole, String::new()) {
        return bad(text);
    }
    if config.optim.average > 0 && !ema::WINDOWS.contains(&config.optim.average) {
        let (min, max) = ema::WINDOWS.into_inner();
        return bad(format!("optim.average = {}: 0 for none, or from {min} to {max}", config.optim.average));
    }
    if config.init.points == 0 {
        return bad("init.points = 0: at least 1".into());
    }
    if !(config.init.opacity > 0.0 && config.init.opacity < 1.0) {
        return bad(format!("init.opacity = {}: between 0 and 1", config.init.opacity));
    }
    check_ranges(config)?;
    check_times(&config.data)?;
    check_densify(&config.densify)?;
    densify::check(config).map_err(TrainError::Config)?;
    check_resets(config)?;
    if config.optim.warmup_decay_steps == 0 {
        return bad("optim.warmup_decay_steps = 0: at least 1".into());
    }
    if config.speed.coarse_factor == 0 {
        return bad("speed.coarse_factor = 0: at least 1".into());
    }
    if config.speed.coarse_steps > 0 && config.speed.coarse_factor == 1 {
        return bad(format!(
            "speed.coarse_steps = {}: images are not reduced with speed.coarse_factor = 1; set it to 2 or \
             more, or the steps to 0",
            config.speed.coarse_steps
        ));
    }
    if config.speed.cull_visits > 1 && !find_encoder(&config.model.encoder).is_ok_and(|e| e.skips_culled()) {
        return bad(format!(
            "speed.cull_visits = {}: only with model.encoder = \"factorised\" or \"hexplane\"",
            config.speed.cull_visits
        ));
    }
    losses::check(config).map_err(TrainError::Config)?;
    if config.stages.warmup_steps + config.stages.joint_steps == 0 {
        return bad("stages.warmup_steps and stages.joint_steps are both 0: nothing to train".into());
    }
    if config.output.keep == 0 {
        return bad("output.keep = 0: at least 1, or a run could not be resumed".into());
    }
    if config.output.eval_every > 0 && config.output.eval_views == 0 {
        return bad("output.eval_views = 0: at least 1; output.eval_every=0 turns evaluations off".into());
    }
    rate_schedule::check(&config.optim).map_err(TrainError::Config)
}

/// Refuses numbers that would soon lead to NaN, for which the learning rates would then be blamed.
fn check_ranges(config: &Config) -> Result<(), TrainError> {
    let (init, optim) = (&config.init, &config.optim);
    let [first, second] = optim.betas;
    // (key, value, min, max)
    let ranges = [
        ("init.scale", init.scale, 1e-6, 1e6),
        ("init.box_half_size", init.box_half_size, 1e-6, 1e6),
        ("model.bounds_margin", config.model.bounds_margin, 0.0, 1e3),
        ("optim.epsilon", optim.epsilon, f64::from(f32::MIN_POSITIVE), 1.0),
        // 1 in single precision would divide by zero
        ("optim.betas[0]", first, 0.0, 0.999_999),
        ("optim.betas[1]", second, 0.0, 0.999_999),
        ("densify.prune_opacity", config.densify.prune_opacity, 0.0, 0.999),
        // a rate that falls log-linearly to zero is zero from the second step on
        ("optim.attributes_final_fraction", optim.attributes_final_fraction, 1e-9, 1e9),
    ];
    match ranges.into_iter().find(|(_, value, min, max)| !(min..=max).contains(&value)) {
        None => Ok(()),
        Some((key, value, min, _)) if value < min && min < 1e-5 => {
            Err(TrainError::Config(format!("{key} = {value:?}: above 0 (at least {min:.1e})")))
        }
        Some((key, value, min, max)) => Err(TrainError::Config(format!("{key} = {value:?}: between {min} and {max}"))),
    }
}

/// Refuses times that no view can have, and two selections of times at once.
fn check_times(data: &DataConfig) -> Result<(), TrainError> {
    let bad = |text: String| Err(TrainError::Config(text));
    if let Some(time) = data.only_times.iter().find(|time| !(0.0..=1.0).contains(*time)) {
        return bad(format!("data.only_times: {time} is not a time; each must be between 0 and 1"));
    }
    if !data.only_times.is_empty() && data.times > 0 {
        return bad(format!(
            "data.only_times and data.times = {} both choose times: give only one of them",
            data.times
        ));
    }
    Ok(())
}

/// Refuses keys that would have no effect, as they wait for opacity resets that never come, or an effect other than
/// stated.
fn check_densify(densify: &DensifyConfig) -> Result<(), TrainError> {
    let bad = |text: String| Err(TrainError::Config(text));
    if densify.every == 0 {
        return bad("densify.every = 0: at least 1; densify.mode = \"off\" adds none".into());
    }
    if densify.prune_every == 0 {
        return bad("densify.prune_every = 0: at least 1; densify.prune_opacity = 0 removes none".into());
    }
    let waits = [
        ("prune_size", densify.prune_size > 0.0, densify.prune_size),
        ("opacity_reset_until", densify.opacity_reset_until > 0, densify.opacity_reset_until as f64),
    ];
    if let Some((key, _, value)) = waits.into_iter().find(|(_, is_on, _)| *is_on && densify.opacity_reset == 0) {
        return bad(format!(
            "densify.{key} = {value}: has an effect only after an opacity reset; set densify.opacity_reset as well"
        ));
    }
    let DensifyConfig { opacity_reset: first, opacity_reset_until: last, .. } = *densify;
    if last > 0 && last < first {
        return bad(format!(
            "densify.opacity_reset_until = {last}: before densify.opacity_reset = {first}, which comes once all the same; \
             set it to 0 for one reset, or to a later step"
        ));
    }
    Ok(())
}

/// Refuses opacity resets that never come.
fn check_resets(config: &Config) -> Result<(), TrainError> {
    let (densify, warmup) = (&config.densify, config.stages.warmup_steps);
    let reset = densify.opacity_reset;
    let steps = warmup + config.stages.joint_steps;
    let text = if densify.opacity_reset_joint && reset == 0 {
        "densify.opacity_reset_joint = true: has an effect only with densify.opacity_reset; set that as well".to_owned()
    } else if !densify.opacity_reset_joint && reset > warmup {
        format!(
            "densify.opacity_reset = {reset}: never comes, as warm-up ends after stages.warmup_steps = {warmup}; set \
             densify.opacity_reset_joint to true, or densify.opacity_reset to 0"
        )
    } else if reset > 0 && reset >= steps {
        format!(
            "densify.opacity_reset = {reset}: never comes, as the run ends after {steps} steps, and none is made at its \
             end; set it below that, or to 0"
        )
    } else {
        return Ok(());
    };
    Err(TrainError::Config(text))
}

/// Describes the first number that is below 0, not finite (which JSON writes as null) or beyond single precision: no
/// key accepts any of these, but that settings of registered methods may be negative.
fn bad_number(value: &serde_json::Value, key: String) -> Option<String> {
    match value {
        serde_json::Value::Null => Some(format!("{key}: NaN or infinite; a finite number, 0 or above")),
        serde_json::Value::Number(n) => match n.as_f64() {
            Some(v) if v < 0.0 && !key.starts_with("method_settings.") => {
                Some(format!("{key} = {n}: a finite number, 0 or above"))
            }
            Some(v) if v > f64::from(f32::MAX) => Some(format!("{key} = {v:e}: too large, at most 3.4e38")),
            _ => None,
        },
        serde_json::Value::Array(items) => items.iter().find_map(|v| bad_number(v, key.clone())),
        serde_json::Value::Object(fields) => fields.iter().find_map(|(name, v)| {
            let dot = if key.is_empty() { "" } else { "." };
            bad_number(v, format!("{key}{dot}{name}"))
        }),
        _ => None,
    }
}

#[cfg(test)]
#[path = "check_tests.rs"]
mod tests;
