//! What a client says.

use crate::edit::Operation;
use crate::name::Name;
use crate::run::keyframes::Key;
use crate::run::view::View;
use crate::view::compare::Compare;
use crate::view::gizmo::Preview;
use crate::view::jobs::task::Task;
use serde::Deserialize;

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
    /// Have the training that goes on in the viewer's process pause, or go on.
    Pause {
        /// Number by which the answer is known.
        id: u32,
        /// Whether to pause.
        pause: bool,
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
}
