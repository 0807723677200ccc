//! Who has a run: claims on a shared folder, made of files only.
//!
//! A claim is a file `claim-NNNN` in the run's folder, made by `create_new`, so that only one of two processes gets it.
//! Its holder rewrites it regularly with a rising count, its heartbeat. A holder without a heartbeat is dead, and its
//! run is taken over by making the claim of the next number, which again only one process can. The holder is the
//! process that has the highest number and has not released it. Clocks are not compared: each process watches
//! heartbeats itself.

use crate::process::{birth, host_name};
use serde::{Deserialize, Serialize};
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Time between two heartbeats of a holder.
const BEAT: Duration = Duration::from_secs(15);
/// Time without a heartbeat after which a holder elsewhere is dead; longer than file systems cache attributes (60 s).
const DEAD: Duration = Duration::from_secs(150);

/// Highest number of a claim; a run is not taken over more often, so a file with a higher number is not a claim.
const MAX_NUMBER: u32 = 999_999;

/// Who holds a run, as recorded in the claim file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClaimHolder {
    /// Name of the machine.
    pub host: String,
    /// What distinguishes boots and containers of the same name; process ids are meaningful only within it.
    pub place: String,
    /// Process id.
    pub pid: u32,
    /// When the process began, in the system's ticks, as ids are reused.
    pub born: u64,
    /// Slurm's array job and task, if the process belongs to one.
    pub task: Option<String>,
    /// How often Slurm had started that task before.
    pub starts: u32,
    /// Rises while the holder lives.
    pub beat: u64,
    /// Whether the holder has released the run.
    pub released: bool,
}

/// A claim of this process on a run, until it is dropped.
#[derive(Debug)]
pub struct Claim {
    path: PathBuf,
    holder: ClaimHolder,
    stop: Option<Sender<()>>,
    heart: Option<JoinHandle<u64>>,
}

/// The result of asking for a run.
#[derive(Debug)]
pub enum ClaimOutcome {
    /// This process has it.
    Mine(Claim),
    /// Another running process has it.
    Held(ClaimHolder),
}

/// Asks for the run in `folder`, which is created if missing. Waits some minutes if only time can tell whether a holder
/// is alive.
///
/// # Errors
/// Any error of the file system.
pub fn claim(folder: &Path) -> io::Result<ClaimOutcome> {
    fs::create_dir_all(folder)?;
    let me = ClaimHolder::me();
    let mut watched: Option<(u32, ClaimHolder, Instant)> = None;
    loop {
        let Some((number, holder)) = newest(folder)? else {
            if let Some(claim) = take(folder, 1, &me)? {
                return Ok(ClaimOutcome::Mine(claim));
            }
            continue;
        };
        let free = match holder {
            Some(holder) if !holder.released => match (holder.is_gone(&me), &watched) {
                (Some(true), _) => true,
                (Some(false), _) => return Ok(ClaimOutcome::Held(holder)),
                (None, Some((n, was, since))) if *n == number && *was == holder => since.elapsed() > DEAD,
                // there was a heartbeat while we watched
                (None, Some((n, ..))) if *n == number => return Ok(ClaimOutcome::Held(holder)),
                (None, _) => {
                    watched = Some((number, holder, Instant::now()));
                    false
                }
            },
            Some(_) => true,
            // made a moment ago, or its maker died at that moment
            None => match &watched {
                Some((n, _, since)) if *n == number => since.elapsed() > 2 * BEAT,
                _ => {
                    watched = Some((number, me.clone(), Instant::now()));
                    false
                }
            },
        };
        if free {
            if number == MAX_NUMBER {
                let path = claim_path(folder, number);
                return Err(io::Error::other(format!(
                    "{}: claim numbers are used up; remove this file",
                    path.display()
                )));
            }
            if let Some(claim) = take(folder, number + 1, &me)? {
                return Ok(ClaimOutcome::Mine(claim));
            }
            watched = None;
        } else {
            std::thread::sleep(Duration::from_millis(500));
        }
    }
}

/// Returns who has the run in `folder` according to its files; `None` if nobody, or if the holder is known to be dead.
pub fn holder(folder: &Path) -> Option<ClaimHolder> {
    let (_, holder) = newest(folder).ok()??;
    holder.filter(|h| !h.released && h.is_gone(&ClaimHolder::me()) != Some(true))
}

