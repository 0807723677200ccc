//! A variant's configuration: the file's, with the command line's settings and then its own on top, checked.
//!
//! No step of training reads `[segment]`. It is kept out of the configuration that runs are trained with and recognised by,
//! and belongs to the measurement of segments instead: variants that differ in nothing else share a run.

use super::SweepError;
use super::axes::{Settings, Variant, flatten};
use super::file::SweepFile;
use super::plan::PlanOptions;
use crate::config::layers::Layers;
use crate::config::types::{Config, SegmentConfig};
use crate::config::{PRESETS, RESERVED_VARIABLES};
use crate::eval::segments::SegmentOptions;
use crate::method;
use crate::words::plain;
use std::path::Path;
use toml::{Table, Value};

/// Prefix of the keys that say how segments are measured.
const SEGMENTS: &str = "segments.";
/// The method that is measured unless another is named.
const METHOD: &str = "coarse+fine";
/// Section of the configuration that says how a scene becomes segments.
const SEGMENT: &str = "segment";

/// What every variant starts from: the sweep file and what the command line sets.
pub(super) struct Base<'a> {
    pub file: &'a SweepFile,
    pub path: &'a Path,
    pub options: &'a PlanOptions,
}

/// A variant's configuration.
pub(super) struct Resolved {
    pub config: Config,
    /// The same as TOML text, with every key but those of segmentation.
    pub toml: String,
    pub segments: Option<SegmentOptions>,
}

impl Base<'_> {
    /// Resolves and checks the configuration of `variant` with `seed`.
    pub fn resolve(&self, variant: &Variant, seed: u64) -> Result<Resolved, SweepError> {
        let place = format!("variant \"{}\"", variant.name);
        let bad = |problem: String| SweepError::Key { path: self.path.to_owned(), key: place.clone(), problem };
        let mut layers = Layers::new(PRESETS);
        if let Some(config) = variant.config.as_ref().or(self.file.config.as_ref()) {
            layers = layers.source(config);
        }
        let layers = layers.env(std::env::vars_os(), RESERVED_VARIABLES).map_err(|e| bad(e.to_string()))?;
        let set = flatten(&self.file.set);
        let layers = layers
            .sets(assignments(&set))
            .sets(self.options.set.iter().filter(|s| !s.starts_with(SEGMENTS)).cloned())
            .sets(assignments(&variant.settings))
            .sets([format!("seed={seed}")]);
        let mut resolved = layers.resolve::<Config>().map_err(|e| bad(e.to_string()))?;
        method::check_new(&resolved.value).map_err(|e| bad(e.to_string()))?;
        resolved.table.remove(SEGMENT);
        let toml = resolved.to_toml().map_err(|e| bad(e.to_string()))?;
        let config = &resolved.value.segment;
        let segments = self.segments(&set, &variant.settings, config).map_err(&bad)?;
        if let Some(spec) = &segments {
            spec.check().map_err(|e| bad(e.to_string()))?;
            if spec.methods.len() != 1 {
                return Err(bad("segments.method: give one to each variant".to_owned()));
            }
            let name = &resolved.value.method;
            if !method::find(name).map_err(&bad)?.has_persistent_gaussians() {
                return Err(bad(format!("segments: the method {name} has no Gaussians that stay the same over time")));
            }
        }
        Ok(Resolved { config: resolved.value, toml, segments })
    }

    /// `[segments]` with the keys of the sweep, the command line and the variant on top, and `[segment]`.
    fn segments(
        &self,
        set: &Settings,
        variant: &Settings,
        config: &SegmentConfig,
    ) -> Result<Option<SegmentOptions>, String> {
        let mut table = self.file.segments.clone();
        let command_line = self.options.set.iter().filter_map(|s| {
            let (key, value) = s.split_once('=')?;
            let value: Option<Table> = format!("v = {value}").parse().ok();
            Some((key.to_owned(), value.and_then(|mut t| t.remove("v")).unwrap_or(Value::String(value_text(s)))))
        });
        let all = set.clone().into_iter().chain(command_line).chain(variant.clone());
        for (key, value) in all {
            if let Some(key) = key.strip_prefix(SEGMENTS) {
                table.get_or_insert_default().insert(key.to_owned(), value);
            }
        }
        let read = |mut t: Table| {
            if t.contains_key(SEGMENT) {
                return Err("segments.segment: options of segmentation have keys of their own, segment.*".to_owned());
            }
            // each alone first, as the error does not name the key
            for (key, value) in &t {
                let alone = Table::from_iter([(key.clone(), value.clone())]).try_into::<SegmentOptions>();
                alone.map_err(|e| format!("segments.{key}: {}", plain(e.message())))?;
            }
            t.entry("method").or_insert_with(|| METHOD.into());
            let mut spec: SegmentOptions =
                t.try_into().map_err(|e: toml::de::Error| format!("segments: {}", e.message()))?;
            spec.segment = config.clone();
            let base = self.path.parent().unwrap_or(Path::new(""));
            for path in [&mut spec.mask_dir, &mut spec.sam_weights].into_iter().flatten() {
                *path = std::path::absolute(base.join(&*path)).map_err(|e| format!("segments: {e}"))?;
            }
            Ok::<_, String>(spec)
        };
        table.map(read).transpose()
    }
}

fn value_text(assignment: &str) -> String {
    assignment.split_once('=').map_or(String::new(), |(_, v)| v.to_owned())
}

/// Settings in the form that `--set` takes, without those of segments.
fn assignments(settings: &Settings) -> Vec<String> {
    settings.iter().filter(|(k, _)| !k.starts_with(SEGMENTS)).map(|(k, v)| format!("{k}={v}")).collect()
}
