//! Helpers shared by the tests of several methods.

use super::{Method, Model, Training};
use burn::tensor::{Device, Tensor, TensorData};
use std::collections::BTreeMap;
use std::path::Path;
use volseggs_core::config::sections::Settings;
use volseggs_core::config::types::Config;
use volseggs_core::device::DeviceName;
use volseggs_core::model::ToKernel;
use volseggs_core::model::params::{HostTensor, to_vec};
use volseggs_core::train::SavedTraining;
use volseggs_core::train::checkpoint::{self, CheckpointState};
use volseggs_volume::data::dataset::OpenOptions;
use volseggs_volume::data::fixture::write_sphere_dataset;
use volseggs_volume::data::{Dataset, Split};

/// Opens a compiled-in device for `volseggs_testing::on_every_device`; returns `None`, after reporting it, if it does
/// not start.
pub(super) fn open_to_test(name: &str) -> Option<Device> {
    let device = name.parse().and_then(DeviceName::open);
    device.map_err(|error| volseggs_testing::skip_device(name, &error.to_string())).ok()
}

/// The first compiled-in device.
pub(super) fn device() -> Device {
    DeviceName::all()[0].open().unwrap()
}

/// A built-in preset.
pub(super) fn preset(name: &str) -> Config {
    crate::preset(name).unwrap()
}

/// A built-in preset with the settings `few`, and `more` on top.
pub(super) fn changed(preset: &str, few: &[&str], more: &[&str]) -> Config {
    let sets = few.iter().chain(more).map(|set| (*set).to_owned());
    crate::layers().source(preset).sets(sets).resolve::<Config>().unwrap().value
}

/// The default configuration with a method and its section.
pub(super) fn with_section<S: Settings>(method: &str, settings: &S) -> Config {
    let mut config = Config { method: method.to_owned(), ..Config::default() };
    config.sections.set(settings);
    config
}

/// Edits the section of a method.
pub(super) fn change<S: Settings>(config: &mut Config, edit: impl FnOnce(&mut S)) {
    let mut settings = config.section::<S>().unwrap();
    edit(&mut settings);
    config.sections.set(&settings);
}

/// The parameters of a training's model, by name.
pub(super) fn parameters(training: &dyn Training) -> BTreeMap<String, HostTensor> {
    training.model().parameters()
}

/// The losses of `steps` steps.
pub(super) fn stepped(training: &mut dyn Training, data: &Dataset, steps: usize) -> Vec<f64> {
    (0..steps).map(|_| training.step(&data.train).unwrap().loss).collect()
}

/// `views` views of a ball, `size` pixels square, at two times.
pub(super) fn ball(views: usize, size: u32) -> Dataset {
    let folder = tempfile::tempdir().unwrap();
    write_sphere_dataset(folder.path(), views, size).unwrap();
    Dataset::open(folder.path(), &OpenOptions::default()).unwrap()
}

/// PSNR of the model's image of a training view, decibels.
pub(super) fn psnr(model: &dyn Model, split: &Split, view: usize) -> f64 {
    let frame = &split.frames[view];
    let picture = model.render(frame.camera.to_kernel(), frame.time as f32);
    let mut target = vec![0.0; picture.len() / 4 * 3];
    split.images.composite(view, model.background(), &mut target);
    let colours = picture.chunks_exact(4).flat_map(|p| &p[..3]);
    let squares: f64 = colours.zip(&target).map(|(a, b)| f64::from(a - b).powi(2)).sum();
    -10.0 * (squares / target.len() as f64).log10()
}

/// Parameters and moments after `steps` steps; with a `stop`, the training is saved and dropped there, and another one
/// resumes from its files.
pub(super) fn trained(
    method: &dyn Method,
    config: &Config,
    data: &Dataset,
    steps: usize,
    stop: Option<usize>,
) -> [BTreeMap<String, HostTensor>; 2] {
    let mut training = method.start(config, data, &device()).unwrap();
    for step in 0..steps {
        if stop == Some(step) {
            training = resumed(method, config, data, &*training);
        }
        let report = training.step(&data.train).unwrap();
        assert_eq!((report.step, training.steps_done()), (step, step + 1));
    }
    [training.model().parameters(), training.state()]
}

fn resumed(method: &dyn Method, config: &Config, data: &Dataset, old: &dyn Training) -> Box<dyn Training> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    old.model().save(&path).unwrap();
    let mut new = method.start(config, data, &device()).unwrap();
    let saved = SavedTraining {
        model: &path,
        state: old.state(),
        state_path: &path,
        step: old.steps_done(),
        first_primitives: old.first_primitives(),
    };
    new.resume(saved).unwrap();
    new
}