/// The claim with the highest number; its content is `None` if it is not (completely) written.
fn newest(folder: &Path) -> io::Result<Option<(u32, Option<ClaimHolder>)>> {
    let Some(number) = numbers(folder)?.into_iter().max() else { return Ok(None) };
    let text = match fs::read_to_string(claim_path(folder, number)) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => String::new(),
        text => text?,
    };
    Ok(Some((number, serde_json::from_str(&text).ok())))
}

/// The numbers of the existing claims; files with merely similar names are left alone.
fn numbers(folder: &Path) -> io::Result<Vec<u32>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder)? {
        let name = entry?.file_name();
        let number = name.to_str().and_then(|n| n.strip_prefix("claim-")).and_then(|n| n.parse::<u32>().ok());
        found.extend(
            number.filter(|n| (1..=MAX_NUMBER).contains(n) && claim_path(Path::new(""), *n) == Path::new(&name)),
        );
    }
    Ok(found)
}

fn claim_path(folder: &Path, number: u32) -> PathBuf {
    folder.join(format!("claim-{number:04}"))
}

/// Makes claim `number`; `None` if another process was first.
fn take(folder: &Path, number: u32, me: &ClaimHolder) -> io::Result<Option<Claim>> {
    let path = claim_path(folder, number);
    let mut file = match fs::File::create_new(&path) {
        Err(e) if e.kind() == io::ErrorKind::AlreadyExists => return Ok(None),
        file => file?,
    };
    file.write_all(&serde_json::to_vec(me).map_err(io::Error::other)?)?;
    file.sync_all()?;
    // a slow process may make a number that others have long passed and removed
    let there = numbers(folder)?;
    if there.iter().any(|n| *n > number) {
        fs::remove_file(&path)?;
        return Ok(None);
    }
    for old in there.into_iter().filter(|n| *n < number) {
        let _ = fs::remove_file(claim_path(folder, old));
    }
    let (stop, stopped) = channel();
    let (folder, heart_path, mut beating) = (folder.to_owned(), path.clone(), me.clone());
    let heart = std::thread::Builder::new().name("claim".into()).spawn(move || {
        while stopped.recv_timeout(BEAT) == Err(RecvTimeoutError::Timeout) {
            if matches!(newest(&folder), Ok(Some((n, _))) if n > number) {
                errln!("another process took over this run, as no heartbeat of this one arrived; exiting");
                std::process::exit(75);
            }
            beating.beat += 1;
            // a file system that is unavailable for a while comes back, or others take over
            let _ = beating.write(&heart_path);
        }
        beating.beat
    })?;
    Ok(Some(Claim { path, holder: me.clone(), stop: Some(stop), heart: Some(heart) }))
}

impl Drop for Claim {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(Ok(beat)) = self.heart.take().map(JoinHandle::join) {
            self.holder.beat = beat + 1;
        }
        self.holder.released = true;
        let _ = self.holder.write(&self.path);
    }
}

impl ClaimHolder {
    /// This process.
    fn me() -> Self {
        let pid = std::process::id();
        let read = |path: &str| fs::read_to_string(path).map(|t| t.trim().to_owned()).unwrap_or_default();
        let link = fs::read_link("/proc/self/ns/pid").map(|p| p.display().to_string()).unwrap_or_default();
        let variable = |name: &str| std::env::var(name).ok();
        let array = variable("SLURM_ARRAY_JOB_ID").zip(variable("SLURM_ARRAY_TASK_ID"));
        let task = array.map(|(job, task)| format!("{job}_{task}"));
        let starts = variable("SLURM_RESTART_COUNT").and_then(|n| n.parse().ok()).unwrap_or(0);
        Self {
            host: host_name().unwrap_or_default(),
            place: format!("{} {link}", read("/proc/sys/kernel/random/boot_id")),
            pid,
            born: birth(pid).unwrap_or_default(),
            task,
            starts,
            beat: 0,
            released: false,
        }
    }

    /// Whether the holder is dead, as seen by `me`; `None` if that cannot be determined from here.
    fn is_gone(&self, me: &Self) -> Option<bool> {
        if !me.place.trim().is_empty() && (&self.host, &self.place) == (&me.host, &me.place) {
            return Some(birth(self.pid) != Some(self.born));
        }
        // once a task is started again, its earlier process is no longer running
        (self.task.is_some() && self.task == me.task && self.starts < me.starts).then_some(true)
    }

