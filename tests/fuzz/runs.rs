//! Files of a run folder other than tensors: states, records, logs, edits, exported Gaussians.

use crate::driver::{Scratch, Target, accepted, fuzz};
use volseggs::compare::{curves, runs::from_folders};
use volseggs::config::types::Config;
use volseggs::draw::plot::{PlotSeries, line_plot, line_plot_log_y};
use volseggs::edit::EditStack;
use volseggs::export::ply;
use volseggs::export::splat_file::SplatFileOptions;
use volseggs::log::jsonl::{JsonlWriter, truncate_after};
use volseggs::model::HostGaussians;
use volseggs::sweep::result::live_psnr;
use volseggs::train::checkpoint::{self, CheckpointState};
use volseggs::train::resume;
use volseggs::versioned;

const RECORD: &str = r#"{"format": 1, "version": "0.1.0", "method": "volseggs", "build": "", "dataset_from_run": "../data",
    "calibration": {}, "surroundings": {"lens": {"fov_x": 0.5, "width": 8, "height": 8}, "sphere": {"centre": [0, 0, 0], "radius": 4}},
    "seed": 3, "device": "flex", "threads": 2, "dataset": "data/jets",
    "fingerprint": "0123456789abcdef", "status": "complete", "steps": 100, "training_seconds": 12.5, "gaussians": 400,
    "peak_memory_bytes": 1000000}"#;
const SUMMARY: &str = r#"{"format": 1, "split": "test", "dataset": "data", "fingerprint": "", "parameters": 9, "build": "", "fps_frames": 5,
    "by_region": {"edge": {"pixels": 0.2, "error": 0.5, "psnr": 30.0}, "interior": {"pixels": 0.2, "error": 0.5, "psnr": 30.0}, "outside": {"pixels": 0, "error": 0, "psnr": null}}, "fps_with_copy": 19.0, "views": 3, "psnr": 30.5, "ssim": 0.9, "ssim_gray": 0.91, "lpips_alex": 0.1,
    "lpips_vgg": null, "extra": {"mine": 1.0}, "fps": 20.0, "training_seconds": 12.5, "model_bytes": 123456, "gaussians": 400,
    "width": 32, "height": 32, "background": [1.0, 1.0, 1.0], "notes": ["a note"]}"#;

#[test]
fn state() {
    fuzz("state", |scratch| {
        let config = toml::to_string(&Config::default()).unwrap();
        let state = CheckpointState {
            step: 10,
            initial: 300,
            dataset: "0123456789abcdef".into(),
            config: config.clone(),
            seconds: 1.5,
            packed: false,
        };
        let folder = scratch.path("run/checkpoints/step-000010");
        let path = scratch.write("run/checkpoints/step-000010/state.json", b"");
        let scratch = scratch.clone();
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            let _ = (checkpoint::locate(&folder), checkpoint::advice(&folder));
            let Some(state) = accepted(versioned::from_json::<CheckpointState>(bytes)) else { return false };
            if let Some((allowed, refused)) = accepted(resume::changes(&state.config, &config, state.step)) {
                let _ = allowed.iter().chain(&refused).map(ToString::to_string).collect::<String>();
            }
            let _ = checkpoint::folder_name(state.step);
            true
        };
        Target::new(vec![versioned::to_json_pretty(&state).unwrap()], read).tokens(&[
            "\\n",
            "[a.b]\\n",
            "\\u0000",
            "a.b.c = 1\\n",
        ])
    });
}

/// Compares two runs, one of which has a damaged `file`.
fn compare(scratch: &Scratch, file: &str, seed: &str) -> Target {
    for run in ["a", "b"] {
        scratch.write(&format!("{run}/run.json"), RECORD.as_bytes());
        scratch.write(&format!("{run}/eval/test/mean.json"), SUMMARY.as_bytes());
        scratch.write(&format!("{run}/config.toml"), b"seed = 1\nmodel.width = 4\n");
    }
    let (path, folders) = (scratch.path(&format!("b/{file}")), ["a", "b"].map(|run| scratch.path(run)));
    let scratch = scratch.clone();
    let metrics: Vec<String> = ["psnr", "lpips_alex", "mine", "model_mb"].map(str::to_owned).to_vec();
    let read = move |bytes: &[u8]| {
        scratch.overwrite(&path, bytes);
        accepted(from_folders(&folders, &metrics)).is_some_and(|set| set.outcomes.len() == 2)
    };
    Target::new(vec![seed.as_bytes().to_vec()], read)
}

#[test]
fn record() {
    fuzz("run-record", |scratch| compare(scratch, "run.json", RECORD));
}

#[test]
fn means() {
    fuzz("run-means", |scratch| compare(scratch, "eval/test/mean.json", SUMMARY));
}

