//! The ray caster against exact answers, against the plain reference, and with odd input.

use super::*;
use crate::data::paths::{FOV_X, Lens, RADIUS, training_cameras};
use crate::volume::directions::Directions;
use crate::volume::grid::Grid;
use crate::volume::placement::published_side;
use crate::volume::transfer::SegmentRange;
use reference::trace;

const SPAN: [f64; 2] = [0.0, 1.0];

fn lens(size: u32) -> Lens {
    Lens { fov_x: FOV_X, width: size, height: size }
}

fn volume(dims: [usize; 3], f: impl Fn([f64; 3]) -> f64) -> Volume {
    let at = |i: usize, a: usize| 2.0 * i as f64 / (dims[a] - 1) as f64 - 1.0;
    let mut values = Vec::new();
    for z in 0..dims[2] {
        for y in 0..dims[1] {
            for x in 0..dims[0] {
                values.push(f([at(x, 0), at(y, 1), at(z, 2)]) as f32);
            }
        }
    }
    Volume { grid: Grid::unit(dims), values }
}

/// A transfer function by points `(fraction, opacity)`, red at 0 and blue at 1, without shading.
fn plain(opacity: &[(f64, f32)]) -> TransferFunction {
    TransferFunction {
        name: "test".into(),
        range: Some(SPAN),
        colors: vec![(0.0, [1.0, 0.2, 0.0]), (1.0, [0.0, 0.2, 1.0])],
        opacity: opacity.to_vec(),
        unit_length: 0.1,
        shading: Shading { enabled: false, ..Shading::default() },
        segments: Vec::new(),
    }
}

fn caster(volume: &Volume, transfer: &TransferFunction, step: f64) -> RayCaster {
    RayCaster::new(volume, None, transfer, SPAN, VoxelPlacement::new(&volume.grid, published_side()), step)
}

/// A few balls and a slope: values in [0, 1], flat in places.
fn bumpy(p: [f64; 3]) -> f64 {
    let ball = |c: [f64; 3], r: f64| {
        let d2: f64 = (0..3).map(|a| (p[a] - c[a]).powi(2)).sum();
        (1.0 - d2 / (r * r)).max(0.0)
    };
    (0.9 * ball([0.3, 0.2, -0.4], 0.5) + 0.7 * ball([-0.4, -0.1, 0.3], 0.6) + 0.4 * ball([0.0, 0.5, 0.5], 0.4)).min(1.0)
}

#[test]
fn a_homogeneous_box_follows_beer_lambert() {
    // opacity 0.3 in a tenth of the side: alpha = 1 - 0.7^(way / (0.1 side)), whatever the step
    let v = volume([9, 17, 5], |_| 0.5);
    let tf = plain(&[(0.0, 0.3)]);
    let placement = VoxelPlacement::new(&v.grid, published_side());
    for camera in training_cameras(5, RADIUS, lens(24)) {
        for step in [0.37, 1.0, 3.0] {
            let picture = caster(&v, &tf, step).render(&camera, None);
            let rays = Rays::new(&camera, &VoxelPlacement::new(&v.grid, published_side()));
            let mut hit = 0;
            for y in 0..24 {
                for x in 0..24 {
                    let way = placement.clip(rays.eye, rays.direction(x, y)).map_or(0.0, |(n, f)| f - n);
                    let alpha = 1.0 - 0.7f64.powf(way / (0.1 * published_side()));
                    let p = &picture.pixels[4 * (y * 24 + x)..][..4];
                    // rays end early when a thousandth of the light is left
                    assert!((f64::from(p[3]) - alpha).abs() < 1e-3, "step {step}: {} for {alpha}", p[3]);
                    assert!((p[1] - 0.2 * p[3]).abs() < 1e-3 && (p[0] - 0.5 * p[3]).abs() < 1e-3);
                    hit += usize::from(way > 0.0);
                }
            }
            assert!(hit > 20, "the camera sees the box");
        }
    }
}

