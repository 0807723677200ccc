//! The drawing thread: it owns the workspace, answers the requests of clients, and draws for one client after the other
//! what each wants to see now. Views that a client no longer wants are not drawn.

mod answer;
mod draw;

use super::background::{BackgroundChanges, INTERNAL_ERROR};
use super::cache::Cache;
use super::client::Client;
use super::compare::Side;
use super::hub::{ClientEvent, ClientId, Hub};
use super::jobs::Jobs;
use super::live::TrainerRequest;
use super::others::ComparedRun;
use super::pace::NextDrawing;
use super::protocol::Answer;
use super::share::ThreadShare;
use super::tracks::Tracks;
use super::training::LogWatch;
use super::workspace::Workspace;
use crate::shell;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Time between checks of the files of the run.
const CHECK_PERIOD: Duration = Duration::from_millis(500);

/// Age at which a scene in training is replaced even while a camera is moving.
const MAX_AGE_MOVING: Duration = Duration::from_secs(3);

/// Why a request is refused, with its number if it has one.
type Refused = (Option<u32>, String);

/// The state of the drawing thread.
#[derive(Debug)]
pub struct Renderer {
    space: Workspace,
    /// Runs that it is compared with.
    others: Vec<ComparedRun>,
    cache: Cache,
    clients: BTreeMap<ClientId, Client>,
    /// The client that was drawn for last.
    last: ClientId,
    jobs: Jobs,
    tracks: Tracks,
    background: BackgroundChanges,
    watch: LogWatch,
    /// What was announced to clients about the scene: its step, and whether there is an affinity field.
    announced: (Option<usize>, bool),
    hub: Arc<Hub>,
    /// The share of the machine that drawing may take during training in this process.
    share: Option<Arc<ThreadShare>>,
    /// Until when nothing is drawn.
    rests: Instant,
    /// When the scene of a training changed last.
    changed: Instant,
    /// When the files of the run were checked last.
    looked: Instant,
}

impl Renderer {
    /// Makes the thread's state, which draws `space` for the clients of `hub`, and beside it one of the `others` if
    /// they compare. Deformed Gaussians are cached, up to `cache` bytes for all together.
    pub fn new(space: Workspace, others: Vec<ComparedRun>, cache: usize, hub: Arc<Hub>) -> Self {
        let now = Instant::now();
        Self {
            others,
            cache: Cache::new(cache),
            clients: BTreeMap::new(),
            last: 0,
            jobs: Jobs::new(hub.clone()),
            tracks: Tracks::new(hub.clone()),
            background: BackgroundChanges::new(hub.clone()),
            watch: LogWatch::default(),
            announced: (space.shown.run.step(), space.shown.field.is_some()),
            hub,
            // without a thread of its own, drawing is not limited
            share: space.live().and_then(|_| ThreadShare::new().ok()).map(Arc::new),
            rests: now,
            changed: now,
            looked: now,
            space,
        }
    }

    /// Works until the hub stops it.
    pub fn run(mut self) {
        let mut until = Some(Instant::now());
        while let Some(events) = self.hub.wait(until) {
            // a paused training leaves the machine to the viewer
            let share = self.share.clone().filter(|_| !self.space.live().is_some_and(|live| live.progress().paused));
            until = match share {
                Some(share) => share.work(|| self.turn(events, Some(&share))),
                None => self.turn(events, None),
            };
        }
        self.close();
    }

    /// Does what there is to do; returns until when there is nothing else.
    fn turn(&mut self, events: Vec<(ClientId, ClientEvent)>, share: Option<&ThreadShare>) -> Option<Instant> {
        let began = Instant::now();
        for (id, event) in events {
            self.handle(id, event);
        }
        let news = self.space.live().is_some_and(|live| live.has_news());
        if news || self.looked.elapsed() > CHECK_PERIOD {
            self.looked = Instant::now();
            self.look_at_files();
            self.tell_of_training(news);
        }
        self.tell_of_job();
        self.tell_of_tracks();
        self.take_changes();
        let rests = share.is_some() && began < self.rests;
        let until = if rests { Some(self.rests) } else { self.draw_next() };
        self.clients.retain(|_, client| !client.lost);
        // asked again and again: another time may still have been in preparation when the picture came to rest
        self.clients.values_mut().for_each(|client| client.prepare_clicks(&self.space));
        self.wish();
        if let Some(share) = share {
            self.rests = self.rests.max(began) + share.rest(began.elapsed());
        }
        until
    }

    /// Tells the trainer whether a newer scene is wanted: once all windows show the last one, or when a moving picture
    /// has shown it for long enough.
    fn wish(&self) {
        let Some(live) = self.space.live() else { return };
        let looking = || self.clients.values().filter(|client| client.view.is_some());
        let all_shown = looking().all(|client| client.failed || client.pace.is_done());
        let long_ago = self.changed.elapsed() > MAX_AGE_MOVING && looking().any(|client| client.pace.keeps_up());
        live.wish(match looking().next() {
            None => TrainerRequest::Nothing,
            Some(_) if all_shown || long_ago => TrainerRequest::Now,
            Some(_) => TrainerRequest::AtRest,
        });
    }

