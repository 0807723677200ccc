//! Between the network and the thread that draws: what clients said, in order, and where their answers go.

use super::encode::Picture;
use super::protocol::{Answer, FrameInfo, Request};
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::mpsc::Sender;

/// Messages that may wait, of all clients together; who says more waits.
const WAITING: usize = 1024;

/// A client.
pub type ClientId = u64;

/// What goes to a client.
#[derive(Clone, Debug)]
pub enum Outgoing {
    /// A text.
    Text(Box<Answer>),
    /// A frame.
    Frame(FrameInfo, Vec<u8>),
    /// A frame that is to be encoded.
    Picture(Box<Picture>),
}

impl Outgoing {
    /// Whether nothing comes after it.
    #[must_use]
    pub fn is_last(&self) -> bool {
        matches!(self, Self::Text(answer) if matches!(**answer, Answer::Ended { .. }))
    }
}

/// What happened.
#[derive(Debug)]
pub enum Event {
    /// A client came; its answers go there.
    Came(Sender<Outgoing>),
    /// It said something.
    Said(Box<Request>),
    /// It went.
    Left,
}

#[derive(Debug, Default)]
struct Inbox {
    events: VecDeque<(ClientId, Event)>,
    stop: bool,
    woken: bool,
}

/// The inbox of the thread that draws.
#[derive(Debug, Default)]
pub struct Hub {
    inbox: Mutex<Inbox>,
    news: Condvar,
}

impl Hub {
    /// Tells what happened to a client.
    pub fn tell(&self, client: ClientId, event: Event) {
        self.inbox().events.push_back((client, event));
        self.news.notify_one();
    }

    /// Whether so much waits that clients must be slowed down.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.inbox().events.len() >= WAITING
    }

    /// Has the thread that draws look around, without anything to tell.
    pub fn wake(&self) {
        self.inbox().woken = true;
        self.news.notify_one();
    }

    /// Ends the thread that draws.
    pub fn stop(&self) {
        self.inbox().stop = true;
        self.news.notify_all();
    }

    /// All that happened since the last call; waits until `until` if that is nothing. `None` when it is to stop.
    pub fn wait(&self, until: Option<Instant>) -> Option<Vec<(ClientId, Event)>> {
        let mut inbox = self.inbox();
        let longest = Duration::from_millis(500);
        let wait = until.map_or(longest, |until| until.saturating_duration_since(Instant::now()).min(longest));
        if inbox.events.is_empty() && !inbox.stop && !inbox.woken && !wait.is_zero() {
            inbox = self.news.wait_timeout(inbox, wait).unwrap_or_else(PoisonError::into_inner).0;
        }
        inbox.woken = false;
        if inbox.stop { None } else { Some(inbox.events.drain(..).collect()) }
    }

    fn inbox(&self) -> MutexGuard<'_, Inbox> {
        self.inbox.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
