//! Families of bodies that stay apart: well separated ones, ones that fade, ones that are faster than their size.

use super::draw::Draw;
use super::look::{alike, light};
use super::motion::{Motion, Path, Pulse, Ramp, across, scaled};
use super::scene::{Body, BodyScene};
use super::shape::{Shape, Tube, Wave};

/// Number of intervals between the times of training for which speeds are meant: those of fifteen times.
pub(super) const INTERVALS: f64 = 14.0;

/// Soft edge, roughness and grain of bodies of about this radius.
pub(super) fn surface(draw: &mut Draw, body: &mut Body, radius: f64) {
    body.flank = draw.range(0.035, 0.065).min(radius);
    body.depth = radius;
    if draw.chance(0.4) {
        body.rough = draw.range(0.04, 0.14) * radius;
    }
    if draw.chance(0.3) {
        body.grain = draw.range(0.2, 0.6);
    }
}

/// An ellipsoid of about this radius.
pub(super) fn ball(draw: &mut Draw, radius: f64) -> Shape {
    Shape::Ball([0; 3].map(|_| radius * draw.range(0.78, 1.2)))
}

/// A short bent tube.
fn bean(draw: &mut Draw, radius: f64) -> Shape {
    let by = [draw.range(0.4, 1.0) * radius, 0.0, 0.0];
    let wave = Wave { by, number: draw.range(1.2, 2.2), phase: 1.57, rate: draw.range(-1.5, 1.5) };
    Shape::Tube(Tube { half: radius * draw.range(1.6, 2.4), waves: vec![wave], radius: 0.7 * radius, taper: 0.0 })
}

/// A way of about this length over the series: straight, to and fro, or on an arc.
pub(super) fn wander(draw: &mut Draw, path: Path, length: f64) -> Path {
    let way = draw.direction();
    match draw.whole(0, 2) {
        0 => path.with(Motion::Drift(scaled(way, length))),
        1 => {
            // to and fro once is four times the greatest displacement
            let by = scaled(way, 0.25 * length);
            path.with(Motion::Sway { by, rate: draw.range(5.0, 7.0), phase: draw.angle() })
        }
        _ => {
            let (radius, sign) = (draw.range(0.1, 0.3), draw.signed(1.0, 1.0));
            let by = scaled(across(way), radius);
            path.with(Motion::Arm { by, axis: way, rate: sign * length / radius, length: Ramp::NONE })
        }
    }
}

/// Well separated bodies of two or three colours, several of each.
pub(super) fn blobs(draw: &mut Draw, family: u64, seed: u64) -> BodyScene {
    let shading = light(draw, family, seed);
    let colours = draw.whole(2, 3);
    let (materials, two_sided) = alike(draw, colours, [0.12, 0.7]);
    let mut scene = BodyScene::new(materials, two_sided, shading);
    let speed = if draw.chance(0.35) { draw.range(0.6, 1.0) } else { draw.range(0.05, 0.4) };
    let count = draw.whole(5, 8);
    // in some scenes one of them grows out of nothing
    let late = draw.whole(1, 3 * count);
    for k in 0..count {
        scene.place(draw, 0.10, |draw| {
            let radius = draw.range(0.15, 0.27);
            let shape = if draw.chance(0.25) { bean(draw, radius) } else { ball(draw, radius) };
            let path = Path::at_rest(draw.point(0.7)).tumbling(draw, 2.5);
            let path = wander(draw, path, (speed * 2.0 * radius * INTERVALS).min(1.2));
            let mut body = Body::new(draw, "blob", shape, k % colours, path);
            surface(draw, &mut body, radius);
            if k == late {
                body.path.size = Ramp::once(0.0, 1.0, draw.range(0.3, 0.6), 0.3);
            }
            vec![body]
        });
    }
    scene
}

/// Bodies that fade in and out while they move; every third stays.
pub(super) fn fading(draw: &mut Draw, family: u64, seed: u64) -> BodyScene {
    let shading = light(draw, family, seed);
    let colours = draw.whole(1, 2);
    let (materials, two_sided) = if colours == 1 {
        alike(draw, 1, [0.15, 0.6])
    } else {
        let opacities = [0; 2].map(|_| draw.range(0.15, 0.6));
        (super::look::two_sided(draw, opacities), true)
    };
    let mut scene = BodyScene::new(materials, two_sided, shading);
    let count = draw.whole(5, 7);
    for k in 0..count {
        let duration = |draw: &mut Draw| draw.range(0.2, 0.45);
        let there = match (k % 3, draw.whole(0, 2)) {
            (0, _) => Pulse::default(),
            (_, 0) => Pulse { up: Some((draw.range(0.2, 0.6), duration(draw))), down: None },
            (_, 1) => Pulse { up: None, down: Some((draw.range(0.4, 0.8), duration(draw))) },
            _ => Pulse {
                up: Some((draw.range(0.15, 0.3), duration(draw))),
                down: Some((draw.range(0.7, 0.85), duration(draw))),
            },
        };
        scene.place(draw, 0.07, |draw| {
            let radius = draw.range(0.13, 0.24);
            let shape = if draw.chance(0.35) { bean(draw, radius) } else { ball(draw, radius) };
            let path = Path::at_rest(draw.point(0.7)).tumbling(draw, 2.5);
            let length = draw.range(0.3, 0.9);
            let path = wander(draw, path, length);
            let mut body = Body::new(draw, "cloud", shape, k % colours, path);
            surface(draw, &mut body, radius);
            body.there = there;
            vec![body]
        });
    }
    scene
}

/// Small bodies that move once to three times their diameter between trained times, around a large slow one.
pub(super) fn fast(draw: &mut Draw, family: u64, seed: u64) -> BodyScene {
    let shading = light(draw, family, seed);
    let colours = draw.whole(1, 2);
    let (materials, two_sided) = alike(draw, colours, [0.35, 0.8]);
    let mut scene = BodyScene::new(materials, two_sided, shading);
    scene.place(draw, 0.0, |draw| {
        let radius = draw.range(0.2, 0.28);
        let shape = ball(draw, radius);
        let path = Path::at_rest(draw.point(0.15)).tumbling(draw, 2.0);
        let path = wander(draw, path, 0.2);
        let mut body = Body::new(draw, "slow", shape, 0, path);
        surface(draw, &mut body, radius);
        vec![body]
    });
    let count = draw.whole(3, 5);
    for k in 0..count {
        scene.place(draw, 0.05, |draw| {
            let radius = draw.range(0.08, 0.115);
            let axis = draw.direction();
            let orbit = draw.range(0.45, 0.75);
            let way = draw.range(1.0, 3.0) * 2.0 * radius * INTERVALS;
            let turn = super::motion::turned(&super::motion::rotation(axis, draw.angle()), across(axis));
            let rate = draw.signed(1.0, 1.0) * way / orbit;
            let arm = Motion::Arm { by: scaled(turn, orbit), axis, rate, length: Ramp::NONE };
            let path = Path::at_rest(draw.point(0.15)).tumbling(draw, 3.0).with(arm);
            let shape = ball(draw, radius);
            let mut body = Body::new(draw, "quick", shape, (k + 1) % colours, path);
            surface(draw, &mut body, radius);
            vec![body]
        });
    }
    scene
}
