//! Measures how much an open viewer window slows training: the same training runs alone, with an idle window and with a
//! constantly turning one, in alternation.
//!
//! `cargo bench --bench train_view -- DATASET [--rounds 3] [--size 800] [--program FILE] [arguments of volseggs train]`
//! prints the seconds of each training run, and the medians relative to that of the runs alone. `--program` selects
//! another build.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

#[path = "view/window.rs"]
mod window;

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use window::Window;

/// How the training is watched.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Looking {
    NoObserver,
    Resting,
    Turning,
}

/// Trains once; returns the training time in seconds and the number of frames that the window received.
fn train(program: &str, folder: &Path, arguments: &[String], size: u32, looking: Looking) -> (f64, usize) {
    let run = folder.join("run");
    drop(std::fs::remove_dir_all(&run));
    let mut command = Command::new(program);
    command.args(["train", "--out"]).arg(&run).args(arguments).stdout(Stdio::piped()).stderr(Stdio::null());
    if looking != Looking::NoObserver {
        command.arg("--view");
    }
    let mut child = command.spawn().unwrap();
    let mut frames = 0;
    if looking != Looking::NoObserver {
        let mut url = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut url).unwrap();
        frames = look(url.trim(), size, looking);
    }
    assert!(child.wait().unwrap().success(), "the training failed");
    let record = std::fs::read_to_string(run.join("run.json")).unwrap();
    let record: serde_json::Value = serde_json::from_str(&record).unwrap();
    (record["training_seconds"].as_f64().unwrap(), frames)
}

/// Watches until the training ends; returns the number of frames received.
fn look(url: &str, size: u32, looking: Looking) -> usize {
    let mut window = Window::open(url, size, None);
    for turn in 0_u32.. {
        let turns = looking == Looking::Turning;
        let view = window.view(if turns { 0.003 * f64::from(turn) } else { 0.0 }, 0.5, turns);
        let asks = turns || turn == 0;
        if asks && !window.try_say(&view) || window.frame_within(Duration::from_secs(600)).is_none() {
            return turn as usize;
        }
    }
    0
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn main() {
    let mut words: Vec<String> = std::env::args().skip(1).filter(|w| w != "--bench").collect();
    if words.is_empty() {
        println!("cargo bench --bench train_view -- DATASET [--rounds 3] [--size 800] [arguments of volseggs train]");
        return;
    }
    let mut taken = |flag: &str, or: &str| {
        let Some(at) = words.iter().position(|w| w == flag) else { return or.to_owned() };
        words.drain(at..at + 2).nth(1).unwrap()
    };
    let [rounds, size]: [u32; 2] = [("--rounds", "3"), ("--size", "800")].map(|(f, or)| taken(f, or).parse().unwrap());
    let program = taken("--program", env!("CARGO_BIN_EXE_volseggs"));
    words.insert(0, "--data".into());
    let folder = tempfile::tempdir().unwrap();
    let all = [Looking::NoObserver, Looking::Resting, Looking::Turning];
    let (mut seconds, began) = ([(); 3].map(|()| Vec::new()), Instant::now());
    for round in 0..rounds {
        // each kind begins a round in turn
        for k in 0..all.len() {
            let which = (round as usize + k) % all.len();
            let (took, frames) = train(&program, folder.path(), &words, size, all[which]);
            println!("round {round}: {:?}: {took:.1} s, {frames} frames", all[which]);
            seconds[which].push(took);
        }
    }
    let [alone, resting, turning] = seconds.map(median);
    println!("medians: alone {alone:.1} s");
    println!("a window at rest: {resting:.1} s, {:+.1} %", 100.0 * (resting / alone - 1.0));
    println!("a window that turns: {turning:.1} s, {:+.1} %", 100.0 * (turning / alone - 1.0));
    println!("{:.0} s in all", began.elapsed().as_secs_f64());
}
