//! Comparison of the same training on several devices, step by step: speed, quality and drift of the parameters.

use crate::config::types::Config;
use crate::data::Dataset;
use crate::device::DeviceName;
use crate::method;
use crate::train::TrainError;
use crate::train::run::mean_psnr;
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// The result of a comparison of devices.
#[derive(Clone, Debug, Serialize)]
pub struct DeviceComparison {
    /// Steps taken.
    pub steps: usize,
    /// One for each device, the reference first.
    pub devices: Vec<DeviceResult>,
}

/// One device.
#[derive(Clone, Debug, Serialize)]
pub struct DeviceResult {
    /// Its name.
    pub device: String,
    /// Mean milliseconds per step, without the first one.
    pub step_milliseconds: f64,
    /// PSNR on 12 test views at the end (training views if there are none), in decibels.
    pub psnr: f64,
    /// How far it is from the first device, at some steps.
    pub drift: Vec<Drift>,
}

/// The largest relative difference of any parameter between two devices after a step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Drift {
    /// Steps taken.
    pub step: usize,
    /// Largest difference of two values; `None` once the devices have different numbers of Gaussians.
    pub largest: Option<f64>,
    /// The same, relative to the largest magnitude of that parameter.
    pub relative: Option<f64>,
    /// The parameter.
    pub parameter: String,
}

/// Trains `config` on each of `devices`, comparing them every `every` steps and reporting each comparison to `say`.
/// Ends early when `stop` is raised.
///
/// # Errors
/// If a device cannot start, or training fails.
pub fn compare_devices(
    config: &Config,
    dataset: &Dataset,
    devices: &[DeviceName],
    every: usize,
    stop: &AtomicBool,
    mut say: impl FnMut(&str),
) -> Result<DeviceComparison, TrainError> {
    let mut trainers = Vec::new();
    for name in devices {
        let device = name.open().map_err(|e| TrainError::Config(e.to_string()))?;
        trainers.push(method::start(config, dataset, &device)?);
    }
    let total = trainers.first().map_or(0, |trainer| trainer.total_steps());
    let every = every.max(1);
    let mut seconds = vec![0.0; devices.len()];
    let mut drifts = vec![Vec::new(); devices.len()];
    let mut done = 0;
    while done < total && !stop.load(Ordering::Relaxed) {
        // the first step separately, as it compiles kernels; then blocks of steps, so that no device waits for another
        let to = if done == 0 { 1 } else { total.min((done / every + 1) * every) };
        for (trainer, seconds) in trainers.iter_mut().zip(&mut seconds) {
            let started = Instant::now();
            for _ in done..to {
                trainer.step(&dataset.train)?;
            }
            // a device that works asynchronously may not have finished
            let _ = trainer.model().device().sync();
            if done > 0 {
                *seconds += started.elapsed().as_secs_f64();
            }
        }
        done = to;
        let reference = trainers[0].model().parameters();
        for (i, trainer) in trainers.iter().enumerate().skip(1) {
            let drift = drift(done, &reference, &trainer.model().parameters());
            say(&format!("{done}/{total} {} {drift}", devices[i]));
            drifts[i].push(drift);
        }
    }
    let split = dataset.test.as_ref().unwrap_or(&dataset.train);
    let results =
        devices.iter().zip(trainers).zip(seconds).zip(drifts).map(|(((name, trainer), seconds), drift)| DeviceResult {
            device: name.to_string(),
            step_milliseconds: 1e3 * seconds / done.saturating_sub(1).max(1) as f64,
            psnr: mean_psnr(trainer.model(), split, 12),
            drift,
        });
    Ok(DeviceComparison { steps: done, devices: results.collect() })
}

type HostTensors = std::collections::BTreeMap<String, crate::model::params::HostTensor>;

fn drift(step: usize, a: &HostTensors, b: &HostTensors) -> Drift {
    let mut worst = Drift { step, largest: Some(0.0), relative: Some(0.0), parameter: String::new() };
    for (name, x) in a {
        let Some(y) = b.get(name).filter(|y| y.shape == x.shape) else {
            return Drift { step, largest: None, relative: None, parameter: name.clone() };
        };
        let size = x.values.iter().fold(0.0f64, |m, v| m.max(f64::from(v.abs())));
        let pairs = x.values.iter().zip(&y.values);
        // a NaN on one device only, which `max` would skip, is an infinite difference
        let apart = |x: f32, y: f32| if x.to_bits() == y.to_bits() { 0.0 } else { f64::from((x - y).abs()) };
        let apart = pairs.map(|(x, y)| apart(*x, *y)).map(|gap| if gap.is_nan() { f64::INFINITY } else { gap });
        let gap = apart.fold(0.0, f64::max);
        let relative = gap / size.max(1e-12);
        if Some(relative) > worst.relative {
            worst = Drift { step, largest: Some(gap), relative: Some(relative), parameter: name.clone() };
        }
    }
    worst
}

impl std::fmt::Display for Drift {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match (self.largest, self.relative) {
            (Some(largest), Some(relative)) if largest > 0.0 => {
                write!(
                    f,
                    "largest difference {largest:.2e} ({relative:.1e} of the largest value) in {}",
                    self.parameter
                )
            }
            (Some(_), _) => f.write_str("bit-identical"),
            _ => write!(f, "different numbers of Gaussians ({})", self.parameter),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::params::HostTensor;

    #[test]
    fn nan_on_one_device_only_is_an_infinite_difference() {
        let of = |values: [f32; 2]| {
            HostTensors::from([("means".to_owned(), HostTensor { shape: vec![2], values: values.into() })])
        };
        assert_eq!(drift(1, &of([1.0, f32::NAN]), &of([1.0, f32::NAN])).to_string(), "bit-identical");
        let apart = drift(1, &of([1.0, 2.0]), &of([1.0, f32::NAN]));
        assert_eq!(apart.largest, Some(f64::INFINITY));
        assert!(apart.to_string().contains("means"), "{apart}");
        assert_eq!(drift(1, &of([1.0, 2.0]), &of([1.0, 2.5])).largest, Some(0.5));
    }
}
