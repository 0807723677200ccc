//! Expands a sweep file into its variants: named ones, grids, samples, and all their combinations.

use super::SweepError;
use super::file::{RandomSpec, RangeSpec, SampleMethod, SweepFile};
pub(super) use crate::config::flatten;
use crate::config::short_key;
use crate::memory::{MemoryBudget, product};
use crate::rng::{Purpose, Rng};
use std::collections::{BTreeMap, HashSet};
use toml::Value;

/// Keys set by a variant, by dotted name.
pub type VariantSettings = BTreeMap<String, Value>;

/// A variant: its name and what it sets.
#[derive(Clone, Debug, PartialEq)]
pub struct Variant {
    /// Name in tables.
    pub name: String,
    /// What it starts from instead of the sweep's configuration.
    pub config: Option<String>,
    /// What it sets.
    pub settings: VariantSettings,
    /// Its seeds instead of the sweep's.
    pub seeds: Option<Vec<u64>>,
}

/// Returns all variants of `file`, in order.
///
/// # Errors
/// If an axis has no values, a range or the samples are invalid, a variant has no name or that of another, or there are
/// more entries than a sweep may have.
pub fn variants(file: &SweepFile) -> Result<Vec<Variant>, SweepError> {
    check_count(file, 1, 1, MemoryBudget::now())?;
    let mut found = vec![Variant { name: String::new(), config: None, settings: VariantSettings::new(), seeds: None }];
    if !file.variant.is_empty() {
        let mut named = Vec::new();
        for (i, spec) in file.variant.iter().enumerate() {
            if spec.name.trim().is_empty() {
                return Err(file.wrong(format!("variant {}", i + 1), "the name is empty"));
            }
            if file.variant[..i].iter().any(|other| other.name == spec.name) {
                let problem = format!("two variants are named \"{}\"", spec.name);
                return Err(file.wrong(format!("variant {}", i + 1), problem));
            }
            let (name, config, seeds) = (spec.name.clone(), spec.config.clone(), spec.seeds.clone());
            named.push(Variant { name, config, settings: flatten(&spec.set), seeds });
        }
        found = named;
    }
    let grid = flatten(&file.grid);
    let axes: Vec<String> =
        grid.keys().cloned().chain(file.random.iter().flat_map(|r| r.keys.keys().cloned())).collect();
    for (key, value) in grid {
        let Value::Array(values) = value else {
            return Err(file.wrong(format!("grid.{key}"), "not a list of values"));
        };
        if values.is_empty() {
            return Err(file.wrong(format!("grid.{key}"), "an empty list gives no runs"));
        }
        let with = |variant: &Variant, value: &Value| variant.with(&[(key.clone(), value.clone())], &axes);
        found = found.iter().flat_map(|v| values.iter().map(|value| with(v, value)).collect::<Vec<_>>()).collect();
    }
    if let Some(random) = &file.random {
        let points = samples(file, random)?;
        found = found.iter().flat_map(|v| points.iter().map(|p| v.with(p, &axes)).collect::<Vec<_>>()).collect();
    }
    for variant in &mut found {
        if variant.name.is_empty() {
            variant.name = "base".to_owned();
        }
    }
    Ok(found)
}

/// The seeds of the sweep, followed by those that only variants have.
pub(super) fn all_seeds(seeds: &[u64], variants: &[Variant]) -> Vec<u64> {
    let mut all: Vec<u64> = Vec::new();
    for variant in variants {
        all.extend(variant.seeds(seeds).iter().filter(|seed| !seeds.contains(seed)));
    }
    all.sort_unstable();
    all.dedup();
    seeds.iter().copied().chain(all).collect()
}

/// Maximum number of entries of a sweep: far more than anybody can train, and planned within minutes.
const MAX_ENTRIES: u128 = 100_000;
/// Bytes for an entry and its run while a sweep is planned: the configuration as text, settings, names.
const ENTRY_BYTES: u128 = 16_384;

/// Refuses a file with more entries than can be planned, before any is made. `places` is the number of datasets times
/// that of devices. The error names the key that contributes most.
pub(super) fn check_count(
    file: &SweepFile,
    seeds: usize,
    places: usize,
    budget: MemoryBudget,
) -> Result<(), SweepError> {
    let mut factors = vec![
        ("variant".to_owned(), file.variant.len()),
        ("seeds".to_owned(), seeds),
        ("data and devices".to_owned(), places),
        ("random.count".to_owned(), file.random.as_ref().map_or(1, |r| r.count)),
    ];
    let grid = flatten(&file.grid).into_iter();
    factors.extend(grid.map(|(key, value)| (format!("grid.{key}"), value.as_array().map_or(1, Vec::len))));
    let sizes: Vec<usize> = factors.iter().map(|(_, n)| (*n).max(1)).collect();
    let entries = product(&sizes);
    let (key, n) = factors.into_iter().max_by_key(|(_, n)| *n).unwrap_or_default();
    if entries > MAX_ENTRIES {
        let problem = format!("{n} values make {entries} runs in all; a sweep has at most {MAX_ENTRIES}");
        return Err(file.wrong(key, problem));
    }
    let fits = budget.check(format!("{n} values make {entries} runs in all"), entries.saturating_mul(ENTRY_BYTES));
    fits.map_err(|e| file.wrong(key, e))
}