#[test]
fn a_homogeneous_ball_has_the_length_of_its_chords() {
    // the value falls linearly from the centre, so that trilinear interpolation keeps the radius to second order
    let radius = 0.8;
    let v = volume([97; 3], |p| 1.0 - p.iter().map(|x| x * x).sum::<f64>().sqrt());
    let edge = 1.0 - radius;
    let tf = plain(&[(edge, 0.0), (edge, 0.1)]);
    let side = published_side();
    let camera = &training_cameras(3, RADIUS, lens(64))[1];
    let picture = caster(&v, &tf, 0.25).render(camera, None);
    let rays = Rays::new(camera, &VoxelPlacement::new(&v.grid, published_side()));
    let (mut worst, mut sum) = (0.0f64, 0.0);
    for y in 0..64 {
        for x in 0..64 {
            let d = rays.direction(x, y);
            let off2 = (rays.eye - rays.eye.dot(d) * d).length_squared();
            let chord = 2.0 * ((0.5 * side * radius).powi(2) - off2).max(0.0).sqrt();
            let alpha = 1.0 - 0.9f64.powf(chord / (0.1 * side));
            let error = (f64::from(picture.pixels[4 * (y * 64 + x) + 3]) - alpha).abs();
            worst = worst.max(error);
            sum += error;
        }
    }
    // only rays that graze the ball are affected by the grid
    assert!(worst < 0.03 && sum / 4096.0 < 5e-4, "worst {worst}, mean {}", sum / 4096.0);
}

#[test]
fn agrees_with_the_reference() {
    let v = Volume { grid: Grid::aligned([31, 24, 18], [1.0, 1.3, 2.0], [0.0; 3]), ..volume([31, 24, 18], bumpy) };
    for shaded in [false, true] {
        let mut tf = plain(&[(0.05, 0.0), (0.3, 0.05), (0.5, 0.0), (0.55, 0.9)]);
        tf.shading = Shading { enabled: shaded, ..Shading::default() };
        let fast = caster(&v, &tf, 0.5);
        let placement = VoxelPlacement::new(&v.grid, published_side());
        let (mut square, mut n, mut covered) = (0.0, 0, 0);
        for camera in training_cameras(7, RADIUS, lens(20)) {
            let picture = fast.render(&camera, None);
            for (i, p) in picture.pixels.chunks_exact(4).enumerate() {
                let want = trace(&v, &tf, SPAN, &placement, 0.5, &camera, [i % 20, i / 20]);
                square += (0..4).map(|c| (f64::from(p[c]) - want[c]).powi(2)).sum::<f64>();
                n += 4;
                covered += usize::from(want[3] > 0.1);
            }
        }
        let psnr = -10.0 * (square / f64::from(n)).log10();
        assert!(covered > 100 && psnr > 60.0, "shaded {shaded}: {psnr} dB over {covered} pixels");
    }
}

#[test]
fn skipping_and_threads_change_no_bit() {
    let v = volume([40, 33, 50], bumpy);
    let tf = plain(&[(0.2, 0.0), (0.3, 0.4), (0.4, 0.0), (0.8, 0.0), (0.9, 0.9)]);
    let skipping = caster(&v, &tf, 0.5);
    let mut all = caster(&v, &tf, 0.5);
    all.occupancy = BrickDistances::new(v.grid.dims, |_| true);
    for camera in training_cameras(5, RADIUS, lens(50)) {
        let picture = all.render(&camera, None);
        for threads in [1, 2, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert!(pool.install(|| skipping.render(&camera, None)) == picture);
        }
    }
    // and there was something to skip
    assert!(skipping.occupancy.occupied() < all.occupancy.occupied() / 2);
}

