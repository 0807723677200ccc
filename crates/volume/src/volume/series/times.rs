//! The times of the steps of a series: in [0, 1], and as the files or the user give them.

use super::SeriesOptions;
use crate::volume::error::VolumeError;
use crate::volume::source::{PhysicalMetadata, VOXELS};
use std::path::Path;

/// The unit of times that dates give.
const SECONDS: &str = "s";

/// The times of all steps.
#[derive(Debug)]
pub(super) struct SeriesTimes {
    /// In [0, 1]: 0 the first, 1 the last; 0 for a single step.
    pub scene: Vec<f64>,
    /// As given, ascending; `None` where they are unknown.
    pub values: Option<Vec<f64>>,
    /// The unit of `values`, if it is named.
    pub unit: Option<String>,
}

impl SeriesTimes {
    /// The times that the options give, else those of the file of many steps, else those of `dates` in seconds, else
    /// evenly spaced ones. Dates count from the first.
    ///
    /// # Errors
    /// Times that do not fit or do not increase, or the unit of times that nothing gives or that is that of dates.
    pub fn new(
        path: &Path,
        steps: usize,
        options: &SeriesOptions,
        dates: Option<Vec<f64>>,
        physical: &PhysicalMetadata,
        notes: &mut Vec<String>,
    ) -> Result<Self, VolumeError> {
        let dates = dates.filter(|_| options.times.is_none());
        let dates: Option<Vec<f64>> = dates.map(|all| all.iter().map(|t| t - all[0]).collect());
        let scene = normalised(path, steps, options.times.as_deref().or(dates.as_deref()))?;
        if let Some(values) = dates {
            if let Some(given) = options.time_unit.as_ref().filter(|unit| *unit != SECONDS) {
                let problem = format!("the dates in the names of the files give times in {SECONDS}, not {given}");
                let hint = "omit it, or give the time of each step with --time-values";
                return Err(VolumeError::invalid(path, "--time-unit", problem, hint));
            }
            return Ok(Self { scene, values: Some(values), unit: Some(SECONDS.to_owned()) });
        }
        // times that were given are not in the unit of the file's own
        let own = physical.time.as_ref().filter(|_| options.times.is_none() && steps > 1);
        let mut unit = own.and_then(|t| t.unit.clone());
        let of_file = own.map(|t| (0..steps).map(|k| t.start + k as f64 * t.step).collect::<Vec<f64>>());
        // a step beyond the precision of the start gives no times
        let increases = |times: &Vec<f64>| times.windows(2).all(|t| t[0] < t[1]) && times.iter().all(|t| t.is_finite());
        let values = options.times.clone().or(of_file.filter(increases));
        if values.is_none() {
            unit = None;
        }
        if let Some(given) = options.time_unit.as_ref().filter(|_| values.is_none()) {
            let hint = "give the time of each step with --time-values";
            return Err(VolumeError::invalid(path, "--time-unit", format!("the times in {given} are not known"), hint));
        }
        replace("--time-unit", &mut unit, &options.time_unit, notes);
        Ok(Self { scene, values, unit })
    }
}

/// Puts a unit that was given in place of that of the files, with a note where these name another one.
pub(super) fn replace(flag: &str, own: &mut Option<String>, given: &Option<String>, notes: &mut Vec<String>) {
    let Some(given) = given else { return };
    if let Some(own) = own.as_ref().filter(|own| *own != given && *own != VOXELS) {
        notes.push(format!("{flag} {given} is used instead of the unit of the files, {own}"));
    }
    *own = Some(given.clone());
}

fn normalised(path: &Path, steps: usize, times: Option<&[f64]>) -> Result<Vec<f64>, VolumeError> {
    let last = steps.saturating_sub(1).max(1) as f64;
    let Some(times) = times else { return Ok((0..steps).map(|i| i as f64 / last).collect()) };
    let bad = |problem: String, hint: &str| Err(VolumeError::invalid(path, "times", problem, hint));
    if times.len() != steps {
        return bad(format!("{} times are given for {steps} steps", times.len()), "give one time for each step");
    }
    if let Some(i) = (0..steps).find(|&i| !times[i].is_finite() || (i > 0 && times[i] <= times[i - 1])) {
        let problem = match times[i].is_finite() {
            true => format!(
                "step {i} has the time {}, which is not after that of step {}, {}",
                times[i],
                i - 1,
                times[i - 1]
            ),
            false => format!("step {i} has the time {}", times[i]),
        };
        return bad(problem, "give finite, increasing times");
    }
    let (t0, t1) = (times[0], times[steps - 1]);
    // Halves keep the difference of huge times finite.
    let half = if (t1 - t0).is_finite() { 1.0 } else { 0.5 };
    let span = t1 * half - t0 * half;
    let time = |t: &f64| if steps == 1 { 0.0 } else { ((t * half - t0 * half) / span).clamp(0.0, 1.0) };
    Ok(times.iter().map(time).collect())
}
