//! What `volseggs view` and `volseggs train --view` share: where the viewer listens, and the messages about it.

use super::CliError;
use crate::memory::Bytes;
#[cfg(unix)]
use crate::shell;
use crate::view::listen::{Reach, Serving, ViewError};
#[cfg(unix)]
use crate::view::local;
use clap::Args;
use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;

/// How the viewer is served.
#[derive(Debug, Args)]
#[group(id = "serving")]
pub struct ServingArgs {
    /// Port to listen on; any free one if not given.
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    port: u16,
    /// Address to listen on. Any other than the default makes the viewer reachable from other machines, without
    /// encryption.
    #[arg(long, value_name = "ADDRESS", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    bind: IpAddr,
    /// Listen on this socket file, accessible only to you, instead of a port; for `ssh -L 8137:FILE`. --port is then
    /// the port on your own machine. Unix only.
    #[arg(long, value_name = "FILE", conflicts_with = "bind")]
    socket: Option<PathBuf>,
    /// A name under which browsers reach the viewer, besides localhost; may be repeated.
    #[arg(long = "allow-host", value_name = "NAME")]
    hosts: Vec<String>,
    /// Allow no changes: no segments or edits, and no pausing of a training.
    #[arg(long)]
    pub(super) read_only: bool,
    /// Memory for cached times, over all runs: 100 times of 150,000 Gaussians without edits take 660M.
    #[arg(long, value_name = "SIZE", default_value = "1G", allow_hyphen_values = true)]
    cache: Bytes,
}

impl ServingArgs {
    /// Where the viewer is to be reached.
    pub(super) fn reach(&self) -> Reach {
        Reach { bind: self.bind, port: self.port, socket: self.socket.clone(), hosts: self.hosts.clone() }
    }

    /// Maximum size in bytes of the cached deformed Gaussians.
    pub(super) fn cache(&self) -> usize {
        usize::try_from(self.cache.0).unwrap_or(usize::MAX)
    }
}

impl From<ViewError> for CliError {
    fn from(error: ViewError) -> Self {
        match error {
            ViewError::Run(error) => error.into(),
            ViewError::Address { .. } | ViewError::Socket { .. } => Self::input(error),
            ViewError::System(_) => Self::failure(error),
        }
    }
}

/// Prints what a user has to know besides the address.
pub(super) fn explain(serving: &Serving, end: &str) {
    if !serving.address.ip().is_loopback() {
        errln!("note: other machines can reach this address, and connections are not encrypted");
    }
    if let Some(line) = forwarding(serving) {
        errln!("on your own machine: {line}");
    }
    errln!("open it in a browser; {end}");
}

/// The command that reaches the viewer from the machine from which the user connected by ssh; always given for a socket
/// file.
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