#[test]
fn large_images_are_complete_and_can_be_interrupted() {
    let v = volume([12; 3], bumpy);
    let tf = plain(&[(0.2, 0.0), (0.3, 0.4)]);
    let camera = Camera::look_at(-DVec3::Y * RADIUS, DVec3::ZERO, DVec3::Z, FOV_X, 700, 530);
    let quick = caster(&v, &tf, 2.0);
    let (picture, rays) =
        (quick.render(&camera, None), Rays::new(&camera, &VoxelPlacement::new(&v.grid, published_side())));
    for (x, y) in (0..700).step_by(37).flat_map(|x| (0..530).step_by(31).map(move |y| (x, y))).chain([(699, 529)]) {
        let want = quick.cast(&rays, x, y, None, false).color;
        assert_eq!(picture.pixels[4 * (y * 700 + x)..][..4], want, "{x}, {y}");
    }
    assert_eq!(quick.render_until(&camera, None, &AtomicBool::new(false)), Some(picture));
    assert_eq!(quick.render_until(&camera, None, &AtomicBool::new(true)), None);
    // hours of work, stopped after a moment
    let (slow, stop) = (caster(&v, &tf, 1e-4), AtomicBool::new(false));
    let started = std::time::Instant::now();
    let drawn = std::thread::scope(|scope| {
        scope.spawn(|| {
            std::thread::sleep(std::time::Duration::from_millis(50));
            stop.store(true, Ordering::Relaxed);
        });
        slow.render_with_labels(&camera, 0.05, &stop)
    });
    assert_eq!(drawn, None);
    assert!(started.elapsed().as_secs() < 60, "{:?}", started.elapsed());
}

#[test]
fn segments_alone_make_up_the_whole() {
    let v = volume([32; 3], bumpy);
    let [left, right] = [1, 2];
    let ids = (0..32usize.pow(3)).map(|i| if i % 32 < 14 { left } else { right }).collect();
    let labels = VolumeLabels { grid: v.grid, ids };
    let tf = plain(&[(0.1, 0.0), (0.4, 0.9)]);
    let placement = VoxelPlacement::new(&v.grid, published_side());
    let caster = RayCaster::new(&v, Some(labels), &tf, SPAN, placement, 0.5);
    let camera = Camera::look_at(-DVec3::Y * RADIUS, DVec3::ZERO, DVec3::Z, FOV_X, 40, 40);
    let (whole, image) = caster.render_with_labels(&camera, 0.05, &AtomicBool::new(false)).unwrap();
    assert_eq!(whole, caster.render(&camera, None));
    let alone: Vec<RaycastPicture> = [left, right].map(|id| caster.render(&camera, Some(&caster.isolate(id)))).into();
    for (i, id) in image.iter().enumerate() {
        let [a, b] = [&alone[0], &alone[1]].map(|p| p.pixels[4 * i + 3]);
        // light passes through both, one after the other
        assert!((1.0 - (1.0 - a) * (1.0 - b) - whole.pixels[4 * i + 3]).abs() < 3e-3);
        match id {
            0 => assert!(whole.pixels[4 * i + 3] < 0.05),
            1 => assert!(a > 0.0),
            _ => assert!(b > 0.0),
        }
    }
    assert!(image.contains(&1) && image.contains(&2));
    assert!(caster.render(&camera, Some(&caster.isolate(9))).coverage() == 0.0);
}

#[test]
fn named_ranges_are_segments_too() {
    let v = volume([32; 3], |p| 1.0 - p.iter().map(|x| x * x).sum::<f64>().sqrt());
    let mut tf = plain(&[(0.2, 0.0), (0.25, 0.3)]);
    let range = |name: &str, range| SegmentRange { name: name.into(), range, color: None };
    tf.segments = vec![range("shell", [0.2, 0.6]), range("core", [0.6, 1.01])];
    let caster = caster(&v, &tf, 0.5);
    let camera = Camera::look_at(-DVec3::Y * RADIUS, DVec3::ZERO, DVec3::Z, FOV_X, 64, 64);
    let [shell, core] = [1, 2].map(|id| caster.render(&camera, Some(&caster.isolate(id))));
    // the core is hidden in the shell, and visible alone
    assert!(shell.coverage() > core.coverage() && core.coverage() > 0.01);
    let ratio = (core.coverage() / shell.coverage()).sqrt();
    assert!((ratio - 0.4 / 0.8).abs() < 0.05, "{ratio}");
}

