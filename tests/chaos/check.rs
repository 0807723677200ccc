//! What must hold at any moment, and at the end.

use crate::files::{Snapshot, fits};
use crate::jobs::{Job, depends_on_the_clock};
use crate::whole::{whole, whole_dataset};
use std::collections::BTreeSet;
use std::path::Path;
use volseggs::train::checkpoint;

/// Returns all faults in what a killed command left in `folder`, given the files `before` it, `now`, and `after` a
/// command that was left alone. `after` is empty when that one is checked itself.
pub fn faults(job: &Job, folder: &Path, before: &Snapshot, now: &Snapshot, after: &Snapshot) -> Vec<String> {
    let mut faults = Vec::new();
    let may = |path: &str| fits(&job.writable, path) && !fits(&job.except, path);
    for (path, old) in before {
        match now.get(path) {
            None if !fits(&job.removable, path) => faults.push(format!("{path} existed before and is missing")),
            Some(new) if new != old && !may(path) => {
                faults.push(format!("{path} changed, although {} must not change it", job.name))
            }
            _ => {}
        }
    }
    for (path, bytes) in now {
        let old = before.get(path);
        if old.is_none() && !may(path) {
            faults.push(format!("{path} was created, although {} must not create it", job.name));
        }
        if old == Some(bytes) {
            continue;
        }
        if let Err(e) = whole(&folder.join(path)) {
            faults.push(format!("{path} is incomplete or damaged ({} bytes): {e}", bytes.len()));
        }
        let neither = !depends_on_the_clock(path) && after.get(path).is_some_and(|new| new != bytes);
        if neither {
            faults.push(format!(
                "{path} ({} bytes) is neither as before ({:?}) nor as an undisturbed command leaves it ({:?})",
                bytes.len(),
                old.map(Vec::len),
                after.get(path).map(Vec::len)
            ));
        }
    }
    if !after.is_empty() {
        faults.extend(job.atomic.iter().filter_map(|part| mixed(part, before, now, after)));
    }
    faults.extend(folders(folder, now));
    faults
}

/// Returns a fault if a folder is neither entirely as before nor entirely as after.
fn mixed(part: &str, before: &Snapshot, now: &Snapshot, after: &Snapshot) -> Option<String> {
    let prefix = format!("{part}/");
    let of = |all: &Snapshot| -> Snapshot {
        let inside = all.iter().filter(|(path, _)| path.starts_with(&prefix));
        inside
            .map(|(path, b)| (path.clone(), if depends_on_the_clock(path) { Vec::new() } else { b.clone() }))
            .collect()
    };
    let (old, there, new) = (of(before), of(now), of(after));
    if there == old || there == new {
        return None;
    }
    let names = |a: &Snapshot, b: &Snapshot| -> Vec<String> {
        let set: BTreeSet<&String> = a.iter().filter(|(p, bytes)| b.get(*p) != Some(bytes)).map(|(p, _)| p).collect();
        set.into_iter().take(5).cloned().collect()
    };
    Some(format!(
        "{part} is neither entirely as before nor entirely as after: differs from before {:?}, differs from after {:?}, \
         missing or different {:?}",
        names(&there, &old),
        names(&there, &new),
        names(&new, &there)
    ))
}

/// Returns the faults of folders that have a final name but lack a part.
fn folders(folder: &Path, now: &Snapshot) -> Vec<String> {
    let mut faults = Vec::new();
    for name in ["prepared", "fresh"] {
        if folder.join(name).exists()
            && let Err(e) = whole_dataset(&folder.join(name))
        {
            faults.push(format!("{name}: {e}"));
        }
    }
    let parents = |of: &str| -> BTreeSet<String> {
        let inside = now.keys().filter_map(|path| path.rsplit_once('/').map(|(parent, _)| parent));
        inside.filter(|p| p.rsplit_once('/').is_some_and(|(up, _)| up.ends_with(of))).map(str::to_owned).collect()
    };
    let mut need = |parents: BTreeSet<String>, names: &[&str]| {
        for parent in parents {
            for name in names.iter().filter(|n| !now.contains_key(&format!("{parent}/{n}"))) {
                faults.push(format!("{parent} has no {name}"));
            }
        }
    };
    need(parents("/checkpoints"), &["scene.safetensors", "optimizer.safetensors", "state.json"]);
    need(
        parents("run/track"),
        &["statistics.json", "statistics.csv", "events.csv", "tracks.csv", "over-time.svg", "times.png"],
    );
    if now.keys().any(|p| p.starts_with("new/")) && !now.contains_key("new/run.json") {
        faults.push("new holds files of a run but no run.json".into());
    }
    faults
}

/// Returns a fault if a run lost the newest checkpoint that it had before.
pub fn lost_checkpoint(run: &Path, before: Option<usize>) -> Option<String> {
    let newest = newest(run);
    (newest < before).then(|| format!("{}: the newest checkpoint was {before:?}, now {newest:?}", run.display()))
}

/// Returns the step of a run's newest checkpoint.
pub fn newest(run: &Path) -> Option<usize> {
    checkpoint::list(run).pop().map(|(step, _)| step)
}
