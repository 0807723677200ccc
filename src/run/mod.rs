//! What can be done with a trained run, by a command or a viewer alike: opened, looked at, segmented, followed, edited,
//! measured. Everything here reads and writes the files of the run folder, and prints nothing.
//!
//! [`OpenRun`] is the run ([`AnyRun`] one of any method, which can be drawn and measured); [`cameras`] chooses who looks at it, [`selection`] what of it, [`look`] what the colours stand
//! for (numbers in a [`palette`]), [`frames`] writes pictures; [`view`] is all of that for one picture, which [`saved`] keeps in files; [`keyframes`] are
//! paths of cameras through such pictures. [`status`] is how its training stands. [`segments`] changes the segments, [`split`] and [`pick`] find new ones by the field
//! that [`affinity`] trains on [`masks`], [`labels`] puts them on voxels, [`edits`] changes the edits, [`follow`] tracks
//! segments, [`export`] writes files of other programs, [`pack`] a small copy of the run, and [`measure`] evaluates the run. `files::RunPaths` says where
//! everything lies.

pub mod affinity;
pub mod cameras;
pub mod edits;
mod error;
pub mod export;
pub mod follow;
pub mod frames;
pub mod keyframes;
pub mod labels;
pub mod look;
pub mod masks;
pub mod measure;
mod open;
pub mod pack;
pub mod palette;
pub mod pick;
pub mod rendering;
pub mod saved;
pub mod segments;
pub mod selection;
pub mod split;
pub mod status;
pub mod view;

pub use error::RunError;
pub use open::{AnyRun, OpenRun, Trained};
