//! Checks whether a training fits into memory before anything is allocated for it: a failed allocation ends the
//! program. The sizes are counted from the configuration; what kernels need in addition is estimated.

use super::TrainError;
use super::densify::rule_of;
use crate::config::types::{Config, D3dgsConfig};
use crate::data::Split;
use crate::memory::MemoryBudget;
use crate::model::size::ModelSizes;

/// Bytes per value.
const VALUE: u128 = 4;
/// Copies of each parameter in a step: itself, its gradient, two moments and one temporary.
const COPIES: u128 = 5;
/// Copies of each Gaussian's attributes while Gaussians are added and removed: on the device, on the host, old and new.
const COPIES_MOVED: u128 = 7;
/// Additional copies of both with a moving average: the average and one temporary.
const COPIES_AVERAGED: u128 = 2;
/// Values per Gaussian in a step besides attributes, features and hidden layers: outputs, projections, tile entries.
const VALUES_DRAWN: u128 = 60;
/// Values per pixel in a step: target, image, gradients, and the statistics of DSSIM.
const VALUES_PIXEL: u128 = 60;
/// Maximum number of entries in a view's table while the visual hull is carved.
const HULL_TABLE: u128 = 257 * 257;

/// Size of the training images.
#[derive(Clone, Copy, Debug)]
pub struct ViewSizes {
    /// Number of images.
    pub count: usize,
    /// Pixels per image.
    pub pixels: usize,
}

impl ViewSizes {
    /// Returns those of a split.
    pub fn from_split(split: &Split) -> Self {
        let (width, height) = (split.images.width as usize, split.images.height as usize);
        Self { count: split.frames.len(), pixels: width.saturating_mul(height) }
    }
}

/// Refuses a training of a model of these `sizes` that needs more memory than `budget`; `on_gpu`, only the tensors' copies on the host count.
///
/// # Errors
/// If the memory does not suffice, naming the key that needs most of it, with its value.
pub fn check_memory(
    config: &Config,
    sizes: fn(&Config) -> ModelSizes,
    views: ViewSizes,
    on_gpu: bool,
    budget: MemoryBudget,
) -> Result<(), TrainError> {
    let need = |config: &Config| needed(config, sizes(config), views, on_gpu);
    let bytes = need(config);
    budget.check(largest(config, need), bytes).map_err(|e| TrainError::Config(e.to_string()))
}

/// Returns the sizes of the scene that [`super::Trainer`] trains.
pub fn scene_sizes(config: &Config) -> ModelSizes {
    let network = config.sections.get::<D3dgsConfig>().ok().flatten();
    ModelSizes::of_scene(&config.model, network.as_ref())
}

/// Returns the bytes at the peak of a training, excluding the images themselves.
fn needed(config: &Config, sizes: ModelSizes, views: ViewSizes, on_gpu: bool) -> u128 {
    let (n, count) = (max_gaussians(config), views.count as u128);
    let ModelSizes { attributes, parameters, kept, .. } = sizes;
    let pixels = views.pixels as u128;
    let averaged = if config.optim.average > 0 { COPIES_AVERAGED } else { 0 };
    let (each, copies, shown) = if on_gpu {
        (attributes.saturating_mul(3 + averaged / 2), 2 + averaged / 2, 16)
    } else {
        let step = attributes.saturating_mul(COPIES - 1 + averaged).saturating_add(kept);
        let step = step.saturating_add(VALUES_DRAWN);
        (step.max(attributes.saturating_mul(COPIES_MOVED + averaged)), COPIES + averaged, VALUES_PIXEL)
    };
    let hull = count.saturating_mul(pixels / 8 + pixels.min(HULL_TABLE).saturating_mul(VALUE));
    let reduced = pixels / u128::from(config.speed.coarse_factor.max(1)).pow(2);
    let reduced = if config.speed.coarse_steps > 0 { count.saturating_mul(reduced).saturating_mul(4) } else { 0 };
    let values = n.saturating_mul(each).saturating_add(parameters.saturating_mul(copies));
    let values = values.saturating_add(pixels.saturating_mul(shown));
    values.saturating_mul(VALUE).saturating_add(hull.max(reduced))
}

/// Returns the maximum number of Gaussians during a training.
pub fn max_gaussians(config: &Config) -> u128 {
    rule_of(config).max_gaussians(config)
}

