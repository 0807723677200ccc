//! What is left when writing ends early, or when two write at once; and what the system's limits on one process do.
#![cfg(target_os = "linux")]

use crate::common::{BINARY, dataset, json, names, refused, text, train, train_arguments, volseggs};
use crate::outputs::{call, leftover, with_run};
use assert_cmd::Command;
use std::path::Path;
use std::process::Output;
use std::time::Duration;

/// The program in `root`, with space-separated arguments, under limits set by the shell.
fn limited(root: &Path, limit: &str, arguments: &[&str]) -> Output {
    let mut shell = Command::new("bash");
    shell.current_dir(root).args(["-c", &format!("{limit}; exec \"$0\" \"$@\""), BINARY]).args(arguments);
    shell.timeout(Duration::from_secs(120)).output().unwrap()
}

fn said(output: &Output) -> String {
    format!("{:?}: {}", output.status, String::from_utf8_lossy(&output.stderr))
}

/// The temporaries in a folder and those below it.
fn temporaries(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for name in names(folder) {
        if folder.join(&name).is_dir() {
            found.extend(temporaries(&folder.join(&name)));
        }
        found.extend(name.starts_with(".tmp-").then_some(name));
    }
    found
}

#[test]
fn a_comparison_is_there_as_a_whole_or_not_at_all() {
    let folder = with_run();
    let root = folder.path();
    call(root, "eval run --views 2").assert().success();
    // bash counts blocks of 1024 bytes: the page does not fit, some files do
    let cut = |root: &Path| {
        let output = limited(root, "ulimit -f 8", &["compare", "run", "--out", "cm"]);
        assert!(output.status.code() == Some(1) && said(&output).contains("File too large"), "{}", said(&output));
        assert!(said(&output).contains("cm") && !said(&output).contains(".tmp-"), "{}", said(&output));
        assert_eq!(temporaries(root), [] as [&str; 0]);
    };
    cut(root);
    assert!(!root.join("cm").exists());
    call(root, "compare run --out cm").assert().success();
    let page = std::fs::read(root.join("cm/report.html")).unwrap();
    cut(root);
    assert!(std::fs::read(root.join("cm/report.html")).unwrap() == page, "the old comparison is kept");
    // several at once: each is complete, one is last
    let start = || std::process::Command::new(BINARY).current_dir(root).args(["compare", "run", "--out", "cm"]).spawn();
    let all: Vec<_> = (0..4).map(|_| start().unwrap()).collect();
    all.into_iter().for_each(|mut child| assert!(child.wait().unwrap().success()));
    assert!(json(&root.join("cm/results.json")).is_object() && root.join("cm/tensorboard").is_dir());
    assert_eq!(temporaries(root), [] as [&str; 0]);
    // not over the run that it shows
    std::fs::create_dir(root.join("outer")).unwrap();
    std::fs::rename(root.join("run"), root.join("outer/run")).unwrap();
    refused(&mut call(root, "compare outer/run --out outer"), &["outer"]);
}

#[test]
fn files_beyond_a_limit_are_an_error() {
    let root = dataset();
    let arguments = train_arguments(root.path(), "run", &[]);
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let output = limited(root.path(), "ulimit -f 20", &arguments);
    assert!(output.status.code() == Some(1) && said(&output).contains("File too large"), "{}", said(&output));
    assert_eq!(temporaries(root.path()), [] as [&str; 0]);
    let folder = with_run();
    for (arguments, out) in [
        (&["export", "run", "--time", "0.5", "--out", "a.ply"][..], "a.ply"),
        (&["pack", "run", "--out", "packed"], "packed"),
        (&["render", "run", "--path", "orbit", "--frames", "3", "--size", "200", "--out", "film.png"], "film.png"),
        (&["render", "run", "--path", "orbit", "--frames", "3", "--size", "200", "--out", "frames"], "frames"),
    ] {
        let output = limited(folder.path(), "ulimit -f 4", arguments);
        assert!(output.status.code() == Some(1) && said(&output).contains("File too large"), "{}", said(&output));
        assert!(!folder.path().join(out).exists(), "{out}");
        assert_eq!(temporaries(folder.path()), [] as [&str; 0], "{out}");
    }
}

