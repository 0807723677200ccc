//! The thread that draws: it owns the workspace, answers what clients ask, and draws for one client after the other what
//! each wants to see now. What a client wanted to see before that is never drawn.

use super::cache::Cache;
use super::client::Client;
use super::compare::Compare;
use super::gizmo::Preview;
use super::hub::{ClientId, Event, Hub, Outgoing};
use super::jobs::Jobs;
use super::pace::Next;
use super::protocol::{Answer, Codec, FrameInfo, Kind, Request, View};
use super::tracks::{Tracks, Wanted};
use super::training::Watch;
use super::workspace::{ChangeError, Workspace};
use crate::export::images::{encode_png, to_rgb8};
use crate::run::RunError;
use crate::run::keyframes::{CameraPath, SavedPath};
use crate::run::pick::Hit;
use crate::run::saved::{SavedView, command};
use jpeg_encoder::{ColorType, Encoder};
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Quality of frames of a moving view, and of one at rest.
const QUALITY: [u8; 2] = [60, 85];
/// Name under which the page saves a picture.
const FILE: &str = "volseggs.png";
/// Name under which the page saves a path.
const PATH_FILE: &str = "path.json";
/// Most cameras of a path that a client may ask for.
const PATH: usize = 3000;
/// How often the files of the run are looked at.
const LOOK: Duration = Duration::from_millis(500);

/// The state of the thread.
#[derive(Debug)]
pub struct Renderer {
    space: Workspace,
    cache: Cache,
    clients: BTreeMap<ClientId, Client>,
    /// The client that was drawn for last.
    last: ClientId,
    jobs: Jobs,
    tracks: Tracks,
    watch: Watch,
    /// What clients were told of the scene: its step, and whether there is an affinity field.
    told: (Option<usize>, bool),
    hub: Arc<Hub>,
}

impl Renderer {
    /// Draws `space` for the clients of `hub`; what is deformed is kept, up to `cache` bytes.
    #[must_use]
    pub fn new(space: Workspace, cache: usize, hub: Arc<Hub>) -> Self {
        let (jobs, tracks) = (Jobs::new(hub.clone()), Tracks::new(hub.clone()));
        let (watch, told) = (Watch::default(), (space.run.step(), space.field().is_some()));
        Self { space, cache: Cache::new(cache), clients: BTreeMap::new(), last: 0, jobs, tracks, watch, told, hub }
    }

    /// Works until the hub stops it.
    pub fn run(mut self) {
        let mut looked = Instant::now();
        let mut until = Some(Instant::now());
        while let Some(events) = self.hub.wait(until) {
            for (id, event) in events {
                self.handle(id, event);
            }
            if looked.elapsed() > LOOK {
                looked = Instant::now();
                self.look_at_files();
                self.tell_of_training();
            }
            self.tell_of_job();
            self.tell_of_tracks();
            until = self.draw_next();
            self.clients.retain(|_, client| !client.lost);
        }
    }

    fn handle(&mut self, id: ClientId, event: Event) {
        match event {
            Event::Came(out) => {
                let mut client = Client::new(out);
                client.answer(self.welcome());
                client.answer(Answer::Document(Box::new(self.space.document())));
                if let Some(training) = self.watch.now() {
                    client.answer(Answer::Training(Box::new(training.clone())));
                }
                if let Some(state) = self.jobs.state() {
                    client.answer(Answer::Job(Box::new(state)));
                }
                self.clients.insert(id, client);
            }
            Event::Left => {
                self.tracks.forget(id);
                self.clients.remove(&id);
            }
            Event::Said(request) => {
                // whatever goes wrong here, the others go on
                let answered = catch_unwind(AssertUnwindSafe(|| self.answer(id, *request)));
                let wrong = answered.unwrap_or_else(|_| Err((None, "the viewer failed at this; it goes on".into())));
                if let (Err((number, message)), Some(client)) = (wrong, self.clients.get_mut(&id)) {
                    client.answer(Answer::Error { id: number, message });
                }
            }
        }
    }

