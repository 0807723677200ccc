//! `volseggs pack`

use super::{CliError, Common, print_json};
use crate::run::OpenRun;
use crate::run::pack::pack;
use crate::shell;
use clap::Args;
use std::path::PathBuf;

/// Write a small copy of a run, with its scene in 8 and 16 bits, for keeping or sharing.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs pack checkpoints/first --out first-small\n  volseggs eval first-small            # what the rounding costs\n  volseggs view first-small\n\nThe copy has the newest scene, the segments, the affinity field and the edits. Every command works on it as on the run, but that it cannot be trained on: what only training needs is left out. Attributes of Gaussians are in fixed point with ranges of their own, positions in 16 bits and all others in 8; the field is in half precision."
)]
pub struct PackArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Folder to write; an older packed run there is replaced.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    #[command(flatten)]
    common: Common,
}

impl PackArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let packed = pack(&OpenRun::open(&self.run, &device)?, &self.out)?;
        if self.common.json {
            return print_json(&packed);
        }
        let [before, after] = [packed.scene_bytes_before, packed.scene_bytes].map(|bytes| bytes as f64 / 1e6);
        outln!(
            "{}: {} Gaussians in {after:.2} MB, {:.0} % of {before:.2}",
            packed.run.display(),
            packed.gaussians,
            100.0 * after / before
        );
        errln!("what the rounding costs: volseggs eval {}", shell::path(&packed.run));
        Ok(())
    }
}
