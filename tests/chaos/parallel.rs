//! Many writers to one run: short work waits for its turn and none of it is lost; long work refuses others at once.

use crate::check::newest;
use crate::common::{copy, json, newest_bytes};
use crate::files::{remove, temporaries};
use crate::program::{Ended, Running, must, run, start, words};
use crate::settings::Settings;
use crate::world::{World, world};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use volseggs::edit::{EditStack, Operation};
use volseggs::files::RunPaths;
use volseggs::files::{LockDuration, RunLock};
use volseggs::rng::{Purpose, Rng};
use volseggs::segment::segmentation::Segmentation;

/// Distinguishes these random numbers from the library's own.
const PURPOSE: u64 = 0xC4A1;
/// Simultaneous writers.
const WRITERS: usize = 20;
/// Longer than a writer can take to sign its lock.
const LONG_WAIT: Duration = Duration::from_secs(3);
/// Time within which a writer is refused while long work is in progress.
const AT_ONCE: Duration = Duration::from_secs(5);

/// Returns the command of writer `i`, whose effect can be identified by `i`.
fn writer(world: &World, i: usize) -> Vec<String> {
    let (a, b) = (&world.segments[0], &world.segments[1]);
    words(&match i % 3 {
        0 => format!("edit recolour run --segment {a} --colour #{i:06x}"),
        1 => format!("edit opacity run --segment {b} --factor {}", factor(i)),
        _ => format!("segment group run g{i} {a} {b}"),
    })
}

/// Returns a number that no other writer has.
fn factor(i: usize) -> f32 {
    0.5 + i as f32 / 65536.0
}

/// Returns the numbers of the writers whose work is in the run.
fn kept(run: &Path) -> BTreeSet<usize> {
    let edits = EditStack::load(&run.join("edits.json")).unwrap();
    let number = |operation: &Operation| match operation {
        Operation::Recolour { rgb, .. } => Some(rgb.iter().fold(0, |sum, c| 256 * sum + (c * 255.0).round() as usize)),
        Operation::Opacity { factor, .. } => Some(((factor - 0.5) * 65536.0).round() as usize),
        _ => None,
    };
    let all: Vec<usize> = edits.operations.iter().filter_map(|e| number(&e.operation)).collect();
    let mut found: BTreeSet<usize> = all.iter().copied().collect();
    assert_eq!(found.len(), all.len(), "an edit is stored twice");
    let segments = Segmentation::load(&RunPaths(run).segments()).unwrap();
    found.extend(segments.segments.iter().filter_map(|s| s.name.strip_prefix('g')?.parse::<usize>().ok()));
    found
}

/// Runs twenty writers at a time until all edits are made: each succeeds, and each edit is there in the end.
pub fn writers() {
    let (world, settings) = (world(), Settings::read());
    let folder = world.fresh("writers");
    must(&folder, &words("edit clear run"));
    let began = Instant::now();
    let mut next = 0;
    let mut failed: Vec<Ended> = Vec::new();
    while next < settings.edits {
        let numbers = next..settings.edits.min(next + WRITERS);
        next = numbers.end;
        let running: Vec<Running> = numbers.map(|i| start(&folder, &writer(world, i))).collect();
        failed.extend(running.into_iter().map(Running::end).filter(|e| e.code() != Some(0)));
        let there = kept(&folder.join("run"));
        let lost: Vec<String> = (0..next).filter(|i| !there.contains(i)).map(|i| writer(world, i).join(" ")).collect();
        let texts: Vec<String> = failed.iter().map(ToString::to_string).collect();
        assert!(
            failed.is_empty() && lost.is_empty(),
            "after {next} edits, {WRITERS} at a time: {} failed, {} are not in {}\nlost:\n{}\nfailed:\n{}",
            failed.len(),
            lost.len(),
            folder.display(),
            lost.join("\n"),
            texts.join("\n")
        );
    }
    println!("{next} edits, {WRITERS} at a time, 0 lost, {:.0} s", began.elapsed().as_secs_f64());
    remove(&folder);
}

/// Twenty writers wait for a lock that is held longer than usual, and then take turns: a writer that has waited long
/// occasionally finds the lock file unsigned, which is no reason to give up.
pub fn writers_that_waited() {
    let world = world();
    let folder = world.fresh("waited");
    let held = RunLock::acquire(&folder.join("run"), "volseggs edit", LockDuration::Short).unwrap();
    let running: Vec<Running> = (0..WRITERS).map(|i| start(&folder, &writer(world, i))).collect();
    std::thread::sleep(LONG_WAIT);
    drop(held);
    let ended = running.into_iter().map(Running::end);
    let failed: Vec<String> = ended.filter(|e| e.code() != Some(0)).map(|e| e.to_string()).collect();
    assert!(failed.is_empty(), "{} of {WRITERS} writers that waited failed:\n{}", failed.len(), failed.join("\n"));
    let there = kept(&folder.join("run"));
    assert!((0..WRITERS).all(|i| there.contains(&i)), "only {there:?} are in {}", folder.display());
    remove(&folder);
}