#[test]
fn a_plateau_of_whole_numbers_is_its_own_segment() {
    // 103 of 255 lies a little above its entry of the table
    let v = volume([9; 3], |_| 103.0);
    let mut tf = plain(&[(0.0, 0.3)]);
    tf.range = Some([0.0, 255.0]);
    let range = |name: &str, low: f64| {
        let range = [low / 255.0, (low + 1.0) / 255.0];
        SegmentRange { name: name.into(), range, color: None }
    };
    tf.segments = vec![range("below", 102.0), range("this", 103.0)];
    let placement = VoxelPlacement::new(&v.grid, published_side());
    let caster = RayCaster::new(&v, None, &tf, [0.0, 255.0], placement, 0.5);
    let camera = Camera::look_at(-DVec3::Y * RADIUS, DVec3::ZERO, DVec3::Z, FOV_X, 24, 24);
    let (whole, ids) = caster.render_with_labels(&camera, 0.05, &AtomicBool::new(false)).unwrap();
    assert!(ids.contains(&2) && ids.iter().all(|id| [0, 2].contains(id)));
    assert_eq!(caster.render(&camera, Some(&caster.isolate(2))), whole);
    assert_eq!(caster.render(&camera, Some(&caster.isolate(1))).coverage(), 0.0);
    assert!(caster.cells(4).ids.iter().all(|id| *id == 2));
}

#[test]
fn shading_follows_the_headlight() {
    // a ball: brightest in the middle, ambient at the rim; the sign of the gradient does not matter
    for sign in [1.0, -1.0] {
        let v = volume([65; 3], |p| 0.5 + sign * (0.5 - p.iter().map(|x| x * x).sum::<f64>().sqrt()));
        let mut tf = plain(&if sign > 0.0 { [(0.3, 0.0), (0.35, 0.99)] } else { [(0.65, 0.99), (0.7, 0.0)] });
        tf.unit_length = 0.01;
        tf.colors = vec![(0.0, [0.5; 3])];
        tf.shading = Shading { enabled: true, ambient: 0.2, diffuse: 0.6, specular: 0.1, power: 10.0 };
        let camera = Camera::look_at(DVec3::X * RADIUS, DVec3::ZERO, DVec3::Z, FOV_X, 65, 65);
        let rgb = caster(&v, &tf, 0.25).render(&camera, None);
        let at = |x: usize| rgb.pixels[4 * (32 * 65 + x)] / rgb.pixels[4 * (32 * 65 + x) + 3].max(0.01);
        if sign > 0.0 {
            assert!((at(32) - (0.5 * 0.8 + 0.1)).abs() < 0.01, "{}", at(32));
            assert!(at(32) > at(24) && at(24) > at(20));
        } else {
            // the hollow shows its nearest corner, lit by its own slope
            assert!(at(32) > 0.3);
        }
    }
}

#[test]
fn odd_input_gives_a_picture() {
    let v = volume([2, 2, 2], |_| 7.0);
    let tf = plain(&[(0.0, 1.0)]);
    let placement = VoxelPlacement::new(&v.grid, 1.0);
    // a span of no width, an opacity of one, a camera inside, and one looking away
    let caster = RayCaster::new(&v, None, &tf, [7.0, 7.0], placement, 0.5);
    let inside = Camera::look_at(DVec3::splat(0.1), DVec3::X, DVec3::Z, 1.0, 8, 8);
    let picture = caster.render(&inside, None);
    assert!(picture.pixels.iter().all(|p| p.is_finite()) && picture.coverage() > 0.5);
    let away = Camera::look_at(DVec3::X * 4.0, DVec3::X * 8.0, DVec3::Z, 1.0, 8, 8);
    assert_eq!(caster.render(&away, None).coverage(), 0.0);
    let nothing = RayCaster::new(&v, None, &plain(&[(0.0, 0.0)]), SPAN, placement, 0.5);
    assert_eq!(nothing.render(&inside, None).coverage(), 0.0);
    assert!(v.grid.len() == 8 && caster.render(&Camera { width: 1, height: 3, ..inside }, None).pixels.len() == 12);
}

