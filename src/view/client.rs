//! One client as the drawing thread knows it: what it wants to see, how fast it receives that, and its selection.

use super::clicks::Clicks;
use super::compare::{Compare, Side};
use super::gizmo::Preview;
use super::hub::Outgoing;
use super::pace::Pace;
use super::protocol::{Answer, Combine, LevelOffer, RequestedGranularity, Selected, View};
use super::workspace::Workspace;
use crate::name::Name;
use crate::run::RunError;
use crate::run::look::{Legend, Look, PreparedLook};
use crate::run::pick::{ClickError, ClickHit, surface_point};
use crate::segment::pick::{Granularity, PickOptions, PickedGaussians};
use std::time::Instant;
use tokio::sync::mpsc::Sender;

/// A client.
#[derive(Debug)]
pub struct Client {
    out: Sender<Outgoing>,
    /// Whether it does not receive what is sent, and is to be dropped.
    pub lost: bool,
    /// Whether what it wants to see could not be drawn; this is tried again when something changes.
    pub failed: bool,
    /// When to draw.
    pub pace: Pace,
    /// What it wants to see.
    pub view: Option<View>,
    /// Unsaved edits that are shown after those of the run.
    pub preview: Option<Preview>,
    /// What it compares that with.
    pub compare: Option<Compare>,
    /// The dataset's image that it has received, by its test view.
    pub image: Option<usize>,
    /// The looks of the picture and of the one beside it, with their keys.
    looks: [Option<(String, Look)>; 2],
    /// The scene that it clicks on.
    clicks: Option<Clicks>,
    /// What is selected, with the number of that selection.
    clicked: Option<(u64, ClickResult)>,
    /// What was prepared last for both with the selection highlighted, with the key of the unhighlighted Gaussians and
    /// the number of the selection.
    highlighted: [Option<(String, u64, PreparedLook)>; 2],
    /// Grows with every change of what is selected.
    selections: u64,
    legend: Option<Legend>,
    /// Why it has no second picture, if so.
    fault: Option<String>,
    /// Number of the last frame.
    pub frame: u32,
}

/// The part of a look's key that follows from the view.
fn shown(view: &View, side: Side) -> String {
    let [eye, target, up] = [[0.0; 3]; 3];
    let still = View { eye, target, up, fov: 0.0, size: [0; 2], time: 0.0, ..view.clone() };
    format!("{:?} {still:?} ", side.run())
}

/// What is selected.
#[derive(Clone, Debug)]
pub struct ClickResult {
    /// The last click.
    pub hit: ClickHit,
    /// What all clicks selected, with scale and cosine of the last.
    pub picked: PickedGaussians,
    /// Time of the click.
    pub time: f64,
    /// What was selected before the last click, and how the click combines with it.
    before: (Vec<u32>, Combine),
}

impl Client {
    /// Makes a client that has just connected.
    pub fn new(out: Sender<Outgoing>) -> Self {
        Self {
            out,
            lost: false,
            failed: false,
            pace: Pace::new(Instant::now()),
            view: None,
            preview: None,
            compare: None,
            image: None,
            looks: [None, None],
            clicks: None,
            clicked: None,
            highlighted: [None, None],
            selections: 0,
            legend: None,
            fault: None,
            frame: 0,
        }
    }

    /// Sends something; a client that left, or has received nothing for long, is lost.
    pub fn send(&mut self, what: Outgoing) {
        self.lost |= self.out.try_send(what).is_err();
    }

    /// Sends an answer.
    pub fn answer(&mut self, answer: Answer) {
        self.send(Outgoing::Text(Box::new(answer)));
    }

    /// Returns what is selected, and the number of that selection.
    pub fn clicked(&self) -> Option<&(u64, ClickResult)> {
        self.clicked.as_ref()
    }

    /// Clears the selection.
    pub fn clear(&mut self) {
        self.clicked = None;
        self.changed();
    }

    /// Clears the selection, unless it is another one by now.
    pub fn clear_selection(&mut self, number: u64) {
        if self.clicked.as_ref().is_some_and(|(now, _)| *now == number) {
            self.clear();
        }
    }

    /// Adapts what it wants to see, and what is selected in the segment, to the new name of a segment.
    pub fn renamed(&mut self, old: &str, new: &str) {
        if let (Some((_, clicked)), Ok(new)) = (&mut self.clicked, Name::new(new)) {
            let hit = &mut clicked.hit;
            for name in hit.within.iter_mut().chain(&mut hit.segments).filter(|name| ***name == *old) {
                name.clone_from(&new);
            }
        }
        let Some(view) = &mut self.view else { return };
        for name in view.alone.iter_mut().chain(&mut view.hidden).filter(|name| *name == old) {
            new.clone_into(name);
        }
    }

