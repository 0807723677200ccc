//! `volseggs pack`

use super::{CliError, CommonArgs, print_json};
use crate::run::pack::pack;
use crate::shell;
use clap::Args;
use std::path::PathBuf;

/// Write a small copy of a run, with its scene in 8 and 16 bits, for keeping or sharing.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs pack checkpoints/first --out first-small\n  volseggs eval first-small            # the cost of rounding\n  volseggs view first-small\n\nThe copy has the newest scene, the segments, the affinity field and the edits. Every command works on it as on the run, except that it cannot be trained further: data that only training needs is omitted. Attributes of Gaussians are in fixed point, each with its own range: positions in 16 bits, all others in 8. The field is in half precision."
)]
pub struct PackArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Folder to write; an older packed run there is replaced, unless it holds results.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    #[command(flatten)]
    common: CommonArgs,
}

impl PackArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let packed = pack(&self.common.open(&self.run)?, &self.out)?;
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
        errln!("to measure the cost of rounding: volseggs eval {}", shell::path(&packed.run));
        Ok(())
    }
}
