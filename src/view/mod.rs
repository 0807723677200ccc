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
//!
//! ```text
//! browser:  view (camera, time, look), acks, clicks, changes          JSON over one websocket
//! server:   token -> cookie, Host, Origin                             tokio, one thread
//! hub:      client messages, in order                                 the newest view of each wins
//! renderer: owns the run; answers; draws for the next client          one thread; splatting takes all cores
//!           cache (time, look) -> inputs of splatting                 at most --cache bytes
//!           moving: JPEG, scaled down to fit 33 ms of work and 100 ms of the connection;
//!           at rest: full, then PNG, the bytes of `render`
//! workspace: a change takes the run's lock, reads what others wrote, and is refused if the client had not seen that;
//!           a newer checkpoint, read on a thread of its own, replaces the scene
//!           order: whether segments or edits changed last, for one undo
//!           preview (a handle is dragged): edits in the view, of one revision, applied after those of the run, never saved
//! others:   runs for comparison, each a read-only workspace; drawn from the same view, kept in the same cache
//! jobs:     one at a time on a thread of its own, with the run's lock   the scene is shared; progress wakes the renderer
//! tracks:   measured for charts on another thread, without the lock
//! live:     train --view: between two steps the trainer checks (train::observer), leaves a copy of its parameters on the
//!           host when a window wants one, and pauses on request
//! share:    meanwhile drawing takes one thread, for a small part of the time
//! page:     ES modules without a build step. `state.js` alone changes what they share; `tsc` checks their JSDoc types
//!           against declarations of the messages that a test generates from `protocol`; what needs no browser
//!           (camera, projection, plot-scale, playback, view-text, units, state, ...) is tested by `node --test`
//! ```
//!
//! Training knows an `Observer` that may pause it, and nothing of the viewer; [`beside`] runs both, `cli::watch`
//! connects them. At most two frames are on their way to a client, so a slow client never falls further behind.

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
use listen::{ServingOptions, ViewError, ViewerAddress, ViewerListener};
use others::ComparedRun;
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
    others: Vec<ComparedRun>,
    options: &ServingOptions,
    stop: &AtomicBool,
    ready: impl FnOnce(&ViewerAddress),
) -> Result<(), ViewError> {
    let listening = ViewerListener::open(options)?;
    let serving = listening.serving().clone();
    listening.serve(space, others, Arc::new(Hub::default()), stop, || ready(&serving))
}
