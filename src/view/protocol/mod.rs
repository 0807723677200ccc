//! Messages between a browser and the server: JSON texts both ways, and frames with a small header.

mod answers;
#[cfg(test)]
mod declarations;
mod frame;
mod requests;

pub use crate::run::view::View;
pub use answers::{Answer, Document, LevelOffer, OtherRun, SegmentRow, Selected};
pub use frame::{Codec, FrameInfo, FrameKind, HEADER};
pub use requests::{Change, Combine, Request, RequestedGranularity, ViewRequest};

/// Maximum length of a text that a client may send, in bytes.
pub const LONGEST: usize = 64 * 1024;
