//! Families of bodies of one colour in contact: touching, merging, splitting.

use super::draw::Draw;
use super::look::{alike, light};
use super::motion::{Motion, Path, Pulse, Ramp, across, scaled, sum};
use super::scattered::wander;
use super::scene::{Body, BodyScene, Joined};
use super::shape::Shape;
use crate::data::lineage;
use crate::volume::synthetic::field::{P3, norm, sub};

/// A body at the end of an arm from `path`, in the group `number`.
fn member(draw: &mut Draw, role: &'static str, radius: f64, path: Path, of: (usize, usize), neck: f64) -> Body {
    let axes = [0; 3].map(|_| radius * draw.range(0.94, 1.06));
    let mut body = Body::new(draw, role, Shape::Ball(axes), of.1, path);
    body.depth = radius;
    body.flows_with = Some(of.0);
    body.neck = neck;
    body
}

/// Clusters of two to four balls of one colour that touch: from just in contact to overlapping by a quarter.
pub(super) fn touching(draw: &mut Draw, family: u64, seed: u64) -> BodyScene {
    let shading = light(draw, family, seed);
    let colours = draw.whole(1, 2);
    let (materials, two_sided) = alike(draw, colours, [0.12, 0.7]);
    let mut scene = BodyScene::new(materials, two_sided, shading);
    let neck = draw.range(0.01, 0.05);
    let clusters = draw.whole(2, 3);
    for number in 0..clusters {
        let count = draw.whole(2, 4);
        scene.place(draw, 0.08, |draw| {
            let balls = cluster(draw, count);
            let (axis, rate) = (draw.direction(), draw.signed(0.5, 2.5));
            let length = draw.range(0.1, 0.5);
            let path = wander(draw, Path::at_rest([0.0; 3]), length);
            let start = draw.point(0.6);
            // the contact closes and opens again, by a few hundredths
            let pulse = Pulse { up: Some((draw.range(0.2, 0.4), 0.3)), down: Some((draw.range(0.6, 0.8), 0.3)) };
            let squeeze = Ramp { before: 1.0, after: draw.range(0.93, 1.0), pulse };
            let body = |(by, radius): (P3, f64)| {
                let arm = Motion::Arm { by, axis, rate, length: squeeze };
                let mut path = path.clone().with(arm);
                (path.start, path.spin) = (start, (axis, rate));
                member(draw, "ball", radius, path, (number, number % colours), neck)
            };
            balls.into_iter().map(body).collect()
        });
    }
    scene
}

/// Positions around their middle and radii of balls, each in contact with one before it.
fn cluster(draw: &mut Draw, count: usize) -> Vec<(P3, f64)> {
    let mut balls: Vec<(P3, f64)> = vec![([0.0; 3], draw.range(0.14, 0.20))];
    for _ in 1..count {
        let radius = draw.range(0.12, 0.19);
        let overlap = draw.range(-0.02, 0.25);
        for _ in 0..50 {
            let (to, other) = balls[draw.whole(0, balls.len() - 1)];
            let p = sum(to, scaled(draw.direction(), (radius + other) * (1.0 - overlap)));
            let clear = |&(q, r): &(P3, f64)| q == to || norm(sub(p, q)) > 0.97 * (radius + r);
            if balls.iter().all(clear) {
                balls.push((p, radius));
                break;
            }
        }
    }
    let middle = scaled(balls.iter().fold([0.0; 3], |p, (q, _)| sum(p, *q)), 1.0 / balls.len() as f64);
    balls.into_iter().map(|(p, radius)| (sub(p, middle), radius)).collect()
}

/// Pairs of one colour that meet. Most coalesce: the smaller cell ends when its centre has come within a third of the
/// way, and what is left is the larger one's. The others part again, and keep their ids all the time: where they are
/// one body, each point belongs to the one in whose surface it lies deepest.
pub(super) fn merging(draw: &mut Draw, family: u64, seed: u64) -> BodyScene {
    let shading = light(draw, family, seed);
    let colours = draw.whole(1, 2);
    let (materials, two_sided) = alike(draw, colours, [0.12, 0.7]);
    let mut scene = BodyScene::new(materials, two_sided, shading);
    let neck = draw.range(0.03, 0.09);
    let pairs = draw.whole(2, 4);
    for number in 0..pairs {
        // the first pair of a scene always coalesces
        let parts = number > 0 && draw.chance(0.4);
        scene.place(draw, 0.08, |draw| {
            let large = draw.range(0.15, 0.21);
            let small = large * draw.range(0.65, 0.95);
            let (at, duration) = (draw.range(0.35, 0.6), draw.range(0.35, 0.6));
            let length = if parts {
                let closest = draw.range(0.45, 0.65);
                let pulse = Pulse { up: Some((0.28, 0.4)), down: Some((0.74, 0.4)) };
                Ramp { before: 1.0, after: closest, pulse }
            } else {
                Ramp::once(1.0, 0.0, at, duration)
            };
            let way = draw.direction();
            let (axis, rate) = (across(way), draw.range(-1.2, 1.2));
            let distance = draw.range(1.3, 1.7) * (large + small);
            let start = Path::at_rest(draw.point(0.6));
            let journey = draw.range(0.1, 0.4);
            let path = wander(draw, start, journey);
            // the smaller one goes the longer way
            let share = small / (large + small);
            let arm = |by: f64| Motion::Arm { by: scaled(way, by * distance), axis, rate, length };
            let mut first =
                member(draw, "drop", large, path.clone().with(arm(share)), (number, number % colours), neck);
            let other = path.with(arm(share - 1.0));
            let mut second = member(draw, "drop", small, other, (number, number % colours), neck);
            if !parts {
                let whole = (large.powi(3) + small.powi(3)).cbrt() / large;
                first.path.size = Ramp::once(1.0, whole, at + 0.1 * duration, duration);
                let joined = Joined { with: 0, at: at + 0.11 * duration, change: lineage::LineageChange::Ended };
                second.joined = Some(joined);
            }
            vec![first, second]
        });
    }
    scene
}

