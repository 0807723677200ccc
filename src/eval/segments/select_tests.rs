//! Tests that the fixed selection knows nothing of the ground truth but where it was clicked.

use super::super::oracle;
use super::super::prompt::ClickPrompt;
use super::super::train::{LiftedField, TrainedMethods};
use super::super::truth::LabelledTrainingView;
use super::*;
use crate::config::types::SegmentConfig;
use crate::config::types::segment::ClickConfig;
use crate::data::Camera;
use crate::data::truth::LabelledView;
use crate::device::DeviceName;
use crate::segment::baselines::saga::{SagaOptions, train as train_saga};
use crate::segment::baselines::sagd::SagdView;
use crate::segment::coarse::coarse;
use crate::segment::fine::AffinityField;
use crate::segment::fine::network::PositionBox;
use crate::segment::test_support::{APART, COUNT, rendering};
use glam::DVec3;
use std::collections::HashMap;

const SIZE: u32 = 40;

/// Two balls of two colours, and what every method needs; untrained fields select something too.
fn scene() -> (HostGaussians, TrainedMethods) {
    let device = DeviceName::all()[0].open().unwrap();
    let mut at = APART.gaussians();
    for (i, sh) in at.sh.chunks_exact_mut(3).enumerate() {
        sh.copy_from_slice(if i < COUNT { &[1.2, -1.2, -1.2] } else { &[-1.2, -1.2, 1.2] });
    }
    let all = MethodSetting::tries(SelectionMethod::Coarse, &SegmentConfig::default());
    let colours = all.iter().filter_map(|setting| match setting {
        MethodSetting::Coarse(of) => Some((*of, coarse(&at, None, &of.within(&SegmentConfig::default()), 0).unwrap())),
        _ => None,
    });
    let field = || {
        Some(LiftedField {
            field: AffinityField::new(4, &device),
            frame: PositionBox::around(&at.means),
            spreads: Vec::new(),
        })
    };
    let options = SagaOptions { steps: 30, pixels: 48, scales: 2, ..SagaOptions::default() };
    let trained = TrainedMethods {
        colours: colours.collect(),
        parts: field(),
        whole: field(),
        saga: Some(train_saga(&APART.prepared(&at), &at.means, &options, |_, _| true).unwrap()),
        votes: Some(APART.views().into_iter().map(|(camera, masks)| SagdView { camera, masks }).collect()),
        seconds: HashMap::new(),
    };
    (at, trained)
}

/// A view from the front, whose pixel at column `x` and row `y` has the label that `label` returns.
fn view(label: impl Fn(u32, u32) -> u16) -> LabelledTrainingView {
    let camera = Camera::look_at(DVec3::new(0.0, -4.0, 0.5), DVec3::ZERO, DVec3::Z, 0.6, SIZE, SIZE);
    let labels = (0..SIZE * SIZE).map(|p| label(p % SIZE, p / SIZE)).collect();
    LabelledTrainingView {
        view: LabelledView { name: "train/r_0".into(), path: "r_0.png".into(), camera, time: 0.5 },
        labels,
    }
}

