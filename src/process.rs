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

/// The user that this process runs as: `ada, uid 1000`, without a name where `/etc/passwd` has none. Variables of the
/// environment do not count, as they can say anything. `None` if the system does not tell.
#[must_use]
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