/// Asserts that a training of a built-in method, resumed from its checkpoint after `stop` steps, has the bits of one that
/// was not stopped, `more` steps later.
pub(super) fn check_checkpoint(config: &Config, data: &Dataset, stop: usize, more: usize) {
    let (text, folder) = (toml::to_string(config).unwrap(), tempfile::tempdir().unwrap());
    let mut whole = crate::start(config, data, &device()).unwrap();
    stepped(&mut *whole, data, stop);
    let (initial, dataset) = (whole.first_primitives(), data.fingerprint());
    let state = CheckpointState {
        step: stop,
        initial,
        dataset: dataset.clone(),
        config: text.clone(),
        seconds: 0.0,
        packed: false,
    };
    let path = checkpoint::save(folder.path(), &*whole, &state, 1).unwrap();
    stepped(&mut *whole, data, more);
    let mut resumed = crate::start(config, data, &device()).unwrap();
    checkpoint::restore(&path, &mut *resumed, &text, &dataset).unwrap();
    stepped(&mut *resumed, data, more);
    assert_eq!(resumed.model().parameters(), whole.model().parameters(), "{stop}");
    assert_eq!(resumed.state(), whole.state(), "{stop}");
}

/// Asserts that a training stopped and resumed is bit-identical to an uninterrupted one, and that a model saved and
/// opened draws bit-identical images.
pub(super) fn check_resume(method: &dyn Method, config: &Config, data: &Dataset) {
    let whole = trained(method, config, data, 5, None);
    let stopped = trained(method, config, data, 5, Some(3));
    assert_eq!(whole, stopped);
    assert_ne!(whole[0], trained(method, config, data, 4, None)[0]);

    let mut training = method.start(config, data, &device()).unwrap();
    training.step(&data.train).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    training.model().save(&path).unwrap();
    let opened = method.open(&path, &device()).unwrap();
    assert_eq!(opened.parameters(), training.model().parameters());
    assert_eq!((opened.counts(), opened.background(), opened.place()), {
        let model = training.model();
        (model.counts(), model.background(), model.place())
    });
    let camera = data.train.frames[0].camera.to_kernel();
    assert_eq!(opened.render(camera, 0.3), training.model().render(camera, 0.3));
}

/// A network run by ONNX Runtime, see `tests/networks_reference.py`: weights by this crate's names, inputs and
/// outputs as `check.NAME`.
pub(super) struct Reference(pub BTreeMap<String, HostTensor>);

impl Reference {
    /// The network of that name.
    pub fn read(network: &str) -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/networks.safetensors");
        let (tensors, _) = volseggs_core::model::scene_file::read_tensors(&path).unwrap();
        let start = format!("{network}.");
        Self(tensors.into_iter().filter_map(|(name, t)| Some((name.strip_prefix(&start)?.to_owned(), t))).collect())
    }

    /// An input.
    pub fn input<const D: usize>(&self, name: &str) -> Tensor<D> {
        let HostTensor { shape, values } = &self.0[&format!("check.{name}")];
        Tensor::from_data(TensorData::new(values.clone(), shape.clone()), &device())
    }

    /// Asserts that an output matches that of ONNX Runtime.
    pub fn check<const D: usize>(&self, name: &str, found: Tensor<D>) {
        let expected = &self.0[&format!("check.{name}")];
        assert_eq!(found.dims().to_vec(), expected.shape, "{name}");
        let largest = expected.values.iter().fold(1.0f32, |m, v| m.max(v.abs()));
        let off = to_vec(found).iter().zip(&expected.values).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(off < 2e-5 * largest, "{name}: off by {off}");
    }
}

/// Asserts that parameters after a few steps do not depend on the number of threads.
pub(super) fn check_threads(method: &dyn Method, config: &Config, data: &Dataset) {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| trained(method, config, data, 3, None))
    };
    assert_eq!(on(1), on(3));
}

/// The error for a file that the method did not write.
pub(super) fn error_of(
    method: &dyn Method,
    edit: impl FnOnce(&mut BTreeMap<String, HostTensor>),
    config: &Config,
    data: &Dataset,
) -> String {
    let training = method.start(config, data, &device()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    training.model().save(&path).unwrap();
    let (mut tensors, header) = volseggs_core::model::scene_file::read_tensors(&path).unwrap();
    edit(&mut tensors);
    let (name, spec) = header.iter().find(|(name, _)| !name.contains("digest")).unwrap();
    volseggs_core::model::scene_file::write_tensors(&path, &tensors, Some((name, spec.clone()))).unwrap();
    method.open(&path, &device()).unwrap_err().to_string()
}
