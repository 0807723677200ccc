//! The state of a sweep's tasks in Slurm's queue.
//!
//! Only `squeue` is asked: a task that has left the queue is not reported, and its result must be looked for in the
//! sweep's folder.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::path::Path;

use super::profile::seconds;
use super::submit::{Submission, submissions};
use super::tasks::Tasks;
use super::{SlurmError, SlurmTools, complaint};

/// A task in the queue.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TaskState {
    /// Slurm's name of the array task, such as `1234_5`, which `scancel` accepts.
    pub id: String,
    /// Slurm's name of the state, such as `RUNNING` or `PENDING`.
    pub state: String,
    /// Seconds it has run since its last start.
    pub seconds: u64,
    /// The node, or the reason why it waits, such as `(Resources)`.
    pub place: String,
}

impl TaskState {
    /// Whether it holds a node.
    pub fn runs(&self) -> bool {
        matches!(
            self.state.as_str(),
            "RUNNING" | "COMPLETING" | "CONFIGURING" | "SUSPENDED" | "STAGE_OUT" | "SIGNALING"
        )
    }
}

/// Returns the tasks of the sweep in `dir` that are in the queue, by the number of their run in `plan` (its hash, as in
/// [`super::SlurmJob`]), whichever plan they were submitted with. For a run that was submitted twice, the running
/// submission is reported, or else the last one.
///
/// # Errors
/// [`SlurmError::Missing`] without `squeue`, [`SlurmError::Refused`] if it fails, errors of the list of jobs and of
/// stored plans.
pub fn queue(tools: &SlurmTools, dir: &Path, plan: &str) -> Result<BTreeMap<usize, TaskState>, SlurmError> {
    let submissions = submissions(dir)?;
    let mut tasks = Tasks::new(dir, plan, &submissions)?;
    let clusters: BTreeSet<Option<&str>> = submissions.iter().map(|s| s.cluster.as_deref()).collect();
    let mut out: BTreeMap<usize, TaskState> = BTreeMap::new();
    for cluster in clusters {
        let of_it: Vec<&Submission> = submissions.iter().filter(|s| s.cluster.as_deref() == cluster).collect();
        let text = ask(tools, cluster, &of_it)?;
        let mut rows: Vec<(u64, usize, TaskState)> = text.lines().filter_map(row).collect();
        rows.sort_by_key(|(job, ..)| *job);
        for (job, index, state) in rows {
            let Some(submission) = of_it.iter().rfind(|s| s.job == job) else { continue };
            let Some(run) = tasks.run(submission, index + submission.offset)? else { continue };
            if !out.get(&run).is_some_and(|known| known.runs() && !state.runs()) {
                out.insert(run, state);
            }
        }
    }
    Ok(out)
}

