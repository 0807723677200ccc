//! `volseggs view`

use super::{CliError, Common, stop_flag};
use crate::memory::Bytes;
#[cfg(unix)]
use crate::shell;
#[cfg(unix)]
use crate::view::local;
use crate::view::{Serving, ViewError, ViewOptions, serve};
use clap::Args;
use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;

/// Look at a run in a browser: fly through space and time, click to segment, edit.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs view checkpoints/first\n  volseggs view checkpoints/first --port 8137 --read-only\n  volseggs view checkpoints/first --with checkpoints/second --with checkpoints/first/checkpoints/step-010000\n\nPrints an address with a secret in it: who has it can look at the run, and change segments and edits unless --read-only is given. Only programs on this machine reach it. From another one:\n  ssh -L 8137:localhost:8137 THIS_MACHINE\n  and open the printed address there. Where others share this machine, --socket FILE keeps them from the port too.\nCtrl-C ends it."
)]
pub struct ViewCommand {
    /// Folder of the run.
    run: PathBuf,
    /// Another run, or a checkpoint of one, to compare with: the page shows it beside this one, from the same camera and at
    /// the same time. May be given many times.
    #[arg(long = "with", value_name = "RUN")]
    with: Vec<PathBuf>,
    /// Port to listen on; any that is free if not given.
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    port: u16,
    /// Address to listen on. Any other than the default lets other machines reach it, without encryption.
    #[arg(long, value_name = "ADDRESS", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    bind: IpAddr,
    /// Listen at this socket file, which only you may use, and at no port; for `ssh -L 8137:FILE`. --port is then the one on
    /// your own machine. On Unix.
    #[arg(long, value_name = "FILE", conflicts_with = "bind")]
    socket: Option<PathBuf>,
    /// A name under which browsers reach it, beside localhost; may be given many times.
    #[arg(long = "allow-host", value_name = "NAME")]
    hosts: Vec<String>,
    /// Change nothing.
    #[arg(long)]
    read_only: bool,
    /// Memory for times that were shown, of all runs together: 100 times of 150,000 Gaussians without edits take 660M.
    #[arg(long, value_name = "SIZE", default_value = "1G")]
    cache: Bytes,
    #[command(flatten)]
    common: Common,
}

impl ViewCommand {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let options = ViewOptions {
            run: self.run,
            with: self.with,
            device,
            bind: self.bind,
            port: self.port,
            socket: self.socket,
            hosts: self.hosts,
            read_only: self.read_only,
            cache: usize::try_from(self.cache.0).unwrap_or(usize::MAX),
        };
        let stop = stop_flag("closing the viewer")?;
        serve(&options, &stop, |serving| {
            outln!("{}", serving.url);
            if !serving.address.ip().is_loopback() {
                errln!("note: other machines can reach this address, and what they send is not encrypted");
            }
            if let Some(line) = forwarding(serving) {
                errln!("on your own machine: {line}");
            }
            errln!("open it in a browser; Ctrl-C ends the viewer");
        })
        .map_err(|e| match e {
            ViewError::Run(error) => error.into(),
            ViewError::Address { .. } | ViewError::Socket { .. } => CliError::input(e),
            ViewError::System(_) => CliError::failure(e),
        })
    }
}

/// The command that reaches the viewer from the machine that somebody came from by ssh; for a socket file always one.
#[cfg(unix)]
fn forwarding(Serving { address, socket, .. }: &Serving) -> Option<String> {
    let port = address.port();
    let to = match socket {
        Some(path) => shell::path(&std::path::absolute(path).unwrap_or_else(|_| path.clone())),
        None => format!("localhost:{port}"),
    };
    let [connection, user] = ["SSH_CONNECTION", "USER"].map(|name| std::env::var(name).ok());
    let exact = connection.and_then(|connection| local::forwarding(&connection, user.as_deref(), port, &to));
    exact.or_else(|| socket.as_ref().map(|_| format!("ssh -L {port}:{to} THIS_MACHINE")))
}

#[cfg(not(unix))]
fn forwarding(_: &Serving) -> Option<String> {
    None
}