    /// Makes what is shown be drawn again.
    pub fn changed(&mut self) {
        self.failed = false;
        self.selections += 1;
        self.pace.changes(Instant::now(), false);
    }

    /// Returns the look of `view` of `space`, as the picture or the one beside it, and the key under which what it
    /// prepares for a time is cached: clients with the same view share it.
    ///
    /// # Errors
    /// If the look or a segment is unknown.
    pub fn look_of(&mut self, space: &Workspace, view: &View, side: Side) -> Result<(&mut Look, String), RunError> {
        let run = side.run();
        let key = format!("{}{}", shown(view, side), space.revision());
        let found = &mut self.looks[side.index()];
        if found.as_ref().is_none_or(|(k, _)| *k != key) {
            let view = usable(space, view);
            let look =
                if run.is_some() { view.look_of_another(&space.shown.run) } else { view.open_look(&space.shown.run) };
            *found = Some((key.clone(), look?));
        }
        match found {
            Some((_, look)) => {
                // the look stays while a handle is dragged: it holds what every step of the drag starts from
                let preview = self.preview.as_ref().filter(|_| side == Side::Picture);
                let preview = Preview::edits_on(preview, space.revision());
                let key = if preview.is_empty() { key } else { format!("{key} {preview:?}") };
                look.preview(&space.shown.run, preview)?;
                Ok((look, key))
            }
            None => Err(RunError::failure("there is no look to draw")),
        }
    }

    /// Returns `prepared`, made for the look under `key`, with the selection highlighted; another run has none.
    pub fn highlighted(&mut self, key: &str, prepared: PreparedLook, side: Side) -> PreparedLook {
        let which = side.index();
        let clicked = self.clicked.as_ref().filter(|_| side.run().is_none());
        let Some(members) = clicked.map(|(_, c)| &c.picked.members) else { return prepared };
        let Some((_, look)) = self.looks[which].as_ref().filter(|_| !members.is_empty()) else { return prepared };
        let known = &mut self.highlighted[which];
        if known.as_ref().is_none_or(|(k, s, _)| (k.as_str(), *s) != (key, self.selections)) {
            *known = Some((key.to_owned(), self.selections, look.highlight(&prepared, members)));
        }
        known.as_ref().map_or(prepared, |(_, _, known)| known.clone())
    }

    /// Returns what it wants to see, with the colour scale that it sees and without the selection.
    ///
    /// # Errors
    /// If it has not requested a view.
    pub fn still(&self) -> Result<View, RunError> {
        let mut view = self.view.clone().ok_or_else(|| RunError::input("nothing is shown yet"))?;
        view.range = view.range.or(self.range());
        Ok(view)
    }

    /// Values at the ends of the colour scale that it sees; `None` if what it wants to see has not been drawn yet.
    pub fn range(&self) -> Option<[f32; 2]> {
        let wanted = shown(self.view.as_ref()?, Side::Picture);
        let (_, look) = self.looks[0].as_ref().filter(|(key, _)| key.starts_with(&wanted))?;
        look.legend().and_then(|l| l.scene_range)
    }

    /// Sends why there is no second picture, if that changed.
    pub fn tell_beside(&mut self, fault: Option<String>) {
        if fault != self.fault {
            self.fault.clone_from(&fault);
            self.answer(Answer::Beside { fault });
        }
    }

    /// Sends the legend of the colours, if it changed.
    pub fn tell_legend(&mut self) {
        let legend = self.looks[0].as_ref().and_then(|(_, look)| look.legend());
        if legend != self.legend {
            self.legend.clone_from(&legend);
            self.answer(Answer::Legend { legend });
        }
    }

    /// Prepares the scene that is shown for clicks, once it is shown in full. Not while something is selected, as its
    /// sliders need the scene that was clicked on.
    pub fn prepare_clicks(&mut self, space: &Workspace) {
        if let Some(view) = self.view.as_ref().filter(|_| self.pace.is_done() && self.clicked.is_none()) {
            Clicks::prepare(&mut self.clicks, space, view.time);
        }
    }

    /// Handles a click on a pixel of the view that was requested last.
    ///
    /// # Errors
    /// If nothing is there, or nothing can be selected.
    pub fn pick(
        &mut self,
        space: &Workspace,
        id: u32,
        pixel: [u32; 2],
        within: Option<&str>,
        (meaning, combine): (Option<RequestedGranularity>, Combine),
    ) -> Result<Selected, ClickError> {
        let view = self.view.clone().ok_or_else(|| RunError::input("nothing is shown yet"))?;
        let started = Instant::now();
        let clicking = Clicks::get(&mut self.clicks, space, view.time)?;
        let hit = clicking.hit(&view.camera(1.0), pixel, within)?;
        let before = self.clicked.take().map(|(_, c)| c.picked.members).unwrap_or_default();
        self.select(id, hit, view.time, (before, combine), meaning, started)
    }

