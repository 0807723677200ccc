//! Configuration of a run: types, layers, built-in presets.

pub mod layers;
pub mod sections;
pub mod types;

use layers::{ConfigError, Layers};
use std::collections::BTreeMap;
use toml::{Table, Value};
use types::Config;

/// The compiled-in presets of this project's own method, by name; those of other methods come with them.
pub const PRESETS: &[(&str, &str)] = &[
    ("best", include_str!("../../../../configs/best.toml")),
    ("quick", include_str!("../../../../configs/quick.toml")),
    ("demo", include_str!("../../../../configs/demo.toml")),
    ("paper", include_str!("../../../../configs/paper.toml")),
    ("official", include_str!("../../../../configs/official.toml")),
    ("static", include_str!("../../../../configs/static.toml")),
];

/// The preset that is used where no configuration is given.
pub const PRESET_IF_NONE_GIVEN: &str = "best";

/// Returns the configuration of a built-in preset of this project's own method.
///
/// # Errors
/// [`ConfigError::NotFound`] if there is no such preset.
///
/// ```
/// let mut config = volseggs_core::config::preset("quick")?;
/// config.densify.budget = 20_000;
/// assert_eq!(config.method, "volseggs");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn preset(name: &str) -> Result<Config, ConfigError> {
    Ok(Layers::new(PRESETS).source(name).resolve()?.value)
}

/// A key's name without its section, unless another key of `among` has the same name.
pub fn short_key<'a>(key: &'a str, among: &[impl AsRef<str>]) -> &'a str {
    fn last(key: &str) -> &str {
        key.rsplit_once('.').map_or(key, |(_, name)| name)
    }
    let is_shared = among.iter().any(|other| other.as_ref() != key && last(other.as_ref()) == last(key));
    if is_shared { key } else { last(key) }
}

/// Flattens sections into dotted keys: `loss = { kind = "l1" }` and `"loss.kind" = "l1"` are equivalent.
pub fn flatten(table: &Table) -> BTreeMap<String, Value> {
    fn walk(prefix: &str, table: &Table, out: &mut BTreeMap<String, Value>) {
        for (key, value) in table {
            let name = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
            match value {
                Value::Table(inner) => walk(&name, inner, out),
                value => drop(out.insert(name, value.clone())),
            }
        }
    }
    let mut out = BTreeMap::new();
    walk("", table, &mut out);
    out
}

/// `VOLSEGGS_*` variables that are not configuration keys; a trailing `*` matches any suffix.
pub const RESERVED_VARIABLES: &[&str] = &[
    "VOLSEGGS_TEST_*",
    "VOLSEGGS_REQUIRE_*",
    "VOLSEGGS_FUZZ_*",
    "VOLSEGGS_CHAOS_*",
    "VOLSEGGS_VIEW_*",
    "VOLSEGGS_AXE",
    "VOLSEGGS_CACHE",
    "VOLSEGGS_SIMD",
    "VOLSEGGS_GPU_ATOMICS",
];

#[cfg(test)]
mod tests {
    use super::*;

    fn with_variable(name: &str) -> Result<Config, ConfigError> {
        let layers = Layers::new(PRESETS).env([(name.into(), "1".into())], RESERVED_VARIABLES)?;
        layers.resolve::<Config>().map(|found| found.value)
    }

    #[test]
    fn reserved_variables_are_not_keys() {
        for name in [
            "VOLSEGGS_TEST_SAM",
            "VOLSEGGS_TEST_OUT",
            "VOLSEGGS_REQUIRE_GPU",
            "VOLSEGGS_REQUIRE_ANY",
            "VOLSEGGS_FUZZ_CASES",
            "VOLSEGGS_SIMD",
        ] {
            assert_eq!(with_variable(name).unwrap(), Config::default(), "{name}");
        }
        assert_eq!(with_variable("VOLSEGGS_SEED").unwrap().seed, 1);
        for name in ["VOLSEGGS_TESTS", "VOLSEGGS_SIMD_", "VOLSEGGS_SEEED"] {
            assert!(matches!(with_variable(name), Err(ConfigError::UnknownKey { .. })), "{name}");
        }
    }

    #[test]
    fn the_defaults_are_the_method_of_the_paper() {
        assert_eq!(preset("paper").unwrap(), Config::default());
    }

    #[test]
    fn warm_up_of_shorter_presets_decays_over_their_own_length() {
        // the values that they were tuned and measured with
        for name in ["best", "quick", "demo", "../../configs/ablations/base-small.toml"] {
            let config = Layers::new(PRESETS).source(name).resolve::<Config>().unwrap().value;
            assert_eq!(config.optim.warmup_decay_steps, config.stages.joint_steps, "{name}");
        }
    }

    #[test]
    fn keys_in_error_messages_are_keys() {
        let message = Layers::new(PRESETS).sets(["loss"]).resolve::<Config>().unwrap_err().to_string();
        let example = message.rsplit(' ').next().unwrap();
        Layers::new(PRESETS).sets([example]).resolve::<Config>().unwrap();
        let message = with_variable("VOLSEGGS_A____B").unwrap_err().to_string();
        assert_eq!(with_variable(message.rsplit(' ').next().unwrap()).unwrap().loss.dssim, 1.0, "{message}");
    }

    #[test]
    fn a_wrong_value_is_reported_in_plain_words() {
        for (set, words) in [
            ("stages.joint_steps=-3", "expected a whole number, 0 or above, not -3"),
            ("loss.kind=l3", "there is no `l3`; available: l1 or l2"),
            ("model=3", "expected a section"),
            ("optim.betas=[0.9]", "expected a list of 2 values"),
        ] {
            let message = Layers::new(PRESETS).sets([set]).resolve::<Config>().unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
            for jargon in ["invalid type", "usize", "struct ", "ModelConfig", "variant"] {
                assert!(!message.contains(jargon), "{message}");
            }
        }
    }
}
