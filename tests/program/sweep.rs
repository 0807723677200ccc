//! Sweeps as whole programs: nothing is lost, nothing is done twice, whatever happens in between.

use crate::common::{BINARY, SETTINGS, json, write_dataset};
use assert_cmd::Command;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant, SystemTime};

/// A folder with a dataset in `data`, made once.
fn root() -> &'static Path {
    static ROOT: OnceLock<PathBuf> = OnceLock::new();
    ROOT.get_or_init(|| {
        let root = Path::new(env!("CARGO_TARGET_TMPDIR")).join("sweep");
        if root.exists() {
            std::fs::remove_dir_all(&root).unwrap();
        }
        write_dataset(&root.join("data"));
        root
    })
}

/// Writes a sweep file whose runs are as small as those of the other tests; returns its path.
fn sweep_file(name: &str, text: &str) -> PathBuf {
    let path = root().join(format!("{name}.toml"));
    let set: String =
        SETTINGS.iter().map(|s| s.split_once('=').unwrap()).map(|(k, v)| format!("\"{k}\" = {v}\n")).collect();
    std::fs::write(&path, format!("{text}\n[data]\nballs = \"data\"\n[set]\n{set}")).unwrap();
    path
}

/// Returns the command `volseggs sweep ARGUMENTS... --out OUT`.
fn sweep(arguments: &[&str], file: &Path, out: &Path) -> Command {
    let mut program = Command::new(BINARY);
    program.arg("sweep").args(arguments).arg(file).arg("--out").arg(out);
    program
}

