//! The viewer in a browser (`volseggs view`): frames are drawn here and sent over a websocket, so that it works through
//! `ssh -L`, on any machine that runs the program, and shows what `volseggs render` draws.
//!
//! [`server`] admits clients ([`auth`]) and passes on what they send ([`protocol`]). [`render`] is the one thread that
//! owns the run ([`workspace`]) and those that it is compared with ([`others`]), answers, and draws, at the [`pace`] of
//! each [`client`]. The [`cache`] holds recently deformed Gaussians, and pictures are [`encode`]d where they are sent.
//! Runs are changed by [`crate::run`], as by the commands; what takes long is done by [`background`], [`jobs`] and
//! [`tracks`], on other threads.
//!
//! [`serve`] shows a run folder. [`beside`] shows a run while this process trains it: the trainer leaves copies of the
//! scene with [`live`], and [`share`] limits drawing to a small part of the machine.

pub mod auth;
pub mod background;
pub mod beside;
pub mod cache;
pub mod clicks;
pub mod client;
pub mod compare;
pub mod encode;
pub mod gizmo;
pub mod hub;
pub mod jobs;
pub mod listen;
pub mod live;
#[cfg(unix)]
pub mod local;
pub mod order;
pub mod others;
pub mod pace;
pub mod page;
pub mod protocol;
pub mod reading;
pub mod refusal;
pub mod render;
pub mod server;
pub mod share;
pub mod tracks;
pub mod training;
pub mod workspace;

use hub::Hub;
use listen::{Listening, Serving, ServingOptions, ViewError};
use others::Other;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use workspace::Workspace;

/// Serves a run, and the `others` that it can be compared with, until `stop` is raised; `ready` receives where the
/// viewer can be reached.
///
/// # Errors
/// If the address cannot be used, or the system gives no thread.
pub fn serve(
    space: Workspace,
    others: Vec<Other>,
    options: &ServingOptions,
    stop: &AtomicBool,
    ready: impl FnOnce(&Serving),
) -> Result<(), ViewError> {
    let listening = Listening::open(options)?;
    let serving = listening.serving().clone();
    listening.serve(space, others, Arc::new(Hub::default()), stop, || ready(&serving))
}
