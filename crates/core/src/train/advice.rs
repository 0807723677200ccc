//! What a configuration allows but hardly means, said before training starts.

use super::densify::rule_of;
use crate::config::types::{Config, VOLSEGGS};

/// Times that a training shows each view to which the default length is suited: 30,000 steps of the paper's 600 views.
const ROUNDS: usize = 50;

/// Returns what is allowed but hardly meant when training on `views` views, one note each: Gaussians that are added until
/// a run ends, as where a preset is shortened by its steps alone; and a joint stage much longer than few views bear.
pub fn advice(config: &Config, views: usize) -> Vec<String> {
    [late_additions(config), many_rounds(config, views)].into_iter().flatten().collect()
}

fn late_additions(config: &Config) -> Option<String> {
    let (densify, joint_steps) = (&config.densify, config.stages.joint_steps);
    // the last step of a run is followed by no addition
    let adds = rule_of(config).adds() && densify.joint_from + 1 < joint_steps;
    (adds && densify.joint_until + 1 >= joint_steps && config.optim.average > 0).then(|| {
        format!(
            "densify.joint_until = {}: Gaussians are added until the run ends (stages.joint_steps = {joint_steps}), and as \
             each addition restarts the moving average, its result has none; in a shorter run, lower densify.joint_until \
             too, here to {}",
            densify.joint_until,
            // as in `best`
            scaled(2, 5, joint_steps)
        )
    })
}

fn many_rounds(config: &Config, views: usize) -> Option<String> {
    let joint_steps = config.stages.joint_steps;
    // other methods have their published lengths; close to the limit is not worth a note
    (config.method == VOLSEGGS && views > 0 && joint_steps >= 2 * ROUNDS * views).then(|| {
        let steps = ROUNDS * views;
        let mut sets = vec![("stages.joint_steps", steps), ("optim.warmup_decay_steps", steps)];
        if rule_of(config).adds() {
            sets.push(("densify.joint_until", scaled(config.densify.joint_until, joint_steps, steps)));
        }
        if config.loss.dssim > 0.0 {
            sets.push(("loss.dssim_last", scaled(config.loss.dssim_last, joint_steps, steps)));
        }
        let sets: Vec<String> = sets.into_iter().map(|(key, value)| format!("--set {key}={value}")).collect();
        format!(
            "stages.joint_steps = {joint_steps} shows each of the {views} training views {} times, and so long a training \
             overfits few views; {ROUNDS} times take {:.0} % of the time: {}",
            joint_steps / views,
            100.0 * steps as f64 / joint_steps as f64,
            sets.join(" ")
        )
    })
}

/// `count` steps of a joint stage of `from` steps, above 0, in one of `to` steps.
fn scaled(count: usize, from: usize, to: usize) -> usize {
    (count as f64 * to as f64 / from as f64).round() as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::preset;

    #[test]
    fn a_run_that_adds_gaussians_until_its_end_is_advised_against() {
        let mut config = preset("best").unwrap();
        assert!(advice(&config, 600).is_empty());
        config.stages.joint_steps = 4000;
        let [text] = &advice(&config, 600)[..] else { panic!("one note") };
        assert!(text.contains("densify.joint_until = 12000") && text.ends_with("here to 1600"), "{text}");
        config.densify.joint_until = 1600;
        assert!(advice(&config, 600).is_empty());
        for quiet in [
            (|c| c.optim.average = 0) as fn(&mut Config),
            |c| c.densify.mode = "off".into(),
            |c| c.stages.joint_steps = 0,
            |c| c.densify.joint_from = 4000,
        ] {
            let mut config = preset("best").unwrap();
            config.stages.joint_steps = 4000;
            quiet(&mut config);
            assert!(advice(&config, 600).is_empty());
        }
    }

    #[test]
    fn a_training_too_long_for_its_views_is_advised_against_with_the_settings_of_a_shorter_one() {
        let mut config = preset("best").unwrap();
        assert!(advice(&config, 301).is_empty() && advice(&config, 0).is_empty());
        let [text] = &advice(&config, 210)[..] else { panic!("one note") };
        let sets = "--set stages.joint_steps=10500 --set optim.warmup_decay_steps=10500 --set densify.joint_until=4200 \
                    --set loss.dssim_last=1750";
        assert!(text.contains("210 training views 142 times") && text.ends_with(sets), "{text}");
        assert!(text.contains("35 % of the time"), "{text}");
        // followed, the advice is silent
        (config.stages.joint_steps, config.densify.joint_until) = (10_500, 4200);
        assert!(advice(&config, 210).is_empty());
        config.method = "d3dgs".into();
        assert!(advice(&Config { stages: preset("best").unwrap().stages, ..config }, 210).is_empty());
        // no key is named that has no effect
        let mut config = preset("best").unwrap();
        (config.densify.mode, config.loss.dssim) = ("off".into(), 0.0);
        assert!(advice(&config, 210)[0].ends_with("--set optim.warmup_decay_steps=10500"));
    }
}