#[test]
fn pictures_do_not_depend_on_the_unit_of_the_data() {
    let transfer = TransferFunction { shading: Shading::default(), ..plain(&[(0.0, 0.0), (0.3, 0.6), (1.0, 0.9)]) };
    let v = volume([17, 13, 9], bumpy);
    let placement = VoxelPlacement::new(&v.grid, published_side());
    let camera = &training_cameras(5, RADIUS, lens(24))[2];
    let of = |unit: f64| {
        let values = v.values.iter().map(|x| x * unit as f32).collect();
        let scaled = Volume { values, ..v.clone() };
        RayCaster::new(&scaled, None, &transfer, [0.0, unit], placement, 0.5).render(camera, None)
    };
    let usual = of(1.0);
    // the squares of gradients would be 0 and infinite
    for exponent in [-80, 66] {
        assert!(of(2f64.powi(exponent)) == usual, "2^{exponent}");
    }
}

/// A volume on a turned grid with the values of the plain one at the same places, which is read along
/// `axes` with the signs of `flips`.
fn turned(v: &Volume, axes: [usize; 3], flips: [bool; 3]) -> Volume {
    let dims = axes.map(|a| v.grid.dims[a]);
    let plain = |at: [usize; 3]| -> [usize; 3] {
        let mut index = [0; 3];
        (0..3).for_each(|a| index[axes[a]] = if flips[a] { dims[a] - 1 - at[a] } else { at[a] });
        index
    };
    let voxel = |i: usize| plain([i % dims[0], i / dims[0] % dims[1], i / (dims[0] * dims[1])]);
    let values = (0..v.grid.len()).map(|i| {
        let [x, y, z] = voxel(i);
        v.values[(z * v.grid.dims[1] + y) * v.grid.dims[0] + x]
    });
    let steps = [0, 1, 2].map(|a| DVec3::AXES[axes[a]] * if flips[a] { -1.0 } else { 1.0 });
    let (directions, _) = Directions::of_steps(steps.map(|s| s.to_array())).unwrap();
    let origin = v.grid.position(DVec3::from_array(plain([0; 3]).map(|i| i as f64))).to_array();
    let grid = Grid { dims, spacing: axes.map(|a| v.grid.spacing[a]), origin, directions };
    Volume { values: values.collect(), grid }
}

