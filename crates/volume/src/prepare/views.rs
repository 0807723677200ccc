//! Which cameras look at which step of a series. No volumes, no images.

use crate::data::Camera;
use crate::data::paths::{Axis, FOV_X, Lens, RADIUS, biased, deal_times, test_spiral, time_indices, training_cameras};

/// The layout of training and test views; the defaults are those of the published datasets.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewOptions {
    /// Width and height of the images in pixels.
    pub size: [u32; 2],
    /// Whole horizontal field of view, radians.
    pub fov_x: f64,
    /// Distance of the cameras from the centre, scene units.
    pub radius: f64,
    /// Steps of the series that training sees.
    pub times: TrainingTimes,
    /// Number of training views of each of these steps.
    pub views_per_time: usize,
    /// Test views along the spiral.
    pub test_views: usize,
    /// Take training views within this angle (radians) of an axis, instead of from the whole sphere.
    pub bias: Option<(Axis, f64)>,
    /// Seed of the assignment of views to times.
    pub seed: u64,
}

/// Which steps training sees.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TrainingTimes {
    /// This many, evenly spread, including the first and the last (at most all of them).
    Count(usize),
    /// The given steps, counted from 0.
    Steps(Vec<usize>),
}

impl Default for ViewOptions {
    fn default() -> Self {
        Self {
            size: [800, 800],
            fov_x: FOV_X,
            radius: RADIUS,
            times: TrainingTimes::Count(30),
            views_per_time: 20,
            test_views: 181,
            bias: None,
            seed: 0,
        }
    }
}

/// One image to be made.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedView {
    /// Its camera.
    pub camera: Camera,
    /// Its step of the series.
    pub step: usize,
}

/// The training views of a series of `steps` steps: a spherical Fibonacci set, assigned to the sampled steps.
pub fn training_views(options: &ViewOptions, steps: usize) -> Vec<PlannedView> {
    let sampled = match &options.times {
        TrainingTimes::Count(n) => time_indices((*n).min(steps), steps),
        TrainingTimes::Steps(list) => list.clone(),
    };
    let n = sampled.len() * options.views_per_time;
    let lens = options.lens();
    let cameras = match options.bias {
        Some((axis, angle)) => biased(n, options.radius, axis, angle, lens),
        None => training_cameras(n, options.radius, lens),
    };
    let deal = deal_times(sampled.len(), options.views_per_time, options.seed);
    cameras.into_iter().zip(deal).map(|(camera, t)| PlannedView { camera, step: sampled[t] }).collect()
}

/// The test views: the spiral from pole to pole while time runs through all steps.
pub fn test_views(options: &ViewOptions, steps: usize) -> Vec<PlannedView> {
    let last = steps.saturating_sub(1) as f64;
    test_spiral(options.test_views, steps, options.radius, options.lens())
        .into_iter()
        .map(|(camera, time)| PlannedView { camera, step: (time * last).round() as usize })
        .collect()
}

impl ViewOptions {
    fn lens(&self) -> Lens {
        Lens { fov_x: self.fov_x, width: self.size[0], height: self.size[1] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_published_layout_is_the_default() {
        let train = training_views(&ViewOptions::default(), 100);
        assert_eq!(train.len(), 600);
        let mut steps: Vec<usize> = train.iter().map(|v| v.step).collect();
        steps.sort_unstable();
        assert_eq!(steps.iter().filter(|s| **s == 99).count(), 20);
        steps.dedup();
        assert_eq!(steps, time_indices(30, 100));
        let test = test_views(&ViewOptions::default(), 100);
        assert_eq!((test.len(), test[0].step, test[45].step, test[180].step), (181, 0, 24, 99));
    }

    #[test]
    fn few_steps_and_chosen_steps() {
        let options = ViewOptions { views_per_time: 2, test_views: 5, ..ViewOptions::default() };
        let train = training_views(&options, 3);
        assert_eq!(train.len(), 6);
        assert!(test_views(&options, 1).iter().all(|v| v.step == 0));
        let chosen = ViewOptions { times: TrainingTimes::Steps(vec![1]), ..options.clone() };
        assert!(training_views(&chosen, 3).iter().all(|v| v.step == 1));
        let biased = ViewOptions { bias: Some((Axis::Y, 0.3)), ..options };
        for view in training_views(&biased, 3) {
            let p = view.camera.position() / biased.radius;
            assert!(p.y.abs() >= 0.3f64.cos() - 1e-12, "{p}");
        }
    }
}
