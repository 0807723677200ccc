//! One client as the thread that draws knows it: what it wants to see, how fast it takes it, and what it has selected.

use super::clicks::Clicks;
use super::gizmo::Preview;
use super::hub::Outgoing;
use super::pace::Pace;
use super::protocol::{Answer, Asked, Combine, Selected, View};
use super::workspace::Workspace;
use crate::data::Camera;
use crate::run::RunError;
use crate::run::look::{Legend, Look, Prepared, Show};
use crate::run::pick::{ClickError, Hit, place};
use crate::run::selection::Selection;
use crate::segment::pick::{Meaning, PickOptions, Picked};
use crate::track::velocity::Component;
use burn::tensor::Device;
use glam::DVec3;
use std::time::Instant;
use tokio::sync::mpsc::Sender;

/// A client.
#[derive(Debug)]
pub struct Client {
    out: Sender<Outgoing>,
    /// It does not take what is sent, and is to be given up.
    pub lost: bool,
    /// When to draw.
    pub pace: Pace,
    /// What it wants to see.
    pub view: Option<View>,
    /// What draws that, with the key by which it is known.
    look: Option<(String, Look)>,
    /// The scene that it clicks on.
    clicks: Option<Clicks>,
    clicked: Option<Clicked>,
    /// What was prepared last with the selection standing out, with the key of the rest and the number of the selection.
    highlighted: Option<(String, u64, Prepared)>,
    /// Grows with every change of what is selected.
    selections: u64,
    legend: Option<Legend>,
    /// Number of the last frame.
    pub frame: u32,
}

/// What is selected.
#[derive(Clone, Debug)]
pub struct Clicked {
    /// The last click.
    pub hit: Hit,
    /// What all clicks selected; scale and cosine of the last.
    pub picked: Picked,
    /// Time of the click.
    pub time: f64,
    /// What was selected before the last click, and what that does to it.
    before: (Vec<u32>, Combine),
}

impl Client {
    /// One that came just now.
    pub fn new(out: Sender<Outgoing>) -> Self {
        let (view, look, clicks, clicked, legend) = (None, None, None, None, None);
        let (pace, lost) = (Pace::new(Instant::now()), false);
        Self { out, lost, pace, view, look, clicks, clicked, highlighted: None, selections: 0, legend, frame: 0 }
    }

    /// Sends something; one that left, or takes nothing for long, is lost.
    pub fn send(&mut self, what: Outgoing) {
        self.lost |= self.out.try_send(what).is_err();
    }

    /// Sends a text.
    pub fn answer(&mut self, answer: Answer) {
        self.send(Outgoing::Text(Box::new(answer)));
    }

    /// What is selected.
    pub fn clicked(&self) -> Option<&Clicked> {
        self.clicked.as_ref()
    }

    /// Forgets what is selected.
    pub fn clear(&mut self) {
        self.clicked = None;
        self.changed();
    }

    /// What is shown is to be drawn anew.
    pub fn changed(&mut self) {
        self.selections += 1;
        self.pace.changes(Instant::now(), false);
    }

    /// The camera of the view at `part` of its full size.
    pub fn camera(view: &View, part: f64) -> Camera {
        let side = |n: u32| ((f64::from(n) * part).round() as u32).max(1);
        let [eye, target, up] = [view.eye, view.target, view.up].map(DVec3::from_array);
        Camera::look_at(eye, target, up, view.fov, side(view.size[0]), side(view.size[1]))
    }

    /// What draws the view, and the key by which what it prepares for a time may be found again: clients that look at the
    /// same share it.
    ///
    /// # Errors
    /// A look or segment that nobody knows.
    pub fn look(&mut self, space: &Workspace, view: &View) -> Result<(&mut Look, String), RunError> {
        let View { look, alone, hidden, edits, preview, .. } = view;
        let key = format!("{look} {alone:?} {hidden:?} {edits} {}", space.revision());
        if self.look.as_ref().is_none_or(|(k, _)| *k != key) {
            let selection = shown(space, view)?;
            self.look = Some((key.clone(), Look::open(&space.run, selection, show(look)?)?));
        }
        match &mut self.look {
            Some((_, look)) => {
                // the look stays while a handle is dragged: it holds what every step of that begins with
                let preview = Preview::on(preview.as_ref(), space.revision());
                let key = if preview.is_empty() { key } else { format!("{key} {preview:?}") };
                look.preview(&space.run, preview)?;
                Ok((look, key))
            }
            None => Err(RunError::failure("no look")),
        }
    }

    /// What was prepared for the look, under `key`, with what is selected standing out.
    pub fn highlighted(&mut self, key: &str, prepared: Prepared, device: &Device) -> Prepared {
        let Some(members) = self.clicked.as_ref().map(|c| &c.picked.members) else { return prepared };
        let Some((_, look)) = self.look.as_ref().filter(|_| !members.is_empty()) else { return prepared };
        if self.highlighted.as_ref().is_none_or(|(k, s, _)| (k.as_str(), *s) != (key, self.selections)) {
            let new = look.highlight(&prepared, members, device);
            self.highlighted = Some((key.to_owned(), self.selections, new));
        }
        self.highlighted.as_ref().map_or(prepared, |(_, _, known)| known.clone())
    }