#[test]
fn films_and_stills_remove_what_a_killed_command_left() {
    let folder = with_run();
    let root = folder.path();
    for line in [
        "render run --path orbit --frames 2 --size 16 --out film.png",
        "render run --camera 3,-2,1.5 --size 16 --out still.png",
    ] {
        let left = root.join(leftover("film.png"));
        std::fs::write(&left, "half a film").unwrap();
        call(root, line).assert().success();
        assert!(!left.exists(), "{line}");
    }
}

#[test]
fn a_limit_of_processes_or_memory_is_named() {
    let root = tempfile::tempdir().unwrap();
    let volume = text(root.path(), "v.npy");
    let head = "{'descr': '|u1', 'fortran_order': False, 'shape': (2, 2, 2), }\n";
    let bytes =
        [b"\x93NUMPY\x01\x00", &(head.len() as u16).to_le_bytes()[..], head.as_bytes(), &[0, 1, 2, 3, 4, 5, 6, 7]];
    std::fs::write(&volume, bytes.concat()).unwrap();
    let many = limited(root.path(), "ulimit -v 2000000; export RAYON_NUM_THREADS=1000", &["inspect", &volume]);
    assert!(
        many.status.code() == Some(1) && said(&many).contains("error: the limit of the address space"),
        "{}",
        said(&many)
    );
    assert!(said(&many).contains("ulimit -v"), "{}", said(&many));
    // whatever the limit, the program ends in its own words if it begins at all
    let mut ends = [0; 2];
    for kibibytes in (40_000..400_000).step_by(20_000) {
        let output = limited(root.path(), &format!("ulimit -v {kibibytes}"), &["inspect", &volume]);
        let fine = output.status.success();
        let named = output.status.code() == Some(1) && said(&output).contains("ulimit -v");
        // below the size of its code, the system does not load it
        let loaded = fine || said(&output).contains("error: ") && !said(&output).contains("error while loading");
        assert!(fine || named || !loaded, "{kibibytes} KiB: {}", said(&output));
        assert!(
            !said(&output).contains("panicked") && !said(&output).contains("memory allocation"),
            "{}",
            said(&output)
        );
        ends[usize::from(fine)] += 1;
    }
    assert!(ends[1] > 0, "{ends:?}");
    // the system's administrator has no such limit
    let mut user = String::new();
    if rustix::process::geteuid().is_root() {
        if std::process::Command::new("setpriv").arg("--version").output().is_err() {
            return;
        }
        let program = root.path().join("volseggs");
        std::fs::copy(BINARY, &program).unwrap();
        std::process::Command::new("chmod").args(["-R", "a+rX"]).arg(root.path()).status().unwrap();
        user = format!(
            "exec setpriv --reuid=65534 --regid=65534 --clear-groups bash -c 'ulimit -u 1; exec {} inspect {volume}'; ",
            program.display()
        );
    }
    let output = limited(root.path(), &format!("{user}ulimit -u 1"), &["inspect", &volume]);
    assert!(output.status.code() == Some(1), "{}", said(&output));
    assert!(
        said(&output).contains("threads: ") && said(&output).contains("ulimit -u, or pids.max"),
        "{}",
        said(&output)
    );
}

#[test]
fn somebody_else_s_run_says_what_can_be_done() {
    // the system lets nobody create a file there
    let error =
        volseggs::files::RunLock::acquire(Path::new("/sys"), "test", volseggs::files::LockDuration::Short).unwrap_err();
    let message = error.to_string();
    assert!(message.starts_with("/sys: this folder cannot be written to (") && message.contains("a copy"), "{message}");
}

#[test]
fn long_files_of_settings_are_refused_before_they_are_parsed() {
    let root = dataset();
    let long = format!("# {}\n", "x".repeat(1_000_000));
    let file = text(root.path(), "long.toml");
    std::fs::write(&file, format!("{long}[init]\npoints = 300\n")).unwrap();
    let words = ["long.toml", "longer than 1000000 bytes"];
    refused(train(root.path(), "run", &[]).args(["--config", &file]), &words);
    refused(volseggs().args(["sweep", "--dry-run", &file]), &words);
    refused(volseggs().args(["prepare", "--synthetic", "jets", "--transfer-function", &file, "--out", "x"]), &words);
    std::fs::write(text(root.path(), "v.raw"), [0; 8]).unwrap();
    std::fs::rename(&file, text(root.path(), "v.toml")).unwrap();
    refused(volseggs().args(["inspect", &text(root.path(), "v.raw")]), &["v.toml", "longer than 1000000 bytes"]);
}
