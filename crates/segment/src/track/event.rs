//! Input and output types of event detection: frames, settings, events, tracks. How events are found is in `events`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The Gaussians of one segment at one time; every frame lists the same Gaussians in the same order.
#[derive(Debug, Clone, Copy)]
pub struct SegmentAtTime<'a> {
    /// Time; frames are in order, forward or backward.
    pub time: f64,
    /// `[S]`: component of each Gaussian, 0 for none (transparent, outlier); at most `S`.
    pub labels: &'a [u32],
    /// `[S]`: linear opacity.
    pub opacity: &'a [f32],
}

/// Settings of [`find_events`](super::events::find_events).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EventConfig {
    /// Fraction of a time's weight (opacity) below which a component is ignored, and of a component's weight below
    /// which its overlap with another is.
    pub min_share: f64,
    /// Number of times that a new state must last to be an event; 1 reports every flicker.
    pub persistence: usize,
    /// Fraction of the largest total opacity over time below which the whole segment counts as gone.
    pub presence_share: f64,
}

impl Default for EventConfig {
    fn default() -> Self {
        Self { min_share: 0.05, persistence: 2, presence_share: 0.02 }
    }
}

/// What happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EventKind {
    /// A component appears (1 child).
    Appear,
    /// A component vanishes (1 parent).
    Vanish,
    /// A component becomes several.
    Split,
    /// Several components become one.
    Merge,
    /// A track continues from `time_from` to `time_to` without an event.
    Continue,
    /// The whole segment becomes visible; its tracks may also appear one by one.
    SegmentAppear,
    /// The whole segment fades; its tracks may also vanish one by one.
    SegmentVanish,
}

/// One event between two times.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SegmentEvent {
    /// Last time of the state before.
    pub time_from: f64,
    /// First time of the state after.
    pub time_to: f64,
    /// What happened.
    pub kind: EventKind,
    /// Tracks before the event.
    pub parents: Vec<u32>,
    /// Tracks after the event.
    pub children: Vec<u32>,
    /// Total opacity of each parent at its last time.
    pub parent_weights: Vec<f64>,
    /// Total opacity of each child at its first time.
    pub child_weights: Vec<f64>,
    /// How well it is supported, in [0, 1]: the least share of the weight of a part that the event accounts for, times
    /// `n / (n + persistence)`, where `n` is the number of times that the shortest of the states before and after lasts.
    /// A part that lasts just long enough to count has half.
    pub confidence: f64,
}

/// The track of one component at one time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrackPoint {
    /// Time.
    pub time: f64,
    /// Label of the component at that time.
    pub component: u32,
    /// Track, from 1; 0 if no track is known.
    pub track: u32,
    /// Total opacity.
    pub weight: f64,
    /// Whether the component was too small or too short-lived for a track of its own and borrows the one that most of
    /// its Gaussians have at neighbouring times.
    pub lent: bool,
}

/// The outcome of [`find_events`](super::events::find_events).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Tracking {
    /// Events in order of time.
    pub events: Vec<SegmentEvent>,
    /// Tracks of all visible components, by time and label.
    pub points: Vec<TrackPoint>,
}
