//! `volseggs view`

use super::data::DataArgs;
use super::serving::explain;
use super::{CliError, CommonArgs, stop_flag};
use crate::view::listen::{ServingOptions, ViewerAddress};
use crate::view::others::ComparedRun;
use crate::view::serve;
use crate::view::workspace::Workspace;
use clap::Args;
use std::path::PathBuf;

/// View a run in a browser: fly through space and time, click to segment, edit.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs view checkpoints/first\n  volseggs view checkpoints/first --port 8137 --read-only\n  volseggs view checkpoints/first --with checkpoints/second --with checkpoints/first/checkpoints/step-010000\n\nPrints an address that contains a secret: anyone who has it can view the run and, unless --read-only is given, change segments and edits. Only programs on this machine can reach it. From another machine, run\n  ssh -L 8137:localhost:8137 THIS_MACHINE\n  and open the printed address there. If others use this machine too, --socket FILE keeps them out as well.\nCtrl-C ends the viewer."
)]
pub struct ViewCommand {
    /// Folder of the run.
    run: PathBuf,
    /// Another run, or a checkpoint of one, to compare with: the page shows it beside this one, from the same camera
    /// and at the same time. May be repeated.
    #[arg(long = "with", value_name = "RUN")]
    with: Vec<PathBuf>,
    #[command(flatten)]
    data: DataArgs,
    #[command(flatten)]
    serving: ServingOptions,
    #[command(flatten)]
    common: CommonArgs,
}

impl ViewCommand {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let stop = stop_flag("closing the viewer")?;
        let space = Workspace::open(&self.run, self.data.data.as_deref(), &device, self.serving.read_only)?;
        let others = ComparedRun::open(&self.with, &device)?;
        serve(space, others, &self.serving, &stop, |serving| {
            if self.common.json {
                let ViewerAddress { url, address, socket } = serving;
                // an address without the file name's odd bytes is still an address
                let socket = socket.as_ref().map(|path| path.to_string_lossy());
                outln!("{}", serde_json::json!({ "url": url, "address": address.to_string(), "socket": socket }));
            } else {
                outln!("{}", serving.url);
            }
            explain(serving, "Ctrl-C ends the viewer");
        })?;
        Ok(())
    }
}
