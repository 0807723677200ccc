//! A socket file instead of a port: only its owner can connect, and `ssh -L PORT:FILE` reaches it.

use std::io::{self, ErrorKind};
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use tokio::net::UnixListener;

/// A socket file, which is removed when this is dropped.
#[derive(Debug)]
pub struct SocketFile(PathBuf);

impl SocketFile {
    /// Listens at `path`, which only its owner may read and write (0600). A socket on which nobody listens any more is
    /// replaced. Must be called within a runtime.
    ///
    /// # Errors
    /// If something else exists there, another viewer listens there, or the system refuses.
    pub fn listen(path: &Path) -> io::Result<(Self, UnixListener)> {
        match path.symlink_metadata() {
            Err(e) if e.kind() == ErrorKind::NotFound => {}
            Err(e) => return Err(e),
            Ok(found) if !found.file_type().is_socket() => {
                return Err(io::Error::new(ErrorKind::AlreadyExists, "the path exists and is not a socket"));
            }
            Ok(_) => match UnixStream::connect(path) {
                Err(e) if e.kind() == ErrorKind::ConnectionRefused => std::fs::remove_file(path)?,
                _ => return Err(io::Error::new(ErrorKind::AddrInUse, "another viewer listens there")),
            },
        }
        // never with the permissions of an ordinary file, even for a moment
        let before = rustix::process::umask(rustix::fs::Mode::from_raw_mode(0o177));
        let listener = UnixListener::bind(path);
        rustix::process::umask(before);
        Ok((Self(path.to_owned()), listener?))
    }
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        // it may be gone already
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Returns the command that forwards `port` of the user's own machine to `to` on this one, which the value of
/// `SSH_CONNECTION` describes; `None` if it does not.
pub fn forwarding(connection: &str, user: Option<&str>, port: u16, to: &str) -> Option<String> {
    // client address, client port, address of this machine, its port
    let [_, _, host, ssh_port] = connection.split_whitespace().collect::<Vec<_>>()[..] else { return None };
    let user = user.map_or(String::new(), |user| format!("{user}@"));
    let with = if ssh_port == "22" { String::new() } else { format!("-p {ssh_port} ") };
    Some(format!("ssh {with}-L {port}:{to} {}", crate::shell::quote(&format!("{user}{host}"))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ssh_command_names_this_machine_as_it_was_reached() {
        let line = |connection, user| forwarding(connection, user, 8137, "localhost:8137");
        let usual = line("10.0.0.2 51234 10.0.0.9 22", Some("ada"));
        assert_eq!(usual.unwrap(), "ssh -L 8137:localhost:8137 ada@10.0.0.9");
        assert_eq!(line("::1 5 fe80::1 2222", None).unwrap(), "ssh -p 2222 -L 8137:localhost:8137 fe80::1");
        assert_eq!(line("", None), None);
        assert_eq!(line("a b c", None), None);
    }

    #[test]
    fn only_a_dead_socket_is_replaced() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build().unwrap();
        let _inside = runtime.enter();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s");
        std::fs::write(&path, "mine").unwrap();
        assert!(SocketFile::listen(&path).unwrap_err().to_string().contains("is not a socket"));
        std::fs::remove_file(&path).unwrap();
        let (file, listener) = SocketFile::listen(&path).unwrap();
        assert!(SocketFile::listen(&path).unwrap_err().to_string().contains("another viewer"));
        // as if its process was killed: the file stays
        std::mem::forget(file);
        drop(listener);
        let (file, _listener) = SocketFile::listen(&path).unwrap();
        drop(file);
        assert!(!path.exists());
    }
}
