//! Training: a few views per step; a step of the discriminator, then one of the generator.

use super::discriminator::Discriminator;
use super::generator::{GROUPS, image_values, parameters};
use super::layers::BatchMoments;
use super::model::{INPUTS, InSituNet, InSituNetSpec};
use super::resize::resized;
use crate::insitunet::{AdversarialLoss, InSituNetConfig};
use crate::layers::softplus;
use crate::learner::{Learner, PYTORCH_ADAM};
use crate::pixels::PixelEpochs;
use crate::sphere::ViewSphere;
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor, TensorData};
use std::collections::BTreeMap;
use std::path::Path;
use volseggs_base::memory::{MemoryBudget, product};
use volseggs_base::rng::{Purpose, Rng};
use volseggs_core::config::types::Config;
use volseggs_core::metrics::lpips::{Lpips, LpipsNet};
use volseggs_core::model::params::{self, HostTensor};
use volseggs_core::model::{Model, ToKernel};
use volseggs_core::train::checkpoint::CheckpointError;
use volseggs_core::train::optimizer::AdamConstants;
use volseggs_core::train::watch::LossWatch;
use volseggs_core::train::{SavedTraining, StepReport, StepTimes, TrainError, Training, evaluation_background, timed};
use volseggs_volume::data::{Dataset, Split};

/// Prefix of the names of the discriminator's tensors in a checkpoint.
const CRITIC: &str = "discriminator.";

/// The note printed if features are requested but not available.
const NO_VGG: &str = "note: insitunet.vgg is not set: pixels are compared, not features of VGG-16; \
                      `volseggs lpips --help` says where its weights are published and makes the file";

/// A training in progress.
#[derive(Debug)]
pub struct InSituNetTraining {
    learner: Learner<InSituNet>,
    /// `None` if its score has no weight.
    critic: Option<Learner<Discriminator>>,
    vgg: Option<Lpips>,
    views: PixelEpochs,
    step: usize,
    watch: LossWatch,
    /// With gradients.
    device: Device,
}

impl InSituNetTraining {
    /// Starts a training on a device without gradients.
    ///
    /// # Errors
    /// If it does not fit into memory, or the weights of VGG cannot be read.
    pub fn new(
        settings: &InSituNetConfig,
        config: &Config,
        dataset: &Dataset,
        device: &Device,
    ) -> Result<Self, TrainError> {
        check_memory(settings, MemoryBudget::now())?;
        let split = &dataset.train;
        let background = evaluation_background(&config.data.background)?;
        let spec = InSituNetSpec { config: settings.clone(), sphere: ViewSphere::around(split), background };
        let [perceptual, _] = settings.comparison();
        let vgg = (perceptual > 0.0).then(|| vgg(Path::new(&settings.vgg), device)).transpose()?;
        if perceptual != settings.perceptual {
            errln!("{NO_VGG}");
        }
        let watch = LossWatch::new(device, config.output.checkpoint_every, settings.steps);
        let device = device.clone().autodiff();
        let adam = AdamConstants { betas: [settings.beta1, 0.999], ..PYTORCH_ADAM };
        let critic = (settings.adversarial > 0.0).then(|| {
            let mut rng = Rng::new(config.seed, 1, Purpose::MethodInit);
            Learner::new(Discriminator::new(settings, &mut rng, &device), adam)
        });
        let views = PixelEpochs::new(split.frames.len(), 1, 1, config.seed);
        let learner = Learner::new(InSituNet::new(spec, config.seed, &device), adam);
        Ok(Self { learner, critic, vgg, views, step: 0, watch, device })
    }

    fn spec(&self) -> &InSituNetSpec {
        &self.learner.module().spec
    }

    /// Inputs `[N, 4]` and images `[N, 3, side, side]` in [-1, 1] of the views of the step; each view occurs once per
    /// round.
    fn batch(&self, split: &Split) -> (Tensor<2>, Tensor<4>) {
        let spec = self.spec();
        let n = spec.config.batch;
        let (width, height) = (split.images.width as usize, split.images.height as usize);
        let (mut inputs, mut images) = (Vec::with_capacity(n * INPUTS), Vec::with_capacity(n * 3 * width * height));
        let mut image = vec![0.0; 3 * width * height];
        for view in self.views.of_step(self.step, n) {
            let frame = &split.frames[view.view];
            inputs.extend(spec.inputs(&frame.camera.to_kernel(), frame.time as f32));
            split.images.composite(view.view, spec.background, &mut image);
            images.extend((0..3).flat_map(|c| image[c..].iter().step_by(3).map(|v| 2.0 * v - 1.0)));
        }
        let inputs = Tensor::from_data(TensorData::new(inputs, [n, INPUTS]), &self.device);
        let images = Tensor::<4>::from_data(TensorData::new(images, [n, 3, height, width]), &self.device);
        (inputs, resized(images, [spec.config.side(); 2]))
    }

    /// Performs a step of the discriminator on real and generated images.
    fn judge(&mut self, truth: &Tensor<4>, made: &Tensor<4>, inputs: &Tensor<2>) -> Result<(), TrainError> {
        let (settings, step) = (self.spec().config.clone(), self.step);
        let Some(critic) = &mut self.critic else { return Ok(()) };
        critic.change(Discriminator::follow);
        let score = |pictures: &Tensor<4>| critic.module().forward(pictures.clone(), inputs.clone());
        let (of_truth, of_made) = (score(truth), score(&made.clone().detach()));
        let loss = match settings.adversarial_loss {
            AdversarialLoss::Vanilla => softplus(of_truth.neg()).mean() + softplus(of_made).mean(),
            AdversarialLoss::Hinge => {
                relu(of_truth.neg().add_scalar(1.0)).mean() + relu(of_made.add_scalar(1.0)).mean()
            }
        };
        let mut gradients = loss.backward();
        critic.update(step, &mut gradients, |_| Some(settings.critic_rate))
    }

