//! `optim.*`: learning rates and how they decay.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `optim.*`: Adam with one learning rate per parameter group.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OptimConfig {
    /// Learning rate of means, as a multiple of the scene's extent. It decays over the joint stage as set by
    /// `schedule`, and in warm-up over `warmup_decay_steps`.
    pub means: f64,
    /// Steps, from the start of warm-up, over which the rate of the means would decay to its final value; the decay
    /// restarts with the joint stage.
    pub warmup_decay_steps: usize,
    /// Learning rate of rotations.
    pub rotations: f64,
    /// Learning rate of log-scales.
    pub log_scales: f64,
    /// Learning rate of opacity logits.
    pub opacity: f64,
    /// Learning rate of the first spherical-harmonics coefficient.
    pub sh: f64,
    /// Learning rate of the other coefficients, as a fraction of `sh`.
    pub sh_rest: f64,
    /// Learning rate of the normals of `model.appearance = "headlight"`.
    pub normals: f64,
    /// Learning rate of the material of `model.appearance = "headlight"`.
    pub material: f64,
    /// Learning rate of planes, lines and temporal vectors, and of the other encoders (the implicit one needs a tenth;
    /// D3DGS uses 8e-4).
    pub encoder: f64,
    /// Learning rate of the decoder.
    pub decoder: f64,
    /// Learning rate of the per-Gaussian embedding, used if `model.embedding` is above 0.
    pub embedding: f64,
    /// Final rate of means, encoder, decoder and embedding, as a fraction of the initial rate.
    pub final_fraction: f64,
    /// Final rate of the other groups, as a fraction of the initial rate; they decay in the last stage of training, or
    /// over the whole run with `decay_over = "run"`.
    pub attributes_final_fraction: f64,
    /// How the rates of means, encoder, decoder and embedding decay: `log-linear`, `cosine`, `constant` or a registered
    /// schedule.
    pub schedule: String,
    /// Decay over each stage separately (`stage`, in warm-up over `warmup_decay_steps`), or once over the whole run
    /// (`run`, as in 3DGS).
    pub decay_over: DecayOver,
    /// First and second decay rates of Adam.
    pub betas: [f64; 2],
    /// Adam's epsilon.
    pub epsilon: f64,
    /// Length in steps of the moving average of the parameters that is shown and saved in their place; 0 for none. It
    /// covers at most a tenth of the steps since it began, and restarts with the joint stage, whenever Gaussians are
    /// added or removed, and when opacities are reset.
    pub average: usize,
}

impl Default for OptimConfig {
    fn default() -> Self {
        Self {
            means: 1.6e-4,
            warmup_decay_steps: 20_000,
            rotations: 1e-3,
            log_scales: 5e-3,
            opacity: 0.05,
            sh: 2.5e-3,
            sh_rest: 0.05,
            normals: 0.01,
            material: 5e-3,
            encoder: 1e-3,
            decoder: 1e-4,
            embedding: 0.01,
            final_fraction: 0.01,
            attributes_final_fraction: 1.0,
            schedule: "log-linear".into(),
            decay_over: DecayOver::Stage,
            betas: [0.9, 0.999],
            epsilon: 1e-15,
            average: 0,
        }
    }
}

/// The period over which the rates decay.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DecayOver {
    /// Each stage separately.
    Stage,
    /// The whole run.
    Run,
}