#[test]
fn labels_outside_of_the_clicked_pixel_do_not_change_what_is_selected() {
    let device = DeviceName::all()[0].open().unwrap();
    let (at, trained) = scene();
    let config = SegmentConfig::default();
    let scenery = Scenery { at: &at, trained: &trained, config: &config };
    let prompt = |labels: &dyn Fn(u32, u32) -> u16| {
        ClickPrompt::new(&[view(labels)], &[3], (&at, rendering()), (1, &ClickConfig::default()), &device)
            .unwrap()
            .unwrap()
    };
    // a disc around where one of the balls is seen
    let whole = prompt(&|x, y| if x.abs_diff(12).pow(2) + y.abs_diff(20).pow(2) < 36 { 3 } else { 5 });
    let [x, y] = whole.pixel;
    // all other pixels blank, and all other pixels with other labels
    let alone = prompt(&|i, j| if [i, j] == [x, y] { 3 } else { 0 });
    let others = prompt(&|i, j| if [i, j] == [x, y] { 3 } else { 4 + ((7 * i + 3 * j) % 5) as u16 });
    let mut chosen = 0;
    for method in SelectionMethod::ALL {
        let setting = MethodSetting::fixed(method, &SegmentConfig::default());
        let of = |p: &ClickPrompt| fixed(scenery, (method, &setting), p.first(), 1, |_| None).unwrap();
        let found = of(&whole);
        for other in [&alone, &others] {
            assert_eq!(other.pixel, whole.pixel);
            let again = of(other);
            assert_eq!((again.selected, again.setting), (found.selected.clone(), found.setting.clone()), "{method}");
        }
        assert_eq!((found.fit, found.clicks), (None, 1));
        chosen += usize::from(!found.selected.members.is_empty());
    }
    assert_eq!(chosen, 5, "each method selects something, so that there is something to compare");
    // the oracle does know the other labels
    let best = |p: &ClickPrompt| oracle::best(scenery, SelectionMethod::Coarse, p, 1).unwrap().fit;
    assert_ne!(best(&whole), best(&alone));
}

#[test]
fn further_clicks_add_to_what_is_selected() {
    let device = DeviceName::all()[0].open().unwrap();
    let (at, trained) = scene();
    let config = SegmentConfig::default();
    let scenery = Scenery { at: &at, trained: &trained, config: &config };
    // both balls are wanted
    let prompt = ClickPrompt::new(&[view(|_, _| 3)], &[3], (&at, rendering()), (2, &ClickConfig::default()), &device)
        .unwrap()
        .unwrap();
    let [first, second] = [3, COUNT as u32 + 3].map(|i| Click { under: vec![(i, 1.0)] });
    let setting = MethodSetting::fixed(SelectionMethod::Coarse, &SegmentConfig::default());
    let one = fixed(scenery, (SelectionMethod::Coarse, &setting), first.clone(), 1, |_| Some(second.clone())).unwrap();
    let two = fixed(scenery, (SelectionMethod::Coarse, &setting), first, 2, |_| Some(second.clone())).unwrap();
    assert_eq!((one.clicks, two.clicks), (1, 2));
    assert!(one.selected.members.iter().all(|i| (*i as usize) < COUNT));
    assert!(two.selected.members.len() > one.selected.members.len() + COUNT / 2);
    assert!(
        prompt.fit(&oracle::flags(&two.selected.members, at.len()))
            > prompt.fit(&oracle::flags(&one.selected.members, at.len()))
    );
    // a click on nothing selects nothing
    let nowhere = Click { under: Vec::new() };
    for method in SelectionMethod::ALL {
        let setting = MethodSetting::fixed(method, &SegmentConfig::default());
        let found = fixed(scenery, (method, &setting), nowhere.clone(), 1, |_| None).unwrap();
        assert_eq!(found.selected, SelectedGaussians::default(), "{method}");
    }
}

#[test]
fn moved_gaussians_keep_the_position_of_the_selection() {
    let at = APART.gaussians();
    let moved = (vec![0.5, 0.0, 0.0, 0.0, 0.25, 0.0], vec![0.0, 0.0, -1.0, 0.0, 0.0, 0.0]);
    let selected = SelectedGaussians { members: vec![2, 7], moved, asked: None };
    let all = selected.within(&at);
    assert_eq!(all.subset(&selected.members), selected.gaussians(&at));
    assert_eq!((all.means[3 * 2], all.means[3 * 7 + 1]), (at.means[6] + 0.5, at.means[22] + 0.25));
    assert_eq!(all.subset(&[0, 5]), at.subset(&[0, 5]));
    let plain = SelectedGaussians { members: vec![1, 7], ..SelectedGaussians::default() };
    let both = plain.with(&selected);
    assert_eq!((both.members.clone(), both.moved.0[..3].to_vec()), (vec![1, 2, 7], vec![0.0; 3]));
    assert_eq!(both.moved.0[6..], [0.0; 3], "where both have it, as the first has it");
    assert!(both.moves() && !plain.moves());
}
