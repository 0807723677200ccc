//! Configuration of a run: types, layers, built-in presets.

pub mod layers;
pub mod types;

/// The presets that are compiled in, by name.
pub const PRESETS: &[(&str, &str)] = &[
    ("best", include_str!("../../configs/best.toml")),
    ("quick", include_str!("../../configs/quick.toml")),
    ("demo", include_str!("../../configs/demo.toml")),
    ("paper", include_str!("../../configs/paper.toml")),
    ("official", include_str!("../../configs/official.toml")),
];

/// `VOLSEGGS_*` variables that are not configuration keys; `*` stands for any end.
pub const RESERVED_VARIABLES: &[&str] = &[
    "VOLSEGGS_TEST_*",
    "VOLSEGGS_REQUIRE_*",
    "VOLSEGGS_FUZZ_*",
    "VOLSEGGS_CHAOS_*",
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
    fn variables_of_tests_and_kernels_are_no_keys() {
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
    fn keys_in_error_messages_are_keys() {
        let told = Layers::new(PRESETS).sets(["loss"]).resolve::<Config>().unwrap_err().to_string();
        let example = told.rsplit(' ').next().unwrap();
        Layers::new(PRESETS).sets([example]).resolve::<Config>().unwrap();
        let told = with_variable("VOLSEGGS_A____B").unwrap_err().to_string();
        assert_eq!(with_variable(told.rsplit(' ').next().unwrap()).unwrap().loss.dssim, 1.0, "{told}");
    }

    #[test]
    fn a_wrong_value_is_told_in_plain_words() {
        for (set, words) in [
            ("stages.joint_steps=-3", "expected a whole number, 0 or above, not -3"),
            ("loss.kind=l3", "there is no `l3`; there is l1 or l2"),
            ("model=3", "expected a section"),
            ("optim.betas=[0.9]", "expected a list of 2 values"),
        ] {
            let told = Layers::new(PRESETS).sets([set]).resolve::<Config>().unwrap_err().to_string();
            assert!(told.contains(words), "{told}");
            for jargon in ["invalid type", "usize", "struct ", "ModelConfig", "variant"] {
                assert!(!told.contains(jargon), "{told}");
            }
        }
    }
}
