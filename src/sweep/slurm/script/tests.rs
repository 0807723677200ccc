use std::fs;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use super::super::fake;
use super::*;

fn job(dir: &Path, profile: &str) -> SlurmJob {
    SlurmJob::new(dir, SlurmProfile::parse(Path::new("p.toml"), profile).unwrap()).unwrap()
}

fn bash(arguments: &[&str]) -> String {
    let output = Command::new("bash").args(arguments).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn the_script_has_what_the_profile_asks_for() {
    let text = script(&job(
        Path::new("/s/ab"),
        "partition='gpu'\ntime='02:00:00'\nmemory='8G'\ncpus=8\ngpus=1\nconstraint='a|b'\nmodules=['cuda/12']\n\
         setup=['source env.sh']\nparallel=50\nextra=['--exclusive']\ncommand='my volseggs'",
    ));
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines[0], "#!/bin/bash -l");
    for line in [
        "#SBATCH --job-name=ab",
        "#SBATCH --output=/s/ab/slurm/%A_%a.log",
        "#SBATCH --open-mode=append",
        "#SBATCH --requeue",
        "#SBATCH --signal=B:USR1@120",
        "#SBATCH --partition=gpu",
        "#SBATCH --time=02:00:00",
        "#SBATCH --mem=8G",
        "#SBATCH --cpus-per-task=8",
        "#SBATCH --gres=gpu:1",
        "#SBATCH --constraint=a|b",
        "#SBATCH --exclusive",
        "#   sbatch --array=0-9%50 --export=ALL,SWEEP_OFFSET=0 /s/ab/slurm/ab.sbatch",
        "module load cuda/12",
        "source env.sh",
        "my volseggs sweep worker /s/ab --task \"$task\" &",
    ] {
        assert!(lines.contains(&line), "{line} is not in\n{text}");
    }
    // Slurm reads no options after the first command
    let first = lines.iter().position(|line| !line.starts_with('#')).unwrap();
    assert!(lines[first..].iter().all(|line| !line.starts_with("#SBATCH")));
    assert!(!text.contains("VOLSEGGS_"));
    let plain = script(&job(Path::new("/s"), ""));
    assert!(plain.starts_with("#!/bin/bash\n") && !plain.contains("--partition") && !plain.contains("module load"));
}

#[test]
fn paths_that_slurm_cannot_take_are_refused() {
    for bad in ["/s/a\nb", "/s/a\\b", "/s/a\u{7f}"] {
        let error = SlurmJob::new(Path::new(bad), SlurmProfile::default()).unwrap_err();
        assert!(matches!(error, SlurmError::Folder { .. }), "{error}");
    }
    let relative = SlurmJob::new(Path::new("some where"), SlurmProfile::default()).unwrap();
    assert!(relative.dir.is_absolute());
    assert_eq!(relative.name, "some_where");
    assert_eq!(SlurmJob::new(Path::new("/"), SlurmProfile::default()).unwrap().name, "sweep");
}

#[test]
fn words_come_through_the_shell_as_they_are() {
    for word in ["", "a b", "it's", "\"q\"", "$HOME `x` \\ ; & # *", "ü", "-n", "a%b", "''"] {
        assert_eq!(bash(&["-c", &format!("printf %s {}", quote(word))]), word);
    }
    assert_eq!(quote("/plain/path-1.txt"), "/plain/path-1.txt");
    assert_eq!(directive("it's \"x\"#"), "\"it's \\\"x\\\"#\"");
}

#[test]
fn bash_takes_the_script_with_any_path() {
    let base = tempfile::tempdir().unwrap();
    for name in ["plain", "a b", "it's", "\"q\" $HOME", "`x`;&#", "50%A"] {
        let job = job(&base.path().join(name), "modules=['cuda/12']\nsetup=['true # done', 'x=1']");
        fs::create_dir_all(job.folder()).unwrap();
        fs::write(job.file(), script(&job)).unwrap();
        bash(&["-n", job.file().to_str().unwrap()]);
    }
}

/// A sweep's folder with a fake worker that does what `body` says and can take notes.
struct Stage {
    base: tempfile::TempDir,
    job: SlurmJob,
}

impl Stage {
    fn new(body: &str, profile: &str) -> Self {
        let base = tempfile::tempdir().unwrap();
        let bin = base.path().join("bin");
        let notes = quote(base.path().join("notes").to_str().unwrap());
        fake::program(&bin, "worker", &format!("note() {{ echo \"$*\" >>{notes}; }}\n{body}"));
        fake::program(&bin, "scontrol", &format!("echo \"scontrol $*\" >>{notes}; exit ${{SCONTROL:-0}}"));
        let dir = base.path().join("it's \"my\" sweep");
        let command = quote(bin.join("worker").to_str().unwrap());
        let job = job(&dir, &format!("command = {command:?}\n{profile}"));
        fs::create_dir_all(job.folder()).unwrap();
        fs::write(job.file(), script(&job)).unwrap();
        Self { base, job }
    }

    fn start(&self, variables: &[(&str, &str)]) -> Child {
        let mut command = Command::new("bash");
        command.arg(self.job.file()).env("PATH", fake::path(&self.base.path().join("bin")));
        for (name, value) in [("SLURM_ARRAY_JOB_ID", "7"), ("SLURM_ARRAY_TASK_ID", "3"), ("SLURM_CPUS_PER_TASK", "5")] {
            command.env(name, value);
        }
        command.env_remove("SWEEP_OFFSET").envs(variables.iter().copied());
        command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    }

