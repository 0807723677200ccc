//! Submission of a sweep's tasks as job arrays, and the list of what was submitted, `slurm/jobs.jsonl`.

use std::ffi::OsString;
use std::fmt::Write;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use super::script::{SlurmJob, folder, script};
use super::{SlurmError, SlurmTools, complaint, io_at};
use crate::files::write_atomic;
use crate::log::jsonl::JsonlWriter;
use crate::versioned::{self, Versioned};

/// Slurm's own default, for clusters that do not report their limit.
const MAX_ARRAY_SIZE: usize = 1001;

/// One job array that Slurm accepted.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Submission {
    /// Number of the job.
    pub job: u64,
    /// The cluster, if a site has several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cluster: Option<String>,
    /// Number to add to an array index to get the task.
    pub offset: usize,
    /// The tasks, in rising order.
    pub tasks: Vec<usize>,
    /// Hash of the plan that numbers them.
    pub plan: String,
    /// Time of submission, in seconds since 1970.
    pub time: u64,
}

/// Writes the script of `job` and submits `tasks` as job arrays within the cluster's limit. The caller must omit tasks
/// that are already in the queue. What was accepted before an error stays submitted and listed.
///
/// # Errors
/// [`SlurmError::Missing`] without `sbatch`, [`SlurmError::Refused`] if it refuses a job, [`SlurmError::Answer`] if its
/// answer is no job number, [`SlurmError::NoArrays`], and errors of files.
pub fn submit(tools: &SlurmTools, job: &SlurmJob, tasks: &[usize]) -> Result<Vec<Submission>, SlurmError> {
    if !tools.have("sbatch") {
        return Err(SlurmError::Missing { program: "sbatch".to_owned() });
    }
    let file = job.file();
    fs::create_dir_all(job.folder()).map_err(io_at(&job.folder()))?;
    write_atomic(&file, script(job).as_bytes()).map_err(io_at(&file))?;
    let list = list_of(&job.dir);
    let mut list = JsonlWriter::open(&list)?;
    let arrays = arrays(tasks, max_array_size(tools)?);
    let count: usize = arrays.iter().map(|(_, indices)| indices.len()).sum();
    let mut out = Vec::new();
    for (offset, indices) in arrays {
        // the limit of tasks at once applies to each array: each gets its share of the profile's
        let share = |parallel: u32| (parallel as usize * indices.len() / count).max(1);
        let throttle = job.profile.parallel.map(|n| format!("%{}", share(n))).unwrap_or_default();
        let arguments: [OsString; 4] = [
            "--parsable".into(),
            format!("--array={}{throttle}", ranges(&indices)).into(),
            format!("--export=ALL,SWEEP_OFFSET={offset}").into(),
            file.clone().into(),
        ];
        let output = tools.call("sbatch", &arguments)?;
        if !output.status.success() {
            return Err(SlurmError::Refused { program: "sbatch".to_owned(), said: complaint(&output) });
        }
        let said = String::from_utf8_lossy(&output.stdout);
        let (number, cluster) = job_number(&said)
            .ok_or_else(|| SlurmError::Answer { program: "sbatch".to_owned(), said: said.trim().to_owned() })?;
        let tasks = indices.iter().map(|index| index + offset).collect();
        let time = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
        let submission = Submission { job: number, cluster, offset, tasks, plan: job.plan.clone(), time };
        list.append(&Versioned::new(&submission))?;
        list.sync()?;
        out.push(submission);
    }
    Ok(out)
}

/// Reads what was submitted for the sweep in `dir`, oldest first; empty if nothing was. A half-written last line is
/// skipped.
///
/// # Errors
/// [`SlurmError::Io`], [`SlurmError::JobLine`].
pub fn submissions(dir: &Path) -> Result<Vec<Submission>, SlurmError> {
    let path = list_of(dir);
    let text = match fs::read_to_string(&path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        read => read.map_err(io_at(&path))?,
    };
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    let parse = |(line, text): (usize, &str)| {
        versioned::from_json(text).map_err(|source| SlurmError::JobLine { path: path.clone(), line: line + 1, source })
    };
    whole.lines().enumerate().map(parse).collect()
}

fn list_of(dir: &Path) -> PathBuf {
    folder(dir).join("jobs.jsonl")
}

/// The cluster's limit, which array indices stay below.
fn max_array_size(tools: &SlurmTools) -> Result<usize, SlurmError> {
    let Ok(output) = tools.call("scontrol", &["show".into(), "config".into()]) else { return Ok(MAX_ARRAY_SIZE) };
    let text = String::from_utf8_lossy(&output.stdout);
    let value =
        |line: &str| line.split_once('=').filter(|(key, _)| key.trim() == "MaxArraySize")?.1.trim().parse().ok();
    match text.lines().find_map(value) {
        Some(0) => Err(SlurmError::NoArrays),
        found => Ok(found.unwrap_or(MAX_ARRAY_SIZE)),
    }
}

