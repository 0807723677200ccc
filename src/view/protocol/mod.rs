//! Messages between a browser and the server: JSON texts both ways, and frames with a small header.

mod answers;
mod frame;
mod requests;

pub use crate::run::view::View;
pub use answers::{Answer, Document, LevelOffer, OtherRun, SegmentRow, Selected};
pub use frame::{Codec, FrameInfo, HEADER, Kind};
pub use requests::{Asked, Change, Combine, Request, Wanted};

/// Maximum length of a text that a client may send, in bytes.
pub const LONGEST: usize = 64 * 1024;