    fn write(&self, path: &Path) -> io::Result<()> {
        crate::files::write_atomic(path, &serde_json::to_vec(self).map_err(io::Error::other)?)
    }
}

impl std::fmt::Display for ClaimHolder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "process {} on {}", self.pid, self.host)?;
        self.task.as_ref().map_or(Ok(()), |task| write!(f, ", task {task}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mine(claimed: io::Result<ClaimOutcome>) -> Claim {
        match claimed.unwrap() {
            ClaimOutcome::Mine(claim) => claim,
            ClaimOutcome::Held(holder) => panic!("held by {holder}"),
        }
    }

    #[test]
    fn one_of_many_gets_the_claim_and_the_next_one_after_its_release() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("run");
        let got: Vec<ClaimOutcome> = std::thread::scope(|s| {
            let threads: Vec<_> = (0..8).map(|_| s.spawn(|| claim(&folder).unwrap())).collect();
            threads.into_iter().map(|t| t.join().unwrap()).collect()
        });
        assert_eq!(got.iter().filter(|c| matches!(c, ClaimOutcome::Mine(_))).count(), 1);
        assert!(holder(&folder).is_some());
        drop(got);
        assert!(holder(&folder).is_none());
        let again = mine(claim(&folder));
        assert_eq!(again.path, folder.join("claim-0002"));
        assert!(!folder.join("claim-0001").exists());
    }

    #[test]
    fn a_dead_process_of_this_machine_is_taken_over_at_once() {
        let dir = tempfile::tempdir().unwrap();
        let mut dead = ClaimHolder::me();
        dead.born += 1;
        dead.write(&claim_path(dir.path(), 7)).unwrap();
        assert!(holder(dir.path()).is_none());
        let claim = mine(claim(dir.path()));
        assert_eq!(claim.path, dir.path().join("claim-0008"));
    }

    #[test]
    fn files_with_invalid_claim_numbers_are_ignored() {
        let dir = tempfile::tempdir().unwrap();
        let others = ["claim-4294967295", "claim-1000000", "claim-0000", "claim-+007", "claim-9"];
        for name in others {
            fs::write(dir.path().join(name), "").unwrap();
        }
        assert!(holder(dir.path()).is_none());
        let mut dead = ClaimHolder::me();
        dead.born += 1;
        dead.write(&claim_path(dir.path(), MAX_NUMBER - 1)).unwrap();
        // at once, though all numbers below are free
        let last = mine(claim(dir.path()));
        assert_eq!(last.path, claim_path(dir.path(), MAX_NUMBER));
        assert!(!claim_path(dir.path(), MAX_NUMBER - 1).exists());
        assert!(others.iter().all(|name| dir.path().join(name).exists()));
        drop(last);
        assert!(claim(dir.path()).unwrap_err().to_string().contains("claim-999999"));
    }

    #[test]
    fn a_task_requeued_on_another_machine_continues_at_once() {
        let (mut before, mut now) = (ClaimHolder::me(), ClaimHolder::me());
        before.host = "other".into();
        assert_eq!(before.is_gone(&now), None);
        (before.task, now.task) = (Some("12_3".into()), Some("12_3".into()));
        // another process in the same task
        assert_eq!(before.is_gone(&now), None);
        now.starts = 1;
        assert_eq!(before.is_gone(&now), Some(true));
        now.task = Some("13_3".into());
        assert_eq!(before.is_gone(&now), None);
    }

    #[test]
    fn a_remote_holder_with_a_heartbeat_is_alive() {
        let dir = tempfile::tempdir().unwrap();
        let mut other = ClaimHolder::me();
        other.place = "elsewhere".into();
        let path = claim_path(dir.path(), 1);
        other.write(&path).unwrap();
        let answer = std::thread::scope(|s| {
            let asking = s.spawn(|| claim(dir.path()).unwrap());
            std::thread::sleep(Duration::from_millis(1200));
            other.beat += 1;
            other.write(&path).unwrap();
            asking.join().unwrap()
        });
        assert!(matches!(answer, ClaimOutcome::Held(h) if h.beat == 1));
    }
}
