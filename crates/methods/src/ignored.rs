//! Settings of the shared sections that a method does not read: they are refused, as two runs that differ
//! in nothing else would be compared as if they differed.

use toml::Value;
use volseggs_core::config::types::{Config, ViewOrder};

/// The shared sections that methods without Gaussians do not read: of the shared ones they read `[data]` and `[output]`.
const OF_GAUSSIANS: [&str; 7] = ["init", "model", "stages", "loss", "optim", "densify", "speed"];
/// Keys of the field, which other methods with Gaussians lack. Its encoder, embedding and regularisers are refused by
/// the methods themselves.
const OF_THE_FIELD: [&str; 16] = [
    "levels",
    "resolution",
    "time_knots",
    "time_curve",
    "channels",
    "width",
    "decoder",
    "zero_init_heads",
    "bias_init",
    "grid_init",
    "time_range",
    "implicit_width",
    "implicit_depth",
    "implicit_octaves",
    "implicit_time_octaves",
    "implicit_skip",
];

/// Rejects settings of Gaussians, and those of `[data]` that a network does not follow, unless they are the defaults; for a
/// method that is a network without Gaussians.
///
/// # Errors
/// The first such key with its value, and what to do.
pub fn without_gaussians(config: &Config) -> Result<(), String> {
    let method = config.method.as_str();
    if config.data.background == "random" {
        return Err(format!("data.background = \"random\": {method} needs one colour; set white, black or a colour"));
    }
    if config.data.order != ViewOrder::Shuffled {
        return Err(format!("data.order: {method} draws views in its own way; remove the key"));
    }
    let changed = Changed::of(config);
    let found = OF_GAUSSIANS.iter().find_map(|section| changed.first(section, |_| true));
    let why = format!("has no Gaussians and reads [{method}], [data] and [output] only");
    found.map_or(Ok(()), |key| Err(refusal(&key, method, &why)))
}

/// Rejects settings of the field, unless they are the defaults; for a method with Gaussians and something else in its place.
///
/// # Errors
/// The first such key with its value, and what to do.
pub fn without_field(config: &Config) -> Result<(), String> {
    let found = Changed::of(config).first("model", |key| OF_THE_FIELD.contains(&key));
    found.map_or(Ok(()), |key| Err(refusal(&key, &config.method, "has no such field")))
}

fn refusal(key: &str, method: &str, why: &str) -> String {
    format!(
        "{key}: {method} {why}; remove the key, or start from the preset {method} instead of that of another method"
    )
}

/// A configuration beside the default one.
struct Changed {
    given: Option<Value>,
    default: Option<Value>,
}

impl Changed {
    fn of(config: &Config) -> Self {
        let [given, default] = [config, &Config::default()].map(|config| Value::try_from(config).ok());
        Self { given, default }
    }

    /// The first key of a section that counts and is not the default, with its value.
    fn first(&self, section: &str, counts: impl Fn(&str) -> bool) -> Option<String> {
        let of = |all: &Option<Value>| all.as_ref().and_then(|all| all.get(section)).and_then(Value::as_table).cloned();
        let (given, default) = (of(&self.given)?, of(&self.default)?);
        let found = given.iter().find(|(key, value)| counts(key) && default.get(*key) != Some(value));
        found.map(|(key, value)| format!("{section}.{key} = {value}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::visnerf::VisNerfConfig;
    use crate::{check, layers};

    /// Methods without Gaussians.
    const NETWORKS: [&str; 3] = ["coordnet", "insitunet", "visnerf"];

    fn config(preset: &str, set: &str) -> Config {
        layers().source(preset).sets([set.to_owned()]).resolve::<Config>().unwrap().value
    }

    #[test]
    fn what_the_method_does_not_read_is_refused() {
        let of_networks = [
            ("loss.dssim=0.5", "loss.dssim = 0.5"),
            ("optim.average=70", "optim.average = 70"),
            ("stages.joint_steps=40000", "stages.joint_steps = 40000"),
            ("data.background=random", "data.background"),
            ("data.order=independent", "data.order"),
        ];
        let of_the_field = [("model.resolution=32", "model.resolution = 32"), ("model.width=8", "model.width = 8")];
        let networks = NETWORKS.iter().flat_map(|method| of_networks.map(|(set, key)| (*method, set, key)));
        let others = ["d3dgs", "4dgs"].into_iter().flat_map(|method| of_the_field.map(|(set, key)| (method, set, key)));
        for (method, set, key) in networks.chain(others) {
            let config = config(method, set);
            let error = check(&config).unwrap_err().to_string();
            assert!(error.contains(key) && error.contains(method), "{error}");
        }
        for method in NETWORKS.into_iter().chain(["d3dgs", "4dgs", "volseggs"]) {
            let preset = if method == "volseggs" { "best" } else { method };
            check(&config(preset, "output.eval_every=100")).unwrap();
            check(&config(preset, "data.downscale=2")).unwrap();
        }
    }

    #[test]
    fn the_preset_of_another_method_is_refused() {
        let mut quick = config("quick", "seed=1");
        quick.method = "visnerf".into();
        quick.sections.set(&VisNerfConfig::default());
        assert!(check(&quick).unwrap_err().to_string().contains("reads [visnerf]"));
    }
}
