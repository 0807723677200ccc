//! Runs of a plan as processes on this machine: several at a time, sharing the cores evenly, a line for each that ends.
//!
//! Each run is a process of its own (`sweep worker`), so that one that runs out of memory or panics does not affect the
//! others, and a sweep that is killed leaves whole checkpoints behind. Children end when this process does.

use super::SweepError;
use super::halving;
use super::plan::Plan;
use super::result::{
    RunCompletion, RunFailure, failure_path, live_psnr, metrics_path, progress, read, read_metrics, write,
};
use crate::durations::duration;
use crate::files::RunPaths;
use crate::log::progress::{bar, line};
use indicatif::{MultiProgress, ProgressBar};
use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Exit code of a worker that was interrupted and can be resumed.
pub const INTERRUPTED: u8 = super::slurm::script::RESUMABLE;
/// Exit code of a worker whose run another process has.
pub const HELD: u8 = 76;

/// How to run a plan on this machine.
#[derive(Clone, Debug)]
pub struct LocalOptions {
    /// Folder of the sweep.
    pub dir: PathBuf,
    /// Hash of the plan.
    pub plan: String,
    /// Number of processes at a time.
    pub jobs: usize,
    /// Indices of the runs to do, from 0.
    pub runs: Vec<usize>,
    /// The program, which must be the build that made the plan; see [`crate::program::executable`].
    pub program: PathBuf,
}

/// Numbers of runs by how they ended.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RunTally {
    /// Done now.
    pub done: usize,
    /// Done before.
    pub before: usize,
    /// Failed, with the error recorded.
    pub failed: usize,
    /// Killed by a signal or interrupted; they continue at the next call.
    pub died: usize,
    /// Stopped by successive halving.
    pub stopped: usize,
}

struct LocalJob {
    index: usize,
    child: Child,
    started: Instant,
    line: ProgressBar,
    looked: Instant,
}

/// Runs what is left of `options.runs`, rung by rung if the plan has rungs.
///
/// # Errors
/// If a process cannot be started, or `stop` was raised (children then save checkpoints first).
pub fn run(plan: &Plan, options: &LocalOptions, stop: &AtomicBool) -> Result<RunTally, SweepError> {
    std::fs::create_dir_all(options.dir.join("logs")).map_err(|e| SweepError::io(&options.dir, e))?;
    let mut tally = RunTally::default();
    let mut runs = options.runs.clone();
    let (mut stopped, mut failed_before_end) = (BTreeMap::new(), 0);
    if let Some(spec) = &plan.halving {
        for &rung in &spec.rungs {
            let short =
                |i: &usize| progress(plan, *i) == RunCompletion::Open && steps_done(&plan.run_folder(*i)) < rung;
            let open: Vec<usize> = runs.iter().copied().filter(short).collect();
            if !open.is_empty() {
                errln!("to step {rung}: {} runs", open.len());
                let mut at_rung = RunTally::default();
                Pool::new(plan, options, Some(rung), stop).all(&open, &mut at_rung)?;
                if at_rung.died > 0 {
                    // judged now, they would be judged by fewer steps than the others
                    return Ok(RunTally { died: at_rung.died, failed: at_rung.failed, ..tally });
                }
            }
            // with those not chosen that have come as far before: a run must not be the best of itself alone
            let reached =
                |i: &usize| progress(plan, *i) == RunCompletion::Done || steps_done(&plan.run_folder(*i)) >= rung;
            let field: Vec<usize> =
                (0..plan.runs.len()).filter(|i| runs.contains(i) || !options.runs.contains(i) && reached(i)).collect();
            let kept = halving::survivors(plan, &field, rung, spec.keep);
            let failed = |run: &usize| matches!(progress(plan, *run), RunCompletion::Failed(_));
            let (lost, dropped): (Vec<usize>, Vec<usize>) =
                runs.iter().copied().filter(|run| !kept.contains(run)).partition(failed);
            failed_before_end += lost.len();
            stopped.extend(dropped.into_iter().map(|run| (plan.runs[run].key.clone(), rung)));
            runs.retain(|run| kept.contains(run));
            halving::save(&options.dir, plan, &options.runs, &stopped)?;
        }
        tally.stopped = stopped.len();
        errln!("to the end: {} runs", runs.len());
    }
    let done = |i: &usize| progress(plan, *i) == RunCompletion::Done;
    tally.before = runs.iter().filter(|i| done(i)).count();
    let open: Vec<usize> = runs.iter().copied().filter(|i| progress(plan, *i) == RunCompletion::Open).collect();
    tally.failed = runs.len() - tally.before - open.len();
    if tally.before + tally.failed > 0 {
        errln!("{} of {} runs are already done, {} failed before", tally.before, runs.len(), tally.failed);
    }
    tally.failed += failed_before_end;
    Pool::new(plan, options, None, stop).all(&open, &mut tally)?;
    Ok(tally)
}

