//! `insitunet.*`

use super::{above_zero, at_least_one, not_negative};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `insitunet.*`: the networks and the training of InSituNet. The defaults are the published settings, enlarged to images of
/// 1024x1024 pixels as VolSegGS did.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InSituNetConfig {
    /// Channels of the generator at 4x4 pixels and after each block, which doubles the side: pictures are
    /// 4 * 2^(blocks) pixels wide and high.
    pub channels: Vec<usize>,
    /// Channels of the discriminator after each block, which halves the side; as many as the generator's blocks.
    pub critic_channels: Vec<usize>,
    /// Width of the layers that take in the time and the direction of view.
    pub encoder: usize,
    /// Steps.
    pub steps: usize,
    /// Views a step.
    pub batch: usize,
    /// Learning rate of the generator.
    pub rate: f64,
    /// Learning rate of the discriminator.
    pub critic_rate: f64,
    /// First decay of Adam.
    pub beta1: f64,
    /// Weight of the mean squared difference of features of a VGG network.
    pub perceptual: f64,
    /// File with the weights of VGG-16 that `volseggs lpips` makes; empty for none: pixels are then compared in the place of
    /// features.
    pub vgg: String,
    /// Weight of the mean squared difference of pixels in [-1, 1].
    pub pixel: f64,
    /// Weight of the discriminator's verdict; 0 for no discriminator.
    pub adversarial: f64,
    /// How the discriminator is trained.
    pub adversarial_loss: AdversarialLoss,
    /// Whether its layers are divided by their largest singular value.
    pub spectral_norm: bool,
}

/// What the discriminator minimises.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum AdversarialLoss {
    /// The logistic loss of the first generative adversarial networks.
    Vanilla,
    /// Nothing beyond a margin of 1.
    Hinge,
}

impl Default for InSituNetConfig {
    fn default() -> Self {
        Self {
            channels: vec![1024, 1024, 512, 512, 256, 128, 64, 64, 64],
            critic_channels: vec![64, 64, 64, 128, 256, 512, 512, 1024],
            encoder: 512,
            steps: 125_000,
            batch: 4,
            rate: 1e-3,
            critic_rate: 1e-3,
            beta1: 0.9,
            perceptual: 1.0,
            vgg: String::new(),
            pixel: 0.0,
            adversarial: 1e-2,
            adversarial_loss: AdversarialLoss::Vanilla,
            spectral_norm: true,
        }
    }
}

impl InSituNetConfig {
    /// Refuses settings that no training can start with.
    ///
    /// # Errors
    /// The first such key with its value, and what it may be.
    pub fn check(&self) -> Result<(), String> {
        for (key, channels) in [("channels", &self.channels), ("critic_channels", &self.critic_channels)] {
            if channels.contains(&0) {
                return Err(format!("insitunet.{key} = {channels:?}: each at least 1"));
            }
        }
        if !(2..=13).contains(&self.channels.len()) {
            let n = self.channels.len();
            return Err(format!("insitunet.channels: {n} values; between 2 and 13, for pictures of 8 to 16384 pixels"));
        }
        if self.critic_channels.len() + 1 != self.channels.len() {
            return Err(format!(
                "insitunet.critic_channels: {} values; one less than insitunet.channels, which has {}",
                self.critic_channels.len(),
                self.channels.len()
            ));
        }
        at_least_one(&[
            ("insitunet.encoder", self.encoder),
            ("insitunet.steps", self.steps),
            ("insitunet.batch", self.batch),
        ])?;
        above_zero(&[("insitunet.rate", self.rate), ("insitunet.critic_rate", self.critic_rate)])?;
        not_negative(&[
            ("insitunet.perceptual", self.perceptual),
            ("insitunet.pixel", self.pixel),
            ("insitunet.adversarial", self.adversarial),
        ])?;
        // 1 in single precision would divide by zero
        if !(0.0..=0.999_999).contains(&self.beta1) {
            return Err(format!("insitunet.beta1 = {:?}: between 0 and 0.999999", self.beta1));
        }
        if self.perceptual == 0.0 && self.pixel == 0.0 {
            return Err("insitunet.perceptual and insitunet.pixel are both 0: nothing says what a picture shows".into());
        }
        Ok(())
    }

    /// What the differences of features and of pixels count: without a file of VGG there are no features, and pixels take
    /// their place.
    #[must_use]
    pub fn comparison(&self) -> [f64; 2] {
        match (self.vgg.is_empty(), self.pixel > 0.0) {
            (false, _) => [self.perceptual, self.pixel],
            (true, true) => [0.0, self.pixel],
            (true, false) => [0.0, self.perceptual],
        }
    }

    /// Width and height of the generator's pictures, pixels.
    #[must_use]
    pub fn side(&self) -> usize {
        4 << self.channels.len().saturating_sub(1)
    }
}
