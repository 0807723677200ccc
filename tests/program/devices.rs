//! Training on every device besides the default one. CPU devices run the same kernels and give the same bytes; GPUs sum
//! in another order and reach the same quality after 200 steps. A checkpoint of either can be resumed on the other.
#![cfg(any(feature = "ndarray", feature = "tch", feature = "wgpu", feature = "cuda"))]

use crate::common::{dataset, json, metrics, newest_bytes, train};
use std::path::Path;
use std::sync::OnceLock;
use tempfile::TempDir;
use volseggs::device::DeviceName;

/// 40 steps of warm-up, 160 of joint training; the margin only allows for sums in another order.
const LONG: &[&str] = &[
    "stages.warmup_steps=40",
    "stages.joint_steps=160",
    "output.checkpoint_every=100",
    "output.eval_every=200",
    "output.eval_views=6",
];

/// 20 steps of warm-up, 40 of joint training: enough for either device to go on where the other stopped.
const SHORT: &[&str] = &[
    "stages.warmup_steps=20",
    "stages.joint_steps=40",
    "output.checkpoint_every=30",
    "output.eval_every=60",
    "output.eval_views=6",
];

/// Returns the folder of the dataset, with a run `long` and a run `short` on the default device.
fn straight() -> &'static Path {
    static ROOT: OnceLock<TempDir> = OnceLock::new();
    let folder = ROOT.get_or_init(|| {
        let folder = dataset();
        train(folder.path(), "long", LONG).assert().success();
        train(folder.path(), "short", SHORT).assert().success();
        folder
    });
    folder.path()
}

fn test_psnr(run: &Path) -> f64 {
    metrics(run).last().unwrap()["test_psnr"].as_f64().unwrap()
}

/// Checks that the run `name`, in which `device` took part and that ended on `last`, matches `expected`, which was
/// trained on the default device alone.
fn alike(device: DeviceName, last: DeviceName, name: &str, expected: &str) {
    let (run, straight) = (straight().join(name), straight().join(expected));
    let record = json(&run.join("run.json"));
    assert_eq!((&record["status"], &record["device"]), (&"complete".into(), &last.to_string().into()));
    assert_eq!(record["gaussians"], 400);
    let (psnr, expected) = (test_psnr(&run), test_psnr(&straight));
    eprintln!("{name}: {psnr:.4} dB, on the default device {expected:.4} dB");
    match device {
        DeviceName::Wgpu | DeviceName::Cuda => assert!((psnr - expected).abs() < 0.05, "{name}: {psnr} for {expected}"),
        _ => assert!(newest_bytes(&run) == newest_bytes(&straight), "{name} ends with different bytes"),
    }
}

fn two_hundred_steps_match_the_default_device(device: DeviceName) {
    let name = device.to_string();
    train(straight(), &name, LONG).args(["--device", &name]).assert().success();
    alike(device, device, &name, "long");
}

fn a_checkpoint_resumes_on_the_other_device(device: DeviceName) {
    let default = DeviceName::all()[0];
    for (first, second) in [(default, device), (device, default)] {
        let name = format!("{first}-{second}");
        let on = |device: DeviceName, more: &[&str]| {
            train(straight(), &name, SHORT).args(["--device", &device.to_string()]).args(more).assert().success();
        };
        on(first, &["--stop-after", "30"]);
        on(second, &["--resume"]);
        alike(device, second, &name, "short");
    }
}

// without the default device, which would be compared with itself
volseggs_testing::on_devices!(
    crate::common::open => [ndarray "ndarray", tch "tch", wgpu "wgpu", cuda "cuda"]
    two_hundred_steps_match_the_default_device a_checkpoint_resumes_on_the_other_device
);