    fn welcome(&self) -> Answer {
        let run = &self.space.run;
        let around = run.surroundings();
        Answer::Welcome {
            version: env!("CARGO_PKG_VERSION"),
            run: run.path.display().to_string(),
            scene: run.scene.fingerprint(),
            step: run.step(),
            gaussians: run.scene.gaussians.count(),
            centre: run.scene.spec.centre().to_array(),
            radius: around.sphere.radius,
            fov: around.lens.fov_x,
            size: [around.lens.width, around.lens.height],
            clicks: self.space.field().is_some(),
            read_only: self.space.read_only(),
            note: around.note.or_else(|| self.space.fault().map(str::to_owned)),
        }
    }

    /// Answers a request; an error with the request's number, if it has one.
    fn answer(&mut self, id: ClientId, request: Request) -> Result<(), (Option<u32>, String)> {
        let Some(client) = self.clients.get_mut(&id) else { return Ok(()) };
        match request {
            Request::View(wanted) => {
                wanted.view.check().map_err(|e| (None, e))?;
                client.pace.changes(Instant::now(), wanted.moving);
                wanted.compare.map_or(Ok(()), |c| c.check()).map_err(|e| (None, e))?;
                wanted.preview.as_ref().map_or(Ok(()), Preview::check).map_err(|e| (None, e))?;
                client.view = Some(wanted.view);
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
                let picked = client.adjust(id, meaning).map_err(|e| (Some(id), e.to_string()))?;
                client.answer(Answer::Picked(Box::new(picked)));
            }
            Request::Still { id: number } => {
                let wrong = |e: RunError| (Some(number), e.to_string());
                let started = Instant::now();
                let view = client.still().map_err(wrong)?;
                let (size, time) = (view.size, view.time);
                let (run, device) = (&self.space.run, &self.space.device);
                let bytes = SavedView::picture(run, view, FILE, device).map_err(wrong)?;
                let (codec, revision) = (Codec::Png, self.space.revision());
                let (render_ms, encode_ms) = (1e3 * started.elapsed().as_secs_f32(), 0.0);
                let kind = Kind::Still;
                let info = FrameInfo { kind, codec, number, revision, size, time, render_ms, encode_ms };
                client.send(Outgoing::Frame(info, bytes));
            }
            Request::Command { id: number } => {
                let wrong = |e: RunError| (Some(number), e.to_string());
                let view = client.still().map_err(wrong)?;
                let json = serde_json::to_string(&view).map_err(|e| wrong(RunError::failure(e)))?;
                client.answer(Answer::Command {
                    id: number,
                    command: command(&self.space.run, "--view", &json, "still"),
                });
            }
            Request::Views { id: number } => {
                let views = self.space.run.test_views().map_err(|e| (Some(number), e.to_string()))?;
                client.answer(Answer::Views { id: number, views });
            }
            Request::Path { id: number, keys, frames } => {
                let wrong = |e: String| (Some(number), e);
                let shown = client.still().map_err(|e| wrong(e.to_string()))?;
                let path = CameraPath::new(keys.clone()).map_err(wrong)?;
                if frames > PATH {
                    return Err(wrong(format!("frames: at most {PATH}")));
                }
                let file = Box::new(SavedPath::new(&self.space.run, shown, keys, PATH_FILE));
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
                let clicked = client.clicked().cloned().ok_or_else(nothing)?;
                let hit = part_of(&self.space, clicked.hit, &clicked.picked.members);
                let done = self.space.commit(base, &name, &hit, &clicked.picked, clicked.time);
                if done.is_ok() {
                    client.clear();
                }
                self.ended(id, number, done)?;
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
                self.jobs.start(run, &self.space.device, task).map_err(|e| (Some(number), e))?;
                client.answer(Answer::Done { id: number });
            }
            Request::Track { id: number, segments, times } => {
                let wanted = Wanted { client: id, id: number, segments, times, run: self.space.run.share() };
                self.tracks.ask(wanted).map_err(|e| (Some(number), e))?;
            }
            Request::Cancel { id: number, job } => {
                if self.space.read_only() {
                    return Err((Some(number), ChangeError::ReadOnly.to_string()));
                }
                self.jobs.cancel(job).map_err(|e| (Some(number), e))?;
                client.answer(Answer::Done { id: number });
            }
        }
        Ok(())
    }

