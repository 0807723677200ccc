//! Levels at clicks on balls and on beads that touch.

use super::*;
use crate::config::types::SegmentConfig;
use crate::config::types::segment::{AffinityConfig, PiecesConfig};
use crate::device::DeviceName;
use crate::segment::fine::AffinityField;
use crate::segment::fine::network::PositionBox;
use crate::segment::fine::train::train;
use crate::segment::pick::{Granularity, PickOptions, pick};
use crate::segment::test_support::{APART, COUNT, surfaces};

#[test]
fn a_click_on_a_ball_selects_it_and_pick_uses_the_same_levels() {
    let device = DeviceName::all()[0].open().unwrap();
    let at = APART.gaussians();
    // the features of the balls separate only after the first few hundred steps
    let options = AffinityConfig { steps: 2000, pixels: 64, ..AffinityConfig::default() };
    let field = train(&APART.prepared(&at), &options, 0, &device, |_, _| true).unwrap();
    let strays = PiecesConfig { strays: false, ..PiecesConfig::default() };
    let config = SegmentConfig { pieces: strays, ..SegmentConfig::default() };
    let frame = PositionBox::around(&at.means);
    let of = |within| ClickCandidates::new(&field, &frame, &at.means, &at, within, &config);
    let all: Vec<u32> = (0..at.len() as u32).collect();
    let balls = [&all[..COUNT], &all[COUNT..]];
    for clicked in [3, 31, COUNT as u32 + 7] {
        let mine = balls[usize::from(clicked as usize >= COUNT)];
        let (found, likeliest) = levels(&of(&all), clicked).unwrap();
        assert!(overlap(&found[likeliest].members, mine) > 0.9, "{:?}", found[likeliest]);
        assert!(found.iter().all(|l| l.members.binary_search(&clicked).is_ok()));
        assert!(found.is_sorted_by_key(|l| l.members.len()));
        let Level { scale, threshold, .. } = found[likeliest];
        let take = |meaning, list| pick(&of(&all), clicked, &PickOptions { meaning, list }).unwrap();
        let by_hand = Granularity::By { scale, threshold };
        assert_eq!(take(by_hand, false).members, found[likeliest].members);
        assert_eq!(take(by_hand, true).levels, found);
        assert_eq!(take(Granularity::Likeliest, false).members, found[likeliest].members);
        let picked = take(Granularity::Likeliest, true);
        assert_eq!((picked.level, &picked.members), (Some(likeliest), &found[likeliest].members));
        assert_eq!(picked.levels, found);
        assert_eq!(take(Granularity::Level(likeliest), false).members, found[likeliest].members);
        assert_eq!(take(Granularity::Level(99), false).level, Some(found.len() - 1), "there are no more");
        assert_eq!(levels(&of(&all), clicked).unwrap(), (found, likeliest), "the same levels again");
    }
    assert!(levels(&of(&all[1..]), 0).is_err());
    assert_eq!(levels(&of(&[5]), 5).unwrap().0[0].members, [5], "alone");
    // in a segment that holds the first ball and half of the second, the piece is the first ball
    let most = &all[..COUNT + COUNT / 2];
    let (found, likeliest) = levels(&of(most), 31).unwrap();
    assert!(
        found[likeliest].kind == LevelKind::Piece && overlap(&found[likeliest].members, balls[0]) > 0.95,
        "{:?}",
        found[likeliest]
    );
    let options = PickOptions { meaning: Granularity::Likeliest, list: true };
    let picked = pick(&of(most), 31, &options).unwrap();
    assert_eq!((picked.level, &picked.members), (Some(likeliest), &found[likeliest].members));
    let alone = pick(&of(most), 31, &PickOptions { list: false, ..options }).unwrap();
    assert_eq!(alone.members, picked.members, "the piece is found without the others");
}

#[test]
fn a_click_on_one_of_two_touching_beads_selects_it_and_a_higher_level_has_both() {
    let (device, config) = (DeviceName::all()[0].open().unwrap(), SegmentConfig::default());
    // a third one far away, so that the beads are not the whole scene
    let (at, bead_of) = surfaces(&[(-0.9, 1.0), (0.9, 1.0), (9.0, 0.5)]);
    let (field, frame) = (AffinityField::new(1, &device), PositionBox::around(&at.means));
    let within: Vec<u32> = (0..at.len() as u32).filter(|&i| bead_of[i as usize] < 2).collect();
    let of = ClickCandidates::new(&field, &frame, &at.means, &at, &within, &config);
    for bead in 0..2 {
        let own: Vec<u32> = within.iter().copied().filter(|&i| bead_of[i as usize] == bead).collect();
        let clicked = own[own.len() / 2];
        let (found, n) = levels(&of, clicked).unwrap();
        assert!(found[n].kind == LevelKind::Part && overlap(&found[n].members, &own) > 0.9, "{bead}");
        assert!(
            found[n + 1..].iter().any(|l| l.kind == LevelKind::Piece && l.members == within),
            "both together are a level too"
        );
        assert_eq!(likeliest(&of, clicked).unwrap(), found[n]);
    }
}

