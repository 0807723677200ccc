//! Link between the network and the drawing thread: what clients sent, in order, and where their answers go.

use super::encode::OutgoingPicture;
use super::protocol::{Answer, FrameInfo, Request};
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::mpsc::Sender;

/// Number of messages of all clients together that may wait; a client that sends more waits.
const MAX_WAITING: usize = 1024;

/// Number of a client.
pub type ClientId = u64;

/// A message to a client.
#[derive(Clone, Debug)]
pub enum Outgoing {
    /// An answer, as text.
    Text(Box<Answer>),
    /// A frame.
    Frame(FrameInfo, Vec<u8>),
    /// A frame that is to be encoded.
    Picture(Box<OutgoingPicture>),
}

impl Outgoing {
    /// Whether nothing comes after it.
    pub fn is_last(&self) -> bool {
        matches!(self, Self::Text(answer) if matches!(**answer, Answer::Ended { .. }))
    }
}

/// An event of a client.
#[derive(Debug)]
pub enum ClientEvent {
    /// It connected; its answers go there.
    Connected(Sender<Outgoing>),
    /// It sent a request.
    Message(Box<Request>),
    /// It left.
    Disconnected,
}

#[derive(Debug, Default)]
struct Inbox {
    events: VecDeque<(ClientId, ClientEvent)>,
    stop: bool,
    woken: bool,
}

/// The inbox of the drawing thread.
#[derive(Debug, Default)]
pub struct Hub {
    inbox: Mutex<Inbox>,
    condvar: Condvar,
}

impl Hub {
    /// Adds an event of a client.
    pub fn push(&self, client: ClientId, event: ClientEvent) {
        self.inbox().events.push_back((client, event));
        self.condvar.notify_one();
    }

    /// Whether so many events wait that clients must be slowed down.
    pub fn is_full(&self) -> bool {
        self.inbox().events.len() >= MAX_WAITING
    }

    /// Wakes the drawing thread without an event.
    pub fn wake(&self) {
        self.inbox().woken = true;
        self.condvar.notify_one();
    }

    /// Ends the drawing thread.
    pub fn stop(&self) {
        self.inbox().stop = true;
        self.condvar.notify_all();
    }

    /// Returns all events since the last call; if there are none, waits until `until`, for at most half a second.
    /// `None` when the thread is to stop.
    pub fn wait(&self, until: Option<Instant>) -> Option<Vec<(ClientId, ClientEvent)>> {
        let mut inbox = self.inbox();
        let max_wait = Duration::from_millis(500);
        let wait = until.map_or(max_wait, |until| until.saturating_duration_since(Instant::now()).min(max_wait));
        if inbox.events.is_empty() && !inbox.stop && !inbox.woken && !wait.is_zero() {
            inbox = self.condvar.wait_timeout(inbox, wait).unwrap_or_else(PoisonError::into_inner).0;
        }
        inbox.woken = false;
        if inbox.stop { None } else { Some(inbox.events.drain(..).collect()) }
    }

    fn inbox(&self) -> MutexGuard<'_, Inbox> {
        self.inbox.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
