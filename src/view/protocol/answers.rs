//! What the server says.

use crate::run::cameras::Placed;
use crate::run::keyframes::{Key, SavedPath};
use crate::run::look::Legend;
use crate::view::jobs::board::JobState;
use crate::view::tracks::Track;
use crate::view::training::Training;
use serde::Serialize;

/// What the server says.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "type", rename_all = "kebab-case")]
pub enum Answer {
    /// First of all, and again when the scene or whether there is an affinity field changed.
    Welcome {
        /// Version of the program.
        version: &'static str,
        /// Name of the run.
        run: String,
        /// Fingerprint of its scene.
        scene: String,
        /// Steps that it was trained for.
        step: Option<usize>,
        /// Gaussians.
        gaussians: usize,
        /// What cameras look at.
        centre: [f64; 3],
        /// How far from it those of the dataset stand.
        radius: f64,
        /// Their field of view, radians.
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
        /// What there is to say.
        note: Option<String>,
    },
    /// Segments and edits as they are now.
    Document(Box<Document>),
    /// What a click selected.
    Picked(Box<Selected>),
    /// The command that was asked for.
    Command {
        /// Number of the request.
        id: u32,
        /// For a shell.
        command: String,
    },
    /// The dataset's test views.
    Views {
        /// Number of the request.
        id: u32,
        /// In their order.
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
    /// Why there is no picture beside the picture, where one was asked for; nothing once there is.
    Beside {
        /// Why, and what to do.
        fault: Option<String>,
    },
    /// A request was carried out.
    Done {
        /// Its number.
        id: u32,
    },
    /// Where something is.
    Place {
        /// Number of the request.
        id: u32,
        /// World units.
        at: [f64; 3],
    },
    /// How far long work has come.
    Job(Box<JobState>),
    /// What segments are like over time.
    Track(Box<Track>),
    /// How the training of the run has come on.
    Training(Box<Training>),
    /// The key to the colours.
    Legend {
        /// The key; none where things have their own colours.
        legend: Option<Legend>,
    },
    /// The viewer ends; the last that it says.
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

/// A run that the one that is viewed can be compared with.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OtherRun {
    /// A short name of it.
    pub name: String,
    /// Steps that it was trained for.
    pub step: Option<usize>,
    /// Its Gaussians.
    pub gaussians: usize,
    /// What there is to know before the two are compared.
    pub note: Option<String>,
}

/// Segments and edits.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Document {
    /// Grows with every change.
    pub revision: u64,
    /// Old and new names of segments that the last change gave others, whoever made it.
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
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SegmentRow {
    /// Its name.
    pub name: String,
    /// How deep below a whole.
    pub depth: usize,
    /// sRGB in [0, 1].
    pub colour: [f32; 3],
    /// Its Gaussians.
    pub gaussians: usize,
    /// Time at which it was found.
    pub time: f64,
    /// The last colour that an edit gave it, sRGB in [0, 1].
    pub rgb: Option<[f32; 3]>,
    /// What edits multiply its opacity by.
    pub opacity: f32,
    /// Whether an edit hides it.
    pub hidden: bool,
}

/// What is selected.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Selected {
    /// Number of the request.
    pub id: u32,
    /// Where the clicked Gaussian is, world units.
    pub mean: [f32; 3],
    /// Segments that hold it.
    pub segments: Vec<String>,
    /// Gaussians selected, those of earlier clicks with them.
    pub gaussians: usize,
    /// Mask scale that was used.
    pub scale: f32,
    /// Cosine that was used.
    pub threshold: f32,
    /// Shares of the levels that there are, from small to large.
    pub levels: Vec<f64>,
    /// The one that was taken, from 1.
    pub level: Option<usize>,
    /// Milliseconds that it took.
    pub ms: f64,
}
