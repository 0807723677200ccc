//! What `volseggs view` and `volseggs train --view` share: the messages about where the viewer listens.

#[cfg(unix)]
use crate::shell;
use crate::view::listen::ViewerAddress;
#[cfg(unix)]
use crate::view::local;

/// Prints what a user has to know besides the address.
pub(super) fn explain(serving: &ViewerAddress, end: &str) {
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
fn forwarding(ViewerAddress { address, socket, .. }: &ViewerAddress) -> Option<String> {
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
fn forwarding(_: &ViewerAddress) -> Option<String> {
    None
}