/// Steps of the newest checkpoint of the run in `folder`; 0 without one.
pub fn steps_done(folder: &Path) -> usize {
    crate::train::checkpoint::list(folder).last().map_or(0, |(step, _)| *step)
}

struct Pool<'a> {
    plan: &'a Plan,
    options: &'a LocalOptions,
    stop_after: Option<usize>,
    stop: &'a AtomicBool,
    threads: usize,
    screen: MultiProgress,
    overall: ProgressBar,
}

impl<'a> Pool<'a> {
    fn new(plan: &'a Plan, options: &'a LocalOptions, stop_after: Option<usize>, stop: &'a AtomicBool) -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let screen = MultiProgress::new();
        let threads = (cores / options.jobs.max(1)).max(1);
        Self { plan, options, stop_after, stop, threads, overall: screen.add(bar(0, "runs")), screen }
    }

    /// Runs `open`, in order, `jobs` at a time.
    fn all(&self, open: &[usize], tally: &mut RunTally) -> Result<(), SweepError> {
        let mut jobs = Vec::new();
        let ended = self.drive(open, &mut jobs, tally);
        // no child is left behind, even after an error
        self.end(jobs);
        self.overall.finish_and_clear();
        ended
    }

    fn drive(&self, open: &[usize], jobs: &mut Vec<LocalJob>, tally: &mut RunTally) -> Result<(), SweepError> {
        let mut waiting: VecDeque<usize> = open.iter().copied().collect();
        // runs that another process has; tried again now and then
        let mut held: Vec<(usize, Instant)> = Vec::new();
        let mut said_held = Vec::new();
        self.overall.set_length(open.len() as u64);
        self.overall.enable_steady_tick(Duration::from_millis(500));
        while !(waiting.is_empty() && held.is_empty() && jobs.is_empty()) {
            if self.stop.load(Ordering::Relaxed) {
                self.say("saving checkpoints");
                return Err(SweepError::Interrupted);
            }
            while jobs.len() < self.options.jobs
                && let Some(index) = waiting.pop_front()
            {
                jobs.push(self.start(index)?);
            }
            let mut i = 0;
            while i < jobs.len() {
                let Some(status) = jobs[i].child.try_wait().map_err(|e| SweepError::io(&self.options.program, e))?
                else {
                    self.look(&mut jobs[i]);
                    i += 1;
                    continue;
                };
                let job = jobs.remove(i);
                match status {
                    status if status.code() == Some(i32::from(HELD)) => {
                        job.line.finish_and_clear();
                        if !said_held.contains(&job.index) {
                            said_held.push(job.index);
                            self.say(&format!(
                                "{}: left to another process, which has it",
                                self.plan.runs[job.index].label
                            ));
                        }
                        held.push((job.index, Instant::now()));
                    }
                    status => self.ended(&job, status, tally),
                }
            }
            held.retain(|(index, since)| {
                let again = since.elapsed() > Duration::from_secs(3);
                if again {
                    waiting.push_back(*index);
                }
                !again
            });
            std::thread::sleep(Duration::from_millis(50));
        }
        Ok(())
    }

    fn log_path(&self, index: usize) -> PathBuf {
        self.options.dir.join("logs").join(format!("{}.log", self.plan.runs[index].key))
    }

    fn start(&self, index: usize) -> Result<LocalJob, SweepError> {
        let path = self.log_path(index);
        let log = File::options().create(true).append(true).open(&path).map_err(|e| SweepError::io(&path, e))?;
        let errors = log.try_clone().map_err(|e| SweepError::io(&path, e))?;
        let mut command = Command::new(&self.options.program);
        command.arg("sweep").arg("worker").arg(&self.options.dir);
        command.args([
            "--plan",
            &self.options.plan,
            "--task",
            &index.to_string(),
            "--parent",
            &std::process::id().to_string(),
        ]);
        if let Some(steps) = self.stop_after {
            command.args(["--stop-after", &steps.to_string()]);
        }
        command.env("RAYON_NUM_THREADS", self.threads.to_string());
        command.stdin(Stdio::null()).stdout(log).stderr(errors);
        // Ctrl-C goes to this process alone, which then asks its children to end
        #[cfg(unix)]
        {
            use std::os::unix::process::CommandExt;
            command.process_group(0);
            // with the name by which this process was called, whatever path it is started from
            if let Some(name) = std::env::args_os().next() {
                command.arg0(name);
            }
        }
        let child = command.spawn().map_err(|e| SweepError::io(&self.options.program, e))?;
        let line = self.screen.insert_before(&self.overall, line(self.plan.runs[index].steps));
        line.set_message(self.plan.runs[index].label.clone());
        Ok(LocalJob { index, child, started: Instant::now(), line, looked: Instant::now() })
    }

