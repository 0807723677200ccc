//! Families of bodies inside others: nested layers, thin concentric shells, bodies in a noisy plume.

use super::draw::Draw;
use super::look::{light, over, rising};
use super::motion::{Motion, Path, Pulse, scaled};
use super::scattered::{ball, surface, wander};
use super::scene::{Body, BodyScene};
use super::shape::{Noise, Shape, Tube, Wave};
use crate::volume::synthetic::field::P3;

/// No layer is smaller.
const SMALLEST: f64 = 0.08;

/// Opacity of the innermost body: mostly opaque.
fn core_opacity(draw: &mut Draw) -> f64 {
    if draw.chance(0.75) { draw.range(0.3, 0.8) } else { draw.range(0.06, 0.15) }
}

/// A place for object `k` of this many, up to three, of this size: far from those of the others.
fn place(draw: &mut Draw, k: usize, objects: usize, size: f64) -> P3 {
    const OPPOSITE: [P3; 2] = [[1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]];
    // corners of a tetrahedron
    const APART: [P3; 3] = [[1.0, 1.0, 1.0], [-1.0, -1.0, 1.0], [-1.0, 1.0, -1.0]];
    let far = (0.88 - size).max(0.0);
    match objects {
        1 => draw.point(0.5 * far),
        2 => OPPOSITE[k].map(|side| side * far * draw.range(0.8, 1.0)),
        _ => APART[k].map(|side| side * far * draw.range(0.75, 1.0)),
    }
}

/// One to three objects, each a core in a body in a shell or some of these, of a material per layer; shells are hollow,
/// thick or thin, and what is inside moves in what is outside.
pub(super) fn nested(draw: &mut Draw, family: u64, seed: u64) -> BodyScene {
    let shading = light(draw, family, seed);
    let objects = draw.whole(1, 3);
    let most = draw.whole(if objects == 1 { 3 } else { 2 }, if objects == 1 { 4 } else { 3 });
    let size = [0.75, 0.46, 0.40][objects - 1];
    let walls: Vec<bool> = (0..most).map(|k| k + 1 < most && draw.chance(if k == 0 { 0.6 } else { 0.3 })).collect();
    let opacity = |(k, wall): (usize, &bool)| match (k + 1 == most, *wall) {
        (true, _) => core_opacity(draw),
        // the part of a wall between its soft edges
        (false, true) => over(0.06, draw.range(0.08, 0.22)),
        (false, false) => over(1.5 * size, draw.range(0.25, 0.5)),
    };
    let opacities: Vec<f64> = walls.iter().enumerate().map(opacity).collect();
    let materials = rising(draw, &opacities);
    let mut scene = BodyScene::new(materials, false, shading);
    for object in 0..objects {
        // an object may lack its outermost layer
        let first = usize::from(most > 2 && objects > 1 && draw.chance(0.4));
        scene.place(draw, 0.05, |draw| {
            let size = size * draw.range(0.9, 1.05);
            let start = Path::at_rest(place(draw, object, objects, size));
            let length = draw.range(0.05, 0.2) * (1.0 - size);
            let path = wander(draw, start, length);
            layers(draw, &walls, first, size, &path)
        });
    }
    scene
}

/// The layers of one object from the outside in, from the layer `first` on.
fn layers(draw: &mut Draw, walls: &[bool], first: usize, size: f64, path: &Path) -> Vec<Body> {
    let mut bodies: Vec<Body> = Vec::new();
    let (mut radius, mut room, mut path) = (size, size, path.clone());
    for (k, wall) in walls.iter().enumerate().skip(first) {
        if radius < SMALLEST {
            break;
        }
        let axes = [0; 3].map(|_| radius * draw.range(0.8, 1.0));
        let mut own = path.clone().tumbling(draw, 1.5);
        if k > first {
            // as far as there is room in what surrounds it
            let by = scaled(draw.direction(), draw.range(0.5, 0.95) * (room - radius));
            let motion = Motion::Sway { by, rate: draw.range(2.0, 6.0), phase: draw.angle() };
            own = own.with(motion.clone());
            path = path.with(motion);
        }
        let innermost = k + 1 == walls.len();
        let role = match (*wall, innermost) {
            (true, _) => "shell",
            (false, true) => "core",
            (false, false) => "body",
        };
        let rod = innermost && k > first && radius > 0.15 && draw.chance(0.4);
        let shape = if rod {
            Shape::Tube(Tube { half: 0.62 * radius, waves: Vec::new(), radius: 0.36 * radius, taper: 0.2 })
        } else {
            Shape::Ball(axes)
        };
        let mut body = Body::new(draw, role, shape, k, own);
        body.depth = 0.6 * radius;
        body.flank = 0.05_f64.min(0.5 * radius);
        if *wall {
            let thickness = draw.range(0.06, 0.13_f64.min(0.3 * radius).max(0.065));
            (body.flank, body.wall, body.depth) = (0.04, Some(thickness), 0.5 * thickness);
        } else if draw.chance(0.4) {
            body.rough = draw.range(0.02, 0.06) * radius;
        }
        room = axes.into_iter().fold(1.0, f64::min) - body.wall.unwrap_or(0.0) - body.rough - 0.03;
        radius = room * draw.range(0.7, 0.9);
        bodies.push(body);
    }
    bodies
}