/// Splits the tasks, sorted and without duplicates, into arrays of indices below `size`, each after its offset.
fn arrays(tasks: &[usize], size: usize) -> Vec<(usize, Vec<usize>)> {
    let mut tasks = tasks.to_vec();
    tasks.sort_unstable();
    tasks.dedup();
    let blocks = tasks.chunk_by(|a, b| a / size == b / size);
    let shift = |block: &[usize]| {
        let offset = block[0] / size * size;
        (offset, block.iter().map(|task| task - offset).collect())
    };
    blocks.map(shift).collect()
}

/// Formats rising numbers as `0-3,7,9-12`.
fn ranges(numbers: &[usize]) -> String {
    let mut out = String::new();
    for run in numbers.chunk_by(|a, b| a + 1 == *b) {
        let comma = if out.is_empty() { "" } else { "," };
        // writing to a string does not fail
        let _ = match run {
            [one] => write!(out, "{comma}{one}"),
            _ => write!(out, "{comma}{}-{}", run[0], run[run.len() - 1]),
        };
    }
    out
}

/// Parses the answer of `sbatch --parsable`: `NUMBER` or `NUMBER;CLUSTER`. A site's own greeting may precede it.
fn job_number(said: &str) -> Option<(u64, Option<String>)> {
    let line = said.lines().rfind(|line| !line.trim().is_empty())?.trim();
    let (number, cluster) = line.split_once(';').map_or((line, None), |(n, cluster)| (n, Some(cluster.to_owned())));
    Some((number.parse().ok()?, cluster))
}

#[cfg(unix)]
#[cfg(test)]
mod tests {
    use super::super::{SlurmProfile, fake};
    use super::*;
    use proptest::prelude::*;

    struct Stage {
        base: tempfile::TempDir,
        tools: SlurmTools,
        job: SlurmJob,
    }

    impl Stage {
        fn bin(&self) -> PathBuf {
            self.base.path().join("bin")
        }

        fn calls(&self) -> Vec<String> {
            let text = fs::read_to_string(self.bin().join("calls")).unwrap_or_default();
            text.lines().map(str::to_owned).collect()
        }
    }

    fn stage(profile: &str, size: &str) -> Stage {
        let base = tempfile::tempdir().unwrap();
        let bin = base.path().join("bin");
        let sbatch = "cd \"${0%/*}\"; echo \"$*\" >>calls; echo hello; echo $((100 + $(wc -l <calls)))";
        fake::program(&bin, "sbatch", sbatch);
        fake::program(&bin, "scontrol", size);
        let dir = base.path().join("my sweep");
        fs::create_dir(&dir).unwrap();
        let job = SlurmJob::new(&dir, SlurmProfile::parse(Path::new("p"), profile).unwrap()).unwrap();
        let tools = SlurmTools::new(&fake::path(&bin));
        Stage { base, tools, job }
    }

    #[test]
    fn tasks_beyond_the_largest_index_go_into_arrays_with_an_offset() {
        let stage = stage("parallel=50", "echo MaxArraySizes = 3; echo 'MaxArraySize            = 10'");
        let out = submit(&stage.tools, &stage.job, &[25, 3, 0, 1, 2, 3, 7, 19, 12, 10, 11]).unwrap();
        let script = stage.job.file().to_str().unwrap().to_owned();
        assert_eq!(
            stage.calls(),
            [
                format!("--parsable --array=0-3,7%25 --export=ALL,SWEEP_OFFSET=0 {script}"),
                format!("--parsable --array=0-2,9%20 --export=ALL,SWEEP_OFFSET=10 {script}"),
                format!("--parsable --array=5%5 --export=ALL,SWEEP_OFFSET=20 {script}"),
            ]
        );
        assert_eq!(out.iter().map(|s| (s.job, s.offset)).collect::<Vec<_>>(), [(101, 0), (102, 10), (103, 20)]);
        assert_eq!(out[1].tasks, [10, 11, 12, 19]);
        assert!(fs::read_to_string(&script).unwrap().contains("sweep worker"));
        assert_eq!(submissions(&stage.job.dir).unwrap(), out);
        // later submissions are added
        submit(&stage.tools, &stage.job, &[4]).unwrap();
        assert!(stage.calls()[3].starts_with("--parsable --array=4%50 --export"));
        assert_eq!(submissions(&stage.job.dir).unwrap().len(), 4);
    }

