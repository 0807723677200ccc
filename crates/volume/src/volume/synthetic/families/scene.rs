//! The description of a scene: bodies, each a cell with a shape, a path and a material. Families write it, `frame` draws
//! it, `look` shows it.

use super::draw::Draw;
use super::look::BodyMaterial;
use super::motion::{Path, Pulse, scaled, sum, turned};
use super::shape::{Noise, Shape};
use crate::data::lineage::LineageChange;
use crate::volume::synthetic::field::{P3, norm, sub};
use crate::volume::transfer::Shading;

/// A body, which is a cell of the ground truth: label `k + 1` is body `k` of its scene.
#[derive(Clone)]
pub(super) struct Body {
    /// What kind of thing it is: a number is added to make the segment's name.
    pub role: &'static str,
    /// Its form.
    pub shape: Shape,
    /// Thickness of the wall of a hollow body; `None` for a solid one.
    pub wall: Option<f64>,
    /// Where it is.
    pub path: Path,
    /// Index of its material.
    pub material: usize,
    /// When it is there; a fading body fades through the opacities of its material.
    pub there: Pulse,
    /// Width of the soft edge, a length of the box.
    pub flank: f64,
    /// Depth over which its value rises slowly within the band of its material.
    pub depth: f64,
    /// How far noise moves its surface.
    pub rough: f64,
    /// How much of its band of values noise takes up, from 0 to 1.
    pub grain: f64,
    /// The noise of both.
    pub noise: Noise,
    /// Bodies with the same number flow together where they touch.
    pub flows_with: Option<usize>,
    /// Distance at which a neck to such bodies begins to form.
    pub neck: f64,
    /// When it is no cell of its own, but a part of another.
    pub joined: Option<Joined>,
}

/// The merge or the split by which a body ends or begins being a cell of its own.
#[derive(Clone, Copy)]
pub(super) struct Joined {
    /// Index of the body whose cell it is part of, before a split or after a merge.
    pub with: usize,
    /// The time in [0, 1].
    pub at: f64,
    /// [`LineageChange::Began`] for a split, [`LineageChange::Ended`] for a merge.
    pub change: LineageChange,
}

impl Joined {
    fn is_part(self, t: f64) -> bool {
        match self.change {
            LineageChange::Began => t < self.at,
            LineageChange::Ended => t >= self.at,
        }
    }
}

impl Body {
    /// A smooth solid body without events.
    pub fn new(draw: &mut Draw, role: &'static str, shape: Shape, material: usize, path: Path) -> Self {
        let noise = Noise::new(draw, 12.0, 0.0);
        Self {
            role,
            shape,
            wall: None,
            path,
            material,
            there: Pulse::default(),
            flank: 0.05,
            depth: 0.12,
            rough: 0.0,
            grain: 0.0,
            noise,
            flows_with: None,
            neck: 0.0,
            joined: None,
        }
    }

    /// Balls that cover the body at `t`, soft edge included, coarsely.
    fn outline(&self, t: f64) -> Vec<(P3, f64)> {
        let pose = self.path.at(t);
        let edge = 0.5 * self.flank + self.rough;
        match &self.shape {
            Shape::Ball(axes) => {
                vec![(pose.centre, axes.iter().copied().fold(0.0, f64::max) * pose.size + edge)]
            }
            Shape::Tube(tube) => {
                tube.beads(&pose, t).into_iter().step_by(3).map(|(p, radius)| (p, radius + edge)).collect()
            }
            Shape::Sheet(sheet) => {
                let spot = |x: f64, y: f64| {
                    let local = [x * 0.9 * sheet.half[0], y * 0.9 * sheet.half[1], 0.0];
                    (sum(pose.centre, turned(&pose.turn, scaled(local, pose.size))), sheet.thickness + edge)
                };
                [-1.0, 0.0, 1.0].into_iter().flat_map(|x| [-1.0, 0.0, 1.0].map(|y| spot(x, y))).collect()
            }
        }
    }
}

/// A scene of known cells.
pub(super) struct BodyScene {
    /// The bodies, in order of their labels.
    pub bodies: Vec<Body>,
    /// What they are made of.
    pub materials: Vec<BodyMaterial>,
    /// Whether values lie on both sides of an empty middle, as in a field of anomalies; else they rise from 0.
    pub two_sided: bool,
    /// The light.
    pub shading: Shading,
}

/// No body comes closer than this to a face of the box.
const INSIDE: f64 = 0.93;
/// Number of placements that are tried.
const TRIES: usize = 300;
/// Number of times at which bodies are kept apart: enough for those that cross the box in a twentieth of the series.
const TIMES: u32 = 84;

impl BodyScene {
    /// A scene without bodies.
    pub fn new(materials: Vec<BodyMaterial>, two_sided: bool, shading: Shading) -> Self {
        Self { bodies: Vec::new(), materials, two_sided, shading }
    }

    /// Adds the bodies that `make` draws, placed anew until they are inside the box and `gap` away from the bodies that
    /// are there, at all times; adds none if that does not happen. Their indices in `joined` count from the first of them.
    pub fn place(&mut self, draw: &mut Draw, gap: f64, mut make: impl FnMut(&mut Draw) -> Vec<Body>) -> bool {
        let times: Vec<f64> = (0..=TIMES).map(|k| f64::from(k) / f64::from(TIMES)).collect();
        let outlines =
            |bodies: &[Body], t: f64| bodies.iter().flat_map(|body| body.outline(t)).collect::<Vec<(P3, f64)>>();
        let there: Vec<Vec<(P3, f64)>> = times.iter().map(|&t| outlines(&self.bodies, t)).collect();
        for _ in 0..TRIES {
            let new = make(draw);
            let fits = times.iter().zip(&there).all(|(&t, there)| {
                outlines(&new, t).iter().all(|&(p, radius)| {
                    p.iter().all(|c| c.abs() + radius < INSIDE)
                        && there.iter().all(|&(q, other)| norm(sub(p, q)) > radius + other + gap)
                })
            });
            if fits {
                self.add(new);
                return true;
            }
        }
        false
    }

    /// Adds bodies where they are; see [`Self::place`].
    pub fn add(&mut self, new: Vec<Body>) {
        let first = self.bodies.len();
        self.bodies.extend(new.into_iter().map(|mut body| {
            if let Some(joined) = &mut body.joined {
                joined.with += first;
            }
            body
        }));
    }

    /// Names of the cells: the role and, counted among its like, the number of each.
    pub fn names(&self) -> Vec<String> {
        let number = |k: usize| self.bodies[..=k].iter().filter(|body| body.role == self.bodies[k].role).count();
        (0..self.bodies.len()).map(|k| format!("{}-{}", self.bodies[k].role, number(k))).collect()
    }

    /// The label of a body's cell at `t`.
    pub fn label(&self, body: usize, t: f64) -> u16 {
        let mut at = body;
        // no chain of events is longer than the list of bodies
        for _ in 0..self.bodies.len() {
            match self.bodies[at].joined.filter(|joined| joined.is_part(t)) {
                Some(joined) => at = joined.with,
                None => break,
            }
        }
        at as u16 + 1
    }

    /// The ends and beginnings of cells, by time: the label, the event, the label of the cell that goes on.
    pub fn events(&self) -> Vec<(u16, Joined)> {
        let event = |(k, body): (usize, &Body)| body.joined.map(|joined| (k as u16 + 1, joined));
        let mut events: Vec<(u16, Joined)> = self.bodies.iter().enumerate().filter_map(event).collect();
        events.sort_by(|a, b| a.1.at.total_cmp(&b.1.at));
        events
    }
}
