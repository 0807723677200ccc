//! What a configuration must hold before training may start, beyond its types.

use super::{TrainError, losses, schedule};
use crate::config::types::{Config, EncoderKind};
use crate::extend::find_schedule;
use crate::model::extra_encoder::ExtraEncoder;
use burn::tensor::Device;

/// What lies behind the Gaussians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Background {
    /// Always this colour.
    Fixed([f32; 3]),
    /// A new colour each step.
    Random,
}

/// The background colour that `data.background` names; white in evaluation where it is `random`.
///
/// # Errors
/// If it is none of the known forms.
pub fn evaluation_background(text: &str) -> Result<[f32; 3], TrainError> {
    match parse_background(text)? {
        Background::Fixed(colour) => Ok(colour),
        Background::Random => Ok([1.0; 3]),
    }
}

pub(super) fn parse_background(text: &str) -> Result<Background, TrainError> {
    let hex = |s: &str| -> Option<[f32; 3]> {
        let s = s.strip_prefix('#').filter(|s| s.len() == 6 && s.is_ascii())?;
        let byte = |k: usize| u8::from_str_radix(&s[2 * k..2 * k + 2], 16).ok().map(|b| f32::from(b) / 255.0);
        Some([byte(0)?, byte(1)?, byte(2)?])
    };
    match text {
        "white" => Ok(Background::Fixed([1.0; 3])),
        "black" => Ok(Background::Fixed([0.0; 3])),
        "random" => Ok(Background::Random),
        other => hex(other).map(Background::Fixed).ok_or_else(|| {
            TrainError::Config(format!("data.background = \"{other}\": use white, black, random or #rrggbb"))
        }),
    }
}

/// Refuses a run whose largest buffers the device cannot bind; says nothing of devices in host memory.
pub(super) fn check_device(
    config: &Config,
    start: usize,
    images: [usize; 2],
    device: &Device,
) -> Result<(), TrainError> {
    let Some(limit) = crate::device::largest_buffer(device) else { return Ok(()) };
    let n = config.densify.budget.max(start) as u64;
    let pixels = (images[0] * images[1]) as u64;
    let m = &config.model;
    let needs = [
        ("spherical harmonics of densify.budget Gaussians", n * 4 * 3 * (m.sh_degree as u64 + 1).pow(2)),
        ("hidden layers of the decoder for densify.budget Gaussians", n * 4 * 4 * m.width as u64),
        ("statistics of DSSIM at this image size", pixels * 4 * 15),
    ];
    let (what, bytes) = needs.into_iter().max_by_key(|(_, bytes)| *bytes).unwrap_or_default();
    if bytes > limit {
        return Err(TrainError::Config(format!(
            "the {what} take {} MB in one buffer, this GPU binds {} MB at most: fewer Gaussians, a smaller model or \
             smaller images, or --device flex",
            bytes / 1_000_000,
            limit / 1_000_000
        )));
    }
    Ok(())
}

/// Refuses values that no training can start with.
///
/// # Errors
/// The first such value, by its key.
pub fn check(config: &Config) -> Result<(), TrainError> {
    let bad = |text: String| Err(TrainError::Config(text));
    if config.model.sh_degree > 3 {
        return bad(format!("model.sh_degree = {}: at most 3", config.model.sh_degree));
    }
    if config.init.points == 0 {
        return bad("init.points = 0: at least 1".into());
    }
    if !(config.init.opacity > 0.0 && config.init.opacity < 1.0) {
        return bad(format!("init.opacity = {}: between 0 and 1", config.init.opacity));
    }
    let m = &config.model;
    for (name, value) in [
        ("levels", m.levels),
        ("channels", m.channels),
        ("time_knots", m.time_knots),
        ("width", m.width),
        ("resolution", m.resolution),
    ] {
        if value == 0 {
            return bad(format!("model.{name} = 0: at least 1"));
        }
    }
    let whole = serde_json::to_value(config).map_err(|e| TrainError::Config(e.to_string()))?;
    if let Some(key) = not_a_rate(&whole, String::new()) {
        return bad(format!("{key}: a finite number, 0 or above"));
    }
    if config.speed.coarse_factor == 0 {
        return bad("speed.coarse_factor = 0: at least 1".into());
    }
    if config.speed.cull_visits > 1 && config.model.encoder != EncoderKind::Factorised {
        return bad(format!(
            "speed.cull_visits = {}: only with model.encoder = \"factorised\"",
            config.speed.cull_visits
        ));
    }
    if config.stages.warmup_steps + config.stages.joint_steps == 0 {
        return bad("stages.warmup_steps and stages.joint_steps are both 0: nothing to train".into());
    }
    check_registered(config)
}

/// Refuses names of registered things that are not there, before hours of training and not after them.
fn check_registered(config: &Config) -> Result<(), TrainError> {
    let bad = |text: String| Err(TrainError::Config(text));
    if let Err(error) = losses::ExtraTerms::new(&config.loss) {
        return bad(format!("loss.extra: {error}"));
    }
    let (model, name) = (&config.model, &config.optim.schedule);
    if model.encoder == EncoderKind::Extra {
        ExtraEncoder::check(model).or_else(|error| bad(error.to_string()))?;
    } else if !model.extra_encoder.is_empty() {
        return bad(format!("model.extra_encoder = \"{}\": only with model.encoder = \"extra\"", model.extra_encoder));
    }
    if let (Err(error), false) = (find_schedule(name), schedule::SCHEDULES.contains(&name.as_str())) {
        return bad(format!("optim.schedule: {error}; built in: {}", schedule::SCHEDULES.join(", ")));
    }
    let factors = (0..=100).map(|k| schedule::fall(&config.optim, f64::from(k) / 100.0));
    match factors.into_iter().find(|f| !(f.is_finite() && *f >= 0.0)) {
        Some(factor) => bad(format!("optim.schedule = \"{name}\" gives a factor of {factor}: finite, 0 or above")),
        None => Ok(()),
    }
}

/// The first number below 0 or not finite (which JSON writes as null): no key takes either.
fn not_a_rate(value: &serde_json::Value, key: String) -> Option<String> {
    match value {
        serde_json::Value::Null => Some(key),
        serde_json::Value::Number(n) => n.as_f64().is_none_or(|v| v < 0.0).then_some(key),
        serde_json::Value::Array(items) => items.iter().find_map(|v| not_a_rate(v, key.clone())),
        serde_json::Value::Object(fields) => fields.iter().find_map(|(name, v)| {
            let dot = if key.is_empty() { "" } else { "." };
            not_a_rate(v, format!("{key}{dot}{name}"))
        }),
        _ => None,
    }
}
