//! Successive halving: at each rung the worst variants are stopped.
//!
//! A variant is judged by its live test PSNR at the rung, the mean over its seeds, among those of its dataset and
//! device. Decisions depend only on the files of the runs, so a resumed sweep decides as before.

use super::SweepError;
use super::plan::{Plan, PlanEntry};
use super::result::{RunCompletion, live_psnr, progress, read, write};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// A variant on one dataset and device.
type VariantGroup<'a> = (&'a str, &'a str, &'a str);

/// Returns those of `runs` that continue beyond `rung`: for each dataset and device, the best fraction `keep` of the
/// variants, at least one.
pub fn survivors(plan: &Plan, runs: &[usize], rung: usize, keep: f64) -> Vec<usize> {
    let chosen: BTreeSet<usize> = runs.iter().copied().collect();
    let mut scores: BTreeMap<VariantGroup<'_>, Vec<f64>> = BTreeMap::new();
    for entry in plan.entries.iter().filter(|e| chosen.contains(&e.run)) {
        let failed = matches!(progress(plan, entry.run), RunCompletion::Failed(_));
        let psnr = live_psnr(&plan.run_folder(entry.run), rung).filter(|_| !failed);
        // a run that failed or has no score counts as the worst
        let psnr = psnr.map_or(f64::NEG_INFINITY, |(_, p)| p);
        scores.entry(group(plan, entry)).or_default().push(psnr);
    }
    let mut fields: BTreeMap<(&str, &str), Vec<(f64, &str)>> = BTreeMap::new();
    for ((variant, dataset, device), scores) in &scores {
        let mean = scores.iter().sum::<f64>() / scores.len() as f64;
        fields.entry((dataset, device)).or_default().push((mean, variant));
    }
    let mut on = BTreeSet::new();
    for ((dataset, device), mut field) in fields {
        field.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(b.1)));
        let count = ((field.len() as f64 * keep).ceil() as usize).clamp(1, field.len());
        on.extend(field[..count].iter().map(|(_, variant)| (*variant, dataset, device)));
    }
    let continues = |run: &usize| plan.entries.iter().any(|e| e.run == *run && on.contains(&group(plan, e)));
    runs.iter().copied().filter(continues).collect()
}

fn group<'a>(plan: &'a Plan, entry: &'a PlanEntry) -> VariantGroup<'a> {
    let run = &plan.runs[entry.run];
    (&entry.variant, &run.dataset, &run.device)
}

fn file(dir: &Path) -> PathBuf {
    dir.join("halving.json")
}

/// The record of what was stopped.
#[derive(Default, Serialize, Deserialize)]
struct Stopped {
    /// The step of each run, by key.
    steps: BTreeMap<String, usize>,
}

/// Records the step at which each run was stopped, by key, replacing earlier records of the runs of `plan` that were
/// `judged`. Records of other runs, such as those of another build of the program, are kept.
///
/// # Errors
/// If the record cannot be written.
pub fn save(dir: &Path, plan: &Plan, judged: &[usize], now: &BTreeMap<String, usize>) -> Result<(), SweepError> {
    let ours: BTreeSet<&str> = judged.iter().map(|run| plan.runs[*run].key.as_str()).collect();
    let mut all = stopped(dir);
    all.retain(|key, _| !ours.contains(key.as_str()));
    all.extend(now.iter().map(|(key, step)| (key.clone(), *step)));
    write(&file(dir), &Stopped { steps: all }).map_err(|e| SweepError::io(dir, e))
}

/// Reads the step at which each stopped run of the sweep was stopped, by key.
pub fn stopped(dir: &Path) -> BTreeMap<String, usize> {
    read::<Stopped>(&file(dir)).unwrap_or_default().steps
}