impl Variant {
    /// Its seeds; `seeds` are the sweep's.
    pub(super) fn seeds<'a>(&'a self, seeds: &'a [u64]) -> &'a [u64] {
        self.seeds.as_deref().unwrap_or(seeds)
    }

    /// The variant with more keys set, which are added to its name, shortened as far as `axes`, all keys, allow.
    fn with(&self, more: &[(String, Value)], axes: &[String]) -> Self {
        let mut new = self.clone();
        for (key, value) in more {
            let short = short_key(key, axes);
            let text = match value {
                Value::String(text) => text.clone(),
                value => value.to_string(),
            };
            let part = format!("{short}={text}");
            new.name = if new.name.is_empty() { part } else { format!("{}, {part}", new.name) };
            new.settings.insert(key.clone(), value.clone());
        }
        new
    }
}

/// Maximum end of a range of integers, 2^53: beyond it, not every integer can be represented in double precision.
const MAX_INTEGER: f64 = 9_007_199_254_740_992.0;

type AxesPoint = Vec<(String, Value)>;

fn samples(file: &SweepFile, spec: &RandomSpec) -> Result<Vec<AxesPoint>, SweepError> {
    if spec.count == 0 || spec.keys.is_empty() {
        return Err(file.wrong("random", "needs a count of at least 1 and at least one key"));
    }
    if spec.method == SampleMethod::Sobol && spec.keys.len() > 256 {
        return Err(file.wrong("random.keys", "Sobol sampling supports at most 256 keys; use latin-hypercube"));
    }
    if spec.method == SampleMethod::Sobol && spec.count > 1 << 16 {
        let problem = format!("{}: Sobol sampling supports at most 65536 points; use latin-hypercube", spec.count);
        return Err(file.wrong("random.count", problem));
    }
    for (key, range) in &spec.keys {
        range.check().map_err(|problem| file.wrong(format!("random.keys.{key}"), problem))?;
    }
    let units: Vec<Vec<f64>> = (0..spec.keys.len()).map(|axis| unit_numbers(spec, axis)).collect();
    let point =
        |i: usize| spec.keys.iter().zip(&units).map(|((key, range), u)| (key.clone(), range.at(u[i]))).collect();
    // integers and choices can repeat; training the same run twice adds nothing
    let mut met = HashSet::new();
    let new = |point: &AxesPoint| met.insert(format!("{point:?}"));
    Ok((0..spec.count).map(point).filter(new).collect())
}

/// Numbers in [0, 1) of one axis, one for each point.
fn unit_numbers(spec: &RandomSpec, axis: usize) -> Vec<f64> {
    let mut rng = Rng::new(u64::from(spec.seed), axis as u64, Purpose::Sweep);
    match spec.method {
        SampleMethod::Sobol => {
            (0..spec.count).map(|i| f64::from(sobol_burley::sample(i as u32, axis as u32, spec.seed))).collect()
        }
        SampleMethod::Uniform => (0..spec.count).map(|_| f64::from(rng.uniform())).collect(),
        SampleMethod::LatinHypercube => {
            let mut parts: Vec<usize> = (0..spec.count).collect();
            rng.shuffle(&mut parts);
            parts.into_iter().map(|p| (p as f64 + f64::from(rng.uniform())) / spec.count as f64).collect()
        }
    }
}

impl RangeSpec {
    fn check(&self) -> Result<(), String> {
        if !self.choices.is_empty() {
            let mixed = self.low.is_some() || self.high.is_some() || self.log || self.integer;
            return if mixed { Err("has choices and a range; keep one of them".into()) } else { Ok(()) };
        }
        let (Some(low), Some(high)) = (self.low, self.high) else {
            return Err("needs low and high, or choices".into());
        };
        if !(low.is_finite() && high.is_finite() && low < high) {
            return Err(format!("low = {low} is not below high = {high}"));
        }
        if self.log && low <= 0.0 {
            return Err(format!("log requires low above 0, not {low}"));
        }
        if self.integer && (low.fract() != 0.0 || high.fract() != 0.0) {
            return Err("integer requires low and high to be whole numbers".into());
        }
        if self.integer && low.abs().max(high.abs()) > MAX_INTEGER {
            return Err(format!("integer requires low and high from {:e} to {MAX_INTEGER:e}", -MAX_INTEGER));
        }
        Ok(())
    }

    /// The value at `u` in [0, 1).
    fn at(&self, u: f64) -> Value {
        if !self.choices.is_empty() {
            let i = (u * self.choices.len() as f64) as usize;
            return self.choices[i.min(self.choices.len() - 1)].clone();
        }
        let (low, mut high) = (self.low.unwrap_or(0.0), self.high.unwrap_or(1.0));
        if self.integer {
            high += 1.0;
        }
        let value = if self.log { (low.ln() + u * (high.ln() - low.ln())).exp() } else { low + u * (high - low) };
        if self.integer {
            return Value::Integer((value.floor() as i64).min(high as i64 - 1));
        }
        // four significant digits, as a user would have written, which keeps the run's name short
        Value::Float(format!("{value:.3e}").parse().unwrap_or(value))
    }
}

#[cfg(test)]
#[path = "axes_tests.rs"]
mod tests;
