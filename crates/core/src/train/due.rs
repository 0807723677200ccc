//! When Gaussians are added, removed and reset: what is due after a step, determined by the step alone.
//!
//! It is applied when the next step begins. What follows a step, such as an evaluation, a checkpoint or the end of the
//! run, thus sees Gaussians that have been trained since, not copies that still overlap or opacities just reset.

use super::densify::rule_of;
use super::schedule::Stage;
use crate::config::types::Config;
use crate::model::params::HostTensor;
use std::collections::BTreeMap;

/// What is due at a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DueChanges {
    /// Number of Gaussians to grow to; `None` if none are added now.
    pub grow_to: Option<usize>,
    /// Whether transparent Gaussians are removed.
    pub prune: bool,
    /// Whether large Gaussians are removed.
    pub prune_large: bool,
    /// Whether opacities are reset.
    pub reset: bool,
}

impl DueChanges {
    /// Whether Gaussians are added.
    pub fn adds(&self) -> bool {
        self.grow_to.is_some()
    }
}

/// Whether the changes due after the last step are still to be applied.
#[derive(Clone, Copy, Debug, Default)]
pub struct PendingDensification(bool);

/// Changes of the Gaussians to apply before a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Changes {
    /// The step of the run, from 0, after which they were due.
    pub step: usize,
    /// Which are added, removed or reset.
    pub due: DueChanges,
    /// Whether the Gaussians are then sorted along a space-filling curve.
    pub sort: bool,
}

impl PendingDensification {
    /// Marks it in a checkpoint.
    const NAME: &'static str = "densify.pending";

    /// Notes that a step was taken.
    pub fn after_step(&mut self) {
        self.0 = true;
    }

    /// Returns what is to be applied after `steps` steps of a run that started with `start` Gaussians, once.
    pub fn take(&mut self, steps: usize, config: &Config, start: usize) -> Option<Changes> {
        let step = std::mem::take(&mut self.0).then(|| steps.checked_sub(1))??;
        let sort = sorts_after(steps, config);
        let due = due(Stage::from_step(step, config), config, start);
        (due != DueChanges::default() || sort).then_some(Changes { step, due, sort })
    }

    /// Returns what a checkpoint keeps.
    pub fn to_tensors(self) -> BTreeMap<String, HostTensor> {
        let mark = (Self::NAME.to_owned(), HostTensor { shape: vec![1], values: vec![1.0] });
        self.0.then_some(mark).into_iter().collect()
    }

    /// Restores what [`PendingDensification::to_tensors`] returned.
    pub fn load(tensors: &BTreeMap<String, HostTensor>) -> Self {
        Self(tensors.contains_key(Self::NAME))
    }
}

/// Whether Gaussians are sorted after `steps` steps of the run. A training sorts at once after its last step, as none
/// follows.
pub fn sorts_after(steps: usize, config: &Config) -> bool {
    let every = config.speed.sort_every;
    every > 0 && steps.is_multiple_of(every)
}

/// The steps of a stage, counted from 1, at which Gaussians may be added: after `from`, up to and including `until`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct StepSpan {
    from: usize,
    until: usize,
}

impl StepSpan {
    /// Returns the spans of warm-up and of the joint stage. They end before the last step of the run, after which
    /// nothing is applied any more.
    pub(super) fn per_stage(config: &Config) -> [Self; 2] {
        let (d, stages) = (&config.densify, &config.stages);
        let warmup_steps =
            if stages.joint_steps > 0 { stages.warmup_steps } else { stages.warmup_steps.saturating_sub(1) };
        [
            Self { from: d.warmup_from, until: d.warmup_until.min(warmup_steps) },
            Self { from: d.joint_from, until: d.joint_until.min(stages.joint_steps.saturating_sub(1)) },
        ]
    }

    /// Returns its number of steps.
    pub(super) fn steps(self) -> usize {
        self.until.saturating_sub(self.from)
    }

    /// Returns how many of its steps are done after `step`.
    fn done(self, step: usize) -> usize {
        step.saturating_sub(self.from).min(self.steps())
    }

