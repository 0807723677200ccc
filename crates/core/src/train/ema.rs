//! Exponential moving average (EMA) of a scene's parameters, shown and saved in place of the state after the last step.
//!
//! Each step sees one view and moves the parameters towards it; their mean over the last steps is closer to what suits
//! all views (Polyak and Juditsky 1992). Steps continue from the parameters themselves, so the average changes none of
//! them.

use super::densify::{RowSource, apply};
use crate::model::params::{self, HostTensor, ParameterPath};
use crate::model::{Gaussians, Scene};
use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::Tensor;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// Steps between two updates.
const EVERY: usize = 10;
/// During warm-up, the window is one in this many of the steps since the average began, so that early in a training it
/// does not lag behind.
const WARMUP_DIVISOR: usize = 10;
/// Bounds of the window in steps: two updates, and what a checkpoint counts exactly.
pub(super) const WINDOWS: RangeInclusive<usize> = 2 * EVERY..=1_000_000;
/// Prefix, in a checkpoint, of the parameters that steps continue from.
const TRAINED: &str = "trained.";
/// Key, in a checkpoint, of the number of updates of the average.
const UPDATES: &str = "average.updates";

/// The average, empty before the first update.
#[derive(Debug)]
pub(super) struct Ema {
    /// Steps in which the weight of earlier parameters falls by a factor of e; 0 disables the average.
    window: usize,
    /// The mean, without gradients, and the number of its updates, counted only until the window has its full size.
    mean: Option<(Scene, usize)>,
}

impl Ema {
    /// Returns an empty average with a window of `window` steps; 0 disables it.
    pub(super) fn new(window: usize) -> Self {
        Self { window, mean: None }
    }

    /// The average, if there is one.
    pub(super) fn scene(&self) -> Option<&Scene> {
        self.mean.as_ref().map(|(scene, _)| scene)
    }

    /// Starts over, as when the set of Gaussians changes.
    pub(super) fn clear(&mut self) {
        self.mean = None;
    }

    /// Moves the average towards the parameters after `steps` steps, if an update is due.
    pub(super) fn update(&mut self, steps: usize, trained: &Scene) {
        if self.window == 0 || !steps.is_multiple_of(EVERY) {
            return;
        }
        let trained = trained.valid();
        let Some((mean, updates)) = self.mean.take() else {
            self.mean = Some((trained, 1));
            return;
        };
        let updates = (updates + 1).min(WARMUP_DIVISOR * self.window.div_ceil(EVERY));
        let weight = 1.0 / updates.div_ceil(WARMUP_DIVISOR) as f32;
        let spec = trained.spec.clone();
        let mut blend = Blend { path: ParameterPath::default(), values: handles(&trained), weight };
        drop(trained);
        let mean = Module::map(mean, &mut blend);
        self.mean = Some((Scene { spec, ..mean }, updates));
    }

    /// Reorders its Gaussians by `rows`, which keep all of them.
    pub(super) fn rearrange(&mut self, rows: &[RowSource]) {
        if let Some((scene, _)) = &mut self.mean {
            let device = scene.gaussians.means.val().device();
            let moved = apply(rows, &scene.gaussians.to_host(), 0, 0);
            scene.gaussians = Gaussians::from_host(moved, &device);
        }
    }

    /// Returns what a checkpoint needs besides the average itself, which is its model; empty if there is no average.
    pub(super) fn to_tensors(&self, trained: &Scene) -> BTreeMap<String, HostTensor> {
        let Some((_, updates)) = &self.mean else { return BTreeMap::new() };
        let own = params::collect(trained).into_iter().map(|(name, tensor)| (format!("{TRAINED}{name}"), tensor));
        own.chain([(UPDATES.to_owned(), HostTensor { shape: vec![1], values: vec![*updates as f32] })]).collect()
    }

    /// Restores what [`Ema::to_tensors`] returned, where `model` is the model of the checkpoint, and returns the
    /// scene that steps continue from.
    ///
    /// # Errors
    /// A message naming a tensor that does not fit.
    pub(super) fn load(&mut self, model: Scene, tensors: &BTreeMap<String, HostTensor>) -> Result<Scene, String> {
        self.mean = None;
        let Some(updates) = tensors.get(UPDATES) else { return Ok(model) };
        let [updates] = updates.values[..] else {
            return Err(format!("{UPDATES} has {} values, expected 1", updates.values.len()));
        };
        if !(1.0..=*WINDOWS.end() as f32).contains(&updates) || updates.fract() != 0.0 {
            return Err(format!("{UPDATES} is not a number of updates"));
        }
        let mut own = BTreeMap::new();
        for (name, size) in params::sizes(&model) {
            let tensor =
                tensors.get(&format!("{TRAINED}{name}")).ok_or_else(|| format!("{TRAINED}{name} is missing"))?;
            if tensor.values.len() != size {
                return Err(format!("{TRAINED}{name} has {} values, expected {size}", tensor.values.len()));
            }
            if tensor.values.iter().any(|v| !v.is_finite()) {
                return Err(format!("{TRAINED}{name} has values that are not finite"));
            }
            own.insert(name, tensor.clone());
        }
        let trained = params::load(model.clone(), &own).map_err(|e| format!("{TRAINED}*: {e}"))?;
        // a run may be resumed without its average
        self.mean = (self.window > 0).then(|| (model.valid(), updates as usize));
        Ok(trained)
    }
}

