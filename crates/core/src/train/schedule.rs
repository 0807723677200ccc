//! What depends on the step alone: the stage, learning rates, the spherical-harmonics degree, the view.

use super::rate_schedule::find_schedule;
use crate::config::types::{Config, DecayOver, OptimConfig, ShBands, ViewOrder};
use crate::model::appearance::MATERIAL_NAME;
use crate::rng::{Purpose, Rng};

/// A stage and the number of the step within it, from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Canonical Gaussians alone.
    Warmup(usize),
    /// Gaussians and deformation field.
    Joint(usize),
}

impl Stage {
    /// The stage of global step `step`, from 0.
    pub fn from_step(step: usize, config: &Config) -> Self {
        let warmup = config.stages.warmup_steps;
        if step < warmup { Self::Warmup(step) } else { Self::Joint(step - warmup) }
    }

    /// The spherical-harmonics degree in use: one band higher every `stages.sh_every` steps of the run, up to the
    /// maximum.
    pub fn sh_degree(self, config: &Config) -> usize {
        let (every, most) = (config.stages.sh_every, config.model.sh_degree);
        let step = match config.model.sh_bands {
            ShBands::All => 1,
            ShBands::Even => 2,
        };
        self.step_of_run(config).checked_div(every).map_or(most, |bands| (step * bands).min(most))
    }

    /// Progress of the learning rates in [0, 1]: over `optim.warmup_decay_steps` in warm-up, over the whole stage in
    /// the joint stage. As in the reference code, the rates start over with the joint stage; with `optim.decay_over =
    /// "run"` they fall once over both, as in 3DGS.
    pub fn progress(self, config: &Config) -> f64 {
        let stages = &config.stages;
        let (done, steps) = match self {
            _ if config.optim.decay_over == DecayOver::Run => {
                (self.step_of_run(config), stages.warmup_steps + stages.joint_steps)
            }
            Self::Warmup(s) => (s, config.optim.warmup_decay_steps),
            Self::Joint(s) => (s, stages.joint_steps),
        };
        (done as f64 / steps.max(1) as f64).min(1.0)
    }

    /// The step of the whole run, from 0.
    pub fn step_of_run(self, config: &Config) -> usize {
        match self {
            Self::Warmup(s) => s,
            Self::Joint(s) => s + config.stages.warmup_steps,
        }
    }

    /// Its name in logs.
    pub fn name(self) -> &'static str {
        if self.is_joint() { "joint" } else { "warmup" }
    }

    /// Whether this is the joint stage.
    pub fn is_joint(self) -> bool {
        matches!(self, Self::Joint(_))
    }
}

/// Returns the factor applied to the rates of means, encoder, decoder and embedding at `progress` in [0, 1]: that of the
/// schedule `optim.schedule`, whose name has been checked.
pub fn decay(config: &OptimConfig, progress: f64) -> f64 {
    find_schedule(&config.schedule).map_or(1.0, |schedule| schedule.factor(progress, config))
}

/// Returns the learning rate of a parameter by its name, `None` if it is not trained in this stage.
pub fn learning_rate(name: &str, stage: Stage, config: &Config, extent: f64) -> Option<f64> {
    let OptimConfig {
        means, rotations, log_scales, opacity, sh, normals, material, encoder, decoder, embedding, ..
    } = config.optim;
    let decayed = |rate: f64| rate * decay(&config.optim, stage.progress(config));
    // in warm-up before a joint stage with its own decay, these rates stay constant
    let falls = stage.is_joint() || config.stages.joint_steps == 0 || config.optim.decay_over == DecayOver::Run;
    let attribute = |rate: f64| {
        if falls { rate * config.optim.attributes_final_fraction.powf(stage.progress(config)) } else { rate }
    };
    match name {
        "gaussians.means" => Some(decayed(means * extent)),
        "gaussians.rotations" => Some(attribute(rotations)),
        "gaussians.log_scales" => Some(attribute(log_scales)),
        "gaussians.opacity_logits" => Some(attribute(opacity)),
        "gaussians.sh" => Some(attribute(sh)),
        "gaussians.headlight.normals" => Some(attribute(normals)),
        MATERIAL_NAME => Some(attribute(material)),
        _ if !stage.is_joint() => None,
        "gaussians.embedding" => Some(decayed(embedding)),
        _ if name.starts_with("field.encoder") => Some(decayed(encoder)),
        _ => Some(decayed(decoder)),
    }
}

