//! Hyperparameters for TensorBoard's `HPARAMS` page: which settings a run has, and which metrics judge it.
//!
//! The page reads three summaries without numbers, whose metadata holds a protobuf message of the plugin: what the
//! experiment varies, the settings of this session (run), and how it ended. Only the first of each in a run's folder
//! counts.

use std::collections::BTreeMap;
use std::io;

use super::{EventWriter, Message, field::TAG, now};

/// A setting of a run.
#[derive(Debug, Clone, PartialEq)]
pub enum HyperParameter {
    /// A number. Non-finite values are written as text, as TensorBoard refuses them otherwise.
    Number(f64),
    /// Text.
    Text(String),
    /// True or false.
    Flag(bool),
}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SessionEnd {
    /// Without an error.
    Success,
    /// With an error.
    Failure,
}

/// Field numbers of `Summary.Value` and below, and of the plugin's messages.
mod field {
    pub(super) const TENSOR: u32 = 8;
    pub(super) const METADATA: u32 = 9;
    pub(super) const PLUGIN_DATA: u32 = 1;
    pub(super) const PLUGIN_NAME: u32 = 1;
    pub(super) const CONTENT: u32 = 2;
    pub(super) const DTYPE: u32 = 1;
    pub(super) const SHAPE: u32 = 2;
    pub(super) const DIM: u32 = 2;

    pub(super) const EXPERIMENT: u32 = 2;
    pub(super) const SESSION_START: u32 = 3;
    pub(super) const SESSION_END: u32 = 4;

    pub(super) const TIME_CREATED: u32 = 3;
    pub(super) const HPARAM_INFOS: u32 = 4;
    pub(super) const METRIC_INFOS: u32 = 5;
    pub(super) const HPARAM_NAME: u32 = 1;
    pub(super) const HPARAM_TYPE: u32 = 4;
    pub(super) const HPARAM_DIFFERS: u32 = 7;
    pub(super) const METRIC_NAME: u32 = 1;
    pub(super) const METRIC_TAG: u32 = 2;
    pub(super) const METRIC_DISPLAY_NAME: u32 = 3;

    pub(super) const HPARAMS: u32 = 1;
    pub(super) const GROUP_NAME: u32 = 4;
    pub(super) const START_TIME: u32 = 5;
    pub(super) const KEY: u32 = 1;
    pub(super) const VALUE: u32 = 2;
    pub(super) const NUMBER: u32 = 2;
    pub(super) const STRING: u32 = 3;
    pub(super) const BOOL: u32 = 4;

    pub(super) const STATUS: u32 = 1;
    pub(super) const END_TIME: u32 = 2;
}

const FLOAT: u64 = 1;
const TYPE_STRING: u64 = 1;
const TYPE_BOOL: u64 = 2;
const TYPE_FLOAT64: u64 = 3;
const SUCCESS: u64 = 1;
const FAILURE: u64 = 2;

impl HyperParameter {
    fn kind(&self) -> u64 {
        match self {
            Self::Number(value) if value.is_finite() => TYPE_FLOAT64,
            Self::Number(_) | Self::Text(_) => TYPE_STRING,
            Self::Flag(_) => TYPE_BOOL,
        }
    }

    /// A `google.protobuf.Value`.
    fn value(&self) -> Message {
        let value = Message::default();
        match self {
            Self::Number(number) if number.is_finite() => value.double(field::NUMBER, *number),
            Self::Number(number) => value.bytes(field::STRING, number.to_string()),
            Self::Text(text) => value.bytes(field::STRING, text),
            Self::Flag(flag) => value.varint(field::BOOL, u64::from(*flag)),
        }
    }
}

impl EventWriter {
    /// Appends the settings of this run, and the experiment it belongs to: `settings` are those that runs differ in,
    /// `metrics` the tags of scalars with the names that the page shows. Runs of the same `group` (a variant, whose
    /// runs differ in their seeds) are one row of the page.
    ///
    /// Of several runs in one log folder, TensorBoard takes the experiment of any one: all should name the same
    /// settings and metrics.
    ///
    /// # Errors
    /// Any error of the file system.
    pub fn hparams(
        &mut self,
        settings: &BTreeMap<String, HyperParameter>,
        metrics: &[(&str, &str)],
        group: &str,
    ) -> io::Result<()> {
        let mut experiment = Message::default().double(field::TIME_CREATED, now());
        let mut start = Message::default();
        for (name, setting) in settings {
            let info = Message::default().bytes(field::HPARAM_NAME, name).varint(field::HPARAM_TYPE, setting.kind());
            // TensorBoard cannot know this, and shows these settings first
            experiment = experiment.bytes(field::HPARAM_INFOS, info.varint(field::HPARAM_DIFFERS, 1));
            let entry = Message::default().bytes(field::KEY, name).bytes(field::VALUE, setting.value());
            start = start.bytes(field::HPARAMS, entry);
        }
        for (tag, shown) in metrics {
            let name = Message::default().bytes(field::METRIC_TAG, tag);
            let info = Message::default().bytes(field::METRIC_NAME, name).bytes(field::METRIC_DISPLAY_NAME, shown);
            experiment = experiment.bytes(field::METRIC_INFOS, info);
        }
        let start = start.bytes(field::GROUP_NAME, group).double(field::START_TIME, now());
        self.plugin("_hparams_/experiment", field::EXPERIMENT, experiment)?;
        self.plugin("_hparams_/session_start_info", field::SESSION_START, start)
    }

    /// Appends how the run ended.
    ///
    /// # Errors
    /// Any error of the file system.
    pub fn session_end(&mut self, end: SessionEnd) -> io::Result<()> {
        let status = match end {
            SessionEnd::Success => SUCCESS,
            SessionEnd::Failure => FAILURE,
        };
        let message = Message::default().varint(field::STATUS, status).double(field::END_TIME, now());
        self.plugin("_hparams_/session_end_info", field::SESSION_END, message)
    }

    /// Appends a summary whose metadata holds the plugin's `message` as its field `kind`. The tensor, which a summary
    /// must have, is an empty vector of floats.
    fn plugin(&mut self, tag: &str, kind: u32, message: Message) -> io::Result<()> {
        let content = Message::default().bytes(kind, message);
        let data = Message::default().bytes(field::PLUGIN_NAME, b"hparams").bytes(field::CONTENT, content);
        let metadata = Message::default().bytes(field::PLUGIN_DATA, data);
        let tensor = Message::default()
            .varint(field::DTYPE, FLOAT)
            .bytes(field::SHAPE, Message::default().bytes(field::DIM, []));
        let entry = Message::default().bytes(TAG, tag).bytes(field::TENSOR, tensor).bytes(field::METADATA, metadata);
        self.summary(0, entry)
    }
}
