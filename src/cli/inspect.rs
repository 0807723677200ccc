//! `volseggs inspect`
use super::CliError;
use clap::Args;
/// x
#[derive(Debug, Args)]
pub struct InspectArgs {}
impl InspectArgs { pub(super) fn run(self) -> Result<(), CliError> { Ok(()) } }