    /// Tells everybody of a change, or the one who wanted it why it is refused.
    fn ended(&mut self, id: ClientId, number: u32, done: Result<(), ChangeError>) -> Result<(), (Option<u32>, String)> {
        if matches!(done, Ok(()) | Err(ChangeError::Stale)) {
            self.tell_document();
        }
        done.map_err(|e| (Some(number), e.to_string()))?;
        if let Some(client) = self.clients.get_mut(&id) {
            client.answer(Answer::Done { id: number });
        }
        Ok(())
    }

    fn tell_document(&mut self) {
        self.cache.clear();
        let now = (self.space.run.step(), self.space.field().is_some());
        if now != self.told {
            let newer = now.0 != self.told.0;
            self.told = now;
            self.tell_all(&self.welcome());
            // what was selected is of the scene before
            self.clients.values_mut().filter(|_| newer).for_each(Client::clear);
        }
        let document = self.space.document();
        for client in self.clients.values_mut() {
            client.changed();
            client.answer(Answer::Document(Box::new(document.clone())));
        }
    }

    /// Reads what commands and jobs wrote into the run.
    fn look_at_files(&mut self) {
        match self.space.refresh() {
            Ok(false) => {}
            Ok(true) => self.tell_document(),
            Err(error) => self.tell_all(&Answer::Error { id: None, message: error.to_string() }),
        }
    }

    /// Tells how the training of the run has come on.
    fn tell_of_training(&mut self) {
        if let Some(training) = self.watch.look(&self.space.run) {
            let news = Answer::Training(Box::new(training.clone()));
            self.tell_all(&news);
        }
    }

    /// Tells how far a job has come, after what it made when it ended.
    fn tell_of_job(&mut self) {
        let Some(state) = self.jobs.news() else { return };
        if state.end.is_some() {
            self.look_at_files();
        }
        self.tell_all(&Answer::Job(Box::new(state)));
    }

    /// Sends tracks to those who asked for them.
    fn tell_of_tracks(&mut self) {
        while let Some((id, found)) = self.tracks.news() {
            let Some(client) = self.clients.get_mut(&id) else { continue };
            client.answer(match found {
                Ok(track) => Answer::Track(Box::new(track)),
                Err((number, message)) => Answer::Error { id: Some(number), message },
            });
        }
    }

    fn tell_all(&mut self, answer: &Answer) {
        for client in self.clients.values_mut() {
            client.answer(answer.clone());
        }
    }

    /// Draws for the next client for whom there is something to draw; until when there is nothing else to do.
    fn draw_next(&mut self) -> Option<Instant> {
        let now = Instant::now();
        let mut until: Option<Instant> = None;
        let after: Vec<ClientId> = self.clients.range(self.last + 1..).map(|(id, _)| *id).collect();
        let before: Vec<ClientId> = self.clients.range(..=self.last).map(|(id, _)| *id).collect();
        for id in after.into_iter().chain(before) {
            let Some(client) = self.clients.get(&id) else { continue };
            let Some(view) = client.view.clone() else { continue };
            match client.pace.next(now, (view.size[0] * view.size[1]) as usize) {
                Next::Wait => {}
                Next::WaitUntil(moment) => until = Some(until.map_or(moment, |u| u.min(moment))),
                next => {
                    self.last = id;
                    self.draw(id, &view, next);
                    return Some(now);
                }
            }
        }
        until
    }

    fn draw(&mut self, id: ClientId, view: &View, next: Next) {
        let drawn = catch_unwind(AssertUnwindSafe(|| {
            let drawn = self.frame(id, view, next, Kind::Picture)?;
            // first, so that who acknowledges the picture has taken it too
            self.beside(id, view, next)?;
            Ok(drawn)
        }));
        let drawn = drawn.unwrap_or_else(|_| Err(RunError::failure("this view cannot be drawn")));
        let Some(client) = self.clients.get_mut(&id) else { return };
        match drawn {
            Ok((info, bytes)) => {
                client.frame = info.number;
                let pixels = (info.size[0] * info.size[1]) as usize;
                client.pace.sent(Instant::now(), next, info.number, pixels, f64::from(info.render_ms + info.encode_ms));
                client.send(Outgoing::Frame(info, bytes));
                client.tell_legend();
                if next == Next::Lossless {
                    client.prepare_clicks(&self.space, view.time);
                }
            }
            Err(error) => {
                // not again before it changes
                client.view = None;
                client.answer(Answer::Error { id: None, message: error.to_string() });
            }
        }
    }

