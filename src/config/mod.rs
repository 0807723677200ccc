//! Configuration of a run: types, layers, built-in presets.

pub mod layers;
pub mod legacy;
pub mod types;

/// The compiled-in presets, by name.
pub const PRESETS: &[(&str, &str)] = &[
    ("best", include_str!("../../configs/best.toml")),
    ("quick", include_str!("../../configs/quick.toml")),
    ("demo", include_str!("../../configs/demo.toml")),
    ("paper", include_str!("../../configs/paper.toml")),
    ("official", include_str!("../../configs/official.toml")),
    ("static", include_str!("../../configs/static.toml")),
    ("d3dgs", include_str!("../../configs/methods/d3dgs.toml")),
    ("d3dgs-small", include_str!("../../configs/methods/d3dgs-small.toml")),
    ("coordnet", include_str!("../../configs/methods/coordnet.toml")),
    ("coordnet-small", include_str!("../../configs/methods/coordnet-small.toml")),
    ("insitunet", include_str!("../../configs/methods/insitunet.toml")),
    ("insitunet-small", include_str!("../../configs/methods/insitunet-small.toml")),
    ("visnerf", include_str!("../../configs/methods/visnerf.toml")),
    ("visnerf-small", include_str!("../../configs/methods/visnerf-small.toml")),
    ("4dgs", include_str!("../../configs/methods/4dgs.toml")),
    ("4dgs-small", include_str!("../../configs/methods/4dgs-small.toml")),
];

/// A key's name without its section, unless another key of `among` has the same name.
#[must_use]
pub fn short_key<'a>(key: &'a str, among: &[impl AsRef<str>]) -> &'a str {
    fn last(key: &str) -> &str {
        key.rsplit_once('.').map_or(key, |(_, name)| name)
    }
    let is_shared = among.iter().any(|other| other.as_ref() != key && last(other.as_ref()) == last(key));
    if is_shared { key } else { last(key) }
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
    use crate::config::layers::{ConfigError, Layers};
    use crate::config::types::Config;

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
    fn presets_of_published_methods_state_every_key() {
        let defaults = toml::Table::try_from(Config::default()).unwrap();
        let keys = |table: &toml::Table| table.keys().cloned().collect::<std::collections::BTreeSet<_>>();
        // these presets do not set the method
        let sections: Vec<_> = keys(&defaults)
            .into_iter()
            .filter(|k| !["seed", "method", "output", "segment"].contains(&k.as_str()))
            .collect();
        for name in ["paper", "official", "static"] {
            let (_, text) = PRESETS.iter().find(|(preset, _)| *preset == name).unwrap();
            let file: toml::Table = text.parse().unwrap();
            assert_eq!(keys(&file).into_iter().collect::<Vec<_>>(), sections, "{name}: sections");
            for section in &sections {
                let of = |table: &toml::Table| keys(table[section].as_table().unwrap());
                assert_eq!(of(&file), of(&defaults), "{name}: [{section}] must state each of its keys");
            }
        }
    }

    #[test]
    fn presets_of_other_methods_state_every_key_they_read() {
        let defaults = toml::Table::try_from(Config::default()).unwrap();
        let keys = |table: &toml::Table| table.keys().cloned().collect::<std::collections::BTreeSet<_>>();
        let of = |name: &str| -> toml::Table { PRESETS.iter().find(|(n, _)| *n == name).unwrap().1.parse().unwrap() };
        let published = [
            ("d3dgs", toml::Table::try_from(types::methods::D3dgsConfig::default()).unwrap()),
            ("4dgs", toml::Table::try_from(types::methods::FourDgsConfig::default()).unwrap()),
        ];
        for (name, settings) in published {
            let preset = of(name);
            for section in ["data", "init", "stages", "loss", "optim", "densify", "speed"] {
                let of = |table: &toml::Table| keys(table[section].as_table().unwrap());
                assert_eq!(of(&preset), of(&defaults), "{name}: [{section}] must state each key");
            }
            assert_eq!(preset[name].as_table(), Some(&settings), "the defaults are the published settings");
            assert!(
                preset["model"].get("bounds").is_some() && preset["model"].get("bounds_margin").is_some(),
                "{name}"
            );
            let small = Layers::new(PRESETS).source(format!("{name}-small")).resolve::<Config>().unwrap().value;
            assert_eq!((small.method.as_str(), small.loss.kind), (name, types::LossKind::L1));
        }
    }

    #[test]
    fn warm_up_of_shorter_presets_decays_over_their_own_length() {
        // the values that they were tuned and measured with
        for name in ["best", "quick", "demo", "configs/ablations/base-small.toml"] {
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