    #[test]
    fn a_cluster_without_a_reported_limit_gets_the_default() {
        for scontrol in ["exit 1", "echo MaxArraySize = many"] {
            let stage = stage("", scontrol);
            submit(&stage.tools, &stage.job, &(0..1500).collect::<Vec<_>>()).unwrap();
            let calls = stage.calls();
            assert!(calls[0].starts_with("--parsable --array=0-1000 --export=ALL,SWEEP_OFFSET=0 "), "{}", calls[0]);
            assert!(calls[1].starts_with("--parsable --array=0-498 --export=ALL,SWEEP_OFFSET=1001 "), "{}", calls[1]);
        }
        let none = stage("", "echo MaxArraySize = 0");
        assert!(matches!(submit(&none.tools, &none.job, &[1]), Err(SlurmError::NoArrays)));
    }

    #[test]
    fn no_tasks_submit_nothing() {
        let stage = stage("parallel=2", "true");
        assert!(submit(&stage.tools, &stage.job, &[]).unwrap().is_empty());
        assert!(stage.calls().is_empty());
        assert!(submissions(&stage.job.dir).unwrap().is_empty());
        assert!(submissions(Path::new("/nowhere")).unwrap().is_empty());
    }

    #[test]
    fn a_refusal_is_reported_and_earlier_submissions_stay_listed() {
        let stage = stage("", "echo MaxArraySize = 10");
        let twice = "case $* in *OFFSET=10*) echo 'sbatch: error: invalid qos' >&2; exit 1;; *) echo 5;; esac";
        fake::program(&stage.bin(), "sbatch", twice);
        let said = submit(&stage.tools, &stage.job, &[1, 11]).unwrap_err().to_string();
        assert!(said.contains("invalid qos") && said.contains("profile"), "{said}");
        assert_eq!(submissions(&stage.job.dir).unwrap()[0].tasks, [1]);
        fake::program(&stage.bin(), "sbatch", "echo Submitted");
        let error = submit(&stage.tools, &stage.job, &[1]).unwrap_err();
        assert!(matches!(error, SlurmError::Answer { .. }), "{error}");
    }

    #[test]
    fn without_sbatch_nothing_is_written() {
        let dir = tempfile::tempdir().unwrap();
        let job = SlurmJob::new(dir.path(), SlurmProfile::default()).unwrap();
        let error = submit(&SlurmTools::new(dir.path().as_os_str()), &job, &[0]).unwrap_err();
        assert!(matches!(error, SlurmError::Missing { .. }), "{error}");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    #[test]
    fn the_list_forgives_a_torn_end_and_names_a_bad_line() {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("slurm")).unwrap();
        let good = "{\"format\":1,\"plan\":\"\",\"job\":1,\"offset\":0,\"tasks\":[1],\"time\":2}\n";
        fs::write(list_of(dir.path()), format!("{good}{{\"job\":2,")).unwrap();
        assert_eq!(submissions(dir.path()).unwrap().len(), 1);
        fs::write(list_of(dir.path()), format!("{good}nonsense\n{good}")).unwrap();
        assert!(submissions(dir.path()).unwrap_err().to_string().contains("jobs.jsonl:2: "));
    }

    #[test]
    fn answers_of_sbatch() {
        assert_eq!(job_number("12\n"), Some((12, None)));
        assert_eq!(job_number("welcome\n12;big\n\n"), Some((12, Some("big".to_owned()))));
        assert_eq!(job_number(""), None);
        assert_eq!(job_number("Submitted batch job 12"), None);
    }

    fn read_ranges(text: &str) -> Vec<usize> {
        let mut out = Vec::new();
        for part in text.split(',').filter(|part| !part.is_empty()) {
            let (a, b) = part.split_once('-').unwrap_or((part, part));
            out.extend(a.parse::<usize>().unwrap()..=b.parse().unwrap());
        }
        out
    }

    proptest! {
        #[test]
        fn arrays_hold_each_task_once_and_fit(
            tasks in prop::collection::vec(0usize..5000, 0..200), size in 1usize..1500,
        ) {
            let arrays = arrays(&tasks, size);
            let mut seen = Vec::new();
            for (offset, indices) in &arrays {
                prop_assert!(indices.iter().all(|index| *index < size));
                prop_assert_eq!(&read_ranges(&ranges(indices)), indices);
                seen.extend(indices.iter().map(|index| index + offset));
            }
            let mut expected = tasks.clone();
            expected.sort_unstable();
            expected.dedup();
            prop_assert_eq!(seen, expected);
            prop_assert!(arrays.len() <= 5000 / size + 1);
        }
    }
}
