//! Operations on a trained run, shared by commands and viewers: opening, viewing, segmenting, tracking, editing and
//! measuring it. Everything here reads and writes the files of the run folder, and prints nothing.
//!
//! [`OpenRun`] is a run with Gaussians, [`AnyRun`] one of any method, which can be drawn and measured. [`cameras`]
//! chooses the camera, [`selection`] the part of the scene, [`look`] what the colours stand for (numbers use a
//! [`palette`]), and [`frames`] writes pictures; [`view`] combines these for one picture, [`saved`] keeps it in files,
//! and [`keyframes`] are camera paths through such pictures. [`status`] is the state of training. [`segments`] changes
//! the segments; [`split`] and [`pick`] find new ones with the field that [`affinity`] trains on [`masks`]; [`labels`]
//! transfers them to voxels, [`fields`] density, velocity and colour; [`materials`] says which colours of the transfer
//! function they have. [`numbers`] writes depth and velocity of pictures as numbers. [`edits`] changes the edits,
//! [`follow`] tracks segments, [`export`] writes files for other programs, [`pack`] a small copy of the run,
//! [`relocate`] records where its dataset is, and [`measure`] evaluates the run. `files::RunPaths` gives the location of
//! every file.

pub mod affinity;
pub mod cameras;
pub mod contents;
mod dataset;
pub mod edits;
mod error;
pub mod export;
pub mod fields;
pub mod follow;
pub mod frames;
pub mod keyframes;
pub mod labels;
pub mod look;
pub mod masks;
pub mod materials;
pub mod measure;
pub mod numbers;
mod open;
pub mod pack;
pub mod palette;
pub mod pick;
pub mod relocate;
pub mod rendering;
pub mod saved;
pub mod segments;
pub mod selection;
mod settings;
pub mod split;
pub mod status;
pub mod view;

pub use dataset::dataset_of;
pub use error::RunError;
pub use open::{AnyRun, OpenRun, TrainedModel};
