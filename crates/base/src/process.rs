//! This process: what it needs to start, and how it meets the limits of the system. Other processes and machines as
//! reported by Linux, to find out who made a file and whether that process is still running.

use crate::memory::{Bytes, address_space};
use std::fs;

/// Address space that the program needs to start, besides its own code, and for each thread (a stack of 2 MiB, and the
/// allocator's first pages), in bytes: with less, it would be aborted without a message that says why.
const NEEDED: u64 = 64 << 20;
const NEEDED_PER_THREAD: u64 = 8 << 20;

/// Why the program cannot start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The system gives no threads.
    #[error(
        "cannot start {threads} threads: {problem}; raise the limit of processes (ulimit -u, or pids.max of the \
         container) or of memory (ulimit -v), or set RAYON_NUM_THREADS to a smaller number"
    )]
    Threads {
        /// Number of threads.
        threads: usize,
        /// What the system reports.
        problem: String,
    },
    /// The address space is too small.
    #[error(
        "the limit of the address space (ulimit -v) leaves {}, but the program needs {} to start; raise it",
        Bytes(*left),
        Bytes(*needed)
    )]
    Memory {
        /// Bytes.
        left: u64,
        /// Bytes.
        needed: u64,
    },
}

/// Starts the threads that compute. Called once, before any other code uses them, which could only panic if there were
/// none.
///
/// # Errors
/// [`StartError`].
pub fn start_threads() -> Result<(), StartError> {
    let chosen = std::env::var("RAYON_NUM_THREADS").ok().and_then(|n| n.parse().ok()).filter(|n| *n > 0);
    let threads = chosen.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
    let needed = NEEDED.saturating_add(NEEDED_PER_THREAD.saturating_mul(threads as u64));
    if let Some(left) = address_space().filter(|left| *left < needed) {
        return Err(StartError::Memory { left, needed });
    }
    let built = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    built.map_err(|e| StartError::Threads { threads, problem: e.to_string() })
}

/// Lets writing beyond the limit of file sizes (`ulimit -f`) fail like writing to a full disk, so that it is reported and
/// cleaned up; by default, the system ends the process at once.
pub fn report_file_limits() {
    // SAFETY: the call changes what the system does on one signal, and runs before there are other threads.
    #[cfg(unix)]
    unsafe {
        libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
    }
}

/// Name of this machine; `None` if the system does not report it.
pub fn host_name() -> Option<String> {
    fs::read_to_string("/proc/sys/kernel/hostname").ok().map(|name| name.trim().to_owned())
}

/// Start time of a process on this machine, in the system's ticks; `None` if there is no process with this id, or only
/// a zombie.
pub fn birth(pid: u32) -> Option<u64> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // the name in parentheses may hold spaces; the state follows it, and the start time is the 22nd field
    let (_, rest) = stat.rsplit_once(')')?;
    let fields: Vec<&str> = rest.split_whitespace().collect();
    (!matches!(fields.first(), Some(&("Z" | "X")))).then(|| fields.get(19)?.parse().ok())?
}

/// The user that this process runs as: `ada, uid 1000`, without a name where `/etc/passwd` has none. Variables of the
/// environment do not count, as they can say anything. `None` if the system does not tell.
pub fn user() -> Option<String> {
    let uid = uid()?;
    let accounts = fs::read_to_string("/etc/passwd").unwrap_or_default();
    let name = accounts.lines().find_map(|line| name_of(line, uid));
    Some(name.map_or_else(|| format!("uid {uid}"), |name| format!("{name}, uid {uid}")))
}

/// The name in a line of `/etc/passwd`, if it is that of `uid`.
fn name_of(line: &str, uid: u32) -> Option<&str> {
    let mut fields = line.split(':');
    let name = fields.next().filter(|name| !name.is_empty() && !name.chars().any(char::is_control))?;
    (fields.nth(1)?.parse() == Ok(uid)).then_some(name)
}

#[cfg(any(target_os = "linux", target_os = "macos"))]
fn uid() -> Option<u32> {
    Some(rustix::process::geteuid().as_raw())
}

#[cfg(not(any(target_os = "linux", target_os = "macos")))]
fn uid() -> Option<u32> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn users_are_known_by_their_number() {
        assert_eq!(name_of("ada:x:1000:1000:Ada:/home/ada:/bin/sh", 1000), Some("ada"));
        for line in ["ada:x:1000:1000:Ada:/home/ada:/bin/sh", "", ":x:7", "ada:x", "ada:x:y"] {
            assert_eq!(name_of(line, 7), None, "{line}");
        }
        #[cfg(target_os = "linux")]
        assert!(user().is_some_and(|user| user.contains(&format!("uid {}", rustix::process::geteuid().as_raw()))));
    }
}
