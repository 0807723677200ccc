//! Families of thin bodies: tubes, braids of tubes, sheets.

use super::draw::Draw;
use super::look::{alike, light};
use super::motion::{Motion, Path, Ramp, rotation, scaled, turned};
use super::scene::{Body, BodyScene};
use super::shape::{Ripple, Shape, Sheet, Tube, Wave};
use crate::volume::synthetic::field::P3;
use std::f64::consts::{FRAC_PI_2, TAU};

/// A path that turns as a whole about the middle of the box.
fn carried(start: P3, tilt: super::motion::M3, (axis, rate): (P3, f64)) -> Path {
    let mut path = Path::at_rest([0.0; 3]).with(Motion::Arm { by: start, axis, rate, length: Ramp::NONE });
    (path.tilt, path.spin) = (tilt, (axis, rate));
    path
}

/// A wave that bends a tube sideways.
fn bend(draw: &mut Draw, size: f64) -> Wave {
    let angle = draw.angle();
    let by = [size * angle.cos(), size * angle.sin(), 0.0];
    Wave { by, number: draw.range(1.5, 4.0), phase: draw.angle(), rate: draw.signed(0.5, 3.0) }
}

/// Curved tubes of one or two colours that pass near one another, wave, and turn together.
pub(super) fn tubes(draw: &mut Draw, family: u64, seed: u64) -> BodyScene {
    let shading = light(draw, family, seed);
    let colours = draw.whole(1, 2);
    let (materials, two_sided) = alike(draw, colours, [0.25, 0.8]);
    let mut scene = BodyScene::new(materials, two_sided, shading);
    let whole = (draw.direction(), draw.signed(0.4, 2.2));
    let count = draw.whole(3, 6);
    let thick = draw.range(0.035, 0.075);
    for k in 0..count {
        scene.place(draw, 0.03, |draw| {
            let radius = thick * draw.range(0.8, 1.25);
            let waves = [0.22, 0.10].map(|most| {
                let size = draw.range(0.3 * most, most);
                bend(draw, size)
            });
            let half = draw.range(0.5, 0.75);
            let tube = Tube { half, waves: waves.to_vec(), radius, taper: draw.range(-0.25, 0.25) };
            let tilt = rotation(draw.direction(), draw.angle());
            let path = carried(draw.point(0.45), tilt, whole);
            let mut body = Body::new(draw, "tube", Shape::Tube(tube), k % colours, path);
            (body.flank, body.depth) = (0.04, radius);
            vec![body]
        });
    }
    scene
}

/// Two bundles of two or three strands of one colour, twisted around one another in contact, and a strand alone.
pub(super) fn braids(draw: &mut Draw, family: u64, seed: u64) -> BodyScene {
    let shading = light(draw, family, seed);
    let colours = draw.whole(1, 2);
    let (materials, two_sided) = alike(draw, colours, [0.25, 0.8]);
    let mut scene = BodyScene::new(materials, two_sided, shading);
    let whole = (draw.direction(), draw.signed(0.3, 1.5));
    for number in 0..2 {
        let count = draw.whole(2, 3);
        scene.place(draw, 0.06, |draw| {
            let (half, around) = (draw.range(0.5, 0.75), draw.range(0.07, 0.11));
            let (number_of_turns, rate) = (draw.range(2.5, 5.0), draw.signed(0.5, 3.0));
            // strands are in contact where they are at right angles to the line between them
            let steep = half / half.hypot(around * number_of_turns);
            let between = if count == 2 { 1.0 } else { 0.866 };
            let radius = around * between * steep * draw.range(0.88, 1.06);
            let size = draw.range(0.03, 0.15);
            let common = bend(draw, size);
            let tilt = rotation(draw.direction(), draw.angle());
            let path = carried(draw.point(0.45), tilt, whole);
            let strand = |k: usize| {
                let phase = TAU * k as f64 / count as f64;
                let twist = |by, phase| Wave { by, number: number_of_turns, phase, rate };
                let waves = vec![
                    twist([around, 0.0, 0.0], phase),
                    twist([0.0, around, 0.0], phase + FRAC_PI_2),
                    common.clone(),
                ];
                let shape = Shape::Tube(Tube { half, waves, radius, taper: 0.0 });
                let mut body = Body::new(draw, "strand", shape, number % colours, path.clone());
                (body.flank, body.depth) = (0.04, radius);
                (body.flows_with, body.neck) = (Some(number), 0.015);
                body
            };
            (0..count).map(strand).collect()
        });
    }
    if draw.chance(0.6) {
        scene.place(draw, 0.05, |draw| {
            let size = draw.range(0.05, 0.2);
            let waves = vec![bend(draw, size)];
            let tube = Tube { half: draw.range(0.4, 0.7), waves, radius: draw.range(0.05, 0.09), taper: 0.0 };
            let tilt = rotation(draw.direction(), draw.angle());
            let path = carried(draw.point(0.55), tilt, whole);
            let mut body = Body::new(draw, "strand", Shape::Tube(tube), 0, path);
            (body.flank, body.depth) = (0.04, 0.07);
            vec![body]
        });
    }
    scene
}

/// Thin curved sheets that wave, one behind the other, translucent ones among them.
pub(super) fn sheets(draw: &mut Draw, family: u64, seed: u64) -> BodyScene {
    let shading = light(draw, family, seed);
    let colours = draw.whole(1, 3);
    let faint = draw.chance(0.5);
    let opacity = if faint { [0.06, 0.2] } else { [0.15, 0.7] };
    let (materials, two_sided) = alike(draw, colours, opacity);
    let mut scene = BodyScene::new(materials, two_sided, shading);
    let tilt = rotation(draw.direction(), draw.angle());
    let whole = (draw.direction(), draw.signed(0.3, 1.8));
    let count = draw.whole(3, 4);
    let spacing = draw.range(0.28, 0.36);
    let ripple = |draw: &mut Draw, height: f64| {
        let (angle, number) = (draw.angle(), draw.range(2.5, 6.0));
        let numbers = [number * angle.cos(), number * angle.sin()];
        Ripple { height, numbers, phase: draw.angle(), rate: draw.signed(1.5, 5.0) }
    };
    // parallel sheets wave together; the others only nearly so
    let common = [0.09, 0.05].map(|most| {
        let height = draw.range(0.5 * most, most);
        ripple(draw, height)
    });
    let parallel = draw.chance(0.5);
    for k in 0..count {
        let normal = turned(&tilt, [0.0, 0.0, 1.0]);
        let place = scaled(normal, spacing * (k as f64 - 0.5 * (count - 1) as f64));
        let mut ripples = common.to_vec();
        if !parallel {
            ripples.push(ripple(draw, 0.03));
        }
        let thickness = draw.range(0.045, 0.07);
        let half = [0; 2].map(|_| draw.range(0.42, 0.56));
        let shape = Shape::Sheet(Sheet { half, thickness, ripples });
        let mut body = Body::new(draw, "sheet", shape, k % colours, carried(place, tilt, whole));
        (body.flank, body.depth) = (0.04, 0.5 * thickness);
        scene.add(vec![body]);
    }
    scene
}
