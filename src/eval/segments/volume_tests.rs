//! Tests with two balls of known overlap, hollow bodies, non-finite values, and several threads.

use super::*;
use glam::DVec3;

/// Cells of 0.1 in [-1.55, 1.55]^3, with the ids and opacity that `cell` returns.
fn volume(cell: impl Fn(DVec3) -> (u16, f32)) -> TruthVolume {
    let dims = [32; 3];
    let (spacing, origin) = ([0.1; 3], [-1.55; 3]);
    let mut out = TruthVolume { time: 0.0, dims, spacing, origin, ids: Vec::new(), opacity: Vec::new() };
    for c in 0..32 * 32 * 32 {
        let (id, opacity) = cell(DVec3::from_array(out.centre([c % 32, c / 32 % 32, c / 1024])));
        out.ids.push(id);
        out.opacity.push(opacity);
    }
    out
}

const CENTRES: [DVec3; 2] = [DVec3::new(-0.7, 0.0, 0.0), DVec3::new(0.7, 0.0, 0.0)];
const RADIUS: f64 = 0.6;

/// Ball 1 on the left, ball 2 on the right.
fn balls(place: DVec3) -> (u16, f32) {
    let ball = CENTRES.iter().position(|c| c.distance(place) <= RADIUS);
    ball.map_or((0, 0.0), |b| (b as u16 + 1, 0.5))
}

fn add(at: &mut HostGaussians, mean: DVec3, sigma: f64) {
    at.means.extend(mean.as_vec3().to_array());
    at.rotations.extend([1.0, 0.0, 0.0, 0.0]);
    at.log_scales.extend([sigma.ln() as f32; 3]);
    at.opacity_logits.push(1.0);
    at.sh.extend([0.0; 3]);
}

fn no_gaussians() -> HostGaussians {
    HostGaussians { sh_stride: 1, ..HostGaussians::default() }
}

/// A Gaussian in each cell of the balls for which `keep` holds, in the order of the cells, and the ball that each is
/// in.
fn filled(keep: impl Fn(DVec3) -> bool) -> (HostGaussians, Vec<u16>) {
    let truth = volume(balls);
    let (mut at, mut of) = (no_gaussians(), Vec::new());
    for c in 0..truth.ids.len() {
        let place = DVec3::from_array(truth.centre([c % 32, c / 32 % 32, c / 1024]));
        if truth.ids[c] > 0 && keep(place) {
            add(&mut at, place, 0.05);
            of.push(truth.ids[c]);
        }
    }
    (at, of)
}

fn select(of: &[u16], wanted: impl Fn(usize, u16) -> bool) -> SelectedGaussians {
    let members = of.iter().enumerate().filter(|(i, b)| wanted(*i, **b)).map(|(i, _)| i as u32).collect();
    SelectedGaussians { members, ..SelectedGaussians::default() }
}

#[test]
fn balls_are_found_and_their_overlap_is_that_of_the_opacities() {
    let truth = volume(balls);
    let (at, of) = filled(|_| true);
    let cells = TruthCells::new(&truth, &at, 0.0).unwrap();
    let [left, both] = [select(&of, |_, b| b == 1), select(&of, |_, _| true)];
    assert_eq!(cells.iou(&left, &[1]).unwrap(), Some(1.0));
    assert_eq!(cells.iou(&left, &[2]).unwrap(), Some(0.0));
    assert_eq!(cells.iou(&left, &[1, 2]).unwrap(), Some(0.5), "the balls have the same size");
    assert_eq!(cells.iou(&both, &[1]).unwrap(), Some(0.5));
    assert_eq!(cells.iou(&both, &[1, 2]).unwrap(), Some(1.0));
    assert_eq!(cells.iou(&both, &[7]).unwrap(), Some(0.0), "an absent segment");
    assert_eq!(cells.iou(&select(&of, |_, _| false), &[7]).unwrap(), None);
    assert!(cells.hold(&[1]) && cells.hold(&[7, 2]) && !cells.hold(&[7]) && !cells.hold(&[]));
    assert_eq!(cells.labelled_share(), Some(1.0));
    let faint = volume(|p| (balls(p).0, 0.5 * FLOOR));
    let faint = TruthCells::new(&faint, &at, 0.0).unwrap();
    assert!(!faint.hold(&[1]) && faint.labelled_share().is_none(), "its cells are empty");
    // the right ball without an id and three times as opaque
    let one = volume(|p| if balls(p).0 == 2 { (0, 0.9) } else { (balls(p).0, balls(p).1 * 0.6) });
    let share = TruthCells::new(&one, &at, 0.0).unwrap().labelled_share().unwrap();
    assert!((share - 0.25).abs() < 1e-6, "{share}");
    // half of the left ball, cut at its centre
    let half = select(&of, |i, b| b == 1 && f64::from(at.means[3 * i]) < CENTRES[0].x);
    let found = cells.iou(&half, &[1]).unwrap().unwrap();
    assert!((found - 0.5).abs() < 0.01, "{found}");
    // the right ball three times as opaque: it counts three times
    let heavy = volume(|p| if p.x > 0.0 && balls(p).0 > 0 { (2, 0.9) } else { (balls(p).0, balls(p).1 * 0.6) });
    let found = TruthCells::new(&heavy, &at, 0.0).unwrap().iou(&both, &[2]).unwrap().unwrap();
    assert!((found - 0.75).abs() < 1e-6, "{found}");
}