/// A key and an accessor of its value.
type BudgetKey = (&'static str, fn(&mut Config) -> &mut usize);

/// The keys that determine the sizes.
const KEYS: [BudgetKey; 13] = [
    ("init.points", |c| &mut c.init.points),
    ("densify.budget", |c| &mut c.densify.budget),
    ("densify.warmup_budget", |c| &mut c.densify.warmup_budget),
    ("model.levels", |c| &mut c.model.levels),
    ("model.resolution", |c| &mut c.model.resolution),
    ("model.time_knots", |c| &mut c.model.time_knots),
    ("model.channels", |c| &mut c.model.channels),
    ("model.embedding", |c| &mut c.model.embedding),
    ("model.width", |c| &mut c.model.width),
    ("model.implicit_octaves", |c| &mut c.model.implicit_octaves),
    ("model.implicit_time_octaves", |c| &mut c.model.implicit_time_octaves),
    ("model.implicit_width", |c| &mut c.model.implicit_width),
    ("model.implicit_depth", |c| &mut c.model.implicit_depth),
];

/// Returns the key, with its value, whose return to its default would save most; the number of Gaussians if none would.
fn largest(config: &Config, need: impl Fn(&Config) -> u128) -> String {
    let mut defaults = Config::default();
    let saved = |(name, place): &BudgetKey| {
        let (mut other, default) = (config.clone(), *place(&mut defaults));
        let value = *place(&mut other);
        *place(&mut other) = value.min(default);
        (need(&other), format!("{name} = {value}"))
    };
    let best = KEYS.iter().map(saved).min_by_key(|(bytes, _)| *bytes);
    match best {
        Some((bytes, key)) if bytes < need(config) => key,
        _ if !rule_of(config).adds() || config.init.points > config.densify.budget => {
            format!("init.points = {}", config.init.points)
        }
        _ => format!("densify.budget = {}", config.densify.budget),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::preset;

    const VIEWS: ViewSizes = ViewSizes { count: 100, pixels: 400 * 400 };

    fn needed_by(config: &Config, on_gpu: bool) -> u128 {
        needed(config, scene_sizes(config), VIEWS, on_gpu)
    }

    fn refusal(config: &Config, on_gpu: bool) -> String {
        check_memory(config, scene_sizes, VIEWS, on_gpu, MemoryBudget::from_bytes(8_000_000_000))
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn the_default_fits_where_it_runs() {
        let bytes = needed_by(&preset("best").unwrap(), false);
        assert!((300_000_000..2_000_000_000).contains(&bytes), "{bytes}");
        check_memory(&preset("best").unwrap(), scene_sizes, VIEWS, false, MemoryBudget::from_bytes(2_000_000_000))
            .unwrap();
        assert!(needed_by(&preset("best").unwrap(), true) < bytes / 3);
    }

    #[test]
    fn the_key_that_needs_most_memory_is_named() {
        type Huge = fn(&mut Config);
        let cases: [(Huge, &str); 11] = [
            (|c| c.init.points = 2_000_000_000, "init.points = 2000000000"),
            (|c| c.densify.warmup_budget = 1_000_000_000_000, "densify.warmup_budget = 1000000000000"),
            (|c| c.densify.budget = 1_000_000_000_000, "densify.budget = 1000000000000"),
            (|c| c.model.resolution = 20_000, "model.resolution = 20000"),
            (|c| c.model.levels = 60, "model.levels = 60"),
            (|c| c.model.time_knots = 1_000_000_000, "model.time_knots = 1000000000"),
            (|c| c.model.channels = 1_000_000, "model.channels = 1000000"),
            (|c| c.model.width = 1_000_000, "model.width = 1000000"),
            (|c| c.model.embedding = 1_000_000, "model.embedding = 1000000"),
            (|c| (c.model.encoder, c.model.width) = ("implicit".into(), 1_000_000), "model.width = 1000000"),
            (
                |c| (c.model.encoder, c.model.implicit_width) = ("implicit".into(), 1_000_000),
                "model.implicit_width = 1000000",
            ),
        ];
        for (huge, key) in cases {
            let mut config = preset("best").unwrap();
            huge(&mut config);
            let text = refusal(&config, false);
            assert!(text.contains(key) && text.contains("needs about") && text.contains("--memory"), "{text}");
            // tensors on a GPU pass through the host as well
            assert!(refusal(&config, true).contains(key));
        }
    }

    #[test]
    fn hidden_layers_of_the_implicit_encoder_count() {
        let mut config = preset("best").unwrap();
        config.densify.budget = 150_000;
        let before = needed_by(&config, false);
        config.model.encoder = "implicit".into();
        // 150,000 Gaussians keep 3,992 values each; the grid's two million parameters are gone
        let more = needed_by(&config, false) - before;
        assert!((2_300_000_000..2_500_000_000).contains(&more), "{more}");
        (config.model.implicit_depth, config.densify.budget) = (64, 300_000);
        assert!(refusal(&config, false).contains("model.implicit_depth = 64"), "{}", refusal(&config, false));
    }

    #[test]
    fn sizes_beyond_all_bounds_do_not_overflow() {
        let mut config = preset("best").unwrap();
        for (_, place) in KEYS {
            *place(&mut config) = usize::MAX;
        }
        config.speed.coarse_steps = 1;
        config.model.sh_degree = usize::MAX;
        let views = ViewSizes { count: usize::MAX, pixels: usize::MAX };
        assert!(check_memory(&config, scene_sizes, views, false, MemoryBudget::from_bytes(u64::MAX)).is_err());
    }

    #[test]
    fn an_unreachable_gaussian_budget_takes_no_memory() {
        let mut config = preset("best").unwrap();
        (config.init.points, config.densify.budget) = (300, 1_000_000_000_000);
        (config.stages.warmup_steps, config.stages.joint_steps) = (0, 1000);
        assert!(max_gaussians(&config) < 300 << 8);
        config.densify.mode = "relocate".into();
        assert_eq!(max_gaussians(&config), 1_000_000_000_000, "one Gaussian may have many copies");
        config.densify.mode = "off".into();
        assert_eq!(max_gaussians(&config), 300);
    }
}
