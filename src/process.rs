//! Processes and machines as Linux tells of them: who made a file, and whether they still live.

use std::fs;

/// Name of this machine; none where the system does not tell.
#[must_use]
pub fn host_name() -> Option<String> {
    fs::read_to_string("/proc/sys/kernel/hostname").ok().map(|name| name.trim().to_owned())
}

/// When a process of this machine began, in the system's ticks; none if there is none of that id, or it is a dead one not
/// yet waited for.
#[must_use]
pub fn birth(pid: u32) -> Option<u64> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // the name in parentheses may hold spaces; the state comes after it, the start is the 22nd field
    let (_, rest) = stat.rsplit_once(')')?;
    let fields: Vec<&str> = rest.split_whitespace().collect();
    (!matches!(fields.first(), Some(&("Z" | "X")))).then(|| fields.get(19)?.parse().ok())?
}
