//! Segments through time, for the charts of the page: measured on a thread of its own, so that neither frames nor long
//! work wait for it. Nothing is written.

use super::background::guarded;
use super::hub::{ClientId, Hub};
use crate::name::Name;
use crate::run::follow::{TrackedTimes, measure};
use crate::run::{OpenRun, RunError};
use crate::track::events::EventKind;
use crate::track::follow::TrackedSegment;
use schemars::JsonSchema;
use serde::Serialize;
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

/// Numbers of times that a client may request.
const TIMES: RangeInclusive<usize> = 2..=501;
/// Name of several segments as one, used in messages only.
const TOGETHER: &str = "together";

/// Measurements of a segment, or several as one, over time.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Track {
    /// Number of the request.
    pub id: u32,
    /// The segments.
    pub segments: Vec<String>,
    /// Times in [0, 1].
    pub times: Vec<f64>,
    /// Volume of its place at each, in cubic units of the data.
    pub volume: Vec<f64>,
    /// Centroid at each, in units of the data; `None` where it is nowhere.
    pub centroid: Vec<Option<[f64; 3]>>,
    /// Speed of the centroid at each, in units of the data; `None` where it is lost.
    pub speed: Vec<Option<f64>>,
    /// Events of its parts.
    pub events: Vec<TrackEvent>,
}

/// An event of the parts.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct TrackEvent {
    /// Its kind.
    pub kind: EventKind,
    /// Last time before it.
    pub from: f64,
    /// First time after it.
    pub to: f64,
    /// Numbers of parts before and after.
    pub parts: [usize; 2],
}

impl Track {
    fn new(id: u32, segments: Vec<String>, found: &TrackedSegment) -> Self {
        let rows = &found.statistics;
        let events = found.tracking.events.iter().filter(|e| e.kind != EventKind::Continue);
        let speed = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
        Self {
            id,
            segments,
            times: rows.iter().map(|r| r.time).collect(),
            volume: rows.iter().map(|r| r.volume).collect(),
            centroid: rows.iter().map(|r| r.centroid).collect(),
            speed: rows.iter().map(|r| r.velocity.map(speed)).collect(),
            events: events
                .map(|e| TrackEvent {
                    kind: e.kind,
                    from: e.time_from,
                    to: e.time_to,
                    parts: [e.parents.len(), e.children.len()],
                })
                .collect(),
        }
    }
}

/// A request for a track.
#[derive(Debug)]
pub struct TrackRequest {
    /// The client that requested it.
    pub client: ClientId,
    /// Number by which the answer is identified.
    pub id: u32,
    /// Names of segments; several are tracked as one.
    pub segments: Vec<String>,
    /// Number of times, evenly spaced over [0, 1].
    pub times: usize,
    /// The run, which is not locked.
    pub run: OpenRun,
}

/// An answer: the track, or why there is none, with the number of the request.
type TrackResult = Result<Track, (u32, String)>;

/// The thread that measures, and the requests that wait for it: the newest of each client.
#[derive(Debug)]
pub struct Tracks {
    hub: Arc<Hub>,
    waiting: Vec<TrackRequest>,
    /// Answers to requests that never began.
    refused: Vec<(ClientId, TrackResult)>,
    running: Option<(ClientId, Arc<AtomicBool>, JoinHandle<()>)>,
    out: Sender<(ClientId, TrackResult)>,
    found: Receiver<(ClientId, TrackResult)>,
}

impl Tracks {
    /// Starts without requests; `hub` wakes the drawing thread.
    pub fn new(hub: Arc<Hub>) -> Self {
        let (out, found) = channel();
        Self { hub, waiting: Vec::new(), refused: Vec::new(), running: None, out, found }
    }

    /// Queues a request, which replaces this client's earlier one.
    ///
    /// # Errors
    /// If the number of times is out of range, or no segment is named.
    pub fn ask(&mut self, request: TrackRequest) -> Result<(), String> {
        if !TIMES.contains(&request.times) {
            return Err(format!("times: must be between {} and {}", TIMES.start(), TIMES.end()));
        }
        if request.segments.is_empty() {
            return Err("segments: name at least one".into());
        }
        if let Some(old) = self.forget(request.client) {
            self.refused.push((old.client, Err((old.id, replaced()))));
        }
        self.waiting.push(request);
        self.next();
        Ok(())
    }

