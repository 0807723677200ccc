//! What a browser and the server say to each other: JSON texts both ways, and frames with a small header.

use super::compare::Compare;
use super::gizmo::Preview;
use super::jobs::board::JobState;
use super::jobs::task::Task;
use super::tracks::Track;
use super::training::Training;
use crate::edit::Operation;
use crate::name::Name;
use crate::run::cameras::Placed;
use crate::run::keyframes::{Key, SavedPath};
use crate::run::look::Legend;
pub use crate::run::view::View;
use serde::{Deserialize, Serialize};

/// Longest text that a client may send, bytes.
pub const LONGEST: usize = 64 * 1024;
/// Version of the frames' header.
const VERSION: u8 = 1;
/// Bytes of the frames' header.
pub const HEADER: usize = 32;

/// What a client says.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(tag = "type", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Request {
    /// What it wants to see.
    View(Box<Wanted>),
    /// It has drawn a frame, and with it all before.
    Ack {
        /// Number of the frame.
        frame: u32,
    },
    /// A click on the view that it saw last.
    Pick {
        /// Number by which the answer is known.
        id: u32,
        /// Column and row, in pixels of the full size.
        pixel: [u32; 2],
        /// Segment to look in alone; the clicked one if not given.
        within: Option<String>,
        /// How much is meant; the likeliest level if not given.
        meaning: Option<Asked>,
        /// What becomes of what was selected before.
        #[serde(default)]
        combine: Combine,
    },
    /// The same click once more, with another meaning.
    Adjust {
        /// Number by which the answer is known.
        id: u32,
        /// How much is meant.
        meaning: Option<Asked>,
    },
    /// The picture as a file that can be drawn again, without what is selected.
    Still {
        /// Number by which the frame is known.
        id: u32,
    },
    /// The command that draws it.
    Command {
        /// Number by which the answer is known.
        id: u32,
    },
    /// Where the dataset's test views are.
    Views {
        /// Number by which the answer is known.
        id: u32,
    },
    /// Cameras of a path through keyframes, and the path as a file.
    Path {
        /// Number by which the answer is known.
        id: u32,
        /// The keyframes.
        keys: Vec<Key>,
        /// How many cameras.
        frames: usize,
    },
    /// Forget what was selected.
    Clear,
    /// Where that is which a pixel of the view shows that the client asked for last.
    Point {
        /// Number by which the answer is known.
        id: u32,
        /// Column and row, in pixels of the full size.
        pixel: [u32; 2],
    },
    /// Where segments are: their opacity-weighted centre.
    Centre {
        /// Number by which the answer is known.
        id: u32,
        /// Which.
        segments: Vec<String>,
        /// Time in [0, 1].
        time: f64,
    },
    /// Make a segment of what was selected.
    Commit {
        /// Number by which the answer is known.
        id: u32,
        /// Revision of the document that the client knows.
        base: u64,
        /// Its name.
        name: Name,
    },
    /// Change the document.
    Change {
        /// Number by which the answer is known.
        id: u32,
        /// Revision of the document that the client knows.
        base: u64,
        /// The change.
        change: Change,
    },
    /// Start long work.
    Job {
        /// Number by which the answer is known.
        id: u32,
        /// Revision of the document that the client knows.
        base: u64,
        /// The work.
        task: Task,
    },
    /// What segments, several as one, are like over time.
    Track {
        /// Number by which the answer is known.
        id: u32,
        /// Their names.
        segments: Vec<String>,
        /// Times, evenly spaced over [0, 1].
        times: usize,
    },
    /// Stop long work.
    Cancel {
        /// Number by which the answer is known.
        id: u32,
        /// Number of the job.
        job: u64,
    },
}

/// What a client wants to see.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Wanted {
    /// The picture.
    #[serde(flatten)]
    pub view: View,
    /// Whether more is to come at once.
    pub moving: bool,
    /// What it is compared with.
    #[serde(default)]
    pub compare: Option<Compare>,
    /// Edits that are not saved and apply after those of the run.
    #[serde(default)]
    pub preview: Option<Preview>,
}

/// How much a click means.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Asked {
    /// A level, from 1, the smallest.
    Level(usize),
    /// A mask scale in [0, 1] and the cosine that members have at least.
    By {
        /// The scale.
        scale: f32,
        /// The cosine.
        threshold: f32,
    },
}

/// What becomes of what was selected before when something is clicked.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum Combine {
    /// It goes.
    #[default]
    Replace,
    /// The new joins it.
    Add,
    /// The new is taken from it.
    Remove,
}

/// A change of the document.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Change {
    /// Segments by colour, in place of all that there are.
    Coarse {
        /// Time at which they are looked for, in [0, 1].
        time: f64,
        /// Number of colours; suggested from the data if not given.
        clusters: Option<usize>,
    },
    /// Several segments as one.
    Group {
        /// Name of the group.
        name: Name,
        /// Its segments.
        segments: Vec<String>,
    },
    /// Give a segment another name.
    Rename {
        /// What it is called.
        segment: String,
        /// What it is to be called.
        name: Name,
    },
    /// Remove segments with their parts.
    Remove {
        /// Which.
        segments: Vec<String>,
    },
    /// Undo or redo changes of the segments.
    Segments {
        /// Whether to undo; to redo if not.
        undo: bool,
    },
    /// An edit.
    Edit {
        /// Its segments.
        segments: Vec<String>,
        /// What is done to them.
        operation: Operation,
    },
    /// Undo or redo an edit.
    Edits {
        /// Whether to undo; to redo if not.
        undo: bool,
    },
    /// Undo or redo what was changed last, segments or edits.
    Last {
        /// Whether to undo; to redo if not.
        undo: bool,
    },
}

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
        /// Whether clicks can become segments: there is an affinity field.
        clicks: bool,
        /// Whether nothing can be changed.
        read_only: bool,
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
    /// Something cannot be done.
    Error {
        /// Number of the request, if it has one.
        id: Option<u32>,
        /// Why, and what to do.
        message: String,
    },
}

