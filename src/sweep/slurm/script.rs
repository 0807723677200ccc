//! The batch script of a sweep: which resources it asks for, how a worker is started, and what signals do to it.
//!
//! Slurm warns the script with USR1 before the time limit, and asks it with TERM to end now (scancel, preemption). In
//! both cases the worker gets TERM, saves its checkpoint and exits with 75; only after USR1 does the task queue itself
//! again.

use std::env;
use std::fmt::Write;
use std::path::{Path, PathBuf, absolute};

use super::{SlurmError, SlurmProfile, io_at};
use crate::shell::quote;

/// Exit code of a worker that was stopped and can resume from its checkpoint (`EX_TEMPFAIL`).
pub const RESUMABLE: u8 = 75;

/// What the script runs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SlurmJob {
    /// Name in the queue and of the script's file.
    pub name: String,
    /// The sweep's folder, absolute.
    pub dir: PathBuf,
    /// Hash of the plan whose runs the tasks are; the newest plan if empty.
    pub plan: String,
    /// What a task may use.
    pub profile: SlurmProfile,
    /// The program as shell text: the profile's `command`, or the quoted path of this program.
    pub command: String,
}

impl SlurmJob {
    /// Makes a job for the sweep in `dir`, named after that folder.
    ///
    /// # Errors
    /// [`SlurmError::Folder`] for a path that Slurm cannot handle, [`SlurmError::Io`] if the working folder or the
    /// running program cannot be determined.
    pub fn new(dir: &Path, profile: SlurmProfile) -> Result<Self, SlurmError> {
        let dir = absolute(dir).map_err(io_at(dir))?;
        let folder = |what| SlurmError::Folder { path: dir.clone(), what };
        let text = dir.to_str().ok_or_else(|| folder("characters that are not UTF-8"))?;
        if text.contains(char::is_control) {
            return Err(folder("control characters"));
        }
        if text.contains('\\') {
            // in the name of an output file, it disables the placeholders for the numbers of job and task
            return Err(folder("a backslash"));
        }
        let command = match &profile.command {
            Some(command) => command.clone(),
            None => {
                let program = env::current_exe().map_err(io_at(Path::new("the running program")))?;
                quote(program.to_str().ok_or_else(|| folder("a program whose path is not UTF-8"))?)
            }
        };
        let plain = |c: char| if c.is_ascii_alphanumeric() || "_.-".contains(c) { c } else { '_' };
        let name: String = dir.file_name().and_then(|n| n.to_str()).unwrap_or("sweep").chars().map(plain).collect();
        Ok(Self { name, plan: String::new(), profile, command, dir })
    }

    /// Returns the folder of the script, the logs and the list of submitted jobs.
    pub fn folder(&self) -> PathBuf {
        folder(&self.dir)
    }

    /// Returns the path of the script.
    pub fn file(&self) -> PathBuf {
        self.folder().join(format!("{}.sbatch", self.name))
    }
}

/// The folder in which a sweep keeps its Slurm files.
pub(super) fn folder(dir: &Path) -> PathBuf {
    dir.join("slurm")
}

/// Returns the batch script of one job array.
pub fn script(job: &SlurmJob) -> String {
    let profile = &job.profile;
    let mut out = String::new();
    // modules come from the login shell's start-up files
    out += if profile.modules.is_empty() { "#!/bin/bash\n" } else { "#!/bin/bash -l\n" };
    for (option, value) in directives(job) {
        // writing to a string does not fail
        let _ = writeln!(out, "#SBATCH --{option}{}{}", if value.is_empty() { "" } else { "=" }, directive(&value));
    }
    for option in &profile.extra {
        let _ = writeln!(out, "#SBATCH {option}");
    }
    let throttle = profile.parallel.map(|n| format!("%{n}")).unwrap_or_default();
    let file = job.file();
    let _ = write!(
        out,
        "\n# One task of this job array trains one run of the sweep in\n\
         #   {dir}\n\
         # Array index plus SWEEP_OFFSET is the number of the run. To submit runs again (0 to 9, for example):\n\
         #   sbatch --array=0-9{throttle} --export=ALL,SWEEP_OFFSET=0 {file}\n\
         # Finished runs are skipped; stopped runs resume from their checkpoint.\n\n",
        dir = job.dir.display(),
        file = quote(&file.to_string_lossy()),
    );
    out += SIGNALS;
    for module in &profile.modules {
        let module = quote(module);
        let _ = writeln!(out, "module load {module}\nready module load {module}");
    }
    for line in &profile.setup {
        let _ = writeln!(out, "{line}\nready {}", quote(line));
    }
    let _ = write!(
        out,
        "export RAYON_NUM_THREADS=\"${{SLURM_CPUS_PER_TASK:-${{SLURM_CPUS_ON_NODE:-1}}}}\"\n\n\
         [[ -z \"$asked\" ]] || finish {RESUMABLE}\n\
         {command} sweep worker {dir} --task \"$task\"{plan} &\n",
        command = job.command,
        dir = quote(&job.dir.to_string_lossy()),
        plan = if job.plan.is_empty() { String::new() } else { format!(" --plan {}", quote(&job.plan)) },
    );
    out += WAIT;
    out
}

