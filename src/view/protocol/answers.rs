//! Messages of the server.

use crate::data::Calibration;
use crate::run::cameras::Placed;
use crate::run::keyframes::{Key, SavedPath};
use crate::run::look::Legend;
use crate::segment::levels::LevelKind;
use crate::view::jobs::board::JobState;
use crate::view::tracks::Track;
use crate::view::training::TrainingStatus;
use schemars::JsonSchema;
use serde::Serialize;

/// A message of the server.
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[serde(tag = "type", rename_all = "kebab-case")]
pub enum Answer {
    /// The first message, sent again when the scene changes or an affinity field appears or disappears.
    Welcome {
        /// Version of the program.
        version: &'static str,
        /// Name of the run.
        run: String,
        /// Fingerprint of its scene.
        scene: String,
        /// Steps that it was trained for.
        step: Option<usize>,
        /// Number of Gaussians.
        gaussians: usize,
        /// Point that cameras look at.
        centre: [f64; 3],
        /// Distance of the dataset's cameras from it.
        radius: f64,
        /// Their field of view, in radians.
        fov: f64,
        /// Width and height of their pictures.
        size: [u32; 2],
        /// Runs that it can be compared with.
        others: Vec<OtherRun>,
        /// Whether clicks can become segments: there is an affinity field.
        clicks: bool,
        /// Whether segments and edits cannot be changed.
        read_only: bool,
        /// Whether this viewer's own process trains the run.
        in_training: bool,
        /// Whether that training can be paused here.
        can_pause: bool,
        /// Physical space and time of the scene, by which the page converts what it shows.
        calibration: Box<Calibration>,
        /// Names of its units.
        units: Box<Units>,
        /// A note for the user.
        note: Option<String>,
    },
    /// Segments and edits as they are now.
    Document(Box<Document>),
    /// What a click selected.
    Picked(Box<Selected>),
    /// The command that was requested.
    Command {
        /// Number of the request.
        id: u32,
        /// The command, for a shell.
        command: String,
    },
    /// The dataset's test views.
    Views {
        /// Number of the request.
        id: u32,
        /// The views, in order.
        views: Vec<Placed>,
    },
    /// A path through keyframes.
    Path {
        /// Number of the request.
        id: u32,
        /// Its cameras at equal steps.
        frames: Vec<Key>,
        /// What its file holds.
        file: Box<SavedPath>,
    },
    /// Why there is no second picture, if one was requested; without a reason once there is.
    Beside {
        /// Why, and what to do.
        fault: Option<String>,
    },
    /// A request was carried out.
    Done {
        /// Its number.
        id: u32,
    },
    /// A position.
    Place {
        /// Number of the request.
        id: u32,
        /// In scene units.
        at: [f64; 3],
    },
    /// Progress of long work.
    Job(Box<JobState>),
    /// How segments change over time.
    Track(Box<Track>),
    /// Progress of the run's training.
    Training(Box<TrainingStatus>),
    /// The legend of the colours.
    Legend {
        /// The legend; `None` where objects have their own colours.
        legend: Option<Legend>,
    },
    /// The viewer ends; its last message.
    Ended {
        /// Why, and what to do.
        message: String,
    },
    /// Something cannot be done.
    Error {
        /// Number of the request, if it has one.
        id: Option<u32>,
        /// Why, and what to do.
        message: String,
    },
}

/// Names of the units in which the page shows numbers; `normalised` where the data have none.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Units {
    /// Of lengths.
    pub length: String,
    /// Of times.
    pub time: String,
    /// Of speeds.
    pub speed: String,
}

impl From<&Calibration> for Units {
    fn from(known: &Calibration) -> Self {
        let (length, time) = (known.length_unit().to_owned(), known.time_unit().to_owned());
        Self { length, time, speed: known.speed_unit() }
    }
}

/// A run with which the viewed one can be compared.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct OtherRun {
    /// Its short name.
    pub name: String,
    /// Steps that it was trained for.
    pub step: Option<usize>,
    /// Number of its Gaussians.
    pub gaussians: usize,
    /// What to know before the two are compared.
    pub note: Option<String>,
}

/// Segments and edits.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Document {
    /// Grows with every change.
    pub revision: u64,
    /// Old and new names of segments that the last change renamed, whoever made it.
    pub renamed: Vec<[String; 2]>,
    /// Wholes, each followed by its parts.
    pub segments: Vec<SegmentRow>,
    /// The edits that apply, in words.
    pub edits: Vec<String>,
    /// Next change of the segments to undo, and to redo.
    pub segment_steps: [Option<String>; 2],
    /// Whether there is an edit to undo, and to redo.
    pub edit_steps: [bool; 2],
}

/// A segment in the document.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct SegmentRow {
    /// Its name.
    pub name: String,
    /// Depth below a whole.
    pub depth: usize,
    /// sRGB in [0, 1].
    pub colour: [f32; 3],
    /// Number of its Gaussians.
    pub gaussians: usize,
    /// Time at which it was found.
    pub time: f64,
    /// The last colour that an edit gave it, sRGB in [0, 1].
    pub rgb: Option<[f32; 3]>,
    /// Factor by which edits multiply its opacity.
    pub opacity: f32,
    /// Whether an edit hides it.
    pub hidden: bool,
}

/// A level that a click can mean.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct LevelOffer {
    /// What makes its Gaussians one.
    pub kind: LevelKind,
    /// Its share of what the scene shows.
    pub share: f64,
}

/// What is selected.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Selected {
    /// Number of the request.
    pub id: u32,
    /// Position of the clicked Gaussian, in scene units.
    pub mean: [f32; 3],
    /// Segments that contain it.
    pub segments: Vec<String>,
    /// Number of selected Gaussians, including those of earlier clicks.
    pub gaussians: usize,
    /// Mask scale that was used.
    pub scale: f32,
    /// Cosine that was used.
    pub threshold: f32,
    /// The existing levels, from small to large.
    pub levels: Vec<LevelOffer>,
    /// Number of the level that was used, from 1.
    pub level: Option<usize>,
    /// Milliseconds that it took.
    pub ms: f64,
}