/// Cells of one colour that divide, one of them twice. A daughter begins when the neck is thin: before that all is the
/// mother's, which goes on as the other daughter.
pub(super) fn splitting(draw: &mut Draw, family: u64, seed: u64) -> BodyScene {
    let shading = light(draw, family, seed);
    let colours = draw.whole(1, 2);
    let (materials, two_sided) = alike(draw, colours, [0.12, 0.7]);
    let mut scene = BodyScene::new(materials, two_sided, shading);
    let neck = draw.range(0.03, 0.08);
    let cells = draw.whole(2, 4);
    for number in 0..cells {
        let divisions = if number == 0 { draw.whole(1, 2) } else { draw.whole(0, 6).min(1) };
        scene.place(draw, 0.08, |draw| divided(draw, divisions, (number, number % colours), neck));
    }
    scene
}

/// A cell that divides this number of times, 0 to 2.
fn divided(draw: &mut Draw, divisions: usize, of: (usize, usize), neck: f64) -> Vec<Body> {
    let radius = if divisions == 2 { draw.range(0.2, 0.25) } else { draw.range(0.16, 0.23) };
    let first = if divisions == 2 { draw.range(0.25, 0.35) } else { draw.range(0.3, 0.7) };
    let times = [first, first + draw.range(0.3, 0.38), first + draw.range(0.35, 0.42)];
    let duration = draw.range(0.3, 0.45);
    let way = draw.direction();
    let (axis, rate) = (across(way), draw.range(-0.8, 0.8));
    let small = radius * 0.5_f64.powf(divisions as f64 / 3.0);
    let size = match divisions {
        0 => Ramp::NONE,
        1 => Ramp::once(1.0, small / radius, times[0], duration),
        _ => Ramp::once(1.0, small / radius, 0.5 * (times[0] + times[2]), duration + times[2] - times[0]),
    };
    let start = Path::at_rest(draw.point(0.55));
    let journey = draw.range(0.05, 0.3);
    let path = wander(draw, start, journey);
    let ways = [way, across(way), super::motion::turned(&super::motion::rotation(way, 1.2), across(way))];
    let apart = [draw.range(1.35, 1.6) * small * if divisions == 2 { 1.3 } else { 1.0 }, draw.range(1.3, 1.5) * small];
    // the way of each division to which each body goes
    let arm = |division: usize, by: f64| {
        let length = Ramp::once(0.0, 1.0, times[division], duration);
        let by = scaled(ways[division], by * apart[division.min(1)]);
        Motion::Arm { by, axis, rate, length }
    };
    let routes: &[&[(usize, f64)]] = match divisions {
        0 => &[&[]],
        1 => &[&[(0, 1.0)], &[(0, -1.0)]],
        _ => &[&[(0, 1.0), (1, 1.0)], &[(0, -1.0), (2, 1.0)], &[(0, 1.0), (1, -1.0)], &[(0, -1.0), (2, -1.0)]],
    };
    let began = |with: usize, division: usize| {
        Some(Joined { with, at: times[division] + 0.05 * duration, change: lineage::LineageChange::Began })
    };
    let events = [None, began(0, 0), began(0, 1), began(1, 2)];
    let axes = [0; 3].map(|_| radius * draw.range(0.94, 1.06));
    let body = |(route, joined): (&&[(usize, f64)], Option<Joined>)| {
        let mut own = route.iter().fold(path.clone(), |path, (division, by)| path.with(arm(*division, *by)));
        own.size = size;
        let mut body = member(draw, "cell", radius, own, of, neck);
        // daughters lie in each other before they part
        body.shape = Shape::Ball(axes);
        body.joined = joined;
        body
    };
    routes.iter().zip(events).map(body).collect()
}
