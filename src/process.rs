//! Processes and machines as reported by Linux, to find out who made a file and whether that process is still running.

use std::fs;

/// Name of this machine; `None` if the system does not report it.
#[must_use]
pub fn host_name() -> Option<String> {
    fs::read_to_string("/proc/sys/kernel/hostname").ok().map(|name| name.trim().to_owned())
}

/// Start time of a process on this machine, in the system's ticks; `None` if there is no process with this id, or only
/// a zombie.
#[must_use]
pub fn birth(pid: u32) -> Option<u64> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // the name in parentheses may hold spaces; the state follows it, and the start time is the 22nd field
    let (_, rest) = stat.rsplit_once(')')?;
    let fields: Vec<&str> = rest.split_whitespace().collect();
    (!matches!(fields.first(), Some(&("Z" | "X")))).then(|| fields.get(19)?.parse().ok())?
}