/// Segments and edits.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Document {
    /// Grows with every change.
    pub revision: u64,
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

/// How a frame is encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Codec {
    /// With loss.
    Jpeg = 0,
    /// Without.
    Png = 1,
}

/// What a frame is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The picture, to be acknowledged.
    Picture = 0,
    /// What the picture of the same number is compared with.
    Other = 1,
    /// A file that was asked for; its number is that of the request.
    Still = 2,
    /// The dataset's image of the test view of this number, in its own size.
    Image = 3,
}

/// What is told of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameInfo {
    /// What it is.
    pub kind: Kind,
    /// How it is encoded.
    pub codec: Codec,
    /// Number, to be acknowledged.
    pub number: u32,
    /// Revision of the document that it shows.
    pub revision: u64,
    /// Width and height.
    pub size: [u32; 2],
    /// Time that it shows.
    pub time: f64,
    /// Milliseconds to draw.
    pub render_ms: f32,
    /// Milliseconds to encode.
    pub encode_ms: f32,
}

impl FrameInfo {
    /// The frame as it is sent: version, codec, kind, a byte of nothing, then in little-endian order number (u32), revision
    /// (u64), width and height (u16 each), time, drawing and encoding milliseconds (f32 each), and the picture.
    #[must_use]
    pub fn with(&self, picture: &[u8]) -> Vec<u8> {
        let mut out = Vec::with_capacity(HEADER + picture.len());
        out.extend([VERSION, self.codec as u8, self.kind as u8, 0]);
        out.extend(self.number.to_le_bytes());
        out.extend(self.revision.to_le_bytes());
        self.size.iter().for_each(|n| out.extend((*n as u16).to_le_bytes()));
        [self.time as f32, self.render_ms, self.encode_ms].iter().for_each(|v| out.extend(v.to_le_bytes()));
        out.extend(picture);
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_read_and_what_nobody_knows_is_refused() {
        let read = |text: &str| serde_json::from_str::<Request>(text);
        assert_eq!(read(r#"{"type":"ack","frame":7}"#).unwrap(), Request::Ack { frame: 7 });
        let seen = r#"{"type":"view","eye":[4,0,0.1],"target":[0,0,0],"up":[0,0,1],"fov":0.5,"size":[8,8],"time":0.5,"look":"colour","edits":true,"moving":true}"#;
        let Request::View(wanted) = read(seen).unwrap() else { panic!() };
        assert_eq!((wanted.view.eye, wanted.moving), ([4.0, 0.0, 0.1], true));
        assert!(
            read(&seen.replace("\"moving\"", "\"path\"")).is_err() && read(&seen.replace("\"look\"", "\"x\"")).is_err()
        );
        assert!(read(&seen.replace("\"moving\"", "\"x\":1,\"moving\"")).is_err(), "what nobody knows");
        let pick = read(r#"{"type":"pick","id":1,"pixel":[3,4],"meaning":{"level":2},"combine":"add"}"#).unwrap();
        let Request::Pick { meaning, combine, within, .. } = pick else { panic!("{pick:?}") };
        assert_eq!((meaning, combine, within), (Some(Asked::Level(2)), Combine::Add, None));
        let edit = r#"{"type":"change","id":1,"base":3,"change":{"kind":"edit","segments":["red"],"operation":{"opacity":{"factor":0.5}}}}"#;
        assert!(matches!(read(edit).unwrap(), Request::Change { base: 3, change: Change::Edit { .. }, .. }));
        for bad in ["", "{}", "[]", r#"{"type":"ack"}"#, r#"{"type":"ack","frame":-1}"#, r#"{"type":"run","cmd":"ls"}"#]
        {
            assert!(read(bad).is_err(), "{bad}");
        }
        let name = read(r#"{"type":"commit","id":1,"base":0,"name":"../x"}"#);
        assert!(name.is_err(), "names become paths");
    }

    #[test]
    fn a_frame_begins_with_its_header() {
        let info = FrameInfo {
            kind: Kind::Still,
            codec: Codec::Png,
            number: 9,
            revision: 2,
            size: [800, 600],
            time: 0.25,
            render_ms: 12.0,
            encode_ms: 3.0,
        };
        let frame = info.with(b"picture");
        assert_eq!((&frame[..4], &frame[HEADER..]), (&[VERSION, 1, 2, 0][..], &b"picture"[..]));
        assert_eq!(u32::from_le_bytes(frame[4..8].try_into().unwrap()), 9);
        assert_eq!(f32::from_le_bytes(frame[20..24].try_into().unwrap()), 0.25);
    }
}
