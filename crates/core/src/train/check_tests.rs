//! Tests of what is refused before training.

use super::*;
use crate::config::{PRESETS, preset};

fn refusal(edit: impl Fn(&mut Config)) -> String {
    let mut config = preset("best").unwrap();
    edit(&mut config);
    check(&config).unwrap_err().to_string()
}

#[test]
fn invalid_values_are_named_with_the_values_allowed() {
    check(&preset("best").unwrap()).unwrap();
    type Edit = fn(&mut Config);
    let cases: [(Edit, [&str; 2]); 33] = [
        (|c| c.optim.warmup_decay_steps = 0, ["optim.warmup_decay_steps = 0", "at least 1"]),
        (|c| c.data.only_times = vec![0.5, 1.5], ["data.only_times: 1.5", "between 0 and 1"]),
        (|c| c.data.only_times = vec![-0.5], ["data.only_times = -0.5", "0 or above"]),
        (|c| c.data.only_times = vec![f64::NAN], ["data.only_times", "NaN"]),
        (|c| (c.data.only_times, c.data.times) = (vec![0.5], 3), ["data.times = 3", "one of them"]),
        (|c| c.densify.every = 0, ["densify.every = 0", "at least 1"]),
        (|c| c.densify.prune_every = 0, ["densify.prune_every = 0", "at least 1"]),
        (|c| c.densify.prune_size = 0.1, ["densify.prune_size = 0.1", "densify.opacity_reset"]),
        (|c| c.densify.opacity_reset_until = 9, ["densify.opacity_reset_until = 9", "densify.opacity_reset "]),
        (
            |c| (c.densify.opacity_reset, c.densify.opacity_reset_until) = (300, 200),
            ["densify.opacity_reset_until = 200", "opacity_reset = 300"],
        ),
        (|c| c.densify.opacity_reset = 3000, ["densify.opacity_reset = 3000", "stages.warmup_steps = 500"]),
        (
            |c| (c.stages.warmup_steps, c.stages.joint_steps, c.densify.opacity_reset) = (3000, 0, 3000),
            ["densify.opacity_reset = 3000", "after 3000 steps"],
        ),
        (
            |c| {
                (c.stages.warmup_steps, c.stages.joint_steps) = (500, 2000);
                (c.densify.opacity_reset, c.densify.opacity_reset_joint) = (3000, true);
            },
            ["densify.opacity_reset = 3000", "after 2500 steps"],
        ),
        (|c| c.densify.opacity_reset_joint = true, ["opacity_reset_joint = true", "set that as well"]),
        (|c| c.densify.mode = "off".into(), ["densify.budget = 200000", "densify.mode = \"off\""]),
        (
            |c| {
                c.densify.mode = "off".into();
                (c.init.points, c.densify.budget, c.densify.warmup_budget) = (500, 500, 501);
            },
            ["densify.warmup_budget = 501", "set densify.warmup_budget to 500"],
        ),
        (|c| c.optim.final_fraction = 0.0, ["optim.final_fraction = 0", "above 0"]),
        (|c| c.optim.attributes_final_fraction = 0.0, ["optim.attributes_final_fraction = 0", "above 0"]),
        (|c| (c.loss.dssim, c.loss.dssim_last) = (0.2, 0), ["loss.dssim = 0.2", "loss.dssim_last = 0"]),
        (|c| (c.speed.coarse_steps, c.speed.coarse_factor) = (9, 1), ["coarse_steps = 9", "coarse_factor = 1"]),
        (|c| (c.speed.cull_visits, c.loss.fade) = (2, 0.1), ["cull_visits = 2", "loss.fade = 0.1"]),
        (|c| c.init.scale = 0.0, ["init.scale = 0", "above 0"]),
        (|c| c.init.scale = 1e-300, ["init.scale", "above 0"]),
        (|c| c.init.scale = 1e300, ["init.scale = 1e300", "too large, at most 3.4e38"]),
        (|c| c.init.box_half_size = 0.0, ["init.box_half_size = 0", "above 0"]),
        (|c| c.optim.betas[1] = 1.0, ["optim.betas[1] = 1", "between 0 and 0.999999"]),
        (|c| c.optim.epsilon = 0.0, ["optim.epsilon = 0", "above 0"]),
        (|c| c.optim.means = 1e300, ["optim.means = 1e300", "too large"]),
        (|c| c.optim.means = f64::NAN, ["optim.means", "NaN or infinite"]),
        (|c| c.densify.prune_opacity = 1.0, ["densify.prune_opacity = 1", "between"]),
        (|c| c.output.keep = 0, ["output.keep = 0", "at least 1"]),
        (|c| c.output.eval_views = 0, ["output.eval_views = 0", "at least 1"]),
        (
            |c| (c.model.encoder, c.model.implicit_octaves) = ("implicit".into(), 64),
            ["model.implicit_octaves = 64", "at most 24"],
        ),
    ];
    // a cosine may end at zero
    let mut cosine = preset("best").unwrap();
    (cosine.optim.schedule, cosine.optim.final_fraction) = ("cosine".into(), 0.0);
    check(&cosine).unwrap();
    for (edit, words) in cases {
        let text = refusal(edit);
        assert!(words.iter().all(|w| text.contains(w)), "{text}");
        assert!(!text.contains("learning rate"), "{text}");
    }
}

#[test]
fn backgrounds() {
    assert_eq!(evaluation_background("#ff0000").unwrap(), [1.0, 0.0, 0.0]);
    for bad in ["#+1+2+3", "#12345", "#12345g", "ff0000", "red"] {
        assert!(evaluation_background(bad).unwrap_err().to_string().contains(bad));
    }
}

#[test]
fn every_preset_passes() {
    for (name, _) in PRESETS {
        check(&preset(name).unwrap()).unwrap_or_else(|e| panic!("{name}: {e}"));
    }
}
