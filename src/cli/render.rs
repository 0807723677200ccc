//! `volseggs render`
use super::CliError;
use clap::Args;
/// x
#[derive(Debug, Args)]
pub struct RenderArgs {}
impl RenderArgs { pub(super) fn run(self) -> Result<(), CliError> { Ok(()) } }
