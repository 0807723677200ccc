//! A variant's configuration: the file's, with the command line's settings and then its own on top, checked.
//!
//! No step of training reads `[segment]`. It is kept out of the configuration that runs are trained with and recognised by,
//! and belongs to the measurement of segments instead: variants that differ in nothing else share a run.

use super::SweepError;
use super::axes::{Variant, VariantSettings, flatten};
use super::file::SweepFile;
use super::plan::PlanOptions;
use crate::config::types::{Config, SegmentConfig, segment::SECTION as SEGMENT};
use crate::config::{PRESET_IF_NONE_GIVEN, RESERVED_VARIABLES};
use crate::eval::segments::SegmentEvalOptions;
use crate::method;
use crate::words::plain;
use std::path::Path;
use toml::{Table, Value};

/// Prefix of the keys that say how segments are measured.
const SEGMENTS: &str = "segments.";

/// What every variant starts from: the sweep file and what the command line sets.
pub(super) struct Base<'a> {
    pub file: &'a SweepFile,
    pub path: &'a Path,
    pub options: &'a PlanOptions,
}

/// A variant's configuration.
pub(super) struct ResolvedVariant {
    pub config: Config,
    /// The same as TOML text, with every key but those of segmentation.
    pub toml: String,
    pub segments: Option<SegmentEvalOptions>,
}

impl Base<'_> {
    /// Resolves and checks the configuration of `variant` with `seed`.
    pub fn resolve(&self, variant: &Variant, seed: u64) -> Result<ResolvedVariant, SweepError> {
        let place = format!("variant \"{}\"", variant.name);
        let bad = |problem: String| SweepError::Key { path: self.path.to_owned(), key: place.clone(), problem };
        let config = variant.config.as_deref().or(self.file.config.as_deref()).unwrap_or(PRESET_IF_NONE_GIVEN);
        let layers = method::layers().source(config);
        let layers = layers.env(std::env::vars_os(), RESERVED_VARIABLES).map_err(|e| bad(e.to_string()))?;
        let set = flatten(&self.file.set);
        let layers = layers
            .sets(assignments(&set))
            .sets(self.options.set.iter().filter(|s| !s.starts_with(SEGMENTS)).cloned())
            .sets(assignments(&variant.settings))
            .sets([format!("seed={seed}")]);
        let mut resolved = layers.resolve::<Config>().map_err(|e| bad(e.to_string()))?;
        method::check(&resolved.value).map_err(|e| bad(e.to_string()))?;
        resolved.table.remove(SEGMENT);
        let toml = resolved.to_toml().map_err(|e| bad(e.to_string()))?;
        let config = &resolved.value.segment;
        let segments = self.segments(&set, &variant.settings, config).map_err(&bad)?;
        if let Some(spec) = &segments {
            spec.check().map_err(|e| bad(e.to_string()))?;
            let name = &resolved.value.method;
            if !method::find(name).map_err(&bad)?.has_persistent_gaussians() {
                return Err(bad(format!("segments: the method {name} has no Gaussians that stay the same over time")));
            }
        }
        Ok(ResolvedVariant { config: resolved.value, toml, segments })
    }

    /// `[segments]` with the keys of the sweep, the command line and the variant on top, and `[segment]`.
    fn segments(
        &self,
        set: &VariantSettings,
        variant: &VariantSettings,
        config: &SegmentConfig,
    ) -> Result<Option<SegmentEvalOptions>, String> {
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
        let read = |t: Table| {
            if t.contains_key(SEGMENT) {
                return Err("segments.segment: options of segmentation have keys of their own, segment.*".to_owned());
            }
            let spec = t.clone().try_into();
            let mut spec: SegmentEvalOptions =
                spec.map_err(|e: toml::de::Error| format!("{}: {}", wrong_key(&t), plain(e.message())))?;
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

/// Names the key because of which `table` is no section `[segments]`; the errors of the parser do not.
fn wrong_key(table: &Table) -> String {
    let alone = |(key, value): &(&String, &Value)| Table::from_iter([((*key).clone(), (*value).clone())]);
    let wrong = table.iter().find(|entry| alone(entry).try_into::<SegmentEvalOptions>().is_err());
    wrong.map_or_else(|| SEGMENTS.trim_end_matches('.').to_owned(), |(key, _)| format!("{SEGMENTS}{key}"))
}

fn value_text(assignment: &str) -> String {
    assignment.split_once('=').map_or(String::new(), |(_, v)| v.to_owned())
}

/// Settings in the form that `--set` takes, without those of segments.
fn assignments(settings: &VariantSettings) -> Vec<String> {
    settings.iter().filter(|(k, _)| !k.starts_with(SEGMENTS)).map(|(k, v)| format!("{k}={v}")).collect()
}