/// One or two objects of thin, lobed, nearly concentric shells around a core, each of a colour of its own.
pub(super) fn onions(draw: &mut Draw, family: u64, seed: u64) -> BodyScene {
    let shading = light(draw, family, seed);
    let objects = draw.whole(1, 2);
    let shells = draw.whole(2, if objects == 1 { 4 } else { 2 });
    let mut opacities: Vec<f64> = (0..shells).map(|_| over(0.035, draw.range(0.08, 0.2))).collect();
    opacities.push(core_opacity(draw));
    let materials = rising(draw, &opacities);
    let mut scene = BodyScene::new(materials, false, shading);
    for object in 0..objects {
        scene.place(draw, 0.05, |draw| {
            let size = if objects == 1 { draw.range(0.72, 0.8) } else { draw.range(0.42, 0.47) };
            let start = Path::at_rest(place(draw, object, objects, size));
            let length = draw.range(0.05, 0.2) * (1.0 - size);
            let path = wander(draw, start, length);
            let shape = [0; 3].map(|_| draw.range(0.78, 1.0));
            let layer = |k: usize| {
                let core = k == shells;
                let radius = size * (1.0 - 0.7 * k as f64 / shells as f64);
                // shells lie apart by this or more, roughness and shift included
                let apart = 0.78 * 0.7 * size / shells as f64;
                let by = scaled(draw.direction(), if k > 0 { draw.range(0.0, 0.18) * apart } else { 0.0 });
                let mut own = path.clone().with(Motion::Sway { by, rate: draw.range(2.0, 6.0), phase: draw.angle() });
                own.spin = (draw.direction(), draw.signed(0.3, 0.8));
                let axes = shape.map(|a| a * radius);
                let mut body = Body::new(draw, if core { "core" } else { "shell" }, Shape::Ball(axes), k, own);
                body.noise = Noise::new(draw, 2.4 / radius, 2.0);
                body.rough = draw.range(0.12, 0.3) * apart;
                let thickness = draw.range(0.05, 0.065);
                if core {
                    (body.flank, body.depth) = (0.04, radius);
                } else {
                    (body.flank, body.depth, body.wall) = (0.04, 0.5 * thickness, Some(thickness));
                }
                body
            };
            (0..=shells).map(layer).collect()
        });
    }
    scene
}

/// One or two translucent plumes with noise in density and hue, and bodies that rise in them; some come late.
pub(super) fn noisy(draw: &mut Draw, family: u64, seed: u64) -> BodyScene {
    let shading = light(draw, family, seed);
    let opacities = [draw.range(0.025, 0.06), draw.range(0.35, 0.8)];
    let mut materials = rising(draw, &opacities);
    let tint = rising(draw, &[1.0])[0].colours[0];
    let plume = &mut materials[0];
    // a wide band, so that noise shows: from almost nothing to the full opacity, and from one hue to another
    (plume.low, plume.high) = (0.2, 0.6);
    plume.opacities[0] *= 0.05;
    let mix = draw.range(0.5, 0.9) as f32;
    plume.colours[1] = std::array::from_fn(|c| plume.colours[0][c] + mix * (tint[c] - plume.colours[0][c]));
    let mut scene = BodyScene::new(materials, false, shading);
    let plumes = draw.whole(1, 2);
    for number in 0..plumes {
        let inside = if plumes == 1 { draw.whole(2, 3) } else { draw.whole(1, 3) };
        let rise = draw.range(0.15, 0.25);
        let radius = if plumes == 1 { draw.range(0.3, 0.38) } else { draw.range(0.22, 0.27) };
        let side = if plumes == 1 { 0.0 } else { 0.42 * (2.0 * number as f64 - 1.0) };
        let angle = draw.angle();
        let sway = draw.range(0.04, 0.12);
        let lean = Wave {
            by: [sway * angle.cos(), sway * angle.sin(), 0.0],
            number: draw.range(1.5, 3.0),
            phase: draw.angle(),
            rate: draw.signed(1.0, 3.0),
        };
        let half = 0.5;
        let tube = Tube { half, waves: vec![lean.clone()], radius, taper: 0.3 };
        let path = Path::at_rest([side, draw.range(-0.1, 0.1), 0.0]);
        let mut body = Body::new(draw, "plume", Shape::Tube(tube), 0, path.clone());
        body.noise = Noise::new(draw, 11.0, 5.0);
        (body.flank, body.depth, body.grain) = (0.07, 0.9 * radius, draw.range(0.75, 0.95));
        body.rough = draw.range(0.05, 0.10);
        scene.add(vec![body]);
        for k in 0..inside {
            let size = draw.range(0.07, 0.12_f64.min(0.4 * radius));
            // one above the other, in the middle of the plume as it sways
            let level = -0.6 + 0.95 * (k as f64 + draw.range(0.3, 0.7)) / inside as f64;
            let follow = Motion::Sway { by: lean.by, rate: lean.rate, phase: lean.phase + lean.number * level / half };
            let aside = scaled(draw.direction(), 0.25 * (radius - size));
            let mut own = path.clone().with(Motion::Drift([0.0, 0.0, rise])).with(follow).tumbling(draw, 3.0);
            own.start = std::array::from_fn(|a| own.start[a] + if a == 2 { level + 0.1 } else { aside[a] });
            let shape = ball(draw, size);
            let mut body = Body::new(draw, "body", shape, 1, own);
            surface(draw, &mut body, size);
            if k > 0 && draw.chance(0.3) {
                // it grows out of nothing
                body.path.size.pulse = Pulse { up: Some((draw.range(0.3, 0.5), 0.3)), down: None };
                body.path.size.before = 0.0;
            }
            scene.add(vec![body]);
        }
    }
    scene
}
