//! Kills every writing command at random moments; after each kill all files are checked, and the command is then run to
//! its end.

use crate::check::{faults, lost_checkpoint, newest};
use crate::common::{json, newest_bytes};
use crate::files::{self, Snapshot, snapshot, temporaries};
use crate::jobs::{Again, Job, jobs};
use crate::program::{Ended, Running, run, start, words};
use crate::settings::Settings;
use crate::whole::whole;
use crate::world::{World, world};
use std::path::Path;
use std::time::{Duration, Instant};
use volseggs::files::RunPaths;
use volseggs::rng::{Purpose, Rng};
use volseggs::segment::segmentation::Segmentation;

/// Distinguishes these random numbers from the library's own.
const PURPOSE: u64 = 0xC4A0;
/// Kills per command, unless the environment sets a number.
const ROUNDS: usize = 3;
/// Without that number, no command is killed a second time after this long.
const ENOUGH: Duration = Duration::from_secs(45);
/// Maximum number of seconds from the first sight of a temporary to the kill.
const WRITING: f64 = 0.006;
/// Longest wait for a temporary.
const PATIENCE: Duration = Duration::from_secs(30);
/// A command that writes to the run: shows that a killed command no longer holds its lock.
const NEXT: &str = "edit undo run";

/// Results of the kills.
#[derive(Default)]
struct Found {
    /// All strikes; `kills` counts those that hit a living process.
    strikes: usize,
    kills: usize,
    /// Files that were checked.
    files: usize,
    faults: Vec<String>,
}

/// A command, its duration when left alone, and what it then leaves.
struct Known {
    job: Job,
    seconds: f64,
    after: Snapshot,
}

/// One kill; its number determines the moment.
struct Strike {
    number: usize,
    /// Whether it comes while something is being written, rather than at any moment.
    writing: bool,
    rng: Rng,
}

pub fn strike_all() {
    let (world, settings) = (world(), Settings::read());
    let began = Instant::now();
    let (base, data) = (snapshot(&world.root.join("base")), snapshot(&world.root.join("data")));
    let mut found = Found::default();
    for path in base.keys() {
        found.faults.extend(whole(&world.root.join("base").join(path)).err().map(|e| format!("base/{path}: {e}")));
    }
    let mut known = Vec::new();
    for job in jobs(world).into_iter().filter(|j| j.name.contains(&settings.only)) {
        known.extend(undisturbed(world, job, &base, &mut found));
    }
    assert!(!known.is_empty(), "no command to kill: {:?}\n{}", settings.only, shortened(&found.faults));
    let n = known.len();
    println!("{n} commands, {:.0} s when undisturbed", began.elapsed().as_secs_f64());
    let wanted = settings.kills.unwrap_or(ROUNDS * n);
    // a strike after the end of its command does not count
    for number in 0..3 * wanted {
        if found.kills >= wanted {
            break;
        }
        if settings.kills.is_none() && number >= n && began.elapsed() > ENOUGH {
            println!("{number} strikes are enough: this machine is slow");
            break;
        }
        let rng = Rng::new(settings.seed, number as u64, Purpose::Custom(PURPOSE));
        // alternating, so that each command gets both kinds
        let strike = Strike { number, writing: (number / n + number % n) % 2 == 1, rng };
        strike.at(world, &mut known[number % n], &base, settings.seed, &mut found);
        if (number + 1) % 50 == 0 {
            println!("{} strikes, {} faults, {:.0} s", number + 1, found.faults.len(), began.elapsed().as_secs_f64());
        }
    }
    if snapshot(&world.root.join("data")) != data {
        found.faults.push("the dataset of images changed".into());
    }
    println!(
        "{} kills ({} strikes, seed {}), {} files checked, {} lost, {:.0} s",
        found.kills,
        found.strikes,
        settings.seed,
        found.files,
        found.faults.len(),
        began.elapsed().as_secs_f64()
    );
    assert!(found.faults.is_empty(), "{} faults:\n\n{}", found.faults.len(), shortened(&found.faults));
    let enough = settings.kills.unwrap_or(found.strikes / 3);
    assert!(found.kills >= enough, "{} of {} strikes hit a living process", found.kills, found.strikes);
}

/// Formats the first faults in full, and the first lines of the others.
fn shortened(faults: &[String]) -> String {
    const WHOLE: usize = 25;
    let short = |fault: &String| fault.lines().next().unwrap_or_default().to_owned();
    let mut all: Vec<String> = faults.iter().take(WHOLE).cloned().collect();
    all.extend(faults.iter().skip(WHOLE).map(short));
    all.join("\n\n")
}

/// Runs a command to its end and records what it leaves; `None` if it fails.
fn undisturbed(world: &World, job: Job, base: &Snapshot, found: &mut Found) -> Option<Known> {
    let folder = world.fresh(&format!("alone-{}", file_name(job.name)));
    let ended = run(&folder, &job.arguments);
    let after = snapshot(&folder);
    found.files += after.len();
    let mut wrong = faults(&job, &folder, base, &after, &Snapshot::new());
    if ended.code() != Some(0) {
        wrong.push("fails even undisturbed, so it is not killed".into());
    }
    wrong.extend(left_over(&folder));
    let sound = wrong.is_empty();
    for fault in wrong {
        found.faults.push(format!("{}: {fault}\n  undisturbed: {ended}", job.name));
    }
    if sound {
        files::remove(&folder);
    }
    (ended.code() == Some(0)).then_some(Known { job, seconds: ended.seconds, after })
}

