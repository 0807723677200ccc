//! Checks of a sweep file before its variants are resolved one by one, and of a plan.

use super::SweepError;
use super::axes::{Variant, flatten};
use super::file::{HalvingSpec, SweepFile};
use super::key::is_key;
use super::plan::{Plan, PlanOptions};
use super::result::{OF_BOTH, OF_RUNS, OF_SEGMENTS};
use crate::config::types::{Config, DataConfig};
use crate::device::DeviceName;
use crate::nesting::check_toml;
use std::collections::{HashMap, HashSet};
use toml::Table;

/// Refuses lists that are empty or have duplicates, devices that are not available, missing files of weights, and an
/// evaluation on no view.
pub(super) fn check_lists(file: &SweepFile, seeds: &[u64], elsewhere: bool) -> Result<(), SweepError> {
    check_seeds(seeds).map_err(|problem| file.wrong("seeds", problem))?;
    for variant in &file.variant {
        let seeds = variant.seeds.as_deref().map_or(Ok(()), check_seeds);
        seeds.map_err(|problem| file.wrong(format!("variant \"{}\": seeds", variant.name), problem))?;
    }
    for (i, device) in file.devices.iter().enumerate() {
        let name: DeviceName = device.parse().map_err(|e| file.wrong("devices", e))?;
        if !elsewhere {
            name.open().map_err(|e| file.wrong("devices", e))?;
        }
        if file.devices[..i].contains(device) {
            return Err(file.wrong("devices", format!("{device} is listed twice")));
        }
    }
    for weights in &file.eval.lpips_weights {
        if !weights.is_file() {
            return Err(file.wrong("eval.lpips_weights", format!("{}: file not found", weights.display())));
        }
    }
    if file.eval.views == Some(0) {
        return Err(file.wrong("eval.views", "must be at least 1; omit the key to use all views"));
    }
    Ok(())
}

/// Refuses runs on one dataset that would be measured on different test views, or on images of different sizes: their
/// means could not be compared.
pub(super) fn check_views(plan: &Plan) -> Result<(), String> {
    let mut first: HashMap<&str, (DataConfig, &str)> = HashMap::new();
    for run in &plan.runs {
        let data = toml::from_str::<Config>(&run.config).map_err(|e| e.to_string())?.data;
        let (known, other) = first.entry(&run.dataset).or_insert_with(|| (data.clone(), &run.label));
        if (&known.only_times, known.downscale) != (&data.only_times, data.downscale) {
            let on = |d: &DataConfig| format!("data.only_times = {:?}, data.downscale = {}", d.only_times, d.downscale);
            return Err(format!(
                "\"{}\" has {}, \"{other}\" has {}: they would be measured on different images; make a sweep for each",
                run.label,
                on(&data),
                on(known)
            ));
        }
    }
    Ok(())
}

/// Refuses an empty list of seeds, and duplicates.
fn check_seeds(seeds: &[u64]) -> Result<(), String> {
    if seeds.is_empty() {
        return Err("an empty list gives no runs; omit the key to use seed 0".into());
    }
    let mut met = HashSet::new();
    match seeds.iter().find(|seed| !met.insert(**seed)) {
        None => Ok(()),
        Some(seed) => Err(format!("{seed} is listed twice")),
    }
}

/// Refuses `seed` among the keys that are set: seeds are an axis of their own, and would silently overwrite it.
pub(super) fn check_seed_keys(file: &SweepFile, options: &PlanOptions) -> Result<(), SweepError> {
    let set_in = |table: &Table| flatten(table).get("seed").map(ToString::to_string);
    let mut found = vec![("set.seed".to_owned(), set_in(&file.set)), ("grid.seed".to_owned(), set_in(&file.grid))];
    found.extend(file.variant.iter().map(|v| (format!("variant \"{}\": set.seed", v.name), set_in(&v.set))));
    let random = file.random.iter().flat_map(|r| r.keys.keys()).find(|key| *key == "seed");
    found.push(("random.keys.seed".to_owned(), random.map(|_| "0".to_owned())));
    let typed = options.set.iter().find_map(|s| s.split_once('=').filter(|(key, _)| key.trim() == "seed"));
    found.push(("--set seed".to_owned(), typed.map(|(_, value)| value.to_owned())));
    match found.into_iter().find_map(|(key, value)| Some((key, value?))) {
        None => Ok(()),
        Some((key, value)) => {
            let list = if value.starts_with('[') { value } else { format!("[{value}]") };
            let usable = toml::from_str::<Table>(&format!("seeds = {list}")).ok().and_then(|table| {
                let is_seed = |v: &toml::Value| v.as_integer().is_some_and(|seed| seed >= 0);
                table.get("seeds")?.as_array()?.iter().all(is_seed).then_some(list)
            });
            Err(match usable {
                Some(list) => {
                    file.wrong(key, format!("seeds are a separate axis; write seeds = {list} at the top of the file"))
                }
                None => file.wrong(
                    key,
                    "seeds are a separate axis, of whole numbers from 0; write, for example, seeds = [0, 1, 2] at the \
                     top of the file",
                ),
            })
        }
    }
}

