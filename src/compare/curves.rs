//! Learning curves from the `metrics.jsonl` of run folders, and their means over seeds.
//!
//! A curve only illustrates a run, so nothing here fails: a missing file, or a line left half-written by a killed run,
//! only means fewer points.

use crate::files::RunPaths;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Approximate number of points of a smoothed curve.
const SMOOTHED: usize = 100;

/// The curves of one run, or the means over several. PSNR is in decibels; points are in the order of steps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curves {
    /// (step, PSNR on a few test views).
    pub test: Vec<(f64, f64)>,
    /// (step, PSNR on the view trained on).
    pub train: Vec<(f64, f64)>,
    /// (step, loss on the view trained on).
    pub loss: Vec<(f64, f64)>,
    /// (seconds of training, PSNR on a few test views).
    pub test_by_seconds: Vec<(f64, f64)>,
}

/// The fields read from a line.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
struct CurveRecord {
    step: u64,
    #[serde(default)]
    seconds: Option<f64>,
    #[serde(default)]
    loss: Option<f64>,
    #[serde(default)]
    train_psnr: Option<f64>,
    #[serde(default)]
    test_psnr: Option<f64>,
}

/// Reads the lines of a run by step; of several lines with the same step, the last one counts.
fn lines(run: &Path) -> BTreeMap<u64, CurveRecord> {
    let bytes = crate::files::read_regular(&RunPaths(run).metrics()).unwrap_or_default();
    let parsed = bytes.split(|b| *b == b'\n').filter_map(|line| serde_json::from_slice::<CurveRecord>(line).ok());
    parsed.map(|line| (line.step, line)).collect()
}

/// Reads the curves of the run in folder `run`.
pub fn read(run: &Path) -> Curves {
    mean(&[run])
}

/// Returns the mean curves of runs that differ only in the seed, at the steps common to all runs that have a curve.
pub fn mean(runs: &[&Path]) -> Curves {
    let runs: Vec<BTreeMap<u64, CurveRecord>> = runs.iter().map(|run| lines(run)).collect();
    let steps = |value: fn(&CurveRecord) -> Option<f64>| -> Vec<(u64, f64)> { mean_by_step(&runs, value) };
    let test = steps(|line| line.test_psnr);
    // seconds only where there is a test PSNR, so that both have the same steps and runs
    let seconds = steps(|line| line.test_psnr.filter(|v| v.is_finite()).and(line.seconds));
    let seconds: BTreeMap<u64, f64> = seconds.into_iter().collect();
    let test_by_seconds = test.iter().filter_map(|(step, psnr)| Some((*seconds.get(step)?, *psnr))).collect();
    let points = |curve: Vec<(u64, f64)>| curve.into_iter().map(|(step, v)| (step as f64, v)).collect();
    let (train, loss) = (points(steps(|line| line.train_psnr)), points(steps(|line| line.loss)));
    Curves { test: points(test), train, loss, test_by_seconds }
}

fn mean_by_step(runs: &[BTreeMap<u64, CurveRecord>], value: fn(&CurveRecord) -> Option<f64>) -> Vec<(u64, f64)> {
    let mut sums: BTreeMap<u64, (f64, usize)> = BTreeMap::new();
    let mut with_curve = 0;
    for run in runs {
        let mut any = false;
        for (step, v) in run.iter().filter_map(|(step, line)| Some((*step, value(line).filter(|v| v.is_finite())?))) {
            let sum = sums.entry(step).or_default();
            *sum = (sum.0 + v, sum.1 + 1);
            any = true;
        }
        with_curve += usize::from(any);
    }
    // a step missing from one run would make the mean jump
    let whole = sums.into_iter().filter(|(_, (_, count))| *count == with_curve);
    whole.map(|(step, (sum, count))| (step, sum / count as f64)).collect()
}

/// Smooths a curve: at about 100 of its points, gives the value of a straight line fitted to the neighbourhood, a
/// twentieth of the curve.
pub fn smooth(curve: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let half = curve.len() / 40;
    let every = curve.len().div_ceil(SMOOTHED).max(1);
    // always includes the last point, where curves are compared
    let offset = curve.len().saturating_sub(1) % every;
    let at =
        |i: usize| (curve[i].0, line_at(&curve[i.saturating_sub(half)..(i + half + 1).min(curve.len())], curve[i].0));
    (0..curve.len()).skip(offset).step_by(every).map(at).collect()
}