    /// Sends what the picture is compared with.
    fn beside(&mut self, id: ClientId, view: &View, next: Next) -> Result<(), RunError> {
        let Some(client) = self.clients.get_mut(&id) else { return Ok(()) };
        let Some(compare) = client.compare else { return Ok(()) };
        let sent = match (compare, compare.other(view, client.range())) {
            (_, Some(other)) => self.frame(id, &other, next, Kind::Other)?,
            (Compare::Image { view: number }, None) if client.image != Some(number) => {
                // one that cannot be read is told of once
                client.image = Some(number);
                let image = self.space.run.test_image(number)?;
                let size = [image.width(), image.height()];
                let (kind, codec, revision, time) = (Kind::Image, Codec::Png, self.space.revision(), view.time);
                let (number, render_ms, encode_ms) = (number as u32, 0.0, 0.0);
                let info = FrameInfo { kind, codec, number, revision, size, time, render_ms, encode_ms };
                (info, encode_png(&image).map_err(RunError::failure)?)
            }
            _ => return Ok(()),
        };
        if let Some(client) = self.clients.get_mut(&id) {
            client.send(Outgoing::Frame(sent.0, sent.1));
        }
        Ok(())
    }

    fn frame(&mut self, id: ClientId, view: &View, next: Next, kind: Kind) -> Result<(FrameInfo, Vec<u8>), RunError> {
        let client = self.clients.get_mut(&id).ok_or_else(|| RunError::failure("the client left"))?;
        let (part, quality) = match next {
            Next::Moving(part) => (part, Some(QUALITY[0])),
            Next::Full => (1.0, Some(QUALITY[1])),
            _ => (1.0, None),
        };
        let started = Instant::now();
        let camera = view.camera(part);
        let number = client.frame.wrapping_add(1);
        let other = kind == Kind::Other;
        let dragged = client.preview.is_some() && !other;
        let (look, key) = client.look(&self.space, view, other)?;
        let (scene, device) = (&self.space.run.scene, &self.space.device);
        let key = format!("{} {key}", view.time);
        let prepared = match self.cache.get(&key) {
            Some(prepared) => prepared,
            None => {
                let prepared = look.prepare(scene, view.time as f32, device)?;
                if !dragged {
                    // nobody comes back to a step of a drag
                    self.cache.put(key.clone(), prepared.clone());
                }
                prepared
            }
        };
        let prepared = client.highlighted(&key, prepared, other, device);
        let (look, _) = client.look(&self.space, view, other)?;
        let image = look.draw(scene, &prepared, camera.to_kernel(), device);
        let size = [camera.width, camera.height];
        let rgb = to_rgb8(&image, size[0] as usize, size[1] as usize);
        let render_ms = 1e3 * started.elapsed().as_secs_f32();
        let started = Instant::now();
        let (codec, bytes) = match quality {
            Some(quality) => {
                let mut bytes = Vec::new();
                let encoder = Encoder::new(&mut bytes, quality);
                encoder
                    .encode(rgb.as_raw(), size[0] as u16, size[1] as u16, ColorType::Rgb)
                    .map_err(RunError::failure)?;
                (Codec::Jpeg, bytes)
            }
            None => (Codec::Png, encode_png(&rgb).map_err(RunError::failure)?),
        };
        let encode_ms = 1e3 * started.elapsed().as_secs_f32();
        let revision = self.space.revision();
        Ok((FrameInfo { kind, codec, number, revision, size, time: view.time, render_ms, encode_ms }, bytes))
    }
}

/// The click, whose selection is a part of the segment that was looked in if all of it lies there.
fn part_of(space: &Workspace, mut hit: Hit, members: &[u32]) -> Hit {
    let holds = |name: &crate::name::Name| {
        let whole = space.segments().now().get(name);
        whole.is_ok_and(|whole| members.iter().all(|i| whole.members.binary_search(i).is_ok()))
    };
    hit.within = hit.within.filter(holds);
    hit
}