fn start(file: &Path, out: &Path) -> Child {
    let mut program = std::process::Command::new(BINARY);
    program.arg("sweep").arg(file).args(["--jobs", "2", "--out"]).arg(out);
    program.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

/// Returns the metrics files of completed runs, with the times at which they were written.
fn done(out: &Path) -> BTreeMap<PathBuf, SystemTime> {
    let Ok(runs) = std::fs::read_dir(out.join("runs")) else { return BTreeMap::new() };
    let files = runs.flat_map(|r| std::fs::read_dir(r.unwrap().path()).unwrap().map(|f| f.unwrap().path()));
    let metrics = files.filter(|f| f.file_name().unwrap().to_string_lossy().starts_with("metrics-"));
    metrics.map(|f| (f.clone(), f.metadata().unwrap().modified().unwrap())).collect()
}

/// Returns the report without what depends on the clock.
fn table(out: &Path, name: &str) -> Vec<Value> {
    let results = json(&out.join(name).join("results.json"));
    let outcomes = results["set"]["outcomes"].as_array().unwrap();
    let stable = |o: &Value| {
        serde_json::json!([o["variant"], o["seed"], o["state"], o["metrics"]["psnr"], o["metrics"]["ssim"]])
    };
    outcomes.iter().map(stable).collect()
}

const TWELVE: &str = "seeds = [0, 1]\nmetrics = ['psnr', 'ssim', 'training_minutes']\n[grid]\n\
                      'loss.kind' = ['l1', 'l2']\n'model.channels' = [4, 8, 16]";

#[test]
fn a_sweep_that_is_killed_three_times_loses_nothing_and_repeats_nothing() {
    let file = sweep_file("twelve", TWELVE);
    let (straight, killed) = (root().join("straight"), root().join("killed"));
    sweep(&["--jobs", "2"], &file, &straight).assert().success();
    assert_eq!(done(&straight).len(), 12);
    let mut before = BTreeMap::new();
    for wanted in [2, 5, 9] {
        let mut child = start(&file, &killed);
        let patience = Instant::now();
        while done(&killed).len() < wanted && patience.elapsed() < Duration::from_secs(120) {
            std::thread::sleep(Duration::from_millis(20));
        }
        // SIGKILL, in the middle of other runs
        child.kill().unwrap();
        child.wait().unwrap();
        let now = done(&killed);
        assert!((wanted..12).contains(&now.len()), "{} done", now.len());
        assert!(before.iter().all(|(f, t)| now.get(f) == Some(t)), "a completed run was repeated");
        before = now;
    }
    sweep(&["--jobs", "2"], &file, &killed).assert().success();
    let now = done(&killed);
    assert_eq!(now.len(), 12);
    assert!(before.iter().all(|(f, t)| now.get(f) == Some(t)), "a completed run was repeated");
    assert_eq!(table(&straight, "twelve"), table(&killed, "twelve"));
    // nothing is left to do, so nothing is done
    let again = sweep(&["--json"], &file, &killed).assert().success();
    let results: Value = serde_json::from_slice(&again.get_output().stdout).unwrap();
    assert_eq!(results["outcomes"].as_array().unwrap().len(), 12);
    assert_eq!(done(&killed), now);
    for name in ["report.html", "report.md", "table.tex", "results.csv", "results.json", "tensorboard"] {
        assert!(killed.join("twelve").join(name).exists(), "{name}");
    }
}

#[test]
fn two_simultaneous_calls_share_the_runs() {
    let file = sweep_file("shared", "seeds = [7]\n[grid]\n'model.channels' = [4, 8, 16, 32]");
    let out = root().join("shared-out");
    let mut other = start(&file, &out);
    sweep(&["--jobs", "2"], &file, &out).assert().success();
    assert!(other.wait().unwrap().success());
    assert_eq!(done(&out).len(), 4);
    // each run was trained by one process
    for log in std::fs::read_dir(out.join("shared/logs")).unwrap() {
        let text = std::fs::read_to_string(log.unwrap().path()).unwrap();
        assert_eq!(text.matches("\ndone\n").count(), 1, "{text}");
    }
}

#[test]
fn a_failed_run_is_recorded_and_the_others_continue() {
    let file = sweep_file(
        "failing",
        "[[variant]]\nname = 'good'\n[[variant]]\nname = 'wild'\nset = { 'optim.means' = 1e38 }\n\
         [[variant]]\nname = 'other'\nset = { 'loss.kind' = 'l1' }",
    );
    let out = root().join("failing-out");
    let said = sweep(&[], &file, &out).assert().code(1);
    let text = String::from_utf8_lossy(&said.get_output().stderr).into_owned();
    assert!(text.contains("1 runs failed") && text.contains("not finite"), "{text}");
    assert_eq!(done(&out).len(), 2);
    let table = String::from_utf8_lossy(&said.get_output().stdout).into_owned();
    assert!(table.contains("not finite"), "{table}");
    // it is not retried unless requested
    let again = sweep(&[], &file, &out).assert().code(1);
    assert!(String::from_utf8_lossy(&again.get_output().stderr).contains("1 failed before"));
    let planned = |more: &[&str]| {
        let said = sweep(&[&["--dry-run"], more].concat(), &file, &out).assert().success();
        String::from_utf8_lossy(&said.get_output().stdout).into_owned()
    };
    assert!(planned(&[]).contains("remaining: 0 runs"));
    let retried = planned(&["--rerun-failed"]);
    assert!(retried.contains("remaining: 1 runs") && retried.contains(" retry "), "{retried}");
    let asked = sweep(&["--rerun-failed", "--only", "wild"], &file, &out).assert().code(1);
    assert!(String::from_utf8_lossy(&asked.get_output().stderr).contains("FAILED"));
    let status = sweep(&["status"], &file, &out).assert().success();
    let status = String::from_utf8_lossy(&status.get_output().stdout).into_owned();
    assert_eq!((status.matches(" done ").count(), status.matches(" failed ").count()), (2, 1), "{status}");
    // from within the sweep's folder
    let within =
        Command::new(BINARY).current_dir(out.join("failing")).args(["sweep", "status", "."]).assert().success();
    let within = String::from_utf8_lossy(&within.get_output().stdout).into_owned();
    assert_eq!((within.matches(" done ").count(), within.matches(" failed ").count()), (2, 1), "{within}");
}

#[test]
fn a_run_that_was_lengthened_by_hand_is_not_measured_as_the_sweeps_run() {
    let file = sweep_file("lengthened", "");
    let out = root().join("lengthened-out");
    sweep(&[], &file, &out).assert().success();
    let run = std::fs::read_dir(out.join("runs")).unwrap().next().unwrap().unwrap().path();
    let mut longer = Command::new(BINARY);
    longer.args(["train", "--set", "stages.joint_steps=90", "--resume"]).arg(&run).assert().success();
    let steps = json(&run.join("run.json"))["steps"].as_u64().unwrap();
    let text = std::fs::read_to_string(&file).unwrap();
    std::fs::write(&file, format!("[eval]\nviews = 1\n{text}")).unwrap();
    let said = sweep(&[], &file, &out).assert().code(1);
    let text = String::from_utf8_lossy(&said.get_output().stderr).into_owned();
    assert!(text.contains(&format!("was trained on to step {steps}")), "{text}");
}

#[test]
fn a_run_that_fails_before_a_rung_fails_the_sweep() {
    let file = sweep_file(
        "wild",
        "[[variant]]\nname = 'good'\n[[variant]]\nname = 'wild'\nset = { 'optim.means' = 1e38 }\n\
         [halving]\nrungs = [40]\nkeep = 0.5",
    );
    let out = root().join("wild-out");
    let said = sweep(&[], &file, &out).assert().code(1);
    let text = String::from_utf8_lossy(&said.get_output().stderr).into_owned();
    assert!(text.contains("1 runs failed"), "{text}");
}

#[test]
fn a_dry_run_lists_the_runs_and_changes_nothing() {
    let file = sweep_file("dry", TWELVE);
    let out = root().join("dry-out");
    let said = sweep(&["--dry-run"], &file, &out).assert().success();
    let text = String::from_utf8_lossy(&said.get_output().stdout).into_owned();
    assert!(text.contains("12 runs") && text.contains("model.channels = 16"), "{text}");
    assert!(!out.exists());
    sweep(&["--dry-run", "--only", "nothing-like-it"], &file, &out).assert().code(2);
}

#[test]
fn metrics_that_no_row_would_have_are_refused_before_training() {
    let file = sweep_file("no-segments", "metrics = ['psnr', 'iou']");
    let out = root().join("no-segments-out");
    let said = sweep(&[], &file, &out).assert().code(2);
    let text = String::from_utf8_lossy(&said.get_output().stderr).into_owned();
    assert!(text.contains("metrics: \"iou\"") && text.contains("add [segments]"), "{text}");
    assert!(!out.exists());
}

#[test]
fn halving_stops_the_worst() {
    let file = sweep_file(
        "halved",
        "[[variant]]\nname = 'a'\n[[variant]]\nname = 'b'\nset = { 'optim.sh' = 0.0 }\n[[variant]]\nname = 'c'\n\
         set = { 'loss.kind' = 'l1' }\n[[variant]]\nname = 'd'\nset = { 'optim.opacity' = 0.0 }\n\
         [halving]\nrungs = [40]\nkeep = 0.5",
    );
    let out = root().join("halved-out");
    sweep(&["--jobs", "2"], &file, &out).assert().success();
    assert_eq!(done(&out).len(), 2);
    let results = json(&out.join("halved/results.json"));
    let mut at_rung: Vec<(f64, bool)> = Vec::new();
    for outcome in results["set"]["outcomes"].as_array().unwrap() {
        let log = std::fs::read_to_string(Path::new(outcome["run"].as_str().unwrap()).join("metrics.jsonl")).unwrap();
        let lines = log.lines().map(|l| serde_json::from_str::<Value>(l).unwrap());
        let psnr = lines.filter(|l| l["step"] == 40).find_map(|l| l["test_psnr"].as_f64()).unwrap();
        at_rung.push((psnr, outcome["state"]["stopped"] == 40));
    }
    at_rung.sort_by(|a, b| a.0.total_cmp(&b.0));
    let stopped: Vec<bool> = at_rung.iter().map(|(_, stopped)| *stopped).collect();
    assert_eq!(stopped, [true, true, false, false], "{at_rung:?}");
}

#[test]
fn runs_are_compared_over_their_seeds() {
    let file = sweep_file(
        "compared",
        "seeds = [3, 4]\n[[variant]]\nname = 'x'\n[[variant]]\nname = 'y'\nset = { 'loss.kind' = 'l1' }",
    );
    let out = root().join("compared-out");
    sweep(&["--jobs", "2"], &file, &out).assert().success();
    let mut runs: Vec<PathBuf> = std::fs::read_dir(out.join("runs")).unwrap().map(|r| r.unwrap().path()).collect();
    runs.sort();
    let mut compare = Command::new(BINARY);
    let said = compare.arg("compare").args(&runs).arg("--out").arg(root().join("comparison")).assert().success();
    let text = String::from_utf8_lossy(&said.get_output().stdout).into_owned();
    // two rows, each of two seeds
    assert_eq!(text.lines().filter(|l| l.contains('±')).count(), 2, "{text}");
    let page = std::fs::read_to_string(root().join("comparison/report.html")).unwrap();
    assert!(page.contains("<svg") || page.contains("data:image/svg"), "no curves");
    Command::new(BINARY).args(["compare", "/no/such/run"]).assert().code(2);
    // evaluated on fewer views, a run cannot be compared with the others
    let mean = runs[1].join("eval/test/mean.json");
    let mut summary = json(&mean);
    summary["views"] = 2.into();
    std::fs::write(&mean, summary.to_string()).unwrap();
    let refused = Command::new(BINARY).arg("compare").args(&runs).assert().code(2);
    let text = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
    assert!(text.contains("measured on 2 views of") && text.contains("volseggs eval"), "{text}");
}

#[test]
fn devices_are_trained_and_compared() {
    let mut program = Command::new(BINARY);
    program
        .args(["sweep", "devices", "--devices", "flex,ndarray", "--every", "20", "--json", "--data"])
        .arg(root().join("data"));
    for setting in SETTINGS {
        program.args(["--set", setting]);
    }
    let said = program.assert().success();
    let found: Value = serde_json::from_slice(&said.get_output().stdout).unwrap();
    assert_eq!(found["steps"], 80);
    let drift = found["devices"][1]["drift"].as_array().unwrap();
    // the same kernels on both: the same bits
    assert!(drift.iter().all(|d| d["largest"] == 0.0), "{drift:?}");
    assert_eq!(found["devices"][0]["psnr"], found["devices"][1]["psnr"]);
}

/// Makes a copy of the program with other bytes that does the same, as after a rebuild.
fn rebuilt(name: &str) -> PathBuf {
    let path = root().join(name);
    // by another process, as a file that this one has open for writing cannot be started; bytes after the last section
    // of an executable are ignored
    let script = "cp \"$0\" \"$1\" && printf rebuilt >>\"$1\"";
    let copied = std::process::Command::new("sh").args(["-c", script, BINARY]).arg(&path).status().unwrap();
    assert!(copied.success());
    path
}

/// Runs `PROGRAM sweep ARGUMENTS... --out OUT`; returns standard output and standard error.
fn outputs(program: &Path, arguments: &[&str], file: &Path, out: &Path) -> (String, String) {
    let mut command = Command::new(program);
    command.arg("sweep").args(arguments).arg(file).arg("--out").arg(out);
    let output = command.assert().success().get_output().clone();
    (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap())
}

/// Returns the short name of the build of `program`, as `doctor` reports it.
fn build_of(program: &Path) -> String {
    let output = Command::new(program).args(["doctor", "--json"]).assert().success().get_output().clone();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let build = report["build"]["digest"].as_str().unwrap();
    assert!(build.len() == 32 && build.bytes().all(|b| b.is_ascii_hexdigit()), "{report}");
    build[..12].to_owned()
}

const TWO: &str = "metrics = ['psnr', 'fps', 'fps_with_copy', 'model_mb', 'model_mib']\n[[variant]]\nname = 'first'\n\
                   [[variant]]\nname = 'second'\nset = { 'loss.kind' = 'l1' }";

#[test]
fn a_rebuilt_program_retrains_and_adopts_older_runs_only_on_request() {
    let (file, out, program) = (sweep_file("rebuilt", TWO), root().join("rebuilt-out"), Path::new(BINARY));
    let (old, other) = (build_of(program), rebuilt("volseggs-rebuilt"));
    let new = build_of(&other);
    assert_ne!(old, new);
    let (_, message) = outputs(program, &[], &file, &out);
    assert!(!message.contains("build"), "{message}");
    let first = done(&out);
    assert_eq!(first.len(), 2);
    let untouched = |now: &BTreeMap<PathBuf, SystemTime>| first.iter().all(|(f, t)| now.get(f) == Some(t));
    for metrics in first.keys() {
        let run = metrics.parent().unwrap();
        assert!(run.file_name().unwrap().to_str().unwrap().ends_with(&format!("-{old}")), "{run:?}");
        assert!(json(&run.join("run.json"))["build"].as_str().unwrap().starts_with(&old));
        assert!(json(metrics)["build"].as_str().unwrap().starts_with(&old));
    }
    // the same program has nothing to do, and nothing to report about builds
    let (_, message) = outputs(program, &[], &file, &out);
    assert!(message.contains("2 of 2 runs are already done") && !message.contains("build"), "{message}");
    assert_eq!(done(&out), first);

    // the rebuilt program shows the existing results, and names their build
    let (status, message) = outputs(&other, &["status"], &file, &out);
    assert_eq!(status.matches(" done ").count(), 2, "{status}");
    assert!(message.contains(&old) && message.contains(&new), "{message}");
    let (table, message) = outputs(&other, &["collect"], &file, &out);
    assert!(table.contains(&old) && !table.contains("missing") && message.contains(&new), "{table}{message}");

    // it retrains, and says so
    let (_, message) = outputs(&other, &["--dry-run"], &file, &out);
    let line = message.lines().find(|l| l.contains("--any-build")).unwrap();
    assert!(line.contains("2 runs") && line.contains(&old) && line.contains("trained again"), "{line}");
    let (_, message) = outputs(&other, &["--only", "first"], &file, &out);
    assert!(message.contains("--any-build"), "{message}");
    let now = done(&out);
    assert!(now.len() == 3 && untouched(&now), "{now:?}");

    // planned by the new build, half done: the old build's run is reported beside it, and shown on request
    let (status, _) = outputs(&other, &["status"], &file, &out);
    let open = status.lines().find(|l| l.contains(" to do ")).unwrap();
    assert!(open.contains(&old) && status.matches(" done ").count() == 1, "{status}");
    let (table, message) = outputs(&other, &["collect"], &file, &out);
    assert!(
        table.contains("1 missing") && message.contains("--any-build") && message.contains(&old),
        "{table}{message}"
    );
    let (table, _) = outputs(&other, &["collect", "--any-build"], &file, &out);
    assert!(!table.contains("missing") && table.contains(&old) && table.contains(&new), "{table}");

    // on request, it adopts the other one
    let (_, message) = outputs(&other, &["--any-build"], &file, &out);
    assert!(message.contains(&old) && message.contains("2 of 2 runs are already done"), "{message}");
    assert_eq!(done(&out), now);
    let results = json(&out.join("rebuilt/results.json"));
    let builds: Vec<&str> =
        results["set"]["outcomes"].as_array().unwrap().iter().map(|o| o["build"].as_str().unwrap()).collect();
    assert_eq!(builds, [new.as_str(), old.as_str()]);
    // both figures of speed and both units of size are in the table
    for outcome in results["set"]["outcomes"].as_array().unwrap() {
        let metric = |id: &str| outcome["metrics"][id].as_f64().unwrap();
        assert!(metric("fps") > 0.0 && metric("fps_with_copy") > 0.0, "{outcome}");
        assert!((metric("model_mb") * 1e6 - metric("model_mib") * 1024.0 * 1024.0).abs() < 1e-3, "{outcome}");
    }

    // without the request, it goes on to train what it has not trained itself
    outputs(&other, &[], &file, &out);
    let now = done(&out);
    assert!(now.len() == 4 && untouched(&now), "{now:?}");
}

#[test]
fn a_worker_of_an_unplanned_build_trains_its_own_run() {
    let (file, out, program) = (sweep_file("handed", TWO), root().join("handed-out"), Path::new(BINARY));
    outputs(program, &["--only", "first"], &file, &out);
    let (old, other) = (build_of(program), rebuilt("volseggs-handed"));
    let new = build_of(&other);
    // like a Slurm task whose program was rebuilt while it was queued
    let mut worker = Command::new(&other);
    let output = worker.args(["sweep", "worker", "--task", "1"]).arg(out.join("handed")).assert().success();
    let message = String::from_utf8_lossy(&output.get_output().stderr).into_owned();
    assert!(message.contains(&old) && message.contains(&new) && message.contains("\ndone\n"), "{message}");
    let runs: Vec<PathBuf> = done(&out).into_keys().map(|f| f.parent().unwrap().to_owned()).collect();
    let of = |build: &str| runs.iter().filter(|r| r.to_str().unwrap().ends_with(&format!("-{build}"))).count();
    assert_eq!((runs.len(), of(&old), of(&new)), (2, 1, 1), "{runs:?}");
    let (status, _) = outputs(program, &["status"], &file, &out);
    assert!(status.contains(&format!("finished by build {new}")), "{status}");
    // it does not repeat what is done
    let again =
        Command::new(&other).args(["sweep", "worker", "--task", "1"]).arg(out.join("handed")).assert().success();
    assert!(String::from_utf8_lossy(&again.get_output().stderr).contains("already done"));
}

#[test]
#[cfg(target_os = "linux")]
fn all_runs_use_the_program_that_started_even_if_its_file_is_replaced() {
    let (file, out) = (sweep_file("replaced", TWO), root().join("replaced-out"));
    let (program, other) = (rebuilt("volseggs-replaced"), PathBuf::from(BINARY));
    let begun = build_of(&program);
    assert_ne!(begun, build_of(&other));
    let mut command = std::process::Command::new(&program);
    command.arg("sweep").arg(&file).arg("--out").arg(&out);
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let patience = Instant::now();
    while !out.join("replaced/plan.json").is_file() && patience.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(5));
    }
    // as a linker replaces the old file with a new one
    let next = root().join("volseggs-next");
    let copied = std::process::Command::new("cp").arg(&other).arg(&next).status().unwrap();
    assert!(copied.success());
    std::fs::rename(&next, &program).unwrap();
    assert!(child.wait().unwrap().success());
    let runs: Vec<PathBuf> = done(&out).into_keys().map(|f| f.parent().unwrap().to_owned()).collect();
    assert!(runs.len() == 2 && runs.iter().all(|r| r.to_str().unwrap().ends_with(&format!("-{begun}"))), "{runs:?}");
    assert!(runs.iter().all(|r| json(&r.join("run.json"))["build"].as_str().unwrap().starts_with(&begun)), "{runs:?}");
}
