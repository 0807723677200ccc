//! `volseggs eval`
use super::CliError;
use clap::Args;
/// x
#[derive(Debug, Args)]
pub struct EvalArgs {}
impl EvalArgs { pub(super) fn run(self) -> Result<(), CliError> { Ok(()) } }
