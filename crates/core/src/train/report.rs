//! Outcome and timings of a step.

use std::time::{Duration, Instant};

/// Times of the parts of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepTimes {
    /// Choosing and compositing the view.
    pub data: Duration,
    /// Forward pass of field and decoder, or of another network.
    pub deform: Duration,
    /// Forward pass of splatting, or of another renderer.
    pub splat: Duration,
    /// Forward pass of the loss.
    pub loss: Duration,
    /// The whole backward pass.
    pub backward: Duration,
    /// Optimiser.
    pub adam: Duration,
    /// Statistics and densification.
    pub densify: Duration,
}

impl StepTimes {
    fn parts(&mut self) -> [&mut Duration; 7] {
        let Self { data, deform, splat, loss, backward, adam, densify } = self;
        [data, deform, splat, loss, backward, adam, densify]
    }
}

/// Runs a part of a step, and adds its time to `slot`.
pub fn timed<T>(slot: &mut Duration, part: impl FnOnce() -> T) -> T {
    let began = Instant::now();
    let result = part();
    *slot += began.elapsed();
    result
}

/// Mean times of several steps. What is due at every tenth or hundredth step would be in each step that is logged, or
/// in none.
#[derive(Clone, Copy, Debug, Default)]
pub struct MeanTimes {
    sum: StepTimes,
    steps: u32,
}

impl MeanTimes {
    /// Adds a step.
    pub fn add(&mut self, mut times: StepTimes) {
        for (sum, time) in self.sum.parts().into_iter().zip(times.parts()) {
            *sum += *time;
        }
        self.steps += 1;
    }

    /// Returns the mean of the steps added so far, zeros if there are none, and forgets them.
    pub fn take(&mut self) -> StepTimes {
        let Self { mut sum, steps } = std::mem::take(self);
        sum.parts().into_iter().for_each(|time| *time /= steps.max(1));
        sum
    }
}

/// Outcome of a step.
#[derive(Clone, Copy, Debug)]
pub struct StepReport {
    /// Global step, from 0.
    pub step: usize,
    /// Name of its stage: `warmup` or `joint`; `train` for a method without stages.
    pub stage: &'static str,
    /// Total loss; on a device that runs ahead of the host, that of the last step that was read.
    pub loss: f64,
    /// PSNR of that step's training view, decibels.
    pub psnr: f64,
    /// Gaussians after the step; 0 for a method without primitives.
    pub primitives: usize,
    /// Times of its parts.
    pub times: StepTimes,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_the_mean_of_the_steps_since_the_last_ones() {
        let mut mean = MeanTimes::default();
        assert_eq!(mean.take(), StepTimes::default());
        let ms = Duration::from_millis;
        mean.add(StepTimes { data: ms(2), densify: ms(30), ..StepTimes::default() });
        mean.add(StepTimes { data: ms(4), adam: ms(5), ..StepTimes::default() });
        let times =
            StepTimes { data: ms(3), adam: Duration::from_micros(2500), densify: ms(15), ..StepTimes::default() };
        assert_eq!(mean.take(), times);
        mean.add(StepTimes { loss: ms(7), ..StepTimes::default() });
        assert_eq!(mean.take(), StepTimes { loss: ms(7), ..StepTimes::default() });
    }
}