    /// Returns the position, in scene units, of what a pixel shows in the view that was requested last.
    ///
    /// # Errors
    /// If nothing is there.
    pub fn point(&self, space: &Workspace, pixel: [u32; 2]) -> Result<[f64; 3], ClickError> {
        let view = self.view.as_ref().ok_or_else(|| RunError::input("nothing is shown yet"))?;
        let run = &space.shown.run;
        let at = usable(space, view).open_look(run)?.selection().gaussians_at(&run.scene, view.time as f32)?;
        let click = &run.config.segment.click;
        surface_point((&at, run.scene.spec.rendering()), &view.camera(1.0), pixel, click, view.time, &run.device())
    }

    /// Repeats the last click, with another meaning.
    ///
    /// # Errors
    /// If there was none.
    pub fn adjust(
        &mut self,
        space: &Workspace,
        id: u32,
        meaning: Option<RequestedGranularity>,
    ) -> Result<Selected, ClickError> {
        let Some((_, ClickResult { hit, time, before, .. })) = &self.clicked else {
            return Err(RunError::input("click on something first").into());
        };
        let (hit, time, before) = (hit.clone(), *time, before.clone());
        // there may have been a click at another time meanwhile that hit nothing
        Clicks::get(&mut self.clicks, space, time)?;
        self.select(id, hit, time, before, meaning, Instant::now())
    }

    fn select(
        &mut self,
        id: u32,
        hit: ClickHit,
        time: f64,
        before: (Vec<u32>, Combine),
        meaning: Option<RequestedGranularity>,
        started: Instant,
    ) -> Result<Selected, ClickError> {
        let Some(clicking) = self.clicks.as_ref().and_then(Clicks::last) else { return Err(ClickError::NoField) };
        // a slider asks again and again: the levels at the click stay the same
        let known = self
            .clicked
            .as_ref()
            .map(|(_, c)| &c.picked.levels)
            .filter(|_| matches!(meaning, Some(RequestedGranularity::By { .. })));
        let list = known.is_none();
        let options = PickOptions { meaning: meaning.map_or(Granularity::Likeliest, Into::into), list };
        let mut picked = clicking.select(&hit, &options)?;
        if let Some(levels) = known {
            picked.levels.clone_from(levels);
        }
        picked.members = combine(&before, std::mem::take(&mut picked.members));
        let selected = Selected {
            id,
            mean: hit.mean,
            segments: hit.segments.iter().map(ToString::to_string).collect(),
            gaussians: picked.members.len(),
            scale: picked.scale,
            threshold: picked.threshold,
            levels: picked.levels.iter().map(|l| LevelOffer { kind: l.kind, share: l.share }).collect(),
            level: picked.level.map(|n| n + 1),
            ms: 1e3 * started.elapsed().as_secs_f64(),
        };
        self.changed();
        self.clicked = Some((self.selections, ClickResult { hit, picked, time, before }));
        Ok(selected)
    }
}

/// The view as it can be drawn: while the segments on disk cannot be used, neither can their edits, and none is hidden.
fn usable(space: &Workspace, view: &View) -> View {
    match space.has_document() {
        true => view.clone(),
        false => View { edits: false, hidden: Vec::new(), ..view.clone() },
    }
}

impl From<RequestedGranularity> for Granularity {
    fn from(requested: RequestedGranularity) -> Self {
        match requested {
            RequestedGranularity::Level(n) => Self::Level(n.get() - 1),
            RequestedGranularity::By { scale, threshold } => Self::By { scale, threshold },
        }
    }
}

/// Combines ascending lists: what was selected before and what is new.
fn combine((before, how): &(Vec<u32>, Combine), new: Vec<u32>) -> Vec<u32> {
    match how {
        Combine::Replace => new,
        Combine::Add => {
            let mut all = before.clone();
            all.extend(new);
            all.sort_unstable();
            all.dedup();
            all
        }
        Combine::Remove => before.iter().filter(|i| new.binary_search(i).is_err()).copied().collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clicks_add_and_remove() {
        let with = |how| combine(&(vec![1, 3, 5], how), vec![3, 4]);
        assert_eq!(with(Combine::Replace), [3, 4]);
        assert_eq!(with(Combine::Add), [1, 3, 4, 5]);
        assert_eq!(with(Combine::Remove), [1, 5]);
    }
}