impl Strike {
    /// Kills a command once, with all checks.
    fn at(mut self, world: &World, known: &mut Known, base: &Snapshot, seed: u64, found: &mut Found) {
        let number = self.number;
        let folder = world.fresh(&format!("kill-{number:04}-{}", file_name(known.job.name)));
        let before = newest(&folder.join("half"));
        let mut child = start(&folder, &known.job.arguments);
        let moment = self.wait(&mut child, &folder, known.seconds);
        let ended = child.kill();
        found.strikes += 1;
        found.kills += usize::from(ended.was_killed());

        let now = snapshot(&folder);
        found.files += now.len();
        let mut wrong = faults(&known.job, &folder, base, &now, &known.after);
        wrong.extend(lost_checkpoint(&folder.join("half"), before));
        if !ended.was_killed() {
            // it ended before the strike
            wrong.extend((ended.code() != Some(0)).then(|| "failed by itself".to_owned()));
            known.seconds = known.seconds.min(ended.seconds);
        }
        wrong.extend(ended.err.contains("panicked").then(|| "panicked".to_owned()));
        let (last, more) = to_the_end(world, &known.job, &folder, base);
        wrong.extend(more);
        if wrong.is_empty() {
            files::remove(&folder);
            return;
        }
        for fault in wrong {
            found.faults.push(format!(
                "{}: {fault}\n  kill {number}, seed {seed}, {moment} of {:.3} s; the files are kept\n  killed: {ended}\n  then: {last}",
                known.job.name, known.seconds
            ));
        }
    }

    /// Waits for the moment of the kill, and describes it.
    fn wait(&mut self, child: &mut Running, folder: &Path, seconds: f64) -> String {
        let at = f64::from(self.rng.uniform()) * seconds;
        if !self.writing {
            std::thread::sleep(Duration::from_secs_f64(at));
            return format!("at {at:.3} s");
        }
        // most of the writing happens near the end
        std::thread::sleep(Duration::from_secs_f64(0.5 * at));
        let mut seen = Vec::new();
        while seen.is_empty() && !child.has_ended() && child.age() < PATIENCE {
            std::thread::sleep(Duration::from_micros(200));
            seen = temporaries(folder);
        }
        let more = f64::from(self.rng.uniform()) * WRITING;
        let first = child.age().as_secs_f64();
        std::thread::sleep(Duration::from_secs_f64(more));
        format!("{more:.4} s after {seen:?} was seen at {first:.3} s")
    }
}

/// Runs the killed command to its end, or, if its work was already done, another one that needs the run's lock. Returns
/// its outcome and all faults of the files it leaves.
fn to_the_end(world: &World, job: &Job, folder: &Path, base: &Snapshot) -> (Ended, Vec<String>) {
    let has_segment = |name: &str| {
        let all = Segmentation::load(&RunPaths(&folder.join("run")).segments());
        all.is_ok_and(|all| all.get(name).is_ok())
    };
    let done = match job.again {
        Again::Same | Again::Train(_) => false,
        Again::Segment(name) => has_segment(name),
        Again::NoSegment(name) => !has_segment(name),
        Again::Folder(name) => folder.join(name).exists(),
    };
    let arguments = match job.again {
        _ if done => words(NEXT),
        Again::Train(run) if newest(&folder.join(run)).is_some() => words(&format!("train --resume {run}")),
        _ => job.arguments.clone(),
    };
    let ended = run(folder, &arguments);
    let mut wrong = Vec::new();
    if ended.code() != Some(0) {
        wrong.push("cannot be run to its end after the kill".to_owned());
        return (ended, wrong);
    }
    wrong.extend(left_over(folder));
    if !done {
        wrong.extend(faults(job, folder, base, &snapshot(folder), &Snapshot::new()));
    }
    let expected = match job.again {
        Again::Segment(name) => has_segment(name).then_some(()).ok_or_else(|| format!("there is no segment {name}")),
        Again::NoSegment(name) => {
            (!has_segment(name)).then_some(()).ok_or_else(|| format!("segment {name} still exists"))
        }
        Again::Folder(name) => folder.join(name).is_dir().then_some(()).ok_or_else(|| format!("{name} is missing")),
        Again::Train(run) => trained(world, &folder.join(run)),
        Again::Same => Ok(()),
    };
    wrong.extend(expected.err().map(|e| format!("at the end: {e}")));
    (ended, wrong)
}

/// Checks that a killed training ends with the bytes of one that was left alone.
fn trained(world: &World, run: &Path) -> Result<(), String> {
    let status = json(&run.join("run.json"))["status"].clone();
    if status != "complete" {
        return Err(format!("the status is {status}"));
    }
    (newest_bytes(run) == newest_bytes(&world.run()))
        .then_some(())
        .ok_or_else(|| "its scene or its optimiser is not that of a training that was never killed".to_owned())
}

/// Returns a fault if temporaries are left where there should be none.
fn left_over(folder: &Path) -> Option<String> {
    let left = temporaries(folder);
    (!left.is_empty()).then(|| format!("temporaries are left at the end: {}", left.join(", ")))
}

/// Returns a command's name for use in a file name, with `-` in place of spaces and of the dashes of options.
fn file_name(name: &str) -> String {
    name.replace(" --", "-").replace(' ', "-")
}