    /// Announces that the viewer ends; after a training, each window first gets the last scene in its own view.
    fn close(mut self) {
        // requested changes are finished first
        while let Some((request, found)) = self.background.wait() {
            self.take_change(request, found);
        }
        let mut message = "The viewer was closed.".to_owned();
        if let Some(ended) = self.space.live().and_then(|live| live.ended()) {
            message = format!("{ended} `volseggs view {}` shows the run.", shell::path(&self.space.shown.run.path));
            self.look_at_files();
            self.tell_of_training(true);
            let views: Vec<_> = self.clients.iter().filter_map(|(id, c)| Some((*id, c.view.clone()?))).collect();
            for (id, view) in views {
                self.draw(id, &view, NextDrawing::Lossless);
            }
        }
        self.tell_all(&Answer::Ended { message });
    }

    fn handle(&mut self, id: ClientId, event: ClientEvent) {
        match event {
            ClientEvent::Connected(out) => {
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
            ClientEvent::Disconnected => {
                self.tracks.forget(id);
                self.clients.remove(&id);
            }
            ClientEvent::Message(request) => {
                // the other clients go on, whatever goes wrong here
                let answered = catch_unwind(AssertUnwindSafe(|| self.answer(id, *request)));
                let answered = answered.unwrap_or_else(|_| Err((None, INTERNAL_ERROR.to_owned())));
                if let (Err((number, message)), Some(client)) = (answered, self.clients.get_mut(&id)) {
                    client.answer(Answer::Error { id: number, message });
                }
            }
        }
    }

    fn welcome(&self) -> Answer {
        let run = &self.space.shown.run;
        let around = &run.record.surroundings;
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
            others: self.others.iter().map(|other| other.describe(run)).collect(),
            clicks: self.space.shown.field.is_some(),
            read_only: self.space.read_only(),
            in_training: self.space.live().is_some(),
            can_pause: self.space.can_pause().is_ok(),
            calibration: Box::new(run.calibration().clone()),
            units: Box::new(run.calibration().into()),
            note: self.space.shown.fault.clone(),
        }
    }

    fn tell_document(&mut self) {
        self.cache.clear();
        let now = (self.space.shown.run.step(), self.space.shown.field.is_some());
        if now != self.announced {
            let newer = now.0 != self.announced.0;
            self.announced = now;
            self.tell_all(&self.welcome());
            // the selection belongs to the previous scene
            self.clients.values_mut().filter(|_| newer).for_each(Client::clear);
        }
        let document = self.space.document();
        for client in self.clients.values_mut() {
            document.renamed.iter().for_each(|[old, new]| client.renamed(old, new));
            client.changed();
            client.answer(Answer::Document(Box::new(document.clone())));
        }
    }

    /// Reads what commands and jobs wrote to the run.
    fn look_at_files(&mut self) {
        match self.space.refresh() {
            Ok(false) => {}
            Ok(true) if self.space.live().is_some() => self.show_newer(),
            Ok(true) => self.tell_document(),
            Err(error) => self.tell_all(&Answer::Error { id: None, message: error.to_string() }),
        }
        for k in 0..self.others.len() {
            let step = self.others[k].space.shown.run.step();
            match self.others[k].space.refresh() {
                Ok(false) => {}
                Ok(true) => {
                    self.cache.clear();
                    let newer = self.others[k].space.shown.run.step() != step;
                    if newer {
                        self.tell_all(&self.welcome());
                    }
                    let compares = |client: &&mut Client| client.compare.is_some_and(|c| c.side() == Side::OfRun(k));
                    self.clients.values_mut().filter(compares).for_each(Client::changed);
                }
                Err(error) => {
                    let message = format!("{}: {error}", self.others[k].name());
                    self.tell_all(&Answer::Error { id: None, message });
                }
            }
        }
    }

    /// Shows the newer scene of a training. There is no document that would change with it.
    fn show_newer(&mut self) {
        self.changed = Instant::now();
        self.cache.clear();
        self.announced.0 = self.space.shown.run.step();
        self.clients.values_mut().for_each(Client::clear);
    }

    /// Reports the progress of the run's training, at once if that is `urgent`.
    fn tell_of_training(&mut self, urgent: bool) {
        let live = self.space.live().map(|live| live.progress());
        if let Some(training) = self.watch.check(&self.space.shown.run, live, urgent) {
            let news = Answer::Training(Box::new(training.clone()));
            self.tell_all(&news);
        }
    }

    /// Reports the progress of a job; when it has ended, after what it made.
    fn tell_of_job(&mut self) {
        let Some(state) = self.jobs.changed() else { return };
        if state.end.is_some() {
            self.look_at_files();
        }
        self.tell_all(&Answer::Job(Box::new(state)));
    }

    /// Sends tracks to the clients that requested them.
    fn tell_of_tracks(&mut self) {
        while let Some((id, found)) = self.tracks.finished() {
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
}
