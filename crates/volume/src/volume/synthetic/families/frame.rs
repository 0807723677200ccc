//! A scene at one time, and its field: what depends on time alone is computed once, what depends on height once per
//! slice.

use super::motion::{M3, Pose, scaled, turned_back};
use super::scene::{Body, BodyScene};
use super::shape::{Noise, Shape, Sheet};
use crate::volume::synthetic::LABEL_FLOOR;
use crate::volume::synthetic::field::{P3, dot, ellipsoid, norm, smooth_max, smooth_min, step, sub};
use crate::volume::synthetic::strand::{Chunk, chunks};

/// Number of pieces of a tube under one bound.
const CHUNK: usize = 6;

/// Below this size a body has vanished.
const VANISHED: f64 = 0.05;

/// A shape in its place.
enum Form {
    Ball(P3),
    Tube(Vec<Chunk>),
    Sheet(Sheet),
}

/// A body in its place.
struct PlacedBody {
    form: Form,
    centre: P3,
    turn: M3,
    size: f64,
    t: f64,
    /// Beyond this distance from the centre it has no effect.
    reach: f64,
    wall: Option<f64>,
    /// How far beyond its surface it has an effect, without noise.
    edge: f64,
    rough: f64,
    noise: Noise,
    label: u16,
}

/// Bodies that flow together, or one alone.
struct Group {
    members: Vec<PlacedBody>,
    neck: f64,
    flank: f64,
    depth: f64,
    grain: f64,
    band: [f64; 2],
    side: f64,
    strength: f64,
}

/// The scene at one time.
pub(in crate::volume::synthetic) struct FamilyFrame {
    groups: Vec<Group>,
    two_sided: bool,
}

/// The scene at one time and height: the bodies that reach it.
pub(in crate::volume::synthetic) struct Slice<'a> {
    z: f64,
    groups: Vec<(&'a Group, Vec<&'a PlacedBody>)>,
    two_sided: bool,
}

impl PlacedBody {
    fn new(body: &Body, label: u16, t: f64) -> Self {
        let Pose { centre, turn, size } = body.path.at(t);
        let edge = 0.5 * body.flank + body.neck;
        let far = edge + body.rough;
        let (form, reach) = match &body.shape {
            Shape::Ball(axes) => {
                let axes = axes.map(|a| a * size);
                (Form::Ball(axes), axes.into_iter().fold(0.0, f64::max) + far)
            }
            Shape::Tube(tube) => {
                let beads = tube.beads(&body.path.at(t), t);
                let reach = beads.iter().map(|(p, radius)| norm(sub(*p, centre)) + radius).fold(0.0, f64::max);
                (Form::Tube(chunks(0, &beads, CHUNK, far).collect()), reach + far)
            }
            Shape::Sheet(sheet) => (Form::Sheet(sheet.clone()), sheet.reach() * size + far),
        };
        let (wall, rough, noise) = (body.wall, body.rough, body.noise.clone());
        Self { form, centre, turn, size, t, reach, wall, edge, rough, noise, label }
    }

    /// Whether it can affect the field at the height `z`.
    fn reaches(&self, z: f64) -> bool {
        (self.centre[2] - z).abs() < self.reach
    }

    /// Signed distance, negative inside, and the point in the body's coordinates; `None` where it has no effect.
    fn outside(&self, p: P3) -> Option<(f64, P3)> {
        let from = sub(p, self.centre);
        if dot(from, from) >= self.reach * self.reach {
            return None;
        }
        let local = turned_back(&self.turn, from);
        let mut outside = match &self.form {
            Form::Ball(axes) => ellipsoid(local, *axes),
            Form::Tube(chunks) => {
                let nearest = chunks.iter().filter_map(|chunk| chunk.outside(p)).fold(f64::INFINITY, f64::min);
                if nearest.is_infinite() {
                    return None;
                }
                nearest
            }
            Form::Sheet(sheet) => sheet.outside(scaled(local, 1.0 / self.size), self.t) * self.size,
        };
        // farther out noise makes no difference
        if self.rough > 0.0 && outside < self.rough + self.edge {
            outside += self.rough * self.noise.at(local, self.t);
        }
        if let Some(wall) = self.wall {
            outside = (outside + 0.5 * wall).abs() - 0.5 * wall;
        }
        Some((outside, local))
    }
}

