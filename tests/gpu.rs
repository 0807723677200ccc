//! Training on the GPU beside training on the CPU: the same quality after 200 steps, and a checkpoint of either goes on
//! on the other. Without an adapter it skips with a line, unless `VOLSEGGS_REQUIRE_GPU` is set.
#![cfg(feature = "wgpu")]
#![allow(clippy::unwrap_used)]

mod common;

use common::{dataset, json, metrics, train};
use std::io::Write;
use std::path::Path;
use volseggs::device::DeviceName;

/// 40 steps of warm-up, 160 of both; a margin for the sums whose order differs, no more.
const STEPS: &[&str] = &[
    "stages.warmup_steps=40",
    "stages.joint_steps=160",
    "output.checkpoint_every=100",
    "output.eval_every=200",
    "output.eval_views=6",
];

fn is_there() -> bool {
    match DeviceName::Wgpu.open() {
        Ok(_) => true,
        Err(error) => {
            assert!(std::env::var_os("VOLSEGGS_REQUIRE_GPU").is_none(), "{error}");
            // past the capture of tests, so that it is seen
            let _ = writeln!(std::io::stderr(), "skipped: {error}");
            false
        }
    }
}

fn test_psnr(run: &Path) -> f64 {
    metrics(run).last().unwrap()["test_psnr"].as_f64().unwrap()
}

#[test]
fn two_hundred_steps_end_alike_on_every_device() {
    if !is_there() {
        return;
    }
    let root = dataset();
    let on = |device: &str| {
        train(root.path(), device, STEPS).args(["--device", device]).assert().success();
        let run = root.path().join(device);
        assert_eq!(json(&run.join("run.json"))["gaussians"], 400);
        test_psnr(&run)
    };
    let [flex, ndarray, wgpu] = ["flex", "ndarray", "wgpu"].map(on);
    eprintln!("test PSNR, dB: flex {flex:.4}, ndarray {ndarray:.4}, wgpu {wgpu:.4}");
    assert!((flex - ndarray).abs() < 0.05 && (flex - wgpu).abs() < 0.05, "{flex} {ndarray} {wgpu}");
}

#[test]
fn a_checkpoint_of_one_device_goes_on_on_another() {
    if !is_there() {
        return;
    }
    let root = dataset();
    train(root.path(), "straight", STEPS).assert().success();
    let expected = test_psnr(&root.path().join("straight"));
    for (first, second) in [("flex", "wgpu"), ("wgpu", "flex")] {
        let name = format!("{first}-{second}");
        train(root.path(), &name, STEPS).args(["--device", first, "--stop-after", "100"]).assert().success();
        train(root.path(), &name, STEPS).args(["--device", second, "--resume"]).assert().success();
        let run = root.path().join(&name);
        assert_eq!(json(&run.join("run.json"))["status"], "complete");
        let psnr = test_psnr(&run);
        eprintln!("{name}: {psnr:.4} dB, straight {expected:.4} dB");
        assert!((psnr - expected).abs() < 0.05, "{name}: {psnr} against {expected}");
    }
}