#[test]
fn a_segment_of_all_gaussians_has_pieces_and_the_whole_scene_has_none() {
    let (device, config) = (DeviceName::all()[0].open().unwrap(), SegmentConfig::default());
    let at = APART.gaussians();
    let (field, frame) = (AffinityField::new(1, &device), PositionBox::around(&at.means));
    let all: Vec<u32> = (0..at.len() as u32).collect();
    let of = |segment| ClickCandidates::new(&field, &frame, &at.means, &at, &all, &config).of_segment(segment);
    let (found, n) = levels(&of(true), 31).unwrap();
    assert!(found[n].kind == LevelKind::Piece && likeliest(&of(true), 31).unwrap() == found[n]);
    assert!(
        found.iter().any(|l| l.kind == LevelKind::Piece && overlap(&l.members, &all[..COUNT]) > 0.9),
        "the clicked ball"
    );
    assert!(levels(&of(false), 31).unwrap().0.iter().all(|l| matches!(l.kind, LevelKind::Similar | LevelKind::Object)));
}

#[test]
fn the_whole_segment_and_all_that_is_connected_are_levels_too() {
    let (device, config) = (DeviceName::all()[0].open().unwrap(), SegmentConfig::default());
    // two balls that touch, of two colours, and a third, of the first colour, far away
    let (at, ball_of) = surfaces(&[(-0.97, 1.0), (0.97, 1.0), (9.0, 0.5)]);
    let (field, frame) = (AffinityField::new(1, &device), PositionBox::around(&at.means));
    let balls = |wanted: &[usize]| -> Vec<u32> {
        (0..at.len() as u32).filter(|&i| wanted.contains(&ball_of[i as usize])).collect()
    };
    let within = balls(&[0, 2]);
    let of = ClickCandidates::new(&field, &frame, &at.means, &at, &within, &config);
    let clicked = balls(&[0])[7];
    let take = |meaning| pick(&of, clicked, &PickOptions { meaning, ..PickOptions::default() });
    for (kind, expected) in
        [(LevelKind::Piece, vec![0]), (LevelKind::Segment, vec![0, 2]), (LevelKind::Object, vec![0, 1])]
    {
        let picked = take(Granularity::OfKind(kind)).unwrap();
        assert_eq!((picked.kind, picked.members), (kind, balls(&expected)));
    }
    let likeliest = take(Granularity::Likeliest).unwrap();
    assert_eq!((likeliest.kind, likeliest.members), (LevelKind::Piece, balls(&[0])));
    let (found, n) = levels(&of, clicked).unwrap();
    assert_eq!(found[n].kind, LevelKind::Piece);
    assert!(found.is_sorted_by_key(|l| l.members.len()));
    let shown = |kind| found.iter().find(|l| l.kind == kind).unwrap().share;
    assert!(
        shown(LevelKind::Object) > shown(LevelKind::Segment) && shown(LevelKind::Segment) > shown(LevelKind::Piece),
        "in the scene"
    );
    let error = take(Granularity::OfKind(LevelKind::Part)).unwrap_err().to_string();
    assert!(error.contains("no part") && error.contains("piece, segment, object"), "{error}");
}

#[test]
fn a_plateau_is_found_between_two_slopes() {
    let config = &LevelsConfig::default();
    // 100 Gaussians with cosines of 0.45 to 0.55, and the 50 of the object itself at 0.92
    let cosines: Vec<f32> = (0..100).map(|n| 0.45 + 0.001 * n as f32).chain((0..50).map(|_| 0.92)).collect();
    let sizes = sizes(&cosines, &[1.0; 150], 1.0, config);
    assert_eq!((sizes[0], sizes[10], sizes[21]), (150.0, 50.0, 1.0));
    let found = plateaus(&sizes, config);
    assert!(found.iter().any(|(k, s)| *s == 1.0 && sizes[*k] == 50.0), "{found:?}");
    let steep: Vec<f64> = (0..22).map(|k| 0.1f64.powi(k)).collect();
    assert_eq!(plateaus(&steep, config).len(), 1, "only the best where none is stable");
}

#[test]
fn non_finite_gaussians_weigh_nothing_and_match_nothing() {
    let mut at = APART.gaussians();
    (at.log_scales[0], at.opacity_logits[1]) = (f32::NAN, f32::INFINITY);
    assert_eq!(sizes(&[f32::NAN, 2.0], &[5.0, 1.0], 0.5, &SegmentConfig::default().levels)[0], 1.0);
    let (device, config) = (DeviceName::all()[0].open().unwrap(), SegmentConfig::default());
    let (field, frame) = (AffinityField::new(1, &device), PositionBox::around(&at.means));
    at.means[30] = f32::NAN;
    let all: Vec<u32> = (0..at.len() as u32).collect();
    let of = ClickCandidates::new(&field, &frame, &at.means, &at, &all, &config);
    let (found, likeliest) = levels(&of, 10).unwrap();
    assert!(found[likeliest].members.contains(&10));
}
