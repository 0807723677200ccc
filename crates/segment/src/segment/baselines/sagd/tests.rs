//! SAGD on two balls: votes, choices of masks, cuts, non-finite values, thread counts.

use super::*;
use crate::segment::test_support::{APART, COUNT, add, on_threads};

fn balls() -> Vec<SagdView> {
    APART.views().into_iter().map(|(camera, masks)| SagdView { camera, masks }).collect()
}

/// A camera at z = -4 that looks along z: x to the right, y down, 100 pixels per unit at the origin.
fn ahead(masks: Vec<Mask>) -> SagdView {
    let rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let translation = [0.0, 0.0, 4.0];
    let camera =
        PinholeCamera { width: 100, height: 100, fx: 400.0, fy: 400.0, cx: 50.0, cy: 50.0, rotation, translation };
    SagdView { camera, masks }
}

/// The mask of the pixels left of column `end`.
fn left(end: usize) -> Mask {
    Mask::from_rows(100, 100, &(0..10_000).map(|p| p % 100 < end).collect::<Vec<_>>()).unwrap()
}

fn one(mean: [f32; 3], log_scales: [f32; 3]) -> HostGaussians {
    let mut at = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
    add(&mut at, mean, log_scales);
    at
}

#[test]
fn a_click_finds_its_ball_by_the_small_mask_and_both_by_the_large_one() {
    let (at, views) = (APART.gaussians(), balls());
    let n = COUNT as u32;
    for clicked in [3, n + 3] {
        for (choice, expected) in [
            (MaskChoice::Smallest, if clicked < n { 0..n } else { n..2 * n }),
            (MaskChoice::Middle, if clicked < n { 0..n } else { n..2 * n }),
            (MaskChoice::Largest, 0..2 * n),
        ] {
            let options = SagdOptions { choice, decompose: false, ..SagdOptions::default() };
            let found = segment(&at, &views, clicked, &options).unwrap();
            assert_eq!(found.members, expected.collect::<Vec<u32>>(), "{choice:?} of {clicked}");
            assert_eq!((found.voting, &found.gaussians), (6, &at.subset(&found.members)));
        }
    }
    // with neighbours from the other ball in the prompt, only the mask of both covers all of it
    let wide = SagdOptions { choice: MaskChoice::Smallest, neighbours: 2 * COUNT, ..SagdOptions::default() };
    assert_eq!(segment(&at, &views, 0, &wide).unwrap().members.len(), 2 * COUNT);
}

#[test]
fn the_vote_needs_more_than_the_agreement() {
    let mut at = one([-0.2, 0.0, 0.0], [-5.0; 3]);
    add(&mut at, [0.2, 0.0, 0.0], [-5.0; 3]);
    // Gaussian 1 is inside the masks of `wide` of the ten views
    let views = |wide: usize| (0..10).map(|v| ahead(vec![left(if v < wide { 100 } else { 50 })])).collect::<Vec<_>>();
    let members = |wide| segment(&at, &views(wide), 0, &SagdOptions::default()).unwrap().members;
    assert_eq!((members(7), members(8)), (vec![0], vec![0, 1]));
    let low = SagdOptions { agreement: 0.2, ..SagdOptions::default() };
    assert_eq!(segment(&at, &views(3), 0, &low).unwrap().members, [0, 1]);
}

