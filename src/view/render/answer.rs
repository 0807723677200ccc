//! Answers to requests.

use super::{Refused, Renderer};
use crate::run::keyframes::{CameraPath, SavedPath};
use crate::run::pick;
use crate::run::saved::{SavedView, command};
use crate::run::segments::RunSegments;
use crate::run::{OpenRun, RunError};
use crate::view::background::ChangeRequest;
use crate::view::client::ClickResult;
use crate::view::gizmo::Preview;
use crate::view::hub::{ClientId, Outgoing};
use crate::view::protocol::{Answer, Change, Codec, FrameInfo, FrameKind, Request};
use crate::view::refusal::ChangeError;
use crate::view::tracks::TrackRequest;
use crate::view::workspace::coarse;
use std::time::Instant;

/// Name under which the page saves a picture.
const PICTURE_FILE: &str = "volseggs.png";
/// Name under which the page saves a path.
const PATH_FILE: &str = "path.json";
/// Maximum number of cameras of a path that a client may request.
const MAX_CAMERAS: usize = 3000;

impl Renderer {
    /// Answers a request; an error comes with the request's number, if it has one.
    pub(super) fn answer(&mut self, id: ClientId, request: Request) -> Result<(), Refused> {
        let Some(client) = self.clients.get_mut(&id) else { return Ok(()) };
        match request {
            Request::View(wanted) => {
                wanted.view.check().map_err(|e| (None, e))?;
                client.pace.changes(Instant::now(), wanted.moving);
                wanted.compare.map_or(Ok(()), |c| c.check(self.others.len())).map_err(|e| (None, e))?;
                wanted.preview.as_ref().map_or(Ok(()), Preview::check).map_err(|e| (None, e))?;
                client.view = Some(wanted.view);
                client.failed = false;
                client.preview = wanted.preview;
                client.compare = wanted.compare;
            }
            Request::Ack { frame } => client.pace.acknowledges(Instant::now(), frame),
            Request::Pick { id, pixel, within, meaning, combine } => {
                let picked = client.pick(&self.space, id, pixel, within.as_deref(), (meaning, combine));
                let picked = picked.map_err(|e| (Some(id), e.to_string()))?;
                client.answer(Answer::Picked(Box::new(picked)));
            }
            Request::Adjust { id, meaning } => {
                let picked = client.adjust(&self.space, id, meaning).map_err(|e| (Some(id), e.to_string()))?;
                client.answer(Answer::Picked(Box::new(picked)));
            }
            Request::Still { id: number } => {
                let wrong = |e: RunError| (Some(number), e.to_string());
                let started = Instant::now();
                let view = client.still().map_err(wrong)?;
                let (size, time) = (view.size, view.time);
                let bytes = SavedView::picture(&self.space.shown.run, view, PICTURE_FILE).map_err(wrong)?;
                let (codec, revision) = (Codec::Png, self.space.revision());
                let (render_ms, encode_ms) = (1e3 * started.elapsed().as_secs_f32(), 0.0);
                let kind = FrameKind::Still;
                let info = FrameInfo { kind, codec, number, revision, size, time, render_ms, encode_ms };
                client.send(Outgoing::Frame(info, bytes));
            }
            Request::Command { id: number } => {
                let wrong = |e: RunError| (Some(number), e.to_string());
                let view = client.still().map_err(wrong)?;
                let json = serde_json::to_string(&view).map_err(|e| wrong(RunError::failure(e)))?;
                client.answer(Answer::Command {
                    id: number,
                    command: command(&self.space.shown.run, "--view", &json, "still"),
                });
            }
            Request::Views { id: number } => {
                let views = self.space.shown.run.test_views().map_err(|e| (Some(number), e.to_string()))?;
                client.answer(Answer::Views { id: number, views });
            }
            Request::Path { id: number, keys, frames } => {
                let wrong = |e: String| (Some(number), e);
                let shown = client.still().map_err(|e| wrong(e.to_string()))?;
                let path = CameraPath::new(keys.clone()).map_err(wrong)?;
                if frames > MAX_CAMERAS {
                    return Err(wrong(format!("frames: at most {MAX_CAMERAS}")));
                }
                let file = Box::new(SavedPath::new(&self.space.shown.run, shown, keys, PATH_FILE));
                client.answer(Answer::Path { id: number, frames: path.frames(frames).collect(), file });
            }
            Request::Clear => client.clear(),
            Request::Point { id, pixel } => {
                let at = client.point(&self.space, pixel).map_err(|e| (Some(id), e.to_string()))?;
                client.answer(Answer::Place { id, at });
            }
            Request::Centre { id, segments, time } => {
                let at = self.space.centre(&segments, time).map_err(|e| (Some(id), e.to_string()))?;
                client.answer(Answer::Place { id, at });
            }
            Request::Commit { id: number, base, name } => {
                let nothing = || (Some(number), "click on something first".to_owned());
                let (selection, ClickResult { hit, picked, time, .. }) =
                    client.clicked().cloned().ok_or_else(nothing)?;
                let request = ChangeRequest { client: id, id: number, base, selection: Some(selection) };
                self.begin(request, move |run, segments| {
                    pick::commit(run, segments, &name, &hit, &picked, time).map(drop)
                })?;
            }
            Request::Change { id: number, base, change: Change::Coarse { time, clusters } } => {
                let request = ChangeRequest { client: id, id: number, base, selection: None };
                self.begin(request, move |run, segments| coarse(run, segments, time, clusters))?;
            }
            Request::Change { id: number, base, change } => {
                let done = self.space.change(base, &change);
                self.ended(id, number, done)?;
            }
            Request::Job { id: number, base, task } => {
                let run = match self.space.for_work(base) {
                    Ok(run) => run,
                    Err(error) => return self.ended(id, number, Err(error)),
                };
                self.jobs.start(run, task).map_err(|e| (Some(number), e))?;
                client.answer(Answer::Done { id: number });
            }
            Request::Track { id: number, segments, times } => {
                let run = self.space.shown.run.share();
                let request = TrackRequest { client: id, id: number, segments, times, run };
                self.tracks.ask(request).map_err(|e| (Some(number), e))?;
            }
            Request::Pause { id: number, pause } => {
                self.space.can_pause().map_err(|e| (Some(number), e.to_string()))?.pause(pause);
                client.answer(Answer::Done { id: number });
            }
            Request::Cancel { id: number, job } => {
                self.space.refuse().map_err(|e| (Some(number), e.to_string()))?;
                self.jobs.cancel(job).map_err(|e| (Some(number), e))?;
                client.answer(Answer::Done { id: number });
            }
        }
        Ok(())
    }