fn difference(a: &RaycastPicture, b: &RaycastPicture) -> f32 {
    a.pixels.iter().zip(&b.pixels).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

#[test]
fn a_volume_stored_in_any_orientation_gives_the_same_pictures_and_cells() {
    let grid = Grid::aligned([17, 13, 9], [1.0, 1.2, 2.0], [30.0, -5.0, 7.0]);
    let v = Volume { grid, ..volume([17, 13, 9], bumpy) };
    let mut tf = plain(&[(0.1, 0.0), (0.3, 0.4), (0.8, 0.9)]);
    tf.shading = Shading::default();
    tf.segments = vec![SegmentRange { name: "core".into(), range: [0.4, 1.0], color: None }];
    let place = |v: &Volume| RayCaster::new(v, None, &tf, SPAN, VoxelPlacement::new(&v.grid, published_side()), 0.5);
    let cameras = training_cameras(3, RADIUS, lens(24));
    let draw = |caster: &RayCaster| cameras.iter().map(|c| caster.render(c, None)).collect::<Vec<_>>();
    let (pictures, cells) = (draw(&place(&v)), place(&v).cells(16));
    assert!(pictures.iter().all(|p| p.coverage() > 0.05) && cells.ids.contains(&1));
    let mirrored = Volume { grid, ..turned(&v, [0, 1, 2], [true, false, false]) };
    let wrong = draw(&place(&mirrored)).iter().zip(&pictures).map(|(a, b)| difference(a, b)).fold(0.0, f32::max);
    assert!(wrong > 0.1, "a mirrored volume would show: {wrong}");
    for axes in ORDERS {
        for flips in (0..8).map(|k| [k & 1 > 0, k & 2 > 0, k & 4 > 0]) {
            let caster = place(&turned(&v, axes, flips));
            let same = axes == ORDERS[0] && flips == [false; 3];
            for (a, b) in draw(&caster).iter().zip(&pictures) {
                assert!(
                    if same { a == b } else { difference(a, b) < 2e-3 },
                    "{axes:?} {flips:?}: {}",
                    difference(a, b)
                );
            }
            let found = caster.cells(16);
            assert_eq!((found.dims, found.ids.len()), (cells.dims, cells.ids.len()), "{axes:?} {flips:?}");
            assert!((0..3).all(|a| (found.origin[a] - cells.origin[a]).abs() < 1e-12));
            // where a cell's centre is between two voxels, either is the nearest
            let other = found.ids.iter().zip(&cells.ids).filter(|(a, b)| a != b).count();
            assert!(other * 25 <= cells.ids.len(), "{other} of {} ids", cells.ids.len());
            let sum = |c: &SceneCells| c.opacity.iter().map(|o| f64::from(*o)).sum::<f64>();
            assert!((sum(&found) / sum(&cells) - 1.0).abs() < 0.02, "{} {}", sum(&found), sum(&cells));
        }
    }
}

#[test]
fn an_oblique_volume_shows_what_lies_at_its_places() {
    // the same field, sampled on an aligned grid and on an oblique, mirrored one: a ball beside the centre
    let field = |p: DVec3| (1.0 - (p - DVec3::new(3.0, -2.0, 1.0)).length() / 6.0).max(0.0);
    let (s, c) = 0.5f64.sin_cos();
    let (directions, _) = Directions::of_steps([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, 1.0]]).unwrap();
    let mut grids = [Grid::aligned([33; 3], [1.0; 3], [-16.0; 3]); 2];
    let first = directions.matrix() * DVec3::splat(-16.0);
    grids[1] = Grid { directions, origin: first.to_array(), ..grids[0] };
    let tf = plain(&[(0.2, 0.0), (0.25, 0.5)]);
    let casters = grids.map(|grid| {
        let place =
            |i: usize| field(grid.position(DVec3::from_array([i % 33, i / 33 % 33, i / 1089].map(|v| v as f64))));
        let values = (0..grid.len()).map(|i| place(i) as f32).collect();
        RayCaster::new(&Volume { grid, values }, None, &tf, SPAN, VoxelPlacement::new(&grid, 1.0), 0.25)
    });
    for camera in training_cameras(4, RADIUS, lens(32)) {
        let [a, b] = [0, 1].map(|i| casters[i].render(&camera, None));
        let square: f32 = a.pixels.iter().zip(&b.pixels).map(|(a, b)| (a - b).powi(2)).sum();
        let psnr = -10.0 * (square / a.pixels.len() as f32).log10();
        assert!(a.coverage() > 0.005 && psnr > 40.0, "{psnr} dB, {}", a.coverage());
    }
    let centre = |caster: &RayCaster| {
        let cells = caster.cells(40);
        let (mut sum, mut weight) = (DVec3::ZERO, 0.0);
        for (i, opacity) in cells.opacity.iter().enumerate() {
            let at = [i % cells.dims[0], i / cells.dims[0] % cells.dims[1], i / (cells.dims[0] * cells.dims[1])];
            let place: [f64; 3] = std::array::from_fn(|a| cells.origin[a] + cells.spacing[a] * at[a] as f64);
            sum += DVec3::from_array(place) * f64::from(*opacity);
            weight += f64::from(*opacity);
        }
        32.0 * sum / weight
    };
    for caster in &casters {
        let found = centre(caster);
        assert!((found - DVec3::new(3.0, -2.0, 1.0)).length() < 0.1, "{found}");
    }
}