    /// Cancels what the client requested; returns the request if it had not begun.
    pub fn forget(&mut self, client: ClientId) -> Option<TrackRequest> {
        if let Some((of, stop, _)) = &self.running
            && *of == client
        {
            stop.store(true, Ordering::Release);
        }
        let at = self.waiting.iter().position(|w| w.client == client)?;
        Some(self.waiting.remove(at))
    }

    /// Returns the next answer, if there is one.
    pub fn finished(&mut self) -> Option<(ClientId, TrackResult)> {
        if let Some(refused) = self.refused.pop() {
            return Some(refused);
        }
        // a thread sends its answer at its very end
        let result = self.found.try_recv().ok()?;
        self.join();
        self.next();
        Some(result)
    }

    fn next(&mut self) {
        if self.running.is_some() || self.waiting.is_empty() {
            return;
        }
        let request = self.waiting.remove(0);
        let (client, id, stop) = (request.client, request.id, Arc::new(AtomicBool::new(false)));
        let (out, hub, stopped) = (self.out.clone(), self.hub.clone(), stop.clone());
        let work = move || {
            let found = match guarded(|| follow(request, &stopped)) {
                Ok(Some(track)) => Ok(track),
                Ok(None) => Err((id, replaced())),
                Err(error) => Err((id, error.to_string())),
            };
            // nobody listens any more if the viewer closes
            let _ = out.send((client, found));
            hub.wake();
        };
        let thread = std::thread::Builder::new().name("tracks".into()).spawn(work);
        match thread {
            Ok(thread) => self.running = Some((client, stop, thread)),
            Err(error) => self.refused.push((client, Err((id, format!("cannot start a thread for this: {error}"))))),
        }
    }

    fn join(&mut self) {
        if let Some((_, _, thread)) = self.running.take() {
            // it catches its own panics
            let _ = thread.join();
        }
    }
}

impl Drop for Tracks {
    fn drop(&mut self) {
        if let Some((_, stop, _)) = &self.running {
            stop.store(true, Ordering::Release);
        }
        self.join();
    }
}

fn replaced() -> String {
    "replaced by a newer request".into()
}

fn follow(request: TrackRequest, stop: &AtomicBool) -> Result<Option<Track>, RunError> {
    let TrackRequest { id, segments, times, run, .. } = request;
    let group = (segments.len() > 1).then(|| Name::new(TOGETHER)).transpose().map_err(RunError::failure)?;
    let times = TrackedTimes::Even { from: 0.0, to: 1.0, frames: times };
    let asked = format!("{} times", times.count());
    let found = measure(&run, &segments, group.as_ref(), (&times, &asked), || !stop.load(Ordering::Acquire))?;
    Ok(found.and_then(|found| found.first().map(|f| Track::new(id, segments, f))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::events::{SegmentEvent, Tracking};

    #[test]
    fn continuing_parts_are_not_events() {
        let event = |kind, parents: &[u32], children: &[u32]| SegmentEvent {
            time_from: 0.5,
            time_to: 0.6,
            kind,
            parents: parents.to_vec(),
            children: children.to_vec(),
            parent_weights: Vec::new(),
            child_weights: Vec::new(),
            confidence: 1.0,
        };
        let events = vec![event(EventKind::Continue, &[1], &[1]), event(EventKind::Split, &[1], &[2, 3])];
        let tracking = Tracking { events, points: Vec::new() };
        let found = TrackedSegment { name: "a".into(), statistics: Vec::new(), tracking };
        let track = Track::new(7, vec!["a".into()], &found);
        assert_eq!(track.events, [TrackEvent { kind: EventKind::Split, from: 0.5, to: 0.6, parts: [1, 2] }]);
        assert!(serde_json::to_string(&track).unwrap().contains(r#""kind":"split""#));
    }
}