/// Twenty writers, half of them killed at random moments: whatever a writer reported as done is there, the files are
/// complete, and the other and later writers get their turn.
pub fn killed_writers() {
    let (world, settings) = (world(), Settings::read());
    let folder = world.fresh("killed-writers");
    must(&folder, &words("edit clear run"));
    let mut rng = Rng::new(settings.seed, 0, Purpose::Custom(PURPOSE));
    let (mut kills, mut next) = (0, 0);
    while next < settings.edits {
        let numbers = next..next + WRITERS;
        next = numbers.end;
        let mut running: Vec<(usize, Running)> = numbers.map(|i| (i, start(&folder, &writer(world, i)))).collect();
        rng.shuffle(&mut running);
        let rest = running.split_off(WRITERS / 2);
        let mut ended = Vec::new();
        for (i, child) in running {
            std::thread::sleep(Duration::from_secs_f64(0.05 * f64::from(rng.uniform())));
            ended.push((i, child.kill()));
        }
        ended.extend(rest.into_iter().map(|(i, child)| (i, child.end())));
        kills += ended.iter().filter(|(_, e)| e.was_killed()).count();
        let there = kept(&folder.join("run"));
        for (i, ended) in &ended {
            let done = ended.code() == Some(0);
            assert!(done || ended.was_killed(), "seed {}, neither done nor killed: {ended}", settings.seed);
            assert!(!done || there.contains(i), "seed {}, done, but missing from the run: {ended}", settings.seed);
        }
        must(&folder, &words("edit list run"));
    }
    // each writer cleans up where it writes
    must(&folder, &words("edit clear run"));
    must(&folder, &words(&format!("segment group run last {} {}", world.segments[0], world.segments[1])));
    assert_eq!(temporaries(&folder), Vec::<String>::new(), "after the last edit in {}", folder.display());
    println!("{next} writers, {kills} killed, 0 edits lost (seed {})", settings.seed);
    assert!(kills > 0, "no writer was killed");
    remove(&folder);
}

/// Checks that a command is refused at once, naming the training.
fn refused_at_once(folder: &Path, arguments: &[String]) {
    let began = Instant::now();
    let ended = run(folder, arguments);
    assert!(began.elapsed() < AT_ONCE, "not refused at once during a training: {ended}");
    assert_eq!(ended.code(), Some(2), "not refused during a training: {ended}");
    for words in ["in use by", "volseggs train"] {
        assert!(ended.err.contains(words), "no {words:?}: {ended}");
    }
}

/// A run in training accepts no other writer, can be read, and is free once the training is killed.
pub fn beside_a_training() {
    let world = world();
    let folder = world.fresh("training");
    let training = world.training("long", &["stages.joint_steps=200000", "output.checkpoint_every=50"]);
    let long = folder.join("long");
    let mut first = start(&folder, &training);
    first.wait_until("the first checkpoint", || newest(&long).is_some());
    refused_at_once(&folder, &training);
    for line in ["train --resume long", "segment coarse long --clusters 2", "eval long", "edit clear long"] {
        refused_at_once(&folder, &words(line));
    }
    for line in ["edit list long", "segment list long", "render long --camera 0,-4,0 --size 8 --out still"] {
        let ended = run(&folder, &words(line));
        assert_eq!(ended.code(), Some(0), "a reader failed during a training: {ended}");
    }
    assert!(!first.has_ended(), "the training ended by itself: {}", first.end());
    let killed = first.kill();
    assert!(killed.was_killed(), "{killed}");
    let steps = newest(&long).unwrap();
    let more = steps + 3;
    let second = must(&folder, &words(&format!("train --resume long --stop-after {more}")));
    assert_eq!(json(&long.join("run.json"))["steps"], more, "{second}");
    must(&folder, &words("segment coarse long --clusters 2"));
    remove(&folder);
}

/// Two trainings start at the same moment: one trains, the other is refused, and the result is complete.
pub fn two_trainings() {
    let world = world();
    let folder: PathBuf = world.fresh("two");
    for round in 0..3 {
        let run = folder.join("new");
        remove(&run);
        let training = world.training("new", &[]);
        let both = [start(&folder, &training), start(&folder, &training)].map(Running::end);
        let mut codes = both.each_ref().map(Ended::code);
        codes.sort();
        let texts = both.each_ref().map(ToString::to_string).join("\n");
        assert_eq!(codes, [Some(0), Some(2)], "round {round}:\n{texts}");
        assert_eq!(json(&run.join("run.json"))["status"], "complete", "round {round}:\n{texts}");
        if newest_bytes(&run) != newest_bytes(&world.run()) {
            let kept = folder.join("another-result");
            copy(&run, &kept);
            panic!(
                "round {round}: the result differs from that of one training; it is kept in {}\n{texts}",
                kept.display()
            );
        }
    }
    remove(&folder);
}