    fn contains(self, step: usize) -> bool {
        step > self.from && step <= self.until
    }
}

/// Returns what is due after the step of `stage`, for a run that started with `start` Gaussians; steps count from 1
/// within their stage.
fn due(stage: Stage, config: &Config, start: usize) -> DueChanges {
    let d = &config.densify;
    let [warmup, joint] = StepSpan::per_stage(config);
    let (step, span) = match stage {
        Stage::Warmup(s) => (s + 1, warmup),
        Stage::Joint(s) => (s + 1, joint),
    };
    let within = span.contains(step);
    // the last step of each line towards a budget, so that the line ends at the budget
    let ends = stage.is_joint() || joint.steps() == 0 || d.warmup_budget > 0;
    let is_last = ends && within && step == span.until;
    let every = |n: usize| within && step.is_multiple_of(n.max(1));
    let grow_to = match every(d.every) || is_last {
        true => rule_of(config).target(d, stage, line(stage, config, start)),
        false => None,
    };
    let prunes = match stage {
        Stage::Warmup(_) => step > d.prune_from,
        Stage::Joint(_) => d.prune_joint,
    };
    // counted over the run, as resets may continue in the joint stage
    let of_run = stage.step_of_run(config) + 1;
    let was_reset = d.opacity_reset > 0 && of_run > d.opacity_reset;
    // after the last step of the run nothing would raise opacities again, or train what replaces removed Gaussians, and
    // each change of the Gaussians restarts the moving average
    let goes_on = of_run < config.stages.warmup_steps + config.stages.joint_steps;
    // not at the end of a span as such: opacities since the last pruning may be those of a few times only
    let prunes = prunes && every(d.prune_every) && goes_on;
    let reset = (!stage.is_joint() || d.opacity_reset_joint)
        && d.opacity_reset > 0
        && goes_on
        && (of_run == d.opacity_reset || of_run <= d.opacity_reset_until && of_run.is_multiple_of(d.opacity_reset));
    DueChanges {
        grow_to,
        prune: prunes && d.prune_opacity > 0.0,
        prune_large: prunes && d.prune_size > 0.0 && was_reset,
        reset,
    }
}

