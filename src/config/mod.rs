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

/// `VOLSEGGS_*` variables that are not configuration keys.
pub const RESERVED_VARIABLES: &[&str] = &[
    "VOLSEGGS_TEST_DATA",
    "VOLSEGGS_REQUIRE_GPU",
    "VOLSEGGS_REQUIRE_SLURM",
    "VOLSEGGS_CACHE",
    "VOLSEGGS_SIMD",
    "VOLSEGGS_GPU_ATOMICS",
];
