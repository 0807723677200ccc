//! Messages of a client.

use crate::edit::Operation;
use crate::name::Name;
use crate::run::keyframes::Key;
use crate::run::view::View;
use crate::view::compare::Compare;
use crate::view::gizmo::Preview;
use crate::view::jobs::task::Task;
use schemars::JsonSchema;
use serde::Deserialize;
use std::num::NonZero;

/// A message of a client.
#[derive(Clone, Debug, Deserialize, PartialEq, JsonSchema)]
#[serde(tag = "type", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Request {
    /// What it wants to see.
    View(Box<ViewRequest>),
    /// It has drawn a frame and all before it.
    Ack {
        /// Number of the frame.
        frame: u32,
    },
    /// A click on the view that it saw last.
    Pick {
        /// Number by which the answer is identified.
        id: u32,
        /// Column and row, in pixels of the full size.
        pixel: [u32; 2],
        /// Segment to look in; the clicked one if not given.
        within: Option<String>,
        /// How much to select; the likeliest level if not given.
        meaning: Option<RequestedGranularity>,
        /// What happens to the earlier selection.
        #[serde(default)]
        combine: Combine,
    },
    /// The same click once more, with another meaning.
    Adjust {
        /// Number by which the answer is identified.
        id: u32,
        /// How much to select.
        meaning: Option<RequestedGranularity>,
    },
    /// The picture as a file that can be drawn again, without the selection.
    Still {
        /// Number by which the frame is identified.
        id: u32,
    },
    /// The command that draws the picture.
    Command {
        /// Number by which the answer is identified.
        id: u32,
    },
    /// Where the dataset's test views are.
    Views {
        /// Number by which the answer is identified.
        id: u32,
    },
    /// Cameras of a path through keyframes, and the path as a file.
    Path {
        /// Number by which the answer is identified.
        id: u32,
        /// The keyframes.
        keys: Vec<Key>,
        /// Number of cameras.
        frames: usize,
    },
    /// Clear the selection.
    Clear,
    /// The position of what a pixel shows in the view that the client requested last.
    Point {
        /// Number by which the answer is identified.
        id: u32,
        /// Column and row, in pixels of the full size.
        pixel: [u32; 2],
    },
    /// The position of segments: their opacity-weighted centre.
    Centre {
        /// Number by which the answer is identified.
        id: u32,
        /// Which segments.
        segments: Vec<String>,
        /// Time in [0, 1].
        time: f64,
    },
    /// Make a segment of the selection.
    Commit {
        /// Number by which the answer is identified.
        id: u32,
        /// Revision of the document that the client knows.
        base: u64,
        /// Its name.
        #[schemars(with = "String")]
        name: Name,
    },
    /// Change the document.
    Change {
        /// Number by which the answer is identified.
        id: u32,
        /// Revision of the document that the client knows.
        base: u64,
        /// The change.
        change: Change,
    },
    /// Start long work.
    Job {
        /// Number by which the answer is identified.
        id: u32,
        /// Revision of the document that the client knows.
        base: u64,
        /// The work.
        task: Task,
    },
    /// How segments, several as one, change over time.
    Track {
        /// Number by which the answer is identified.
        id: u32,
        /// Their names.
        segments: Vec<String>,
        /// Number of times, evenly spaced over [0, 1].
        times: usize,
    },
    /// Pause or continue the training in the viewer's process.
    Pause {
        /// Number by which the answer is identified.
        id: u32,
        /// Whether to pause.
        pause: bool,
    },
    /// Stop long work.
    Cancel {
        /// Number by which the answer is identified.
        id: u32,
        /// Number of the job.
        job: u64,
    },
}

/// What a client wants to see.
#[derive(Clone, Debug, Deserialize, PartialEq, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ViewRequest {
    /// The picture.
    #[serde(flatten)]
    pub view: View,
    /// Whether more changes are to come at once.
    pub moving: bool,
    /// What it is compared with.
    #[serde(default)]
    pub compare: Option<Compare>,
    /// Unsaved edits that are shown after those of the run.
    #[serde(default)]
    pub preview: Option<Preview>,
}

/// How much a click selects.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum RequestedGranularity {
    /// A level, from 1, the smallest.
    Level(NonZero<usize>),
    /// A mask scale in [0, 1] and the minimum cosine of members.
    By {
        /// The scale.
        scale: f32,
        /// The cosine.
        threshold: f32,
    },
}

/// What happens to the earlier selection when something is clicked.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Combine {
    /// It is replaced.
    #[default]
    Replace,
    /// The new selection is added to it.
    Add,
    /// The new selection is removed from it.
    Remove,
}

/// A change of the document.
#[derive(Clone, Debug, Deserialize, PartialEq, JsonSchema)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Change {
    /// Replace all segments by segments by colour.
    Coarse {
        /// Time at which to segment, in [0, 1].
        time: f64,
        /// Number of colours; suggested from the data if not given.
        clusters: Option<usize>,
    },
    /// Group several segments as one.
    Group {
        /// Name of the group.
        #[schemars(with = "String")]
        name: Name,
        /// Its segments.
        segments: Vec<String>,
    },
    /// Rename a segment.
    Rename {
        /// Its current name.
        segment: String,
        /// Its new name.
        #[schemars(with = "String")]
        name: Name,
    },
    /// Remove segments with their parts.
    Remove {
        /// Which segments.
        segments: Vec<String>,
    },
    /// Undo or redo a change of the segments.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn valid_requests_are_read_and_unknown_fields_refused() {
        let read = |text: &str| serde_json::from_str::<Request>(text);
        assert_eq!(read(r#"{"type":"ack","frame":7}"#).unwrap(), Request::Ack { frame: 7 });
        let seen = r#"{"type":"view","eye":[4,0,0.1],"target":[0,0,0],"up":[0,0,1],"fov":0.5,"size":[8,8],"time":0.5,"look":"colour","edits":true,"moving":true}"#;
        let Request::View(wanted) = read(seen).unwrap() else { panic!() };
        assert_eq!((wanted.view.eye, wanted.moving), ([4.0, 0.0, 0.1], true));
        assert!(
            read(&seen.replace("\"moving\"", "\"path\"")).is_err() && read(&seen.replace("\"look\"", "\"x\"")).is_err()
        );
        assert!(read(&seen.replace("\"moving\"", "\"x\":1,\"moving\"")).is_err(), "unknown field");
        let pick = read(r#"{"type":"pick","id":1,"pixel":[3,4],"meaning":{"level":2},"combine":"add"}"#).unwrap();
        let Request::Pick { meaning, combine, within, .. } = pick else { panic!("{pick:?}") };
        assert_eq!((meaning, combine, within), (NonZero::new(2).map(RequestedGranularity::Level), Combine::Add, None));
        assert!(
            read(r#"{"type":"pick","id":1,"pixel":[3,4],"meaning":{"level":0}}"#).is_err(),
            "levels are counted from 1"
        );
        let edit = r#"{"type":"change","id":1,"base":3,"change":{"kind":"edit","segments":["red"],"operation":{"opacity":{"factor":0.5}}}}"#;
        assert!(matches!(read(edit).unwrap(), Request::Change { base: 3, change: Change::Edit { .. }, .. }));
        for bad in ["", "{}", "[]", r#"{"type":"ack"}"#, r#"{"type":"ack","frame":-1}"#, r#"{"type":"run","cmd":"ls"}"#]
        {
            assert!(read(bad).is_err(), "{bad}");
        }
        let name = read(r#"{"type":"commit","id":1,"base":0,"name":"../x"}"#);
        assert!(name.is_err(), "names become paths");
    }
}