/// Returns the value of the straight line towards the budget after a step: one line over both stages, or one per stage
/// if warm-up has a budget of its own.
fn line(stage: Stage, config: &Config, start: usize) -> usize {
    let d = &config.densify;
    let [warmup, joint] = StepSpan::per_stage(config);
    let (from, to, done, steps) = match (stage, d.warmup_budget) {
        (Stage::Warmup(s), 0) => (start, d.budget, warmup.done(s + 1), warmup.steps() + joint.steps()),
        (Stage::Joint(s), 0) => (start, d.budget, warmup.steps() + joint.done(s + 1), warmup.steps() + joint.steps()),
        (Stage::Warmup(s), own) => (start, own, warmup.done(s + 1), warmup.steps()),
        (Stage::Joint(s), own) => {
            // warm-up too short to add any has not reached its budget
            let from = if warmup.steps() > 0 { own.max(start) } else { start };
            (from, d.budget, joint.done(s + 1), joint.steps())
        }
    };
    let (from, to) = (from.min(to) as f64, to as f64);
    (from + (to - from) * (done as f64 / steps.max(1) as f64).min(1.0)).round() as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::layers::Layers;
    use crate::config::sections::ConfigSection;
    use crate::config::types::D3dgsConfig;
    use crate::config::{PRESETS, preset};

    /// Returns the warm-up steps, counted from 1, at which `what` is due.
    fn warmup_steps(config: &Config, what: impl Fn(DueChanges) -> bool) -> Vec<usize> {
        (1..=config.stages.warmup_steps).filter(|s| what(due(Stage::Warmup(s - 1), config, 100))).collect()
    }

    fn targets(config: &Config, start: usize) -> Vec<usize> {
        let warmup = (0..config.stages.warmup_steps).map(Stage::Warmup);
        let all = warmup.chain((0..config.stages.joint_steps).map(Stage::Joint));
        all.filter_map(|stage| due(stage, config, start).grow_to).collect()
    }

    #[test]
    fn the_budget_line_ends_at_the_budget() {
        let config = preset("best").unwrap();
        let last = config.densify.joint_until - 1;
        assert_eq!(due(Stage::Joint(last), &config, 50_000).grow_to, Some(config.densify.budget));
        assert_eq!(due(Stage::Joint(last + 1), &config, 50_000), DueChanges::default());
        let first = due(Stage::Warmup(399), &config, 50_000).grow_to.unwrap();
        assert!((50_000..60_000).contains(&first), "{first}");
    }

    #[test]
    fn without_a_joint_stage_warm_up_ends_at_the_budget() {
        let mut config = preset("best").unwrap();
        (config.stages.warmup_steps, config.stages.joint_steps) = (730, 0);
        (config.densify.budget, config.densify.warmup_from, config.densify.prune_every) = (1000, 100, 100);
        assert_eq!(targets(&config, 100).last(), Some(&1000));
        let pruned = warmup_steps(&config, |d| d.prune);
        assert_eq!(pruned, [200, 300, 400, 500, 600, 700], "never by the opacities of a few last steps");
        config.densify.warmup_until = 450;
        assert_eq!(warmup_steps(&config, |d| d.grow_to.is_some()), [200, 300, 400, 450]);
        assert_eq!(targets(&config, 100).last(), Some(&1000));
        assert_eq!(warmup_steps(&config, |d| d.prune), [200, 300, 400]);
        // a joint stage that adds no Gaussians does not count
        (config.stages.joint_steps, config.densify.joint_from) = (300, 300);
        assert_eq!(targets(&config, 100).last(), Some(&1000));
    }

    #[test]
    fn nothing_is_added_or_removed_after_the_last_step_of_the_run() {
        let mut config = preset("best").unwrap();
        config.stages.joint_steps = 4000;
        let joint = |step: usize| due(Stage::Joint(step - 1), &config, 100);
        assert!(joint(3500).prune && joint(4000) == DueChanges::default());
        assert_eq!(joint(3999).grow_to, Some(config.densify.budget), "with one step left to train what is added");
        (config.stages.warmup_steps, config.stages.joint_steps) = (1000, 0);
        assert_eq!(warmup_steps(&config, |d| d.prune), [500]);
    }

    #[test]
    fn what_is_due_waits_for_the_next_step_and_is_applied_once() {
        let mut config = preset("best").unwrap();
        (config.densify.mode, config.speed.sort_every) = ("off".into(), 100);
        (config.densify.prune_opacity, config.densify.opacity_reset) = (0.0, 250);
        let reset = DueChanges { reset: true, ..DueChanges::default() };
        let mut pending = PendingDensification::default();
        assert_eq!(pending.take(0, &config, 100), None, "no step has been taken");
        for (steps, expected) in [
            (99, None),
            (100, Some(Changes { step: 99, due: DueChanges::default(), sort: true })),
            (250, Some(Changes { step: 249, due: reset, sort: false })),
        ] {
            assert_eq!(pending.take(steps, &config, 100), None);
            pending.after_step();
            let mut restored = PendingDensification::load(&pending.to_tensors());
            assert_eq!(pending.take(steps, &config, 100), expected);
            assert_eq!(restored.take(steps, &config, 100), expected);
            assert!(pending.to_tensors().is_empty());
        }
        config.speed.sort_every = 0;
        pending.after_step();
        assert_eq!(pending.take(100, &config, 100), None);
    }

    #[test]
    fn a_span_without_steps_adds_nothing_even_at_its_end() {
        let mut config = preset("best").unwrap();
        (config.densify.mode, config.stages.joint_steps) = ("threshold".into(), 20_000);
        (config.densify.joint_from, config.densify.joint_until) = (20_000, 14_900);
        let joint = |step: usize| due(Stage::Joint(step), &config, 100).grow_to;
        assert_eq!((joint(14_899), joint(19_999)), (None, None));
    }

    #[test]
    fn warm_up_may_have_a_budget_of_its_own() {
        let mut config = preset("best").unwrap();
        (config.stages.warmup_steps, config.densify.warmup_from) = (1000, 0);
        (config.densify.warmup_budget, config.densify.budget) = (300, 500);
        let all = targets(&config, 100);
        assert!(all.is_sorted(), "{all:?}");
        assert_eq!((all[9], all.last()), (300, Some(&500)));
        assert_eq!(targets(&config, 400).first(), Some(&300), "above that from the start: none are added");
        config.densify.warmup_from = 1000;
        let joint = targets(&config, 100);
        assert!(joint[0] < 120 && joint.last() == Some(&500), "warm-up adds none, so the line starts below: {joint:?}");
        config.densify.warmup_from = 0;
        // warm-up above the second budget: the joint stage aims at that budget and removes none
        config.densify.warmup_budget = 700;
        let all = targets(&config, 100);
        assert_eq!(all[9], 700);
        assert!(all[10..].iter().all(|n| *n == 500), "{all:?}");
        config.densify.mode = "threshold".into();
        let all = targets(&config, 100);
        assert!(all[..10].iter().all(|n| *n == 700) && all[10..].iter().all(|n| *n == 500), "{all:?}");
    }

    #[test]
    fn opacities_are_reset_as_3dgs_and_as_the_released_code_do() {
        let mut config = preset("best").unwrap();
        (config.stages.warmup_steps, config.densify.opacity_reset) = (30_000, 3000);
        let resets = |config: &Config| warmup_steps(config, |d| d.reset);
        assert_eq!(resets(&config), [3000], "once, unless more are configured");
        config.densify.opacity_reset_until = 14_900;
        assert_eq!(resets(&config), [3000, 6000, 9000, 12_000]);
        config.stages.warmup_steps = 3000;
        assert_eq!(resets(&config), [3000], "its last step");
        assert!(!due(Stage::Joint(2999), &config, 100).reset);
        config.stages.joint_steps = 0;
        assert!(resets(&config).is_empty(), "the run ends there, with opacities near 0");
    }

    #[test]
    fn resets_may_go_on_in_the_joint_stage_counted_over_the_run() {
        ConfigSection::new::<D3dgsConfig>().add();
        let d3dgs = Layers::new(PRESETS).source("../../configs/methods/d3dgs.toml");
        let config = d3dgs.resolve::<Config>().unwrap().value;
        let steps = config.stages.warmup_steps + config.stages.joint_steps;
        let run = (1..=steps).map(|step| (step, due(Stage::from_step(step - 1, &config), &config, 100)));
        let run: Vec<(usize, DueChanges)> = run.collect();
        let at = |what: fn(&DueChanges) -> bool| {
            run.iter().filter(|(_, due)| what(due)).map(|(s, _)| *s).collect::<Vec<_>>()
        };
        assert_eq!(at(|d| d.reset), [3000, 6000, 9000, 12_000], "as 3DGS, but for step 500 on white");
        let added = at(|d| d.grow_to.is_some());
        assert_eq!((added.first(), added.last(), added.len()), (Some(&600), Some(&14_900), 144));
        assert_eq!(at(|d| d.prune), added);
        assert_eq!(at(|d| d.prune_large).first(), Some(&3100), "above step 3,000");
    }

    #[test]
    fn large_gaussians_are_pruned_only_after_a_reset_and_with_pruning_on() {
        let mut config = preset("best").unwrap();
        (config.stages.warmup_steps, config.densify.warmup_from) = (6000, 500);
        (config.densify.prune_size, config.densify.prune_every, config.densify.prune_from) = (0.1, 500, 1000);
        assert_eq!(warmup_steps(&config, |d| d.prune)[..2], [1500, 2000]);
        assert!(warmup_steps(&config, |d| d.prune_large).is_empty());
        config.densify.opacity_reset = 3000;
        assert_eq!(warmup_steps(&config, |d| d.prune_large), [3500, 4000, 4500, 5000, 5500, 6000]);
        assert!(due(Stage::Joint(999), &config, 100).prune);
        config.densify.prune_joint = false;
        let joint = due(Stage::Joint(999), &config, 100);
        assert!(!joint.prune && !joint.prune_large && joint.grow_to.is_some());
    }
}