/// Returns the training view of a step, as `data.order` specifies: every view once per round, shuffled anew each round,
/// or any view at any step.
pub fn view(config: &Config, step: usize, views: usize) -> usize {
    let rng = |key: usize| Rng::new(config.seed, key as u64, Purpose::Views);
    match config.data.order {
        ViewOrder::Independent => rng(step).below(views),
        ViewOrder::Shuffled => {
            let (round, place) = (step / views, step % views);
            let mut order: Vec<usize> = (0..views).collect();
            rng(round).shuffle(&mut order);
            order[place]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::preset;

    #[test]
    fn every_view_is_seen_once_a_round() {
        let config = Config { seed: 7, ..preset("best").unwrap() };
        let mut seen: Vec<usize> = (0..30).map(|s| view(&config, s, 30)).collect();
        let second: Vec<usize> = (30..60).map(|s| view(&config, s, 30)).collect();
        assert_ne!(seen, second);
        seen.sort_unstable();
        assert_eq!(seen, (0..30).collect::<Vec<_>>());
    }

    #[test]
    fn independent_views_come_with_replacement_and_all_alike() {
        let mut config = preset("best").unwrap();
        config.data.order = ViewOrder::Independent;
        let mut counts = [0; 30];
        (0..3000).for_each(|s| counts[view(&config, s, 30)] += 1);
        assert!(counts.iter().all(|n| (60..150).contains(n)), "{counts:?}");
        let first: std::collections::BTreeSet<usize> = (0..30).map(|s| view(&config, s, 30)).collect();
        assert!(first.len() < 30, "30 draws without a repetition");
        assert_eq!(view(&config, 12, 30), view(&config, 12, 30));
    }

    /// A joint stage of 20,000 steps, and rates that end at a hundredth.
    fn to_a_hundredth() -> Config {
        let mut config = preset("best").unwrap();
        (config.stages.joint_steps, config.optim.warmup_decay_steps) = (20_000, 20_000);
        config.optim.final_fraction = 0.01;
        config
    }

    #[test]
    fn the_means_rate_in_warm_up_does_not_depend_on_the_joint_stage() {
        let mut config = to_a_hundredth();
        let rate = |step: usize, config: &Config| {
            let rate = |stage| learning_rate("gaussians.means", stage, config, 1.0).unwrap();
            rate(Stage::Warmup(step)) / rate(Stage::Warmup(0))
        };
        for joint_steps in [0, 5000, 20_000, 30_000] {
            config.stages.joint_steps = joint_steps;
            assert!((rate(2000, &config) - 0.01f64.powf(0.1)).abs() < 1e-12, "{joint_steps}");
        }
        (config.stages.warmup_steps, config.optim.warmup_decay_steps) = (30_000, 30_000);
        assert!((rate(15_000, &config) - 0.1).abs() < 1e-12 && (rate(30_000, &config) - 0.01).abs() < 1e-12);
    }

    #[test]
    fn rates_may_fall_once_over_the_whole_run() {
        let mut config = to_a_hundredth();
        (config.stages.warmup_steps, config.stages.joint_steps) = (3000, 27_000);
        config.optim.decay_over = DecayOver::Run;
        let rate = |name, stage| learning_rate(name, stage, &config, 1.0).unwrap();
        let start = rate("gaussians.means", Stage::Warmup(0));
        for (stage, progress) in [(Stage::Warmup(1500), 0.05), (Stage::Joint(0), 0.1), (Stage::Joint(12_000), 0.5)] {
            assert!((rate("gaussians.means", stage) / start - 0.01f64.powf(progress)).abs() < 1e-12, "{stage:?}");
        }
        // the network's rate starts at the schedule's value at that step, as in the published code of D3DGS
        let network = rate("field.encoder.D3dgs.output.weight", Stage::Joint(0));
        assert!((network / config.optim.encoder - 0.01f64.powf(0.1)).abs() < 1e-12);
        // and the attributes' rates follow it too
        config.optim.attributes_final_fraction = 0.01;
        let rate = |name, stage| learning_rate(name, stage, &config, 1.0).unwrap();
        let fallen =
            rate("gaussians.opacity_logits", Stage::Warmup(1500)) / rate("gaussians.opacity_logits", Stage::Warmup(0));
        assert!((fallen - 0.01f64.powf(0.05)).abs() < 1e-12, "{fallen}");
    }

    #[test]
    fn rates_fall_log_linearly_and_the_field_waits_for_the_joint_stage() {
        let config = to_a_hundredth();
        let rate = |name, stage| learning_rate(name, stage, &config, 4.0);
        assert_eq!(rate("field.encoder.Factorised.planes", Stage::Warmup(3)), None);
        let start = rate("gaussians.means", Stage::Joint(0)).unwrap();
        let middle = rate("gaussians.means", Stage::Joint(10_000)).unwrap();
        assert!((start - 6.4e-4).abs() < 1e-9 && (middle / start - 0.1).abs() < 1e-9);
    }
}
