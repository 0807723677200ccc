//! Commands that are asked to stop: a training saves a checkpoint and can be resumed, `prepare` leaves nothing.

use crate::check::newest;
use crate::common::{BINARY, json};
use crate::files::{remove, temporaries};
use crate::program::{Ended, Stream, must, start, start_command, start_with, words};
use crate::world::{World, world};
use std::path::Path;
use std::process::Command;
use std::time::Duration;

/// Far too long to end by itself, with no checkpoint due before the signal comes.
const ENDLESS: [&str; 2] = ["stages.joint_steps=200000", "output.checkpoint_every=100000"];
/// Interval between two signals that count as one.
const REPEATED: Duration = Duration::from_millis(50);

/// Counts the lines of a run's metrics.
fn lines(run: &Path) -> usize {
    std::fs::read_to_string(run.join("metrics.jsonl")).map_or(0, |t| t.lines().count())
}

/// Checks what a stopped training leaves.
fn stopped(what: &str, folder: &Path, name: &str, ended: &Ended) {
    let run = folder.join(name);
    let record = json(&run.join("run.json"));
    assert_eq!(record["status"], "interrupted", "{what}: {ended}");
    let steps = newest(&run);
    assert!(steps.is_some(), "{what}: no checkpoint: {ended}");
    assert_eq!(record["steps"].as_u64(), steps.map(|s| s as u64), "{what}: {ended}");
    assert_eq!(temporaries(&run), Vec::<String>::new(), "{what}: {ended}");
}

/// Runs a training that gets `signals` after its first steps; returns the seconds until then.
fn signalled(world: &World, folder: &Path, name: &str, signals: &[&str], streams: [Stream; 2]) -> f64 {
    let run = folder.join(name);
    let mut child = start_with(folder, &world.training(name, &ENDLESS), streams);
    child.wait_until("the first steps", || lines(&run) >= 2);
    let seconds = child.age().as_secs_f64();
    for (i, signal) in signals.iter().enumerate() {
        if i > 0 {
            std::thread::sleep(REPEATED);
        }
        if i == 0 || !child.has_ended() {
            child.signal(signal);
        }
    }
    let ended = child.end();
    let what = format!("{signals:?}, streams {streams:?}");
    assert_eq!(ended.fault(), None, "{what}: {ended}");
    assert_eq!(ended.code(), Some(1), "{what}: {ended}");
    if streams[1] == Stream::Kept {
        assert!(ended.err.contains("--resume"), "{what}: {ended}");
    }
    stopped(&what, folder, name, &ended);
    seconds
}

pub fn to_trainings() {
    let world = world();
    let folder = world.fresh("signals");
    let kept = [Stream::Kept; 2];
    let mut seconds = 0.0;
    for signal in ["HUP", "TERM", "INT"] {
        seconds = signalled(world, &folder, signal, &[signal], kept);
    }
    signalled(world, &folder, "twice", &["TERM", "TERM"], kept);
    signalled(world, &folder, "mixed", &["HUP", "TERM", "HUP"], kept);
    // the terminal is gone, and nobody reads the messages about it
    signalled(world, &folder, "alone", &["HUP"], [Stream::Gone; 2]);
    under_timeout(world, &folder, seconds);
    let next = newest(&folder.join("twice")).unwrap() + 3;
    must(&folder, &words(&format!("train --resume twice --stop-after {next}")));
    assert_eq!(json(&folder.join("twice/run.json"))["steps"], next);
    remove(&folder);
}

/// `timeout` sends its signal to the program and to the whole group, so it arrives twice.
fn under_timeout(world: &World, folder: &Path, seconds: f64) {
    let version = Command::new("timeout").arg("--version").output();
    if !version.is_ok_and(|v| String::from_utf8_lossy(&v.stdout).contains("coreutils")) {
        volseggs_testing::skip(volseggs_testing::Need::Coreutils, "there is no `timeout` of GNU coreutils");
        return;
    }
    let limit = (2.0 * seconds + 1.0).ceil().to_string();
    let mut command = Command::new("timeout");
    command.args(["-k", "60", &limit, BINARY]).args(world.training("timeout", &ENDLESS));
    let ended = start_command(folder, command, [Stream::Kept; 2]).end();
    assert_eq!((ended.fault(), ended.code()), (None, Some(124)), "{ended}");
    stopped("timeout", folder, "timeout", &ended);
}

pub fn to_prepare() {
    let world = world();
    let folder = world.fresh("prepare");
    let line = "prepare --synthetic shells --dims 32 --series-steps 10 --times 10 --views 60 --size 300 --test-views 60 \
                --segment-views 0 --out fresh";
    for signal in ["HUP", "TERM", "INT"] {
        let mut child = start(&folder, &words(line));
        child.wait_until("the folder in progress", || !temporaries(&folder).is_empty());
        child.signal(signal);
        let ended = child.end();
        assert_eq!((ended.fault(), ended.code()), (None, Some(1)), "{signal}: {ended}");
        assert!(ended.err.contains("nothing"), "{signal}: {ended}");
        assert!(!folder.join("fresh").exists(), "{signal}: published nevertheless: {ended}");
        assert_eq!(temporaries(&folder), Vec::<String>::new(), "{signal}: {ended}");
    }
    remove(&folder);
}