impl Group {
    /// Value in [0, 1] and label of the group at a point.
    fn at(&self, members: &[&PlacedBody], p: P3) -> (f64, u16) {
        let mut outside = f64::INFINITY;
        let mut nearest: Option<(f64, P3, &PlacedBody)> = None;
        for placed in members {
            let Some((own, local)) = placed.outside(p) else { continue };
            outside = if outside.is_finite() { smooth_min(outside, own, self.neck) } else { own };
            if nearest.as_ref().is_none_or(|(least, ..)| own < *least) {
                nearest = Some((own, local, placed));
            }
        }
        let Some((_, local, placed)) = nearest else { return (0.0, 0) };
        let shell = step(0.5 - outside / self.flank);
        if shell <= 0.0 {
            return (0.0, 0);
        }
        let mut inner = step(-outside / self.depth);
        if self.grain > 0.0 {
            inner = (inner * (1.0 - self.grain) + self.grain * (0.5 + 1.3 * placed.noise.at(local, placed.t)))
                .clamp(0.0, 1.0);
        }
        let [low, high] = self.band;
        (self.strength * shell * (low + (high - low) * inner), placed.label)
    }
}

impl FamilyFrame {
    /// The scene at the time `t` in [0, 1].
    pub(super) fn new(scene: &BodyScene, t: f64) -> Self {
        let mut groups: Vec<(Option<usize>, Group)> = Vec::new();
        for (k, body) in scene.bodies.iter().enumerate() {
            let placed = PlacedBody::new(body, scene.label(k, t), t);
            let strength = body.there.at(t);
            if strength <= 0.0 || placed.size < VANISHED {
                continue;
            }
            let known = groups.iter_mut().find(|(number, _)| body.flows_with.is_some() && *number == body.flows_with);
            if let Some((_, group)) = known {
                group.members.push(placed);
                continue;
            }
            let material = &scene.materials[body.material];
            let group = Group {
                members: vec![placed],
                neck: body.neck,
                flank: body.flank,
                depth: body.depth,
                grain: body.grain,
                band: [material.low, material.high],
                side: material.side,
                strength,
            };
            groups.push((body.flows_with, group));
        }
        Self { groups: groups.into_iter().map(|(_, group)| group).collect(), two_sided: scene.two_sided }
    }

    /// The value where there is nothing.
    pub fn empty(&self) -> f64 {
        if self.two_sided { 0.5 } else { 0.0 }
    }

    /// The part of the scene that reaches the height `z`.
    pub fn slice(&self, z: f64) -> Slice<'_> {
        let groups = self.groups.iter().map(|group| {
            let members: Vec<&PlacedBody> = group.members.iter().filter(|placed| placed.reaches(z)).collect();
            (group, members)
        });
        let groups = groups.filter(|(_, members)| !members.is_empty());
        Slice { z, groups: groups.collect(), two_sided: self.two_sided }
    }
}

impl Slice<'_> {
    /// Value in [0, 1] and label at one point of the slice; `edge` is the window of the box there, from 0 to 1.
    pub fn at(&self, x: f64, y: f64, edge: f64) -> (f64, u16) {
        let p = [x, y, self.z];
        let (mut above, mut below) = (0.0, 0.0);
        let (mut highest, mut label) = (0.0, 0);
        for (group, members) in &self.groups {
            let (own, of) = group.at(members, p);
            if own <= 0.0 {
                continue;
            }
            let sum = if group.side > 0.0 { &mut above } else { &mut below };
            *sum = smooth_max(*sum, own, own.min(0.02));
            if own > highest {
                (highest, label) = (own, of);
            }
        }
        let value = ((above - below) * edge).clamp(-1.0, 1.0);
        let label = if value.abs() >= LABEL_FLOOR { label } else { 0 };
        (if self.two_sided { 0.5 + 0.5 * value } else { value.max(0.0) }, label)
    }
}