/// Returns the value at `x` of the least-squares line through `near`. A mean would pull both ends of a curve inwards,
/// where the neighbourhood lies to one side.
fn line_at(near: &[(f64, f64)], x: f64) -> f64 {
    let count = near.len() as f64;
    let (mean_x, mean_y) =
        (near.iter().map(|p| p.0).sum::<f64>() / count, near.iter().map(|p| p.1).sum::<f64>() / count);
    let spread: f64 = near.iter().map(|p| (p.0 - mean_x).powi(2)).sum();
    if spread == 0.0 {
        return mean_y;
    }
    let slope = near.iter().map(|p| (p.0 - mean_x) * (p.1 - mean_y)).sum::<f64>() / spread;
    let low = near.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
    let high = near.iter().map(|p| p.1).fold(f64::NEG_INFINITY, f64::max);
    (mean_y + slope * (x - mean_x)).clamp(low, high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::fs::write;

    #[test]
    fn a_run_is_read_and_broken_lines_are_passed_over() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(read(dir.path()), Curves::default());
        let text = "{\"step\":10,\"seconds\":1.5,\"stage\":\"warmup\",\"loss\":0.1,\"train_psnr\":20.0}\n\
                    nonsense\n{\"step\":20,\"seconds\":3.0,\"loss\":null,\"train_psnr\":null,\"test_psnr\":25.0}\n\
                    {\"step\":-1,\"train_psnr\":3}\n\
                    {\"step\":20,\"seconds\":4.0,\"train_psnr\":22.0,\"test_psnr\":26.0}\n\
                    \u{fffd}\n{\"step\":30,\"seconds\":5";
        write(dir.path().join("metrics.jsonl"), text).unwrap();
        let curves = read(dir.path());
        assert_eq!(curves.test, [(20.0, 26.0)], "the last of two lines of a step");
        assert_eq!(curves.train, [(10.0, 20.0), (20.0, 22.0)]);
        assert_eq!(curves.test_by_seconds, [(4.0, 26.0)]);
    }

    #[test]
    fn the_mean_has_the_steps_that_all_have() {
        let dirs: Vec<_> = (0..3).map(|_| tempfile::tempdir().unwrap()).collect();
        let line = |step: u32, psnr: f64| {
            format!("{{\"step\":{step},\"seconds\":{},\"test_psnr\":{psnr}}}\n", psnr * f64::from(step))
        };
        write(dirs[0].path().join("metrics.jsonl"), line(1, 10.0) + &line(2, 20.0) + &line(3, 90.0)).unwrap();
        write(dirs[1].path().join("metrics.jsonl"), line(1, 30.0) + &line(2, 40.0)).unwrap();
        let runs: Vec<&Path> = dirs.iter().map(tempfile::TempDir::path).collect();
        let curves = mean(&runs);
        assert_eq!(curves.test, [(1.0, 20.0), (2.0, 30.0)], "the third run has no file and does not count");
        assert_eq!(curves.test_by_seconds, [(20.0, 20.0), (60.0, 30.0)]);
        assert_eq!((curves.train.len(), mean(&[])), (0, Curves::default()));
    }

    #[test]
    fn smoothing_keeps_lines_straight_and_the_end() {
        let line: Vec<(f64, f64)> = (0..999).map(|i| (f64::from(i), 2.0 * f64::from(i))).collect();
        let smoothed = smooth(&line);
        assert!(smoothed.len() <= 100 && smoothed.last() == Some(&(998.0, 1996.0)));
        assert!(smoothed.iter().all(|(x, y)| (y - 2.0 * x).abs() < 1e-9));
        assert_eq!(smooth(&[]), []);
        assert_eq!(smooth(&line[..1]), line[..1]);
    }

    proptest! {
        #[test]
        fn smoothing_stays_between_minimum_and_maximum(values in proptest::collection::vec(-50.0..50.0f64, 1..400)) {
            let curve: Vec<(f64, f64)> = values.iter().enumerate().map(|(i, v)| (i as f64, *v)).collect();
            let low = values.iter().copied().fold(f64::INFINITY, f64::min) - 1e-9;
            let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max) + 1e-9;
            for (_, v) in smooth(&curve) {
                prop_assert!((low..=high).contains(&v));
            }
        }
    }
}
