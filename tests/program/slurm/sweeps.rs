//! Real runs on Slurm: submitted twice at once, cancelled, out of time.

use super::cluster::Cluster;
use crate::common::{BINARY, SETTINGS, json, write_dataset};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::{Duration, Instant};

struct Site {
    cluster: Cluster,
    root: PathBuf,
}

impl Site {
    fn file(&self, name: &str, text: &str) -> PathBuf {
        let path = self.root.join(format!("{name}.toml"));
        let settings = SETTINGS.iter().map(|s| s.split_once('=').unwrap());
        let set: String = settings.map(|(k, v)| format!("\"{k}\" = {v}\n")).collect();
        std::fs::write(&path, format!("{text}\n[data]\nballs = \"data\"\n[set]\n{set}")).unwrap();
        path
    }

    /// Returns the command `volseggs sweep ARGUMENTS...` for this cluster's Slurm.
    fn sweep(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(BINARY);
        command.arg("sweep").args(arguments).args(["--out", self.out().to_str().unwrap()]);
        command.env("SLURM_CONF", self.cluster.conf());
        command
    }

    fn out(&self) -> PathBuf {
        self.root.join("out")
    }

    fn profile(&self, text: &str) -> PathBuf {
        let path = self.root.join("profile.toml");
        std::fs::write(&path, text).unwrap();
        path
    }

    fn submit(&self, file: &Path, profile: &Path) -> Value {
        let arguments = [file.to_str().unwrap(), "--slurm", "--json", "--profile", profile.to_str().unwrap()];
        let output = succeeded(self.sweep(&arguments).output().unwrap());
        serde_json::from_slice::<Value>(&output.stdout).unwrap()["jobs"].take()
    }

    fn status(&self, file: &Path) -> Vec<Value> {
        let output = succeeded(self.sweep(&["status", file.to_str().unwrap(), "--json"]).output().unwrap());
        let mut status: Value = serde_json::from_slice(&output.stdout).unwrap();
        serde_json::from_value(status["runs"].take()).unwrap()
    }

    fn wait(&self, file: &Path, what: &str, reached: impl Fn(&[Value]) -> bool) -> Vec<Value> {
        let begun = Instant::now();
        loop {
            let status = self.status(file);
            if reached(&status) {
                return status;
            }
            if begun.elapsed() > Duration::from_secs(240) {
                let name = file.file_stem().unwrap();
                let logs = std::fs::read_dir(self.out().join(name).join("slurm")).unwrap();
                let logs: Vec<String> = logs.map(|l| std::fs::read_to_string(l.unwrap().path()).unwrap()).collect();
                panic!("{what}: {status:#?}\n{}", logs.join("\n---\n"));
            }
            std::thread::sleep(Duration::from_millis(300));
        }
    }

    /// Returns all logs of a sweep's tasks, in the order of the jobs.
    fn logs(&self, name: &str) -> String {
        let files = std::fs::read_dir(self.out().join(name).join("slurm")).unwrap().map(|f| f.unwrap().path());
        let mut logs: Vec<PathBuf> = files.filter(|f| f.extension().is_some_and(|e| e == "log")).collect();
        let job = |f: &PathBuf| f.file_stem()?.to_str()?.split('_').next()?.parse::<u64>().ok();
        logs.sort_by_key(job);
        logs.into_iter().map(|f| std::fs::read_to_string(f).unwrap()).collect()
    }
}

fn succeeded(output: Output) -> Output {
    assert!(output.status.success(), "{output:?}");
    output
}

fn all(state: &'static str) -> impl Fn(&[Value]) -> bool {
    move |status| status.iter().all(|s| s["state"] == state)
}

/// Returns the steps that the logs of a run's processes report, in order: `120/4000 3 s, 1.2 h left ...`.
fn steps(log: &str) -> Vec<usize> {
    let step = |line: &str| {
        let mut words = line.split(' ');
        let (step, _) = words.next()?.split_once('/')?;
        words.nth(1)?.starts_with('s').then(|| step.parse().ok())?
    };
    log.lines().filter_map(step).collect()
}

#[test]
fn a_sweep_on_slurm() {
    let Some(cluster) = Cluster::start() else { return };
    let root = Path::new(env!("CARGO_TARGET_TMPDIR")).join("sweep slurm");
    if root.exists() {
        std::fs::remove_dir_all(&root).unwrap();
    }
    write_dataset(&root.join("data"));
    let site = Site { cluster, root };
    // Slurm takes more than a minute to check the limit: the other tests run meanwhile
    let late = start_the_late_task(&site);
    two_submissions_at_once(&site, late);
    a_cancelled_task(&site, late);
    the_late_task_is_out_of_time(&site, late);
}

fn two_submissions_at_once(site: &Site, late: u64) {
    let file = site.file(
        "twice",
        "seeds = [0, 1]\n[[variant]]\nname = 'l2'\n[[variant]]\nname = 'l1'\nset = { 'loss.kind' = 'l1' }",
    );
    let profile = site.profile("time = '10'\ncpus = 1\nmemory = '500M'");
    let jobs: Vec<Value> = std::thread::scope(|s| {
        let both: Vec<_> = (0..2).map(|_| s.spawn(|| site.submit(&file, &profile))).collect();
        both.into_iter().map(|t| t.join().unwrap()).collect()
    });
    println!("two submissions at once: {}", serde_json::to_string(&jobs).unwrap());
    site.wait(&file, "all done", all("done"));
    site.cluster.wait_until_empty(Some(late));
    // however many tasks there were, each run was done by one of them
    let logs = site.logs("twice");
    assert_eq!(logs.lines().filter(|l| *l == "done").count(), 4, "{logs}");
    let tasks: usize =
        jobs.iter().flat_map(|j| j.as_array().unwrap()).map(|j| j["tasks"].as_array().unwrap().len()).sum();
    let passed = logs.lines().filter(|l| *l == "already done" || l.ends_with("holds this run")).count();
    assert_eq!(4 + passed, tasks, "{logs}");
    // nothing is left to submit
    assert_eq!(site.submit(&file, &profile), Value::Array(Vec::new()));
    let output = succeeded(site.sweep(&["collect", file.to_str().unwrap()]).output().unwrap());
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(table.contains("l1") && table.contains('±'), "{table}");
    assert_eq!(json(&site.out().join("twice/results.json"))["set"]["outcomes"].as_array().unwrap().len(), 4);
}