/// Returns the parameters of a scene by name, flat.
fn handles(scene: &Scene) -> BTreeMap<String, Tensor<1>> {
    struct Handles {
        path: ParameterPath,
        out: BTreeMap<String, Tensor<1>>,
    }
    impl ModuleVisitor for Handles {
        fn enter_module(&mut self, name: &str, _: &str) {
            self.path.enter(name);
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.path.exit();
        }
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let value = param.val();
            let count = value.dims().iter().product::<usize>();
            self.out.insert(self.path.name(), value.reshape([count]));
        }
    }
    let mut handles = Handles { path: ParameterPath::default(), out: BTreeMap::new() };
    scene.visit(&mut handles);
    handles.out
}

/// Moves each parameter towards the value of the same name.
struct Blend {
    path: ParameterPath,
    values: BTreeMap<String, Tensor<1>>,
    weight: f32,
}

impl ModuleMapper for Blend {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.enter(name);
    }
    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.exit();
    }
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let Some(value) = self.values.remove(&self.path.name()) else { return param };
        let mean = param.into_value();
        let towards = value.reshape(mean.dims()).sub(mean.clone()).mul_scalar(self.weight);
        Param::from_tensor(mean.add(towards))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::fixture::scene;

    fn moved(scene: &Scene, by: f32) -> Scene {
        let mut tensors = params::collect(scene);
        tensors.values_mut().flat_map(|t| &mut t.values).for_each(|v| *v += by);
        params::load(scene.clone(), &tensors).unwrap()
    }

    /// Returns `a - b` for the parameters, asserting that it is the same for all.
    fn difference(a: &Scene, b: &Scene) -> f32 {
        let (a, b) = (params::collect(a), params::collect(b));
        let all: Vec<f32> =
            a.iter().flat_map(|(name, t)| t.values.iter().zip(&b[name].values).map(|(a, b)| a - b)).collect();
        assert!(all.iter().all(|d| (d - all[0]).abs() < 1e-5), "{all:?}");
        all[0]
    }

    #[test]
    fn its_window_is_a_tenth_of_the_steps_up_to_the_given_window() {
        let start = scene();
        let mut average = Ema::new(40);
        for steps in 1..10 {
            average.update(steps, &start);
        }
        assert!(average.scene().is_none(), "it is updated once in ten steps");
        let mut expected = 0.0;
        for i in 0..50 {
            average.update(10 * (i + 1), &moved(&start, i as f32));
            let window = match i {
                0..10 => 1.0,
                10..20 => 2.0,
                20..30 => 3.0,
                _ => 4.0,
            };
            expected += (i as f32 - expected) / window;
            assert!((difference(average.scene().unwrap(), &start) - expected).abs() < 1e-4, "update {i}");
        }
        average.clear();
        assert!(average.scene().is_none());
        let mut none = Ema::new(0);
        none.update(10, &start);
        assert!(none.scene().is_none() && none.to_tensors(&start).is_empty());
    }

    #[test]
    fn it_is_restored_from_a_checkpoint_and_invalid_tensors_are_named() {
        let start = scene();
        let mut average = Ema::new(1000);
        (1..15).for_each(|i| average.update(10 * i, &moved(&start, i as f32)));
        let trained = moved(&start, 5.0);
        let tensors = average.to_tensors(&trained);
        let mut again = Ema::new(1000);
        let back = again.load(average.scene().unwrap().clone(), &tensors).unwrap();
        assert_eq!(params::collect(&back), params::collect(&trained));
        for a in [&mut average, &mut again] {
            a.update(150, &trained);
        }
        assert_eq!(params::collect(again.scene().unwrap()), params::collect(average.scene().unwrap()));

        let poison = [f32::NAN].repeat(tensors["trained.gaussians.means"].values.len());
        for (name, values) in [
            (UPDATES, vec![0.5]),
            (UPDATES, vec![f32::NAN]),
            (UPDATES, vec![]),
            ("trained.gaussians.sh", vec![0.0; 3]),
            ("trained.gaussians.means", poison),
        ] {
            let mut bad = tensors.clone();
            bad.insert(name.into(), HostTensor { shape: vec![values.len()], values });
            let error = again.load(start.clone(), &bad).unwrap_err();
            assert!(error.contains(name), "{error}");
            assert!(again.scene().is_none());
        }
        let mut less = tensors.clone();
        less.remove("trained.gaussians.rotations");
        assert!(again.load(start.clone(), &less).unwrap_err().contains("trained.gaussians.rotations is missing"));
        let mut without = Ema::new(0);
        assert_eq!(params::collect(&without.load(start.clone(), &tensors).unwrap()), params::collect(&trained));
        assert!(without.scene().is_none(), "a run may continue without its average");
        assert_eq!(params::collect(&again.load(start.clone(), &BTreeMap::new()).unwrap()), params::collect(&start));
    }

    #[test]
    fn it_follows_the_order_of_the_gaussians() {
        let start = scene();
        let mut average = Ema::new(100);
        average.update(10, &start);
        let n = start.gaussians.count();
        let rows: Vec<RowSource> = (0..n).rev().map(RowSource::Keep).collect();
        average.rearrange(&rows);
        let flat = |scene: &Scene| params::to_vec(scene.gaussians.means.val());
        let reversed: Vec<f32> = flat(&start).chunks(3).rev().flatten().copied().collect();
        assert_eq!(flat(average.scene().unwrap()), reversed);
    }
}