    /// Tells the key to the colours, where it changed.
    pub fn tell_legend(&mut self) {
        let legend = self.look.as_ref().and_then(|(_, look)| look.legend());
        if legend != self.legend {
            self.legend.clone_from(&legend);
            self.answer(Answer::Legend { legend });
        }
    }

    /// Makes the scene ready for clicks while nothing else is to be done. While something is selected, its sliders need
    /// the scene that was clicked on.
    pub fn prepare_clicks(&mut self, space: &Workspace, time: f64) {
        if self.clicked.is_none() {
            Clicks::prepare(&mut self.clicks, space, time);
        }
    }

    /// A click on a pixel of the view that was asked for last.
    ///
    /// # Errors
    /// If nothing is there, or nothing can be selected.
    pub fn pick(
        &mut self,
        space: &Workspace,
        id: u32,
        pixel: [u32; 2],
        within: Option<&str>,
        (meaning, combine): (Option<Asked>, Combine),
    ) -> Result<Selected, ClickError> {
        let view = self.view.clone().ok_or_else(|| RunError::input("nothing is shown yet"))?;
        let started = Instant::now();
        let clicking = Clicks::get(&mut self.clicks, space, view.time)?;
        let hit = clicking.hit(&Self::camera(&view, 1.0), pixel, within)?;
        let before = self.clicked.take().map(|c| c.picked.members).unwrap_or_default();
        self.select(id, hit, view.time, (before, combine), meaning, started)
    }

    /// Where that is, in world units, which a pixel shows of the view that was asked for last.
    ///
    /// # Errors
    /// If nothing is there.
    pub fn point(&self, space: &Workspace, pixel: [u32; 2]) -> Result<[f64; 3], ClickError> {
        let view = self.view.as_ref().ok_or_else(|| RunError::input("nothing is shown yet"))?;
        let at = shown(space, view)?.at(&space.run.scene, view.time as f32)?;
        place(&at, &Self::camera(view, 1.0), pixel, view.time, &space.device)
    }

    /// The last click once more, with another meaning.
    ///
    /// # Errors
    /// If there was none.
    pub fn adjust(&mut self, id: u32, meaning: Option<Asked>) -> Result<Selected, ClickError> {
        let Some(Clicked { hit, time, before, .. }) = &self.clicked else {
            return Err(RunError::input("click on something first").into());
        };
        let (hit, time, before) = (hit.clone(), *time, before.clone());
        self.select(id, hit, time, before, meaning, Instant::now())
    }

    fn select(
        &mut self,
        id: u32,
        hit: Hit,
        time: f64,
        before: (Vec<u32>, Combine),
        meaning: Option<Asked>,
        started: Instant,
    ) -> Result<Selected, ClickError> {
        let Some(clicking) = self.clicks.as_ref().and_then(Clicks::last) else { return Err(ClickError::NoField) };
        // a slider asks again and again: the levels at the click stay what they are
        let known =
            self.clicked.as_ref().map(|c| &c.picked.levels).filter(|_| matches!(meaning, Some(Asked::By { .. })));
        let list = known.is_none();
        let options = PickOptions { meaning: meaning.map_or(Meaning::Likeliest, of), keep_strays: false, list };
        let mut picked = clicking.select(&hit, &options)?;
        if let Some(levels) = known {
            picked.levels.clone_from(levels);
        }
        picked.members = combine(&before, std::mem::take(&mut picked.members));
        let told = Selected {
            id,
            mean: hit.mean,
            segments: hit.segments.iter().map(ToString::to_string).collect(),
            gaussians: picked.members.len(),
            scale: picked.scale,
            threshold: picked.threshold,
            levels: picked.levels.iter().map(|l| l.share).collect(),
            level: picked.level.map(|n| n + 1),
            ms: 1e3 * started.elapsed().as_secs_f64(),
        };
        self.clicked = Some(Clicked { hit, picked, time, before });
        self.changed();
        Ok(told)
    }
}

/// What of the scene a view shows, whatever is clicked.
fn shown(space: &Workspace, view: &View) -> Result<Selection, RunError> {
    let all = space.segments().now();
    let mut away = Vec::new();
    for name in &view.hidden {
        // one that is gone hides nothing
        away.extend(all.get(name).map(|s| s.members.clone()).unwrap_or_default());
    }
    // while the segments on the disk cannot be used, edits of them cannot either
    let edits = view.edits && space.fault().is_none();
    Ok(Selection::open(&space.run, &view.alone, edits)?.hiding(away))
}

fn of(asked: Asked) -> Meaning {
    match asked {
        Asked::Level(n) => Meaning::Level(n.saturating_sub(1)),
        Asked::By { scale, threshold } => Meaning::By { scale, threshold },
    }
}

/// Ascending lists: what was there, with or without what is new.
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

/// What the colours stand for, by its name in the protocol.
fn show(name: &str) -> Result<Show, RunError> {
    Ok(match name {
        "colour" => Show::Colour,
        "depth" => Show::Depth,
        "segments" => Show::Segments,
        "velocity x" => Show::Velocity(Component::X),
        "velocity y" => Show::Velocity(Component::Y),
        "velocity z" => Show::Velocity(Component::Z),
        "velocity speed" => Show::Velocity(Component::Speed),
        _ => {
            return Err(RunError::input(
                "look: colour, depth, segments, velocity x, velocity y, velocity z or velocity speed",
            ));
        }
    })
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