fn a_cancelled_task(site: &Site, late: u64) {
    let file = site.file("cancelled", "[grid]\n'stages.joint_steps' = [3000]");
    let profile = site.profile("time = '10'\ncpus = 1");
    let job = site.submit(&file, &profile)[0]["job"].as_u64().unwrap();
    site.wait(&file, "some steps", |s| s[0]["state"] == "running" && s[0]["step"].as_u64().unwrap() >= 80);
    site.cluster.call("scancel", &[&job.to_string()]);
    site.cluster.wait_until_empty(Some(late));
    let status = site.status(&file);
    assert_eq!(status[0]["state"], "begun", "{status:?}");
    let before = steps(&site.logs("cancelled")).last().copied().unwrap();
    site.submit(&file, &profile);
    site.wait(&file, "done after another submission", all("done"));
    let order = steps(&site.logs("cancelled"));
    println!("cancelled at step {before} or later, resumed from its checkpoint to step {}", order.last().unwrap());
    assert!(order.windows(2).all(|w| w[0] < w[1]), "a step was taken twice: {order:?}");
}

fn late(site: &Site) -> PathBuf {
    // long enough: the warning comes a minute and a half before the limit, at the earliest
    site.file("late", "[grid]\n'stages.joint_steps' = [1000000]")
}

fn start_the_late_task(site: &Site) -> u64 {
    // Slurm checks every 30 s and warns up to 30 s early: with a limit of one minute it may warn before the script
    // runs, and then never again
    let profile = site.profile("time = '2'\ngrace = 60\ncpus = 1");
    site.submit(&late(site), &profile)[0]["job"].as_u64().unwrap()
}

fn the_late_task_is_out_of_time(site: &Site, job: u64) {
    // steps before and after the last warning; on a busy machine the first warning may come before the first step
    let around = || {
        let logs = site.logs("late");
        let (before, after) = logs.rsplit_once("queued again")?;
        Some((*steps(before).last()?, *steps(after).first()?))
    };
    site.wait(&late(site), "resumed after the warning before the time limit", |_| around().is_some());
    let (before, after) = around().unwrap();
    site.cluster.call("scancel", &[&job.to_string()]);
    site.cluster.wait_until_empty(None);
    let order = steps(&site.logs("late"));
    println!("out of time after step {before}, requeued, resumed from step {after}");
    assert!(order.windows(2).all(|w| w[0] < w[1]), "a step was taken twice: {order:?}");
}

#[test]
fn queued_runs_are_not_submitted_again_after_an_edit_of_the_file() {
    let root = Path::new(env!("CARGO_TARGET_TMPDIR")).join("sweep edited");
    if root.exists() {
        std::fs::remove_dir_all(&root).unwrap();
    }
    write_dataset(&root.join("data"));
    // scripts as Slurm's programs: job 7 stays in the queue, later ones leave it at once
    let bin = root.join("bin");
    for (name, body) in [
        ("sbatch", "cd \"${0%/*}\"; echo >>calls; echo $((6 + $(wc -l <calls)))"),
        ("squeue", "echo '7_0|PENDING|0:00|(Resources)'; echo '7_1|RUNNING|0:05|node'"),
        ("scontrol", "exit 1"),
    ] {
        super::cluster::executable(&bin.join(name), body);
    }
    let own = std::env::var_os("PATH").unwrap();
    let path = std::env::join_paths(std::iter::once(bin).chain(std::env::split_paths(&own))).unwrap();
    let settings = SETTINGS.iter().map(|s| s.split_once('=').unwrap());
    let set: String = settings.map(|(k, v)| format!("\"{k}\" = {v}\n")).collect();
    let file = root.join("edited.toml");
    let name = file.to_str().unwrap();
    let edit = |head: &str| std::fs::write(&file, format!("{head}\n[data]\nballs = \"data\"\n[set]\n{set}")).unwrap();
    let call = |arguments: &[&str]| -> Value {
        let mut command = Command::new(BINARY);
        command.arg("sweep").args(arguments).arg("--json").arg("--out").arg(root.join("out")).env("PATH", &path);
        serde_json::from_slice(&succeeded(command.output().unwrap()).stdout).unwrap()
    };
    let submitted = || -> Vec<Value> {
        let jobs = call(&[name, "--slurm"]);
        jobs["jobs"].as_array().unwrap().iter().map(|job| job["tasks"].clone()).collect()
    };
    let states = || -> Vec<Value> {
        let status = call(&["status", name]);
        status["runs"].as_array().unwrap().iter().map(|run| run["state"].clone()).collect()
    };
    edit("seeds = [0, 1]");
    assert_eq!(submitted(), [serde_json::json!([0, 1])]);
    edit("title = 'Another'\nseeds = [0, 1]");
    assert_eq!(submitted(), [] as [Value; 0]);
    assert_eq!(states(), ["queued", "running"]);
    // a new run, before the others
    edit("seeds = [2, 0, 1]");
    assert_eq!(submitted(), [serde_json::json!([0])]);
    assert_eq!(states(), ["to do", "queued", "running"]);
}
