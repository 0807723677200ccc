//! Extension points: custom loss terms, space-time encoders, learning-rate schedules, densification rules, metrics, file
//! formats, dataset layouts, sources of masks and whole methods, without changes to this crate.
//!
//! A small program registers them by name, then calls [`crate::main`]; from then on configurations, sweeps and commands
//! accept these names. `docs/research.md` shows how; `examples/extended` is such a program.
//!
//! A name consists of letters, digits, `-` and `_`; any other character becomes `_`. Registering a name again replaces
//! its previous entry, also a built-in one: these are in the same tables. A table is global to the process, and an entry
//! lives as long: register before training or loading a scene.
//!
//! The functions that register are here; each trait is defined beside the code that uses it.

pub use crate::config::sections::{ConfigSection, Settings};
pub use crate::data::dataset_layout::DatasetLayout;
pub use crate::data::scan::SplitScan;
pub use crate::export::exporters::{Content, Exporter};
pub use crate::export::splat_file::{SplatFileError, SplatFileOptions};
pub use crate::method::network::{self, Network, StepInput};
pub use crate::method::{Counts, Method, Model, SavedTraining, Training};
pub use crate::metrics::metric::{Better, Metric, MetricDisplay, MetricFailure, MetricInput, Networks};
pub use crate::model::encoder::{EncoderFactory, find_encoder};
pub use crate::model::encoder_definition::{EncoderDefinition, EncoderParameter, Parameters};
pub use crate::registry::NotRegistered;
pub use crate::segment::masks::registry::{
    ChooseSourceError, MaskSourceKind, SourceInput, SourceOption, SourceOptions, SourceViews,
};
pub use crate::segment::masks::source::{MaskSource, SourceError};
pub use crate::train::densify::{Candidates, DensificationRule, RowSource, find_rule};
pub use crate::train::losses::{LossInput, LossTerm, find_loss_term};
pub use crate::train::rate_schedule::{Schedule, find_schedule};
pub use volseggs_kernels::PinholeCamera;

use crate::data::LAYOUTS;
use crate::export::EXPORTERS;
use crate::method::METHODS;
use crate::metrics::METRICS;
use crate::model::defined_encoder::DefinedEncoderFactory;
use crate::model::encoder::ENCODERS;
use crate::segment::masks::source::MASK_SOURCES;
use crate::train::densify::RULES;
use crate::train::losses::LOSS_TERMS;
use crate::train::rate_schedule::SCHEDULES;

/// Registers a loss term; `loss.extra.NAME = WEIGHT` uses it.
pub fn loss_term(name: &str, term: impl LossTerm + 'static) {
    LOSS_TERMS.insert(name, Box::new(term));
}

/// Registers an encoder; `model.encoder = "NAME"` uses it. It replaces a built-in encoder of that name.
pub fn encoder(name: &str, definition: impl EncoderDefinition + 'static) {
    ENCODERS.insert(name, Box::new(DefinedEncoderFactory(Box::leak(Box::new(definition)))));
}

/// Registers a schedule; `optim.schedule = "NAME"` uses it. It replaces a built-in schedule of that name.
pub fn schedule(name: &str, schedule: impl Schedule + 'static) {
    SCHEDULES.insert(name, Box::new(schedule));
}

/// Registers a densification rule; `densify.mode = "NAME"` uses it. It replaces a built-in rule of that name.
pub fn densification(name: &str, rule: impl DensificationRule + 'static) {
    RULES.insert(name, Box::new(rule));
}

/// Registers a metric; every later evaluation computes it. It replaces a built-in metric of that name.
pub fn metric(name: &str, metric: impl Metric + 'static) {
    METRICS.insert(name, Box::new(metric));
}

/// Registers a source of masks; `segment masks --source NAME`, `eval --segments --masks NAME` and `segments.masks = "NAME"`
/// use it. It replaces a built-in source of that name. What it sees and returns of a picture is
/// [`MaskInput`](crate::segment::masks::source::MaskInput) and [`ScoredMask`](crate::segment::masks::source::ScoredMask).
pub fn mask_source(name: &str, kind: impl MaskSourceKind + 'static) {
    MASK_SOURCES.insert(name, Box::new(kind));
}

/// Registers a format of files for other programs; `volseggs export`, by the extension of `--out` or by `--format`, and the
/// viewer write it. It replaces a built-in format of that extension.
pub fn exporter(exporter: Exporter) {
    EXPORTERS.insert(exporter.extension, Box::new(exporter));
}

/// Registers a layout of datasets: whatever reads a dataset also reads folders that it recognises. It replaces a built-in
/// layout of that name.
pub fn dataset_layout(name: &str, layout: impl DatasetLayout + 'static) {
    LAYOUTS.insert(name, Box::new(layout));
}

/// Registers a method; `method = "NAME"`, or `volseggs train --method NAME`, trains with it. It replaces a built-in
/// method of that name.
pub fn method(name: &str, method: impl Method + 'static) {
    METHODS.insert(name, Box::new(method));
}
