//! `volseggs export`
use super::CliError;
use clap::Args;
/// x
#[derive(Debug, Args)]
pub struct ExportArgs {}
impl ExportArgs { pub(super) fn run(self) -> Result<(), CliError> { Ok(()) } }
