//! `volseggs doctor`
use super::CliError;
use clap::Args;
/// x
#[derive(Debug, Args)]
pub struct DoctorArgs {}
impl DoctorArgs { pub(super) fn run(self) -> Result<(), CliError> { Ok(()) } }