fn directives(job: &SlurmJob) -> Vec<(&'static str, String)> {
    let profile = &job.profile;
    let log = job.folder().to_string_lossy().replace('%', "%%");
    let mut out = vec![
        ("job-name", job.name.clone()),
        ("output", format!("{log}/%A_%a.log")),
        ("open-mode", "append".to_owned()),
        ("requeue", String::new()),
        ("signal", format!("B:USR1@{}", profile.grace())),
        ("nodes", "1".to_owned()),
        ("ntasks", "1".to_owned()),
    ];
    let given = [
        ("partition", profile.partition.clone()),
        ("account", profile.account.clone()),
        ("qos", profile.qos.clone()),
        ("time", profile.time.clone()),
        ("mem", profile.memory.clone()),
        ("cpus-per-task", profile.cpus.map(|n| n.to_string())),
        ("gres", profile.gres()),
        ("constraint", profile.constraint.clone()),
    ];
    out.extend(given.into_iter().filter_map(|(option, value)| Some((option, value?))));
    out
}

/// Part before the worker: what signals do, and how the task ends.
const SIGNALS: &str = r#"task=$((SLURM_ARRAY_TASK_ID + ${SWEEP_OFFSET:-0}))
echo "run $task: on $(hostname), start ${SLURM_RESTART_COUNT:-0}, $(date '+%F %T')"

worker=
asked=
stop() {
    # Once is enough.
    [[ -n "$asked" || -z "$worker" ]] || kill -TERM "$worker" 2>/dev/null
    asked=$1
    woken=1
}
trap 'stop limit' USR1
trap 'stop cancel' TERM

finish() {
    worker=
    # 75: stopped, with a checkpoint. 143: stopped before it handled signals, so before it began.
    if [[ "$asked" == limit && ("$1" == 75 || "$1" == 143) ]]; then
        echo "run $task: stopped before the time limit; queued again, $(date '+%F %T')"
        scontrol requeue "${SLURM_ARRAY_JOB_ID}_${SLURM_ARRAY_TASK_ID}" && exit 0
        echo "run $task: this cluster does not allow requeueing; submit the run by hand as described above" >&2
    fi
    exit "$1"
}

ready() {
    local code=$?
    ((code == 0)) && return
    echo "run $task: setup failed with code $code, so nothing is trained: $*" >&2
    exit "$code"
}

"#;

/// Part after the worker's start: waits for it.
const WAIT: &str = r#"worker=$!
# A signal may have arrived before its process id was known.
[[ -z "$asked" ]] || kill -TERM "$worker" 2>/dev/null

code=127
while true; do
    woken=
    wait "$worker"
    answer=$?
    # 127: its code was already reported, as a signal arrived just as it ended.
    [[ "$answer" == 127 ]] && break
    code=$answer
    # A signal ends the wait, not the worker.
    [[ -n "$woken" ]] || break
done
finish "$code"
"#;

/// Quotes a value for an `#SBATCH` line, which interprets quotes and backslashes, though not quite as the shell does.
fn directive(text: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "_./:,=@%+-|&*()[]".contains(c);
    if text.chars().all(plain) {
        return text.to_owned();
    }
    format!("\"{}\"", text.replace('\\', r"\\").replace('"', "\\\""))
}

#[cfg(unix)]
#[cfg(test)]
mod tests;
