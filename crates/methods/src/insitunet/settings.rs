//! `insitunet.*`

use crate::ranges::{above_zero, at_least_one, not_negative};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use volseggs_core::config::sections::Settings;

/// `insitunet.*`: networks and training of InSituNet. The defaults are the published settings, enlarged to images of
/// 1024x1024 pixels as in the VolSegGS paper.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct InSituNetConfig {
    /// Channels of the generator at 4x4 pixels and after each block, which doubles the side: its images have a width
    /// and height of 4 * 2^(blocks) pixels.
    pub channels: Vec<usize>,
    /// Channels of the discriminator after each block, which halves the side; as many values as the generator has
    /// blocks.
    pub critic_channels: Vec<usize>,
    /// Width of the layers that encode the time and the view direction.
    pub encoder: usize,
    /// Number of steps.
    pub steps: usize,
    /// Views per step.
    pub batch: usize,
    /// Learning rate of the generator.
    pub rate: f64,
    /// Learning rate of the discriminator.
    pub critic_rate: f64,
    /// First decay rate of Adam.
    pub beta1: f64,
    /// Weight of the mean squared difference of VGG features.
    pub perceptual: f64,
    /// File with the weights of VGG-16 as written by `volseggs lpips`; if empty, pixels are compared instead of
    /// features.
    pub vgg: String,
    /// Weight of the mean squared difference of pixels in [-1, 1].
    pub pixel: f64,
    /// Weight of the discriminator's score; 0 for no discriminator.
    pub adversarial: f64,
    /// Loss of the discriminator.
    pub adversarial_loss: AdversarialLoss,
    /// Whether the weights of its layers are divided by their largest singular value.
    pub spectral_norm: bool,
}

/// Loss of the discriminator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum AdversarialLoss {
    /// The logistic loss of the original generative adversarial networks.
    Vanilla,
    /// Hinge loss, zero beyond a margin of 1.
    Hinge,
}

impl Settings for InSituNetConfig {
    const SECTION: &'static str = "insitunet";
    const MAY_CHANGE: &'static [&'static str] = &["vgg"];
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
    /// Rejects settings that no training can start with.
    ///
    /// # Errors
    /// The first invalid key with its value, and the values allowed.
    pub fn check(&self) -> Result<(), String> {
        for (key, channels) in [("channels", &self.channels), ("critic_channels", &self.critic_channels)] {
            if channels.contains(&0) {
                return Err(format!("insitunet.{key} = {channels:?}: each at least 1"));
            }
        }
        if !(2..=13).contains(&self.channels.len()) {
            let n = self.channels.len();
            return Err(format!("insitunet.channels: {n} values; between 2 and 13, for images of 8 to 16384 pixels"));
        }
        if self.critic_channels.len() + 1 != self.channels.len() {
            return Err(format!(
                "insitunet.critic_channels: {} values; must be one fewer than insitunet.channels, which has {}",
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
        // 1 in `f32` would cause a division by zero
        if !(0.0..=0.999_999).contains(&self.beta1) {
            return Err(format!("insitunet.beta1 = {:?}: between 0 and 0.999999", self.beta1));
        }
        if self.perceptual == 0.0 && self.pixel == 0.0 {
            return Err("insitunet.perceptual and insitunet.pixel are both 0: set one of them above 0".into());
        }
        Ok(())
    }

    /// The weights of the feature and pixel differences. Without a VGG file there are no features, and pixels replace
    /// them.
    pub fn comparison(&self) -> [f64; 2] {
        match (self.vgg.is_empty(), self.pixel > 0.0) {
            (false, _) => [self.perceptual, self.pixel],
            (true, true) => [0.0, self.pixel],
            (true, false) => [0.0, self.perceptual],
        }
    }

    /// Width and height of the generator's images, pixels.
    pub fn side(&self) -> usize {
        4 << self.channels.len().saturating_sub(1)
    }
}