#[test]
fn a_gaussian_over_the_edge_is_cut_back_to_its_part_inside() {
    // from x = -0.28 to 0.12, and the mask ends at x = 0: seven tenths are inside
    let sigma = 0.4 / 6.0_f32;
    let mut at = one([-0.08, 0.0, 0.0], [sigma.ln(), -6.0, -6.0]);
    add(&mut at, [-0.3, 0.0, 0.0], [-5.0; 3]);
    let options = SagdOptions::default();
    let found = segment(&at, &[ahead(vec![left(50)])], 1, &options).unwrap();
    assert_eq!(found.members, [0, 1]);
    let (scale, x) = (found.gaussians.log_scales[0].exp() / sigma, found.gaussians.means[0]);
    assert!((scale - 0.8 * 0.7).abs() < 0.02, "{scale}");
    assert!((x + 0.14).abs() < 0.01, "{x}");
    // everything else is unchanged, in this Gaussian and in the one inside
    let mut back = found.gaussians.clone();
    (back.means[0], back.log_scales[0]) = (at.means[0], at.log_scales[0]);
    assert_eq!(back, at);
    // a second view of the same edge changes nothing
    let twice = segment(&at, &[ahead(vec![left(50)]), ahead(vec![left(50)])], 1, &options).unwrap();
    assert_eq!(twice.gaussians, found.gaussians);
    // the same along y, by a rotation about z, from the other end
    let mut turned = at.clone();
    let (sin, cos) = (std::f32::consts::FRAC_PI_4.sin(), std::f32::consts::FRAC_PI_4.cos());
    turned.rotations[..4].copy_from_slice(&[2.0 * cos, 0.0, 0.0, 2.0 * sin]);
    let rows: Vec<bool> = (0..10_000).map(|p| p / 100 >= 46).collect();
    turned.means[0] = -0.2;
    let found = segment(&turned, &[ahead(vec![Mask::from_rows(100, 100, &rows).unwrap()])], 1, &options).unwrap();
    assert!(found.gaussians.means[1] > 0.02 && (found.gaussians.means[0] + 0.2).abs() < 1e-5);
    assert_eq!(
        segment(&at, &[ahead(vec![left(50)])], 1, &SagdOptions { decompose: false, ..options }).unwrap().gaussians,
        at
    );
}

#[test]
fn gaussians_off_screen_behind_or_without_position_are_never_selected() {
    let mut at = one([-0.2, 0.0, 0.0], [-5.0; 3]);
    for mean in [
        [-9.0, 0.0, 0.0],
        [-0.2, 0.0, -9.0],
        [-0.2, 0.0, -4.0],
        [f32::NAN, 0.0, 0.0],
        [0.0, f32::NEG_INFINITY, 0.0],
        [0.0, 0.0, f32::INFINITY],
        [-3e38, 3e38, 3e38],
    ] {
        add(&mut at, mean, [-5.0; 3]);
    }
    add(&mut at, [-0.1, 0.0, 0.0], [f32::NAN, 90.0, f32::INFINITY]);
    at.rotations[8 * 4..].fill(0.0);
    let options = SagdOptions { neighbours: 20, ..SagdOptions::default() };
    let views = [ahead(vec![left(100)])];
    let found = segment(&at, &views, 0, &options).unwrap();
    assert_eq!(found.members, [0, 8]);
    for clicked in 1..8 {
        let options = SagdOptions::default();
        let found = segment(&at, &views, clicked, &options).unwrap();
        assert_eq!((found.members.len(), found.voting, found.gaussians.len()), (0, 0, 0), "{clicked}");
    }
    assert!(segment(&at, &[], 0, &options).unwrap().members.is_empty());
}

#[test]
fn bad_input_is_refused() {
    let at = APART.gaussians();
    let error = segment(&at, &balls(), 999, &SagdOptions::default()).unwrap_err();
    assert_eq!(error, SagdError::Clicked { clicked: 999, count: 2 * COUNT });
    let mut views = balls();
    views[2].masks.push(left(50));
    let error = segment(&at, &views, 0, &SagdOptions::default()).unwrap_err();
    assert_eq!(error.to_string(), "view 2: a mask of 100x100 pixels, but the camera has 40x40");
}

#[test]
fn the_same_bits_on_one_thread_and_on_three() {
    let (mut at, views) = (APART.gaussians(), balls());
    at.log_scales.iter_mut().step_by(3).for_each(|s| *s = -1.5);
    let run = |threads| on_threads(threads, || segment(&at, &views, 3, &SagdOptions::default()).unwrap());
    let found = run(1);
    assert_eq!(found, run(3));
    assert_ne!(found.gaussians, at.subset(&found.members), "something was cut");
}
