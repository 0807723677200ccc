//! `volseggs train --view`

use super::CliError;
use super::serving::explain;
use crate::config::types::Config;
use crate::device::DeviceName;
use crate::method;
use crate::train::run::{RunContext, RunOutcome};
use crate::view::beside::beside;
use crate::view::listen::{ServingOptions, ViewerListener};
use burn::tensor::Device;
use clap::Args;

/// Whether and how a run is shown during training.
#[derive(Debug, Args)]
#[command(mut_group("serving", |group| group.requires("view")))]
pub struct WatchArgs {
    /// Serve the viewer during training: the scene as it develops, metrics, and a button to pause. The result is
    /// bit-identical to a training without it. The viewer ends with the training.
    #[arg(long)]
    view: bool,
    #[command(flatten, next_help_heading = "With --view")]
    serving: ServingOptions,
}

impl WatchArgs {
    /// Starts listening, if the run is to be shown.
    pub(super) fn listen(&self) -> Result<Option<ViewerListener>, CliError> {
        Ok(self.view.then(|| ViewerListener::open(&self.serving)).transpose()?)
    }

    /// Rejects showing the training of a method without persistent Gaussians.
    pub(super) fn check(&self, config: &Config) -> Result<(), CliError> {
        if !self.view || method::named_in(config)?.has_persistent_gaussians() {
            return Ok(());
        }
        Err(CliError::input(format!(
            "--view: only for Gaussians that stay the same over time, and the method {} has none",
            config.method
        )))
    }

    /// Trains on `device` while `listening` serves the viewer. The address is printed to standard output, or to standard error with
    /// `json`.
    pub(super) fn train(
        &self,
        listening: Option<ViewerListener>,
        json: bool,
        context: RunContext<'_>,
        device: &Device,
    ) -> Result<RunOutcome, CliError> {
        let Some(listening) = listening else { return Ok(method::train(context, device)?) };
        // a GPU is left to the training
        let drawn_on = DeviceName::cpu().and_then(|name| name.open().ok()).unwrap_or_else(|| device.clone());
        let serving = listening.serving().clone();
        let ready = || {
            if json {
                errln!("{}", serving.url);
            } else {
                outln!("{}", serving.url);
            }
            explain(&serving, "the viewer ends with the training; Ctrl-C ends both and saves a checkpoint");
        };
        let (outcome, served) =
            beside(listening, &drawn_on, ready, |observer| method::train(context.observed_by(observer), device));
        if let Err(error) = served {
            errln!("note: the viewer ended before the training did: {error}");
        }
        Ok(outcome?)
    }
}