    /// The generator's loss, and the mean squared difference of colours, for PSNR.
    fn loss(&self, truth: Tensor<4>, made: Tensor<4>, inputs: Tensor<2>) -> [Tensor<1>; 2] {
        let settings = &self.spec().config;
        let pixel = (made.clone() - truth.clone()).square().mean();
        // colours span 2 here, but 1 where PSNR is measured
        let squared = pixel.clone().detach().mul_scalar(0.25);
        let [of_features, of_pixels] = settings.comparison();
        let mut terms = Vec::new();
        if of_pixels > 0.0 {
            terms.push(pixel.mul_scalar(of_pixels));
        }
        if let Some(vgg) = &self.vgg {
            let [made, truth] = [made.clone(), truth].map(|images| vgg.first_features(images));
            terms.push((made - truth).square().mean().mul_scalar(of_features));
        }
        if let Some(critic) = &self.critic {
            let score = critic.module().forward(made, inputs);
            let loss = match settings.adversarial_loss {
                AdversarialLoss::Vanilla => softplus(score.neg()).mean(),
                AdversarialLoss::Hinge => score.neg().mean(),
            };
            terms.push(loss.mul_scalar(settings.adversarial));
        }
        let sum = terms.into_iter().reduce(|a, b| a + b);
        [sum.unwrap_or_else(|| unreachable!("perceptual and pixel are not both 0")), squared]
    }
}

impl Training for InSituNetTraining {
    fn total_steps(&self) -> usize {
        self.spec().config.steps
    }

    fn steps_done(&self) -> usize {
        self.step
    }

    fn step(&mut self, split: &Split) -> Result<StepReport, TrainError> {
        let mut times = StepTimes::default();
        let (inputs, truth) = timed(&mut times.data, || self.batch(split));
        let mut seen: Vec<BatchMoments> = Vec::new();
        let forward = || self.learner.module().generator.forward(inputs.clone(), Some(&mut seen));
        let made = timed(&mut times.deform, forward);
        let loss = timed(&mut times.loss, || {
            self.judge(&truth, &made, &inputs)?;
            let [loss, squared] = self.loss(truth, made, inputs);
            self.watch.check(self.step, &loss, || squared).map(|()| loss)
        })?;
        let mut gradients = timed(&mut times.backward, || loss.backward());
        let rate = self.spec().config.rate;
        timed(&mut times.adam, || self.learner.update(self.step, &mut gradients, |_| Some(rate)))?;
        timed(&mut times.adam, || self.learner.change(|model| model.generator.renew(seen)));
        self.step += 1;
        Ok(self.watch.report(self.step - 1, times))
    }

    fn model(&self) -> &dyn Model {
        self.learner.module()
    }

    fn state(&self) -> BTreeMap<String, HostTensor> {
        let mut state = self.learner.state();
        if let Some(critic) = &self.critic {
            let tensors = params::collect(critic.module()).into_iter().chain(critic.state());
            state.extend(tensors.map(|(name, tensor)| (format!("{CRITIC}{name}"), tensor)));
        }
        state
    }

    fn resume(&mut self, from: SavedTraining<'_>) -> Result<(), CheckpointError> {
        let model = InSituNet::read(from.model, &self.device)?;
        let mut of_critic = BTreeMap::new();
        let mut of_generator = BTreeMap::new();
        for (name, tensor) in from.state {
            match name.strip_prefix(CRITIC) {
                Some(name) => of_critic.insert(name.to_owned(), tensor),
                None => of_generator.insert(name, tensor),
            };
        }
        if let Some(critic) = &mut self.critic {
            let module = params::load(critic.module().clone(), &of_critic);
            let module =
                module.map_err(|e| CheckpointError::File { path: from.state_path.into(), reason: e.to_string() })?;
            critic.resume(module, &of_critic, from.state_path, &self.device)?;
        }
        self.learner.resume(model, &of_generator, from.state_path, &self.device)?;
        self.step = from.step;
        Ok(())
    }
}

fn vgg(path: &Path, device: &Device) -> Result<Lpips, TrainError> {
    let vgg = Lpips::load(path, device).map_err(|e| TrainError::Config(format!("insitunet.vgg: {e}")))?;
    match vgg.net() {
        LpipsNet::Vgg => Ok(vgg),
        LpipsNet::Alex => Err(TrainError::Config(format!("insitunet.vgg: {} holds AlexNet, not VGG", path.display()))),
    }
}

fn check_memory(settings: &InSituNetConfig, budget: MemoryBudget) -> Result<(), TrainError> {
    let [trained, statistics] = parameters(settings, &GROUPS);
    // parameters, gradients and moments; about eight images are kept per block
    let numbers = trained.saturating_add(statistics).saturating_mul(5);
    let images = image_values(settings).saturating_mul(product(&[settings.batch, 8]));
    let what = format!("insitunet.batch = {} with this many channels", settings.batch);
    let bytes = numbers.saturating_add(images).saturating_mul(4);
    budget.check(what, bytes).map_err(|e| TrainError::Config(e.to_string()))
}