/// The variant that differences are relative to: the one that is named, or the first.
pub(super) fn baseline(file: &SweepFile, variants: &[Variant]) -> Result<String, SweepError> {
    let first = variants.first().map(|v| v.name.clone()).unwrap_or_default();
    match &file.baseline {
        None => Ok(first),
        Some(name) if variants.iter().any(|v| v.name == *name) => Ok(name.clone()),
        Some(name) => {
            let problem = format!("no variant is named \"{name}\"; available: {}", names(variants));
            Err(file.wrong("baseline", problem))
        }
    }
}

fn names(variants: &[Variant]) -> String {
    variants.iter().map(|v| v.name.as_str()).collect::<Vec<_>>().join(", ")
}

/// Refuses rows of the paper's table that match no variant: the order would be judged without them.
pub(super) fn check_paper(file: &SweepFile, variants: &[Variant]) -> Result<(), SweepError> {
    // `VARIANT` or `VARIANT/SEGMENT`
    let is_of = |row: &str, variant: &Variant| {
        row.strip_prefix(variant.name.as_str()).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
    };
    let mut rows = file.paper.iter().flat_map(|paper| paper.rows.keys());
    match rows.find(|row| !variants.iter().any(|variant| is_of(row, variant))) {
        None => Ok(()),
        Some(row) => {
            let problem = format!("no variant has this name; available: {}", names(variants));
            Err(file.wrong(format!("paper.rows.\"{row}\""), problem))
        }
    }
}

/// Refuses metrics that no row of the table would have, before everything is trained for an empty column.
pub(super) fn check_metrics(plan: &Plan) -> Result<(), String> {
    let segments = plan.entries.iter().any(|e| e.segments.is_some());
    let scenes = plan.entries.iter().any(|e| e.segments.is_none());
    for id in plan.metrics.iter().map(String::as_str) {
        let of_segments = OF_SEGMENTS.contains(&id);
        if of_segments && !segments {
            return Err(format!(
                "\"{id}\" is a metric of segments, which this sweep does not measure; add [segments], or \
                 remove the metric"
            ));
        }
        if !(of_segments || OF_BOTH.contains(&id) || OF_RUNS.contains(&id) || scenes) {
            return Err(format!(
                "\"{id}\" is measured of the whole scene only, and with [segments] each row is a segment; remove the \
                 metric, or [segments]"
            ));
        }
    }
    Ok(())
}

/// Refuses early stopping with an invalid fraction or rungs, or at a step by which a run has no live test PSNR.
pub(super) fn check_halving(halving: &HalvingSpec, plan: &Plan) -> Result<(), String> {
    if !(halving.keep > 0.0 && halving.keep < 1.0) {
        return Err(format!("keep = {} is not between 0 and 1", halving.keep));
    }
    if halving.rungs.is_empty() || !halving.rungs.windows(2).all(|w| w[0] < w[1]) {
        return Err("rungs must be ascending, and at least one is needed".into());
    }
    for run in &plan.runs {
        let config: Config = toml::from_str(&run.config).map_err(|e| e.to_string())?;
        let every = config.output.eval_every;
        if every == 0 || halving.rungs[0] < every {
            return Err(format!(
                "run \"{}\" has no live test PSNR by step {}: output.eval_every is {every}",
                run.label, halving.rungs[0]
            ));
        }
    }
    Ok(())
}

/// Refuses invalid plans: keys of runs that are not hashes (they become part of paths), unknown datasets,
/// configurations that are nested too deeply, and indices out of range.
pub(super) fn check_plan(plan: &Plan) -> Result<(), String> {
    for (i, run) in plan.runs.iter().enumerate() {
        if !is_key(&run.key) {
            return Err(format!("runs[{i}].key: \"{}\" is not a hash", run.key));
        }
        if !plan.datasets.contains_key(&run.dataset) {
            return Err(format!("runs[{i}].dataset: unknown dataset \"{}\"", run.dataset));
        }
        check_toml(&run.config).map_err(|e| format!("runs[{i}].config: {e}"))?;
    }
    for (i, entry) in plan.entries.iter().enumerate() {
        let Some(run) = plan.runs.get(entry.run) else {
            return Err(format!("entries[{i}].run is {}, but there are {} runs", entry.run, plan.runs.len()));
        };
        if let Some(at) = entry.segments.filter(|at| *at >= run.segments.len()) {
            return Err(format!(
                "entries[{i}].segments is {at}, but its run has {} measurements of segments",
                run.segments.len()
            ));
        }
    }
    Ok(())
}