    /// Updates a run's line from its log, about once a second.
    fn look(&self, job: &mut LocalJob) {
        if job.looked.elapsed() < Duration::from_secs(1) || !std::io::stderr().is_terminal() {
            return;
        }
        job.looked = Instant::now();
        let folder = self.plan.run_folder(job.index);
        let Some((step, train)) = last_line(&RunPaths(&folder).metrics()) else { return };
        job.line.set_position(step);
        let test = live_psnr(&folder, usize::MAX).map(|(_, p)| format!(", test {p:.2} dB")).unwrap_or_default();
        job.line.set_message(format!("{}  train {train:.2} dB{test}", self.plan.runs[job.index].label));
    }

    fn say(&self, text: &str) {
        if self.overall.is_hidden() { errln!("{text}") } else { self.overall.println(text) }
    }

    fn ended(&self, job: &LocalJob, status: ExitStatus, tally: &mut RunTally) {
        job.line.finish_and_clear();
        self.overall.inc(1);
        let run = &self.plan.runs[job.index];
        let folder = self.plan.run_folder(job.index);
        let time = duration(job.started.elapsed().as_secs_f64());
        let count = format!("{}/{}", self.overall.position(), self.overall.length().unwrap_or_default());
        let head = format!("{count} {}: {time}", run.label);
        if status.success() {
            tally.done += 1;
            let found = read_metrics(&metrics_path(self.plan, job.index));
            let psnr =
                found.and_then(|m| m.metrics.get("psnr").copied()).or(live_psnr(&folder, usize::MAX).map(|(_, p)| p));
            self.say(&format!("{head}{}", psnr.map(|p| format!(", {p:.2} dB")).unwrap_or_default()));
            return;
        }
        let log = self.log_path(job.index);
        match (status.code(), read::<RunFailure>(&failure_path(&folder))) {
            (Some(code), _) if code == i32::from(INTERRUPTED) => {
                tally.died += 1;
                self.say(&format!("{head}, interrupted; resumes at the next call"));
            }
            (Some(_), Some(failure)) => {
                tally.failed += 1;
                self.say(&format!("{head}, FAILED: {}: {}", failure.stage, failure.error));
            }
            (Some(code), None) => {
                tally.failed += 1;
                // a panic, or an error before the run's folder could be used
                let error = last_words(&log).unwrap_or_else(|| format!("exit code {code}"));
                let failure = RunFailure { error: error.clone(), stage: "process".into() };
                // the run's folder may be the problem; the others go on
                let noted = std::fs::create_dir_all(&folder).is_ok() && write(&failure_path(&folder), &failure).is_ok();
                if !noted {
                    self.say(&format!("{}: the failure cannot be recorded there", folder.display()));
                }
                self.say(&format!("{head}, FAILED: {error}; see {}", log.display()));
            }
            (None, _) => {
                tally.died += 1;
                self.say(&format!("{head}, DIED ({status}; out of memory?); resumes at the next call"));
            }
        }
    }

    /// Asks all children to save and end, and waits for them.
    fn end(&self, jobs: Vec<LocalJob>) {
        for job in &jobs {
            terminate(&job.child);
        }
        for mut job in jobs {
            let _ = job.child.wait();
            job.line.finish_and_clear();
        }
    }
}

/// Asks a process to end.
fn terminate(child: &Child) {
    #[cfg(any(target_os = "linux", target_os = "macos"))]
    if let Some(pid) = i32::try_from(child.id()).ok().and_then(rustix::process::Pid::from_raw) {
        let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
    }
    #[cfg(not(any(target_os = "linux", target_os = "macos")))]
    let _ = child;
}

/// Step and training PSNR of the last complete line of a log, of which only the end is read.
fn last_line(path: &Path) -> Option<(u64, f64)> {
    let text = tail(path, 4096)?;
    let value: serde_json::Value = text.lines().rev().find_map(|l| serde_json::from_str(l).ok())?;
    Some((value["step"].as_u64()?, value["train_psnr"].as_f64()?))
}

/// The last line of a process's log that is not empty and not a `note:`.
fn last_words(path: &Path) -> Option<String> {
    let text = tail(path, 4096)?;
    text.lines().rev().map(str::trim).find(|l| !l.is_empty() && !l.starts_with("note:")).map(str::to_owned)
}

fn tail(path: &Path, bytes: u64) -> Option<String> {
    use std::io::{Read, Seek, SeekFrom};
    let mut file = File::open(path).ok()?;
    let length = file.metadata().ok()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(bytes))).ok()?;
    let mut text = Vec::new();
    file.read_to_end(&mut text).ok()?;
    Some(String::from_utf8_lossy(&text).into_owned())
}