fn ask(tools: &SlurmTools, cluster: Option<&str>, of_it: &[&Submission]) -> Result<String, SlurmError> {
    let jobs: Vec<String> = of_it.iter().map(|s| s.job.to_string()).collect();
    let mut arguments: Vec<OsString> = vec![
        "--array".into(),
        "--noheader".into(),
        "--format=%i|%T|%M|%R".into(),
        format!("--jobs={}", jobs.join(",")).into(),
    ];
    arguments.extend(cluster.map(|name| format!("--clusters={name}").into()));
    let output = tools.call("squeue", &arguments)?;
    // if Slurm has forgotten all of them, squeue fails when asked for one job, but not when asked for several
    let said = complaint(&output);
    if !output.status.success() && !said.contains("Invalid job id") {
        return Err(SlurmError::Refused { program: "squeue".to_owned(), said });
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Job, array index and state of a line; `None` for a line that is not an array task.
fn row(line: &str) -> Option<(u64, usize, TaskState)> {
    let mut parts = line.trim().splitn(4, '|');
    let (id, state, time, place) = (parts.next()?, parts.next()?, parts.next()?, parts.next()?);
    let (job, index) = id.split_once('_')?;
    let state = TaskState {
        id: id.to_owned(),
        state: state.to_owned(),
        seconds: seconds(time).unwrap_or(0),
        place: place.to_owned(),
    };
    Some((job.parse().ok()?, index.parse().ok()?, state))
}

#[cfg(unix)]
#[cfg(test)]
mod tests {
    use super::super::fake;
    use super::*;
    use std::fs;

    fn asked(list: &str, squeue: &str) -> Result<BTreeMap<usize, TaskState>, SlurmError> {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("slurm")).unwrap();
        fs::write(dir.path().join("slurm/jobs.jsonl"), list).unwrap();
        let bin = dir.path().join("bin");
        fake::program(&bin, "squeue", squeue);
        queue(&SlurmTools::new(&fake::path(&bin)), dir.path(), "")
    }

    const TWO: &str = "{\"format\":1,\"plan\":\"\",\"job\":4,\"offset\":0,\"tasks\":[1,2,3],\"time\":1}\n\
                       {\"format\":1,\"plan\":\"\",\"job\":9,\"offset\":1000,\"tasks\":[1001],\"time\":2}\n\
                       {\"format\":1,\"plan\":\"\",\"job\":12,\"offset\":0,\"tasks\":[1,2],\"time\":3}\n";

    #[test]
    fn indices_become_tasks_and_the_running_one_of_two_counts() {
        let found = asked(
            TWO,
            "[[ $* == '--array --noheader --format=%i|%T|%M|%R --jobs=4,9,12' ]] || exit 9\n\
             echo '12_1|PENDING|0:00|(Resources)'; echo '12_2|PENDING|0:00|(JobArrayTaskLimit)'\n\
             echo '4_1|RUNNING|1-02:00:00|node7'; echo '4_2|PENDING|0:00|(a|b)'; echo '9_1|COMPLETING|1:05|n[1-2]'\n\
             echo '77_1|RUNNING|0:01|x'; echo '12|RUNNING|0:01|x'; echo 'CLUSTER: a'; echo '12_|a|b|c'; echo",
        )
        .unwrap();
        assert_eq!(found.keys().copied().collect::<Vec<_>>(), [1, 2, 1001]);
        let state = |id: &str, state: &str, seconds, place: &str| TaskState {
            id: id.to_owned(),
            state: state.to_owned(),
            seconds,
            place: place.to_owned(),
        };
        assert_eq!(found[&1], state("4_1", "RUNNING", 93600, "node7"));
        assert_eq!(found[&2], state("12_2", "PENDING", 0, "(JobArrayTaskLimit)"));
        assert_eq!(found[&1001], state("9_1", "COMPLETING", 65, "n[1-2]"));
    }

    #[test]
    fn jobs_that_left_the_queue_are_no_error() {
        let gone = "echo 'slurm_load_jobs error: Invalid job id specified' >&2; exit 1";
        assert!(asked(TWO, gone).unwrap().is_empty());
        // nothing submitted: squeue is not asked
        assert!(asked("", "exit 1").unwrap().is_empty());
        let said = asked(TWO, "echo 'Unable to contact slurm controller' >&2; exit 1").unwrap_err().to_string();
        assert!(said.contains("Unable to contact"), "{said}");
    }

    #[test]
    fn tasks_of_earlier_plans_count_as_the_runs_with_their_keys() {
        let dir = tempfile::tempdir().unwrap();
        for folder in ["slurm", "plans"] {
            fs::create_dir(dir.path().join(folder)).unwrap();
        }
        let put = |name: &str, keys: &[&str]| {
            let runs: Vec<_> = keys.iter().map(|key| serde_json::json!({ "key": key, "label": "x" })).collect();
            fs::write(dir.path().join(name), serde_json::json!({ "format": 1, "runs": runs }).to_string()).unwrap();
        };
        put("plans/old.json", &["a", "b", "c"]);
        put("plans/now.json", &["c", "a", "d", "e"]);
        fs::write(dir.path().join("plans/torn.json"), "{\"runs\":[").unwrap();
        let line = |job: u64, plan: &str| {
            format!("{{\"format\":1,\"job\":{job},\"offset\":0,\"tasks\":[0],\"plan\":\"{plan}\",\"time\":1}}\n")
        };
        let list = [(4, "old"), (9, "now"), (11, "gone"), (12, "torn"), (13, "")].map(|(job, plan)| line(job, plan));
        fs::write(dir.path().join("slurm/jobs.jsonl"), list.concat()).unwrap();
        let bin = dir.path().join("bin");
        fake::program(
            &bin,
            "squeue",
            "for task in 4_1 4_2 4_7 9_1 9_2 11_0 12_0 13_0; do echo \"$task|PENDING|0:00|x\"; done\n\
             echo '4_0|RUNNING|0:05|x'",
        );
        let found = || {
            let found = queue(&SlurmTools::new(&fake::path(&bin)), dir.path(), "now").unwrap();
            found.into_iter().map(|(run, state)| (run, state.id)).collect::<Vec<_>>()
        };
        let at = |run: usize, id: &str| (run, id.to_owned());
        assert_eq!(found(), [at(0, "4_2"), at(1, "4_0"), at(2, "9_2")]);
    }

    #[test]
    fn several_clusters_are_asked_apart() {
        let list = "{\"format\":1,\"plan\":\"\",\"job\":4,\"cluster\":\"big\",\"offset\":0,\"tasks\":[1],\"time\":1}\n\
                    {\"format\":1,\"plan\":\"\",\"job\":4,\"offset\":0,\"tasks\":[2],\"time\":1}\n";
        let found = asked(
            list,
            "case $* in *--clusters=big*) echo 'CLUSTER: big'; echo '4_1|RUNNING|0:01|x';; \
             *) echo '4_2|PENDING|INVALID|y';; esac",
        )
        .unwrap();
        assert_eq!(found.len(), 2);
        assert_eq!((found[&1].seconds, found[&2].seconds), (1, 0));
    }
}