#[test]
fn run_config() {
    fuzz("run-config", |scratch| {
        compare(scratch, "config.toml", "seed = 2\n[model]\nwidth = 8\n[loss.extra]\nmine = 0.5\n")
    });
}

#[test]
fn metrics() {
    fuzz("metrics", |scratch| {
        let path = scratch.write("metrics.jsonl", b"");
        let scratch = scratch.clone();
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            let found = curves::read(scratch.root());
            let _ = live_psnr(scratch.root(), 20);
            for curve in [&found.test, &found.train, &found.test_by_seconds] {
                let points = curves::smooth(curve);
                let series = [PlotSeries { name: "a".into(), points }];
                let drawn = line_plot("t", "x", "y", &series).len() + line_plot_log_y("t", "x", "y", &series).len();
                assert!(drawn < 1 << 20);
            }
            let cut = accepted(truncate_after(&path, 15)).is_some();
            if let Some(mut writer) = accepted(JsonlWriter::open(&path)) {
                accepted(writer.append(&serde_json::json!({ "step": 16 })));
            }
            cut
        };
        let line = |step: u32| {
            format!(
                "{{\"step\":{step},\"seconds\":{step}.5,\"stage\":\"joint\",\"loss\":0.1,\"train_psnr\":2{step}.0,\"test_psnr\":25.{step}}}\n"
            )
        };
        let whole: String = (1..30).map(line).collect();
        let seeds = [whole.clone(), format!("{whole}{{\"step\":31,\"tr"), "{\"note\":\"x\"}\n".to_owned()];
        Target::new(seeds.map(String::into_bytes).to_vec(), read).tokens(&[
            "\"step\":",
            "\"test_psnr\":",
            "\"train_psnr\":",
            "\"seconds\":",
            "\n{\"step\":99,\"test_psnr\":1e308}\n",
        ])
    });
}

#[test]
fn edits() {
    fuzz("edits", |scratch| {
        let seed = r#"{"format": 1, "operations": [
            {"segments": ["red"], "operation": {"recolour": {"rgb": [0.1, 0.2, 0.3], "keep_shading": true}}},
            {"segments": ["red", "blue"], "operation": {"opacity": {"factor": 0.5}}},
            {"segments": ["red"], "operation": "hide"},
            {"segments": ["red"], "operation": {"translate": {"by": [0, 1, -2.5]}}},
            {"segments": ["red"], "operation": {"rotate": {"axis": [0, 0, 1], "degrees": 90, "about": null}}},
            {"segments": ["red"], "operation": {"scale": {"factor": 2, "about": [0, 0, 0]}}}],
            "undone": [{"segments": ["x"], "operation": "isolate"}]}"#;
        let (path, again, scratch) = (scratch.path("edits.json"), scratch.path("again.json"), scratch.clone());
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            let Some(mut stack) = accepted(EditStack::load(&path)) else { return false };
            let _ = stack.list(&volseggs::data::Calibration::default());
            accepted(stack.validate(&|name| name == "red"));
            stack.save(&again).unwrap();
            assert_eq!(EditStack::load(&again).unwrap(), stack, "unchanged by writing and reading");
            let _ = (stack.undo().is_some(), stack.redo().is_some());
            true
        };
        let tokens = &[
            "\"show\"",
            "\"hide\"",
            "\"rotate\"",
            "\"scale\"",
            "\"about\"",
            "\"segments\"",
            "[]",
            "\"format\": 2,",
            "1e39",
        ];
        Target::new(vec![seed.as_bytes().to_vec()], read).tokens(tokens)
    });
}

#[test]
fn ply() {
    fuzz("ply", |scratch| {
        let path = scratch.path("a.ply");
        let seeds = [0, 1].map(|sh_degree: usize| {
            let n = 2;
            let gaussians = HostGaussians {
                means: [0.0, 1.0, 2.0].repeat(n),
                log_scales: vec![-3.0; 3 * n],
                rotations: [1.0, 0.0, 0.0, 0.0].repeat(n),
                opacity_logits: vec![0.5; n],
                sh: vec![0.25; n * 3 * (sh_degree + 1).pow(2)],
                sh_stride: (sh_degree + 1).pow(2),
                ..HostGaussians::default()
            };
            ply::write(&gaussians, &path, &SplatFileOptions::default()).unwrap();
            std::fs::read(&path).unwrap()
        });
        let scratch = scratch.clone();
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            let Some(found) = accepted(ply::read(&path)) else { return false };
            assert_eq!(found.sh.len(), found.len() * found.sh_stride * 3);
            true
        };
        let tokens = &[
            "property float ",
            "property double x\n",
            "property uchar a\n",
            "element vertex 9\n",
            "end_header\n",
            "comment \n",
        ];
        Target::new(seeds.to_vec(), read).tokens(tokens)
    });
}