    fn notes(&self) -> String {
        fs::read_to_string(self.base.path().join("notes")).unwrap_or_default()
    }

    fn wait_for(&self, what: &str) {
        let start = Instant::now();
        while !self.notes().contains(what) {
            assert!(start.elapsed() < Duration::from_secs(30), "{what} is not in {:?}", self.notes());
            sleep(Duration::from_millis(10));
        }
    }
}

fn signal(child: &Child, name: &str) {
    bash(&["-c", &format!("kill -{name} {}", child.id())]);
}

/// A worker that takes a moment to save when it is asked to end, and notes each time it is asked.
const SAVES: &str = "trap 'note asked; stop=1' TERM
note \"worker $* threads $RAYON_NUM_THREADS\"
note began
while [[ -z \"$stop\" ]]; do sleep 0.02; done
sleep 0.3
note saved
exit 75";

#[test]
fn a_worker_gets_folder_task_and_threads_and_its_code_is_the_jobs() {
    let stage = Stage::new("note \"$1|$2|$3|$4|$5|$RAYON_NUM_THREADS\"; exit 4", "setup=['x=1']");
    assert_eq!(stage.start(&[]).wait().unwrap().code(), Some(4));
    let dir = stage.job.dir.to_str().unwrap();
    assert_eq!(stage.notes(), format!("sweep|worker|{dir}|--task|3|5\n"));
    assert_eq!(stage.start(&[("SWEEP_OFFSET", "2001")]).wait().unwrap().code(), Some(4));
    assert!(stage.notes().contains("|--task|2004|5"));
    let done = Stage::new("exit 0", "");
    assert_eq!(done.start(&[]).wait().unwrap().code(), Some(0));
    // stopped without a signal to the script: nothing is queued again
    let stopped = Stage::new("exit 75", "");
    assert_eq!(stopped.start(&[]).wait().unwrap().code(), Some(75));
    assert_eq!(stopped.notes(), "");
}

#[test]
fn near_the_time_limit_the_worker_saves_and_the_task_is_queued_again() {
    let stage = Stage::new(SAVES, "");
    let mut child = stage.start(&[]);
    stage.wait_for("began");
    signal(&child, "USR1");
    stage.wait_for("asked");
    signal(&child, "USR1");
    assert_eq!(child.wait().unwrap().code(), Some(0));
    let notes = stage.notes();
    assert!(notes.ends_with("began\nasked\nsaved\nscontrol requeue 7_3\n"), "{notes}");
}

#[test]
fn where_it_cannot_be_queued_again_the_code_says_so() {
    let stage = Stage::new(SAVES, "");
    let mut child = stage.start(&[("SCONTROL", "1")]);
    stage.wait_for("began");
    signal(&child, "USR1");
    assert_eq!(child.wait().unwrap().code(), Some(75));
}

#[test]
fn a_cancelled_task_saves_and_is_not_queued_again() {
    for warned in [false, true] {
        let stage = Stage::new(SAVES, "");
        let mut child = stage.start(&[]);
        stage.wait_for("began");
        if warned {
            signal(&child, "USR1");
            stage.wait_for("asked");
        }
        signal(&child, "TERM");
        assert_eq!(child.wait().unwrap().code(), Some(75));
        assert!(stage.notes().ends_with("began\nasked\nsaved\n"), "{}", stage.notes());
    }
}

#[test]
fn a_run_that_ends_well_after_the_warning_is_not_queued_again() {
    let stage = Stage::new("trap 'stop=1' TERM; note began; while [[ -z \"$stop\" ]]; do sleep 0.02; done; exit 0", "");
    let mut child = stage.start(&[]);
    stage.wait_for("began");
    signal(&child, "USR1");
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert_eq!(stage.notes(), "began\n");
}

#[test]
fn a_warning_during_the_setup_is_not_lost() {
    let stage = Stage::new(SAVES, "");
    let slow = format!("echo setup >>{}; sleep 0.5", quote(stage.base.path().join("notes").to_str().unwrap()));
    let job =
        SlurmJob { profile: SlurmProfile { setup: vec![slow], ..stage.job.profile.clone() }, ..stage.job.clone() };
    fs::write(job.file(), script(&job)).unwrap();
    let mut child = stage.start(&[]);
    stage.wait_for("setup");
    signal(&child, "USR1");
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert_eq!(stage.notes(), "setup\nscontrol requeue 7_3\n");
}

#[test]
fn a_worker_that_is_asked_before_it_listens_is_queued_again() {
    let stage = Stage::new("note began; while true; do sleep 0.02; done", "");
    let mut child = stage.start(&[]);
    stage.wait_for("began");
    signal(&child, "USR1");
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert_eq!(stage.notes(), "began\nscontrol requeue 7_3\n");
}

#[test]
fn a_setup_that_fails_ends_the_task() {
    let stage = Stage::new("note began", "setup=['true', 'bash -c \"exit 9\"']");
    assert_eq!(stage.start(&[]).wait().unwrap().code(), Some(9));
    assert_eq!(stage.notes(), "");
}