    /// Begins a change of the segments that takes long.
    fn begin(
        &mut self,
        request: ChangeRequest,
        change: impl FnOnce(&OpenRun, &mut RunSegments) -> Result<(), RunError> + Send + 'static,
    ) -> Result<(), Refused> {
        match self.space.copy(request.base) {
            Ok((run, segments)) => {
                self.background.begin(request, run, segments, change).map_err(|e| (Some(request.id), e.to_string()))
            }
            Err(error) => self.ended(request.client, request.id, Err(error)),
        }
    }

    /// Adopts the changes that were finished meanwhile.
    pub(super) fn take_changes(&mut self) {
        while let Some((request, found)) = self.background.finished() {
            self.take_change(request, found);
        }
    }

    /// Adopts a change, unless the document changed meanwhile.
    pub(super) fn take_change(&mut self, request: ChangeRequest, found: Result<RunSegments, RunError>) {
        let ChangeRequest { client: id, id: number, base, selection } = request;
        let done = found.map_err(ChangeError::from).and_then(|segments| self.space.adopt(base, segments));
        if let (Ok(()), Some(selection), Some(client)) = (&done, selection, self.clients.get_mut(&id)) {
            client.clear_selection(selection);
        }
        if let (Err((number, message)), Some(client)) = (self.ended(id, number, done), self.clients.get_mut(&id)) {
            client.answer(Answer::Error { id: number, message });
        }
    }

    /// Reports a change to all clients, or to the one that requested it why it is refused.
    fn ended(&mut self, id: ClientId, number: u32, done: Result<(), ChangeError>) -> Result<(), Refused> {
        if matches!(done, Ok(()) | Err(ChangeError::Stale)) {
            self.tell_document();
        }
        done.map_err(|e| (Some(number), e.to_string()))?;
        if let Some(client) = self.clients.get_mut(&id) {
            client.answer(Answer::Done { id: number });
        }
        Ok(())
    }
}
