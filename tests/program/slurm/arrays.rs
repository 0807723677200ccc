//! Job arrays, with a shell script as the worker: what matters is how Slurm treats it. It takes a minute, as Slurm
//! rarely checks time limits.

use super::cluster::{Cluster, executable};
use std::fs;
use std::path::Path;
use std::thread::sleep;
use std::time::{Duration, Instant};
use volseggs::sweep::slurm::{SlurmJob, SlurmProfile, queue, submissions, submit};

/// One more than the largest array index; the cluster's own limit.
const MAX_ARRAY_SIZE: usize = 2001;

fn wait_until(what: &str, log: &Path, done: impl Fn() -> bool) {
    let start = Instant::now();
    while !done() {
        let text = fs::read_to_string(log).unwrap_or_default();
        assert!(start.elapsed() < Duration::from_secs(180), "{what} did not happen; {}:\n{text}", log.display());
        sleep(Duration::from_millis(200));
    }
}

/// Ends at once as task 1 or 2500, fails as task 2, is done at the second start as task 0, and otherwise runs forever.
/// When asked to end, it saves and says so.
const WORKER: &str = r#"dir=$3 task=$5
[[ "$1 $2 $4" == "sweep worker --task" ]] || exit 64
trap 'stop=1' TERM
echo "threads $RAYON_NUM_THREADS"
case $task in 1 | 2500) touch "$dir/done-$task"; exit 0 ;; 2) exit 3 ;; esac
[[ $task == 0 && -e "$dir/saved-0" ]] && { touch "$dir/done-0"; exit 0; }
while [[ -z $stop ]]; do sleep 0.1; done
sleep 0.5
touch "$dir/saved-$task"
exit 75"#;

#[test]
fn arrays_run_stop_resume_and_are_cancelled() {
    let Some(cluster) = Cluster::start() else { return };
    let tools = cluster.tools();
    let sweep = cluster.base().join("it's \"my\" 50%A sweep");
    fs::create_dir(&sweep).unwrap();
    let worker = cluster.base().join("worker");
    executable(&worker, WORKER);
    let profile = format!(
        "time = '1'\ngrace = 30\ncpus = 2\nmemory = '100M'\nparallel = 10\npartition = 'main'\n\
         setup = [\"export SETUP='done # well'\"]\nextra = ['--comment=\"a b # c\"']\ncommand = '{}'",
        worker.display()
    );
    let job = SlurmJob::new(&sweep, SlurmProfile::parse(Path::new("profile"), &profile).unwrap()).unwrap();
    let submitted = submit(&tools, &job, &[0, 1, 2, 2500]).unwrap();
    assert_eq!(submitted.iter().map(|s| s.offset).collect::<Vec<_>>(), [0, MAX_ARRAY_SIZE]);
    let log = |job: u64, index: usize| sweep.join(format!("slurm/{job}_{index}.log"));
    let first = log(submitted[0].job, 0);

    let done = |task: usize| sweep.join(format!("done-{task}")).exists();
    wait_until("a short task", &log(submitted[0].job, 1), || done(1));
    wait_until("a task with an offset", &log(submitted[1].job, 499), || done(2500));
    wait_until("the long task", &first, || queue(&tools, &sweep, "").unwrap().get(&0).is_some_and(|s| s.runs()));
    wait_until("the warning", &first, || sweep.join("saved-0").exists());
    wait_until("the second start", &first, || done(0));
    let text = fs::read_to_string(&first).unwrap();
    assert!(text.contains("queued again") && text.contains("start 1,") && text.contains("threads 2"), "{text}");
    wait_until("an empty queue", &first, || queue(&tools, &sweep, "").unwrap().is_empty());
    assert!(!done(2));

    // cancelled: it saves, and is not queued again
    let again = submit(&tools, &job, &[5]).unwrap();
    let log = log(again[0].job, 5);
    let begun = || fs::read_to_string(&log).is_ok_and(|text| text.contains("threads"));
    wait_until("a start", &log, begun);
    cluster.call("scancel", &[&queue(&tools, &sweep, "").unwrap()[&5].id]);
    wait_until("saving", &log, || sweep.join("saved-5").exists());
    wait_until("an empty queue", &log, || queue(&tools, &sweep, "").unwrap().is_empty());
    let text = fs::read_to_string(&log).unwrap();
    assert!(text.contains("CANCELLED") && !text.contains("queued again"), "{text}");
    assert_eq!(submissions(&sweep).unwrap().len(), 3);

    // a refusal by Slurm is reported
    let bad = SlurmProfile { partition: Some("nowhere".to_owned()), ..job.profile.clone() };
    let said = submit(&tools, &SlurmJob { profile: bad, ..job }, &[1]).unwrap_err().to_string();
    assert!(said.contains("invalid partition") && said.contains("profile"), "{said}");
}