#[test]
fn the_interior_belongs_to_the_surface_and_empty_space_to_no_gaussian() {
    let truth = volume(balls);
    // an opaque surface layer, and nothing inside
    let surface_layer = |p: DVec3| CENTRES.iter().any(|c| c.distance(p) > RADIUS - 0.3 && c.distance(p) <= RADIUS);
    let (at, of) = filled(surface_layer);
    let cells = TruthCells::new(&truth, &at, 0.0).unwrap();
    assert_eq!(cells.iou(&select(&of, |_, b| b == 1), &[1]).unwrap(), Some(1.0));
    // what lies in empty space claims no cells
    let mut more = at.clone();
    for _ in 0..50 {
        add(&mut more, DVec3::new(0.0, 1.4, 1.4), 0.02);
    }
    let mut with = select(&of, |_, b| b == 1);
    with.members.extend(at.len() as u32..more.len() as u32);
    assert_eq!(TruthCells::new(&truth, &more, 0.0).unwrap().iou(&with, &[1]).unwrap(), Some(1.0));
}

#[test]
fn half_of_the_density_is_not_more_than_half() {
    let truth = volume(|p| if p.distance(DVec3::splat(0.05)) < 0.01 { (1, 0.5) } else { (0, 0.0) });
    let mut at = no_gaussians();
    add(&mut at, DVec3::splat(0.05), 0.05);
    add(&mut at, DVec3::splat(0.05), 0.05);
    let cells = TruthCells::new(&truth, &at, 0.0).unwrap();
    let of = |members: &[u32]| SelectedGaussians { members: members.to_vec(), ..SelectedGaussians::default() };
    assert_eq!(cells.iou(&of(&[0]), &[1]).unwrap(), Some(0.0));
    assert_eq!(cells.iou(&of(&[0, 1]), &[1]).unwrap(), Some(1.0));
    // cut back to a place beside the cell, the selected ones lose it
    let moved = (vec![0.5, 0.0, 0.0, 0.5, 0.0, 0.0], vec![0.0; 6]);
    let cut = SelectedGaussians { members: vec![0, 1], moved, asked: None };
    add(&mut at, DVec3::new(0.17, 0.05, 0.05), 0.06);
    assert_eq!(TruthCells::new(&truth, &at, 0.0).unwrap().iou(&cut, &[1]).unwrap(), Some(0.0));
}

#[test]
fn non_finite_and_empty_inputs_are_accepted() {
    let truth = volume(balls);
    let (at, of) = filled(|_| true);
    let left = select(&of, |_, b| b == 1);
    let expected = TruthCells::new(&truth, &at, 0.0).unwrap().iou(&left, &[1]).unwrap();
    for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut bad = at.clone();
        for array in 0..4 {
            add(&mut bad, DVec3::new(0.7, 0.0, 0.0), 0.3);
            let i = bad.len() - 1;
            match array {
                0 => bad.means[3 * i + 1] = poison,
                1 => bad.log_scales[3 * i] = poison,
                2 => bad.rotations[4 * i..].fill(0.0),
                _ => bad.opacity_logits[i] = if poison > 0.0 { f32::NAN } else { poison },
            }
        }
        assert_eq!(TruthCells::new(&truth, &bad, 0.0).unwrap().iou(&left, &[1]).unwrap(), expected, "{poison}");
    }
    let mut holes = truth.clone();
    holes.opacity.iter_mut().step_by(7).for_each(|o| *o = f32::NAN);
    assert_eq!(TruthCells::new(&holes, &at, 0.0).unwrap().iou(&left, &[1]).unwrap(), Some(1.0));
    // no Gaussians, nothing selected, no opacity, arrays that disagree
    let none = no_gaussians();
    assert_eq!(
        TruthCells::new(&truth, &none, 0.0).unwrap().iou(&SelectedGaussians::default(), &[1]).unwrap(),
        Some(0.0)
    );
    let clear = volume(|_| (1, 0.0));
    assert_eq!(TruthCells::new(&clear, &at, 0.0).unwrap().iou(&left, &[1]).unwrap(), None);
    let short = TruthVolume { ids: vec![1; 5], ..truth };
    assert!(matches!(TruthCells::new(&short, &at, 0.0), Err(PlaceError::Shape { field: "ids", found: 5, .. })));
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let truth = volume(balls);
    let (at, of) = filled(|p| p.y > 0.2);
    let some = select(&of, |i, _| i % 3 == 0);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let cells = TruthCells::new(&truth, &at, 0.0).unwrap();
            cells.iou(&some, &[1]).unwrap().unwrap().to_bits()
        })
    };
    assert_eq!(on(1), on(3));
}
