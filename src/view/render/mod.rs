//! The thread that draws: it owns the workspace, answers what clients ask, and draws for one client after the other what
//! each wants to see now. What a client wanted to see before that is never drawn.

mod answer;
mod draw;

use super::cache::Cache;
use super::client::Client;
use super::compare::Side;
use super::hub::{ClientId, Event, Hub};
use super::jobs::Jobs;
use super::others::Other;
use super::protocol::Answer;
use super::tracks::Tracks;
use super::training::Watch;
use super::workspace::Workspace;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How often the files of the run are looked at.
const LOOK: Duration = Duration::from_millis(500);

/// Why a request is refused, with its number if it has one.
type Wrong = (Option<u32>, String);

/// The state of the thread.
#[derive(Debug)]
pub struct Renderer {
    space: Workspace,
    /// Runs that it is compared with.
    others: Vec<Other>,
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
    /// Draws `space` for the clients of `hub`, and beside it one of the `others` where they compare; what is deformed is
    /// kept, of all together up to `cache` bytes.
    #[must_use]
    pub fn new(space: Workspace, others: Vec<Other>, cache: usize, hub: Arc<Hub>) -> Self {
        let (jobs, tracks) = (Jobs::new(hub.clone()), Tracks::new(hub.clone()));
        let (watch, told) = (Watch::default(), (space.run.step(), space.field().is_some()));
        let (cache, clients) = (Cache::new(cache), BTreeMap::new());
        Self { space, others, cache, clients, last: 0, jobs, tracks, watch, told, hub }
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
        let around = &self.space.around;
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
            others: self.others.iter().map(|other| other.told(run)).collect(),
            clicks: self.space.field().is_some(),
            read_only: self.space.read_only(),
            note: around.note.clone().or_else(|| self.space.fault().map(str::to_owned)),
        }
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
            document.renamed.iter().for_each(|[old, new]| client.renamed(old, new));
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
        for k in 0..self.others.len() {
            let step = self.others[k].space.run.step();
            match self.others[k].space.refresh() {
                Ok(false) => {}
                Ok(true) => {
                    self.cache.clear();
                    let newer = self.others[k].space.run.step() != step;
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
}
