//! The default of every key: the `best` preset.

use super::*;

impl Default for Config {
    fn default() -> Self {
        Self {
            seed: 0,
            method: method(),
            method_settings: BTreeMap::new(),
            data: DataConfig {
                downscale: 1,
                background: "white".into(),
                times: 0,
                only_times: Vec::new(),
                views_per_time: 0,
                order: ViewOrder::Shuffled,
            },
            init: InitConfig {
                points: 60_000,
                placement: Placement::Hull,
                box_half_size: 1.3,
                scale: 0.6,
                opacity: 0.1,
            },
            model: ModelConfig {
                sh_degree: 2,
                sh_bands: ShBands::Even,
                appearance: Appearance::Sh,
                encoder: EncoderKind::Factorised,
                extra_encoder: String::new(),
                levels: 2,
                resolution: 64,
                time_knots: 25,
                time_curve: TimeCurve::Linear,
                channels: 32,
                grid_init: GridInit::Uniform,
                time_range: TimeRange::Full,
                bounds: Bounds::Hull,
                bounds_margin: 0.05,
                // the network of D3DGS, see `model::implicit`
                implicit_octaves: 10,
                implicit_time_octaves: implicit_time_octaves(),
                implicit_width: implicit_width(),
                implicit_depth: implicit_depth(),
                implicit_skip: implicit_skip(),
                embedding: 16,
                dilation: 0.05,
                path_opacity: 0.5,
                width: 64,
                decoder: DecoderKind::Heads,
                zero_init_heads: true,
                bias_init: BiasInit::Zero,
                deform_opacity: true,
            },
            stages: StagesConfig {
                warmup_steps: 500,
                warmup_times: WarmupTimes::Middle,
                joint_steps: 30_000,
                sh_every: 0,
            },
            loss: LossConfig {
                kind: LossKind::L2,
                weight: 1.0,
                // with 0.2, the paper's weight, this term is several times L2 at the quality that `best` reaches
                dssim: 0.05,
                dssim_last: 5000,
                dssim_ramp: 500,
                dssim_warmup: false,
                alpha: 0.1,
                tv: 1e-4,
                tv_time: 1e-4,
                tv_kind: TvOrder::First,
                tv_reduction: TvReduction::Mean,
                one_prior: 0.0,
                fade: 0.0,
                extra: BTreeMap::new(),
            },
            optim: OptimConfig {
                means: 1.6e-4,
                warmup_decay_steps: 30_000,
                rotations: 1e-3,
                log_scales: 5e-3,
                opacity: 0.05,
                sh: 5e-3,
                sh_rest: 1.0,
                normals: 0.01,
                material: 5e-3,
                encoder: 0.01,
                decoder: 1.4e-3,
                embedding: 0.01,
                final_fraction: 0.1,
                attributes_final_fraction: 1.0,
                schedule: "log-linear".into(),
                decay_over: DecayOver::Stage,
                betas: [0.9, 0.99],
                epsilon: 1e-15,
                average: 1000,
            },
            densify: DensifyConfig {
                budget: 200_000,
                warmup_budget: 0,
                mode: DensifyMode::Budget,
                every: 100,
                warmup_from: 300,
                warmup_until: 15_000,
                joint_from: 500,
                joint_until: 12_000,
                threshold: 2e-4,
                split_above: 0.004,
                prune_opacity: 0.005,
                prune_by: PruneBy::Largest,
                prune_size: 0.0,
                prune_every: 500,
                prune_from: 0,
                prune_joint: true,
                opacity_reset: 0,
                opacity_reset_until: 0,
                opacity_reset_joint: false,
            },
            speed: SpeedConfig { coarse_steps: 0, coarse_factor: 2, sort_every: 1000, cull_visits: 0 },
            output: OutputConfig {
                log_every: 10,
                eval_every: 1000,
                eval_views: 6,
                checkpoint_every: 1000,
                keep: 2,
                max_minutes: 0.0,
            },
            segment: SegmentConfig::default(),
            d3dgs: None,
            coordnet: None,
            insitunet: None,
            visnerf: None,
            fourdgs: None,
        }
    }
}

pub(super) fn method() -> String {
    VOLSEGGS.into()
}

/// The dilation used by scenes that predate the key.
pub(crate) fn dilation_of_3dgs() -> f64 {
    // the decimal number, not the nearest `f32`: it is written into files
    0.3
}

/// The value of the default implicit encoder, also used for scenes that predate its keys.
pub(super) fn implicit_time_octaves() -> usize {
    6
}

/// As [`implicit_time_octaves`].
pub(super) fn implicit_width() -> usize {
    256
}

/// As [`implicit_time_octaves`].
pub(super) fn implicit_depth() -> usize {
    8
}

/// As [`implicit_time_octaves`].
pub(super) fn implicit_skip() -> usize {
    5
}
